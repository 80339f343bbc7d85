#include <convoy/frontend/frozen_landmarks.hpp>
#include <convoy/frontend/range_bearing_ekf.hpp>
#include <convoy/geometry/groups.hpp>

#include "../../support/front_end_contract.hpp"
#include "range_bearing_world.hpp"

#include <gtest/gtest.h>
#include <Eigen/Eigenvalues>

#include <limits>

namespace convoy {
namespace {

template <class G>
struct RangeBearingDrive {
  using Group = G;
  FrontEnd<G>& front_end() { return world.filter(); }
  void run(const std::function<void()>& after_input) {
    world.drive(60.0, 0.03, after_input);
    world.drive(60.0, -0.05, after_input);
    world.drive(30.0, 0.0, after_input);
    world.filter().finish();
    after_input();
  }
  static RangeBearingEkfParams params() {
    RangeBearingEkfParams p = test::quiet_params();
    p.trail_spacing_m = 1.0;
    return p;
  }
  test::RangeBearingWorld<G> world{params(), 11};
};

template <class G>
struct FrozenDrive {
  using Group = G;
  FrontEnd<G>& front_end() { return landmarks; }
  void run(const std::function<void()>& after_input) {
    test::Random random(5);
    FrontEndState<G> state;
    for (int k = 1; k <= 200; ++k) {
      state.stamp_s = 0.5 * k;
      state.abscissa_m = k;
      typename G::Tangent motion = G::Tangent::Constant(0.02), variance = G::Tangent::Constant(1e-4);
      motion[0] = 1.0;
      variance.template tail<G::Dof - G::Dim>() *= 0.01;
      state.pose = state.pose * G::Exp(motion);
      const typename G::Covariance step = variance.asDiagonal();
      state.slam_drift += state.pose.adjoint() * step * state.pose.adjoint().transpose();
      ASSERT_TRUE(landmarks.advance(state));
      if (k % 25 == 0) {
        std::vector<FrozenLandmark<G>> frozen;
        const auto batch = test::frozen_batch(random, {{1, 1}, 0}, G(), test::scattered<G>(random, 8, 20.0), {});
        for (const auto& l : batch.landmarks)
          frozen.push_back({l.position, l.covariance, l.loading, {}, std::uint64_t(8 * k + frozen.size())});
        landmarks.close(frozen);
      }
      after_input();
    }
  }
  FrozenLandmarks<G> landmarks;
};

}  // namespace
}  // namespace convoy

namespace convoy::testing {
using RangeBearingDrives = ::testing::Types<RangeBearingDrive<SE2>, RangeBearingDrive<SE3>>;
INSTANTIATE_TYPED_TEST_SUITE_P(RangeBearingEkf, FrontEndContract, RangeBearingDrives);
using FrozenDrives = ::testing::Types<FrozenDrive<SE2>, FrozenDrive<SE3>>;
INSTANTIATE_TYPED_TEST_SUITE_P(FrozenLandmarks, FrontEndContract, FrozenDrives);
}  // namespace convoy::testing

