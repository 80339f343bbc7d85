#include <convoy/frontend/front_end.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/map/live_pose.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>
#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <algorithm>

namespace convoy {
namespace {

using test::each;

// Vehicle 2 a while after its last anchor; its SLAM remembers landmarks around it, drawn from the model that is stated.
template <class G>
struct Drive {
  explicit Drive(std::uint64_t seed, double sigma_own_m = 0.05)
      : fleet(test::street_fleet<G>(seed)), global(test::built(fleet.store())) {
    const Key last = test::key_of(2, 5);
    typename G::Tangent along = G::Tangent::Zero();
    along[0] = 15.0;
    const G motion = G::Exp(along);
    const typename G::Covariance Q = (15.0 * each<G>(4e-4, 4e-6)).asDiagonal();
    truth = fleet.truth.at(last) * motion;
    live.chain = last.chain;
    live.state = fleet.anchor(last).state;
    live.state.stamp_s += 7.5;
    live.state.abscissa_m += 15.0;
    live.state.pose = live.state.pose * motion * G::Exp(fleet.random().template draw<G::Dof>(Q)).inverse();
    live.state.drift += live.state.pose.adjoint() * Q * live.state.pose.adjoint().transpose();
    live.shared = each<G>(4e-4, 1e-6).asDiagonal();
    const G seen_from = truth * G::Exp(fleet.random().template draw<G::Dof>(live.shared));
    for (const auto& [key, point] : nearest()) {
      const typename G::PointCovariance S = sigma_own_m * sigma_own_m * G::PointCovariance::Identity();
      live.remembered.push_back({key.index, seen_from.inverse() * point + fleet.random().template draw<G::Dim>(S), S});
    }
  }

  // Of vehicle 2, in classes, each class once.
  std::vector<std::pair<Key, typename G::Point>> nearest() const {
    std::vector<std::pair<Key, typename G::Point>> near;
    std::set<int> classes;
    for (const auto& [key, point] : fleet.point_of)
      if (key.chain.vehicle == 2 && global.class_of.find(key) && classes.insert(*global.class_of.find(key)).second)
        near.emplace_back(key, point);
    std::stable_sort(near.begin(), near.end(),
                     [&](const auto& a, const auto& b) { return distance(a.second) < distance(b.second); });
    near.resize(std::min<std::size_t>(near.size(), LivePose<G>::max_remembered));
    return near;
  }
  double distance(const typename G::Point& point) const { return (point - truth.translation()).norm(); }

  typename G::Tangent error(const Estimate<G>& estimate) const { return (truth.inverse() * estimate.mean).Log(); }
  // Of the position relative to vehicle 1, which is near: what the map as a whole is off by cancels.
  typename G::Point beside_the_other(const Estimate<G>& estimate) const {
    const Key other = test::key_of(1, 5);
    const G T = global.map->pose(other.chain, fleet.anchor(other).state)->mean;
    return (T.inverse() * estimate.mean).translation() - (fleet.truth.at(other).inverse() * truth).translation();
  }
  Estimate<G> by_map() const { return *global.map->pose(live.chain, live.state); }