namespace convoy {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

TEST(FrozenLandmarks, RefusesWhatBreaksTheContractAndKeepsItsState) {
  FrozenLandmarks<SE2> front_end;
  FrontEndState<SE2> good;
  good.stamp_s = 10.0;
  good.abscissa_m = 5.0;
  good.pose = SE2(5.0, 0.0, 0.1);
  good.slam_drift = 0.01 * SE2::Covariance::Identity();
  ASSERT_TRUE(front_end.advance(good));
  const auto refused = [&](auto change) {
    FrontEndState<SE2> bad = good;
    change(bad);
    return !front_end.advance(bad) && front_end.state().stamp_s == 10.0 && front_end.state().abscissa_m == 5.0 &&
           front_end.state().pose.theta() == 0.1 && front_end.state().slam_drift == good.slam_drift;
  };
  using S = FrontEndState<SE2>;
  EXPECT_TRUE(refused([](S& s) { s.stamp_s = 9.0; }));
  EXPECT_TRUE(refused([](S& s) { s.abscissa_m = 4.0; }));
  EXPECT_TRUE(refused([](S& s) { s.stamp_s = nan; }));
  EXPECT_TRUE(refused([](S& s) { s.abscissa_m = nan; }));
  EXPECT_TRUE(refused([](S& s) { s.pose = SE2(nan, 0.0, 0.0); }));
  EXPECT_TRUE(refused([](S& s) { s.pose = SE2(0.0, 0.0, nan); }));
  EXPECT_TRUE(refused([](S& s) { s.slam_drift(0, 0) = -1.0; }));
  EXPECT_TRUE(refused([](S& s) { s.slam_drift(1, 1) = nan; }));
}

template <class G>
class SharedLoadings : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(SharedLoadings, Groups);

TYPED_TEST(SharedLoadings, RecoverAJointCovarianceOfTheirRank) {
  using G = TypeParam;
  test::Random random(2);
  Eigen::MatrixXd L(6 * G::Dim, G::Shared);
  for (Eigen::Index i = 0; i < L.size(); ++i) L.data()[i] = random.normal();
  const Eigen::MatrixXd joint = L * L.transpose();
  const auto loadings = shared_loadings<G>(joint);
  ASSERT_EQ(loadings.size(), 6U);
  for (Eigen::Index i = 0; i < 6; ++i)
    for (Eigen::Index j = 0; j < 6; ++j) {
      const typename G::PointCovariance block =
          loadings[static_cast<std::size_t>(i)] * loadings[static_cast<std::size_t>(j)].transpose();
      const typename G::PointCovariance expected = joint.block<G::Dim, G::Dim>(G::Dim * i, G::Dim * j);
      EXPECT_LT((block - expected).norm(), 1e-5 * joint.norm()) << i << ", " << j;
    }
}

TYPED_TEST(SharedLoadings, LeaveEveryLandmarkAnOwnPartAndTheRestOfTheJointCovariancePositive) {
  using G = TypeParam;
  test::Random random(3);
  for (int round = 0; round < 50; ++round) {
    const int n = random.integer(2, 12);
    Eigen::MatrixXd A(G::Dim * n, G::Dim * n);
    for (Eigen::Index i = 0; i < A.size(); ++i) A.data()[i] = random.normal();
    const Eigen::MatrixXd joint = A * A.transpose();
    const auto loadings = shared_loadings<G>(joint);
    Eigen::MatrixXd L(G::Dim * n, G::Shared);
    for (int i = 0; i < n; ++i) L.middleRows<G::Dim>(G::Dim * i) = loadings[static_cast<std::size_t>(i)];
    EXPECT_TRUE(is_covariance(Eigen::MatrixXd(joint - L * L.transpose()), joint.cwiseAbs().maxCoeff()));
    // The strongest components: what is left is no more than the next eigenvalue.
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> all(joint), rest(joint - L * L.transpose());
    const double next = G::Dim * n > G::Shared ? all.eigenvalues()[G::Dim * n - 1 - G::Shared] : 0.0;
    EXPECT_LT(rest.eigenvalues().maxCoeff(), next + 1e-4 * joint.norm());
  }
}

TYPED_TEST(SharedLoadings, OfOneLandmarkAreNothing) {
  using G = TypeParam;
  const auto loadings = shared_loadings<G>(Eigen::MatrixXd::Identity(G::Dim, G::Dim));
  ASSERT_EQ(loadings.size(), 1U);
  EXPECT_TRUE(loadings[0].isZero(0.0));
  EXPECT_TRUE(shared_loadings<G>(Eigen::MatrixXd(0, 0)).empty());
}

// A joint covariance that is nothing but an error of the pose and nothing but errors of each one's own.
template <class G>
class RigidPartTest : public ::testing::Test {};
using RigidPartGroups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(RigidPartTest, RigidPartGroups);

TYPED_TEST(RigidPartTest, TellsWhatMovesThemAllFromWhatIsEachOnesOwn) {
  using G = TypeParam;
  test::Random random(7);
  RelativeLandmarks<G> landmarks;
  landmarks.positions = test::scattered<G>(random, 40, 20.0);
  landmarks.tracks.resize(40);
  Eigen::MatrixXd A(G::Dim * 40, G::Dof);
  for (int i = 0; i < 40; ++i) A.middleRows(G::Dim * i, G::Dim) = G().act_jacobian(landmarks.positions[std::size_t(i)]);
  typename G::Covariance B;
  for (int c = 0; c < G::Dof; ++c) B.col(c) = 0.1 * random.template unit_normal<G::Dof>();
  const typename G::Covariance P = B * B.transpose();
  const Eigen::MatrixXd own = 0.04 * Eigen::MatrixXd::Identity(A.rows(), A.rows());
  landmarks.covariance = A * P * A.transpose();
  const auto rigid = rigid_part(landmarks);
  ASSERT_TRUE(rigid);
  EXPECT_TRUE(rigid->shared.isApprox(P, 1e-9));
  for (const auto& S : rigid->own) EXPECT_LT((S - 1e-4 * G::PointCovariance::Identity()).norm(), 1e-9) << "the floor";
  landmarks.covariance += own;
  const auto both = rigid_part(landmarks);
  EXPECT_LT((both->shared - P).norm(), 0.02 * P.norm());
  for (const auto& S : both->own) {
    EXPECT_GT(S.trace(), 0.8 * 0.04 * G::Dim);
    EXPECT_LT(S.trace(), 1.01 * 0.04 * G::Dim);
  }
  // The first two of them alone fix no pose, nor do many in one place.
  EXPECT_FALSE(rigid_part(subset(landmarks, {0, 1})));
  for (auto& p : landmarks.positions) p = landmarks.positions[0];
  EXPECT_FALSE(rigid_part(landmarks));
}

TYPED_TEST(RigidPartTest, ASubsetKeepsItsBlocks) {
  using G = TypeParam;
  test::Random random(8);
  RelativeLandmarks<G> landmarks{
      {7, 8, 9}, test::scattered<G>(random, 3, 20.0), Eigen::MatrixXd::Random(3 * G::Dim, 3 * G::Dim)};
  const auto some = subset(landmarks, {2, 0});
  EXPECT_EQ(some.tracks, (std::vector<std::uint64_t>{9, 7}));
  EXPECT_EQ(some.positions[0], landmarks.positions[2]);
  EXPECT_EQ(some.covariance.block(0, G::Dim, G::Dim, G::Dim),
            landmarks.covariance.block(2 * G::Dim, 0, G::Dim, G::Dim));
}

}  // namespace
}  // namespace convoy