  test::SampleFleetOf<G> fleet;
  GlobalMap<G> global;
  G truth;
  LivePose<G> live;
};

template <class G>
void expect_same(const Estimate<G>& a, const Estimate<G>& b) {
  EXPECT_TRUE((a.mean.inverse() * b.mean).Log().isZero(1e-12));
  EXPECT_TRUE(a.covariance.isApprox(b.covariance, 1e-9));
}

template <class G>
class LivePoseTest : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(LivePoseTest, Groups);

TYPED_TEST(LivePoseTest, IsConsistentAndBetterThanDeadReckoningFromTheLastAnchor) {
  using G = TypeParam;
  double nees = 0.0, squares = 0.0, squares_by_map = 0.0, smaller = 0.0;
  constexpr int runs = 60;
  for (int run = 0; run < runs; ++run) {
    Drive<G> drive(100 + static_cast<std::uint64_t>(run));
    ASSERT_EQ(drive.live.remembered.size(), LivePose<G>::max_remembered);
    const auto live = live_pose(drive.global, drive.live);
    ASSERT_TRUE(live);
    ASSERT_TRUE(is_covariance(live->covariance));
    nees += squared_mahalanobis(drive.error(*live), live->covariance) / (runs * G::Dof);
    squares += drive.beside_the_other(*live).squaredNorm() / runs;
    squares_by_map += drive.beside_the_other(drive.by_map()).squaredNorm() / runs;
    smaller += live->covariance.determinant() < drive.by_map().covariance.determinant();
  }
  std::printf("seeds 100..%d: ANEES %.2f, position RMSE beside vehicle 1 %.3f m, by the last anchor alone %.3f m\n",
              100 + runs - 1, nees, std::sqrt(squares), std::sqrt(squares_by_map));
  EXPECT_GT(nees, 0.6);
  EXPECT_LT(nees, chi2_quantile(0.999, runs * G::Dof) / (runs * G::Dof));
  EXPECT_LT(std::sqrt(squares), 0.8 * std::sqrt(squares_by_map));
  EXPECT_EQ(smaller, runs);
}

TYPED_TEST(LivePoseTest, LeavesOutALandmarkThatWasTakenForAnother) {
  using G = TypeParam;
  Drive<G> drive(1);
  auto without = drive.live, wrong = drive.live;
  without.remembered.erase(without.remembered.begin() + 3);
  wrong.remembered[3].position[0] += 5.0;
  expect_same(*live_pose(drive.global, wrong), *live_pose(drive.global, without));
}

TYPED_TEST(LivePoseTest, FallsBackToTheLastAnchor) {
  using G = TypeParam;
  Drive<G> drive(2);
  auto few = drive.live, scattered = drive.live, strange = drive.live, turned = drive.live;
  few.remembered.resize(G::Dim);
  expect_same(*live_pose(drive.global, few), drive.by_map());
  for (std::size_t i = 0; i < scattered.remembered.size(); ++i)
    scattered.remembered[i].position[static_cast<int>(i) % G::Dim] += 3.0 * (static_cast<double>(i) - 4.0);
  expect_same(*live_pose(drive.global, scattered), drive.by_map());
  for (auto& l : strange.remembered) l.index += 1'000'000;  // never heard of
  expect_same(*live_pose(drive.global, strange), drive.by_map());
  // All of them fit, and put the vehicle where neither the map's uncertainty nor the drift allows it to be.
  typename G::Tangent off = G::Tangent::Zero();
  off[0] = 20.0;
  for (auto& l : turned.remembered) l.position = G::Exp(off) * l.position;
  expect_same(*live_pose(drive.global, turned), drive.by_map());
}

TYPED_TEST(LivePoseTest, KnowsNothingOfAnUnknownChain) {
  Drive<TypeParam> drive(3);
  drive.live.chain = {99, 1};
  EXPECT_FALSE(live_pose(drive.global, drive.live));
}

TYPED_TEST(LivePoseTest, TheMapKnowsAPoseAndPointsTogether) {
  using G = TypeParam;
  Drive<G> drive(4);
  std::vector<int> classes;
  for (const auto& l : drive.live.remembered)
    classes.push_back(drive.global.class_of.find({drive.live.chain, l.index}).value());
  Map<G>& map = *drive.global.map;
  ChainState<G> between = drive.fleet.anchor(test::key_of(2, 2)).state;  // smoothed, then extrapolated
  const auto& next = drive.fleet.anchor(test::key_of(2, 3)).state;
  between.stamp_s = 0.5 * (between.stamp_s + next.stamp_s);
  between.pose = between.pose * G::Exp(0.5 * (between.pose.inverse() * next.pose).Log());
  between.drift = 0.5 * (between.drift + next.drift);
  for (const ChainState<G>& state : {between, drive.live.state}) {
    const auto around = map.surroundings(drive.live.chain, state, classes);
    ASSERT_TRUE(around);
    const Eigen::MatrixXd& P = around->covariance;
    ASSERT_EQ(P.rows(), G::Dof + G::Dim * static_cast<int>(classes.size()));
    EXPECT_TRUE(is_covariance(P));
    const auto pose = map.pose(drive.live.chain, state);
    EXPECT_LT((P.topLeftCorner(G::Dof, G::Dof) + around->motion - pose->covariance).norm(),
              1e-9 * pose->covariance.norm());
    for (std::size_t i = 0; i < classes.size(); ++i) {
      const auto point = map.class_point(classes[i]);
      const auto at = G::Dof + G::Dim * static_cast<Eigen::Index>(i);
      EXPECT_EQ(around->points[i], point.mean);
      EXPECT_LT((P.block(at, at, G::Dim, G::Dim) - point.covariance).norm(), 1e-9 * point.covariance.norm());
    }
  }
}

// What the SLAM remembers is nothing but what its facts have said: the same sightings, the same odometry since. A peer
// knows the points well. Laid onto the map it may tell as much as the map does, and never more.
TEST(LivePose, TellsTheSameMeasurementsOnce) {
  double nees = 0.0, nees_by_map = 0.0, size = 0.0;
  int held = 0;
  constexpr int runs = 1000;
  test::Random random(1);
  const ChainId peer{1, 1}, own{2, 1};
  for (int run = 0; run < runs; ++run) {
    const SE2::Tangent sigma(0.1, 0.1, 0.01);
    const SE2::Covariance Q = sigma.cwiseAbs2().asDiagonal();
    const SE2 T_first(0.0, 0.0, 0.3), motion(20.0, 0.0, 0.1);
    const SE2 said = motion * SE2::Exp(random.draw<3>(Q)).inverse(), truth = T_first * motion;
    Problem<SE2> problem;
    ChainState<SE2> last;
    last.stamp_s = 10.0;
    last.abscissa_m = 20.0;
    last.pose = said;
    last.drift = said.adjoint() * Q * said.adjoint().transpose();
    problem.nodes = {{{peer, 0}, {}, SE2()}, {{own, 0}, {}, T_first}, {{own, 1}, last, truth}};
    problem.chains = {{peer, 0, 1, true}, {own, 1, 3, true}};
    problem.priors = {{0, SE2(), SE2::Covariance(Eigen::Vector3d(1e-6, 1e-6, 1e-8).asDiagonal())},
                      {1, T_first, SE2::Covariance(Eigen::Vector3d(100.0, 100.0, 1.0).asDiagonal())}};
    const auto step = increment(ChainState<SE2>{}, last);
    problem.drifts = {{1, 2, step.motion, step.covariance}};
    GlobalMap<SE2> global;
    std::vector<Key> members;  // one of each class
    std::vector<std::size_t> ends;
    RelativeLandmarks<SE2> known;
    known.covariance = Eigen::MatrixXd::Zero(16, 16);
    for (int i = 0; i < 8; ++i) {
      const SE2::Point place = T_first * SE2::Point(10.0 * std::cos(i), 10.0 * std::sin(i));
      const Eigen::Matrix2d S_peer = 1e-6 * Eigen::Matrix2d::Identity(), S = 4e-4 * Eigen::Matrix2d::Identity();
      const SE2::Point seen = T_first.inverse() * place + random.draw<2>(S);
      const auto index = static_cast<std::uint32_t>(i);
      problem.points.push_back(place);
      problem.landmarks.push_back({0, i, {peer, index}, place + random.draw<2>(S_peer), S_peer});
      problem.landmarks.push_back({1, i, {own, index}, seen, S});
      members.push_back({own, index});
      ends.push_back(members.size());
      known.tracks.push_back(index);
      known.positions.push_back(said.inverse() * seen);
      const Eigen::Matrix<double, 2, 3> A = SE2().act_jacobian(known.positions.back());
      for (int j = 0; j <= i; ++j) {
        const Eigen::Matrix<double, 2, 3> B = SE2().act_jacobian(known.positions[static_cast<std::size_t>(j)]);
        known.covariance.block<2, 2>(2 * i, 2 * j) = A * Q * B.transpose();
        known.covariance.block<2, 2>(2 * j, 2 * i) = B * Q * A.transpose();
      }
      known.covariance.block<2, 2>(2 * i, 2 * i) += S;
    }
    global.class_of = ClassIndex({members, ends});
    global.map = SparseMap<SE2>().solve(problem);
    LivePose<SE2> live;
    live.chain = own;
    live.state = last;
    const auto part = rigid_part(known);
    ASSERT_TRUE(part);
    live.shared = part->shared;
    for (std::uint32_t i = 0; i < 8; ++i) live.remembered.push_back({i, known.positions[i], part->own[i]});
    const auto here = live_pose(global, live), by_map = global.map->pose(own, last);
    const auto nees_of = [&](const Estimate<SE2>& e) {
      return squared_mahalanobis((truth.inverse() * e.mean).Log(), e.covariance);
    };
    nees += nees_of(*here) / (3.0 * runs);
    nees_by_map += nees_of(*by_map) / (3.0 * runs);
    held += nees_of(*here) < chi2_quantile(0.95, 3);
    size += std::sqrt(here->covariance.determinant() / by_map->covariance.determinant()) / runs;
  }
  std::printf("seed 1: ANEES %.2f, by the map %.2f, coverage %.3f, size of the covariance against the map's %.2f\n",
              nees, nees_by_map, static_cast<double>(held) / runs, size);
  EXPECT_NEAR(nees, 1.0, 0.1);
  EXPECT_GE(held, 0.93 * runs);
  EXPECT_GT(size, 0.9);
}

// A covariance that is none to the last digit, of a size that the limits allow, spoils nothing.
TEST(LivePose, StaysDefiniteWhateverAPeerSays) {
  Drive<SE2> drive(5);
  for (const double large : {1e3, 5.5e7, 9e9}) {
    drive.live.shared = Eigen::Vector3d(-0.9e-9 * large, 1e-3, large).asDiagonal();
    for (auto& l : drive.live.remembered) l.covariance = Eigen::Vector2d(-0.9e-9 * large, large).asDiagonal();
    const auto live = live_pose(drive.global, drive.live);
    ASSERT_TRUE(live);
    EXPECT_EQ(Eigen::LLT<SE2::Covariance>(live->covariance).info(), Eigen::Success) << large;
    EXPECT_TRUE(live->mean.translation().allFinite());
  }
}

// In space, landmarks in a row tell where the vehicle is and leave the turn about the row open: no pose.
TEST(LivePose, LandmarksInARowFixNoPoseInSpace) {
  const ChainId peer{1, 1}, own{2, 1};
  for (const double off_m : {3.0, 0.01}) {
    Problem<SE3> problem;
    problem.nodes = {{{peer, 0}, {}, SE3()}, {{own, 0}, {}, SE3()}};
    problem.chains = {{peer, 0, 1, true}, {own, 1, 2, true}};
    problem.priors = {{0, SE3(), SE3::Covariance(each<SE3>(1e-6, 1e-8).asDiagonal())},
                      {1, SE3(), SE3::Covariance(each<SE3>(1.0, 2.5e-5).asDiagonal())}};
    GlobalMap<SE3> global;
    std::vector<Key> members;  // one of each class
    std::vector<std::size_t> ends;
    LivePose<SE3> live;
    live.chain = own;
    for (int i = 0; i < 8; ++i) {
      const SE3::Point place(4.0 * i - 14.0, off_m * (i % 2), off_m * (i % 3));
      const auto index = static_cast<std::uint32_t>(i);
      problem.points.push_back(place);
      problem.landmarks.push_back({0, i, {peer, index}, place, 1e-6 * SE3::PointCovariance::Identity()});
      problem.landmarks.push_back({1, i, {own, index}, place, 9.0 * SE3::PointCovariance::Identity()});
      members.push_back({own, index});
      ends.push_back(members.size());
      live.remembered.push_back({index, place, 4e-4 * SE3::PointCovariance::Identity()});
    }
    global.class_of = ClassIndex({members, ends});
    global.map = SparseMap<SE3>().solve(problem);
    const auto here = live_pose(global, live), by_map = global.map->pose(own, live.state);
    const double ratio = here->covariance.determinant() / by_map->covariance.determinant();
    if (off_m > 1.0) EXPECT_LT(ratio, 1e-3);
    else EXPECT_NEAR(ratio, 1.0, 1e-6);
  }
}

}  // namespace
}  // namespace convoy
