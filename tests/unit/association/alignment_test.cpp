#include <convoy/association/alignment.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>

namespace convoy {
namespace {

const Key anchor_a{{1, 1}, 1}, anchor_b{{2, 1}, 1};

template <class G>
class AlignOf : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(AlignOf, Groups);

std::vector<IndexPairing> all_pairs(int n) {
  std::vector<IndexPairing> pairs;
  for (int k = 0; k < n; ++k) pairs.emplace_back(k, k);
  return pairs;
}

TYPED_TEST(AlignOf, RecoversAKnownMotion) {
  using G = TypeParam;
  for (std::uint64_t seed = 1; seed <= 50; ++seed) {
    test::Random random(seed);
    const G T_w_a = random.pose_of<G>(100.0), T_w_b = random.pose_of<G>(100.0);
    const test::PointsOf<G> points = test::scattered<G>(random, 12, 20.0);
    const test::BatchNoise exact{0.1, 0.1, 0.0};
    const auto a = test::frozen_batch(random, anchor_a, T_w_a, points, exact);
    const auto b = test::frozen_batch(random, anchor_b, T_w_b, points, exact);
    const auto alignment = align(a, b, all_pairs(12));
    ASSERT_TRUE(alignment);
    EXPECT_LT((alignment->T_a_b.inverse() * T_w_a.inverse() * T_w_b).Log().norm(), 1e-9) << seed;
    EXPECT_LT(alignment->chi2, 1e-12);
    EXPECT_EQ(alignment->dof, 12 * G::Dim - G::Dof);
  }
}

struct Sums {
  int runs = 0;
  double pose = 0.0, chi2 = 0.0, fresh = 0.0;
};

template <class G>
G somewhere_near(test::Random& random) {
  typename G::Tangent d = 8.0 * random.unit_normal<G::Dof>();
  d.template tail<G::Dof - G::Dim>() /= 8.0;
  return G::Exp(d);
}

// Fresh: a thirteenth pair, which the alignment has not seen.
template <class G>
Sums monte_carlo(double shared_m) {
  Sums sums;
  for (std::uint64_t seed = 1; seed <= 400; ++seed) {
    test::Random random(seed);
    const G T_w_a = random.pose_of<G>(20.0), T_w_b = T_w_a * somewhere_near<G>(random);
    test::PointsOf<G> points;
    for (const auto& p : test::scattered<G>(random, 13, 20.0)) points.push_back(T_w_a * p);
    const auto a = test::frozen_batch(random, anchor_a, T_w_a, points, {0.1, shared_m});
    const auto b = test::frozen_batch(random, anchor_b, T_w_b, points, {0.15, shared_m});
    const auto alignment = align(a, b, all_pairs(12));
    EXPECT_TRUE(alignment);
    if (!alignment) continue;
    ++sums.runs;
    const G error = alignment->T_a_b.inverse() * (T_w_a.inverse() * T_w_b);
    sums.pose += squared_mahalanobis(error.Log(), alignment->covariance());
    sums.chi2 += alignment->chi2;
    sums.fresh += residual_chi2(*alignment, a.landmarks[12], b.landmarks[12]);
  }
  return sums;
}

bool in_band(double sum, double dof) { return sum > chi2_quantile(0.001, dof) && sum < chi2_quantile(0.999, dof); }

TYPED_TEST(AlignOf, StatesTheCovarianceThatItsErrorsHave) {
  using G = TypeParam;
  for (const double shared_m : {0.0, 0.3}) {
    const Sums s = monte_carlo<G>(shared_m);
    const double dof = 12 * G::Dim - G::Dof;
    ASSERT_EQ(s.runs, 400);
    EXPECT_TRUE(in_band(s.pose, G::Dof * s.runs)) << s.pose / (G::Dof * s.runs);
    EXPECT_TRUE(in_band(s.chi2, dof * s.runs)) << s.chi2 / (dof * s.runs);
    EXPECT_TRUE(in_band(s.fresh, G::Dim * s.runs)) << s.fresh / (G::Dim * s.runs);
    for (const double factor : {0.7, 1.5}) {  // covariances that are wrong would be noticed
      EXPECT_FALSE(in_band(s.pose / factor, G::Dof * s.runs));
      EXPECT_FALSE(in_band(s.fresh / factor, G::Dim * s.runs));
    }
  }
}

TEST(Align, GivesNothingWhereTheGeometryDoesNotFixTheMotion) {
  test::Random random(1);
  const auto batch = [&](const Key& anchor, const test::Points& points) {
    return test::frozen_batch(random, anchor, SE2(), points, {0.1, 0.0, 0.0});
  };
  const test::Points two{{3.0, 4.0}, {8.0, -1.0}}, same{{3.0, 4.0}, {3.0, 4.0}, {3.0, 4.0}};
  EXPECT_TRUE(align(batch(anchor_a, two), batch(anchor_b, two), all_pairs(2)));
  EXPECT_FALSE(align(batch(anchor_a, two), batch(anchor_b, two), all_pairs(1)));
  EXPECT_FALSE(align(batch(anchor_a, two), batch(anchor_b, two), {}));
  EXPECT_FALSE(align(batch(anchor_a, same), batch(anchor_b, same), all_pairs(3)));
}

TEST(Align, InSpaceGivesNothingOfPointsInARow) {
  test::Random random(1);
  const auto batch = [&](const Key& anchor, const test::PointsOf<SE3>& points, double noise) {
    return test::frozen_batch(random, anchor, SE3(), points, {0.1, 0.05, noise});
  };
  test::PointsOf<SE3> row, plane, three{{0, 0, 0}, {5, 1, 0}, {2, -4, 1}};
  for (int k = 0; k < 8; ++k) row.emplace_back(5.0 * k - 10.0, 3.0, 0.5 * k);
  for (int k = 0; k < 8; ++k) plane.emplace_back(5.0 * (k % 4), 4.0 * (k / 4), 1.0);
  for (const double noise : {0.0, 1.0}) {  // exactly in a row, or but for their errors
    EXPECT_FALSE(align(batch(anchor_a, row, noise), batch(anchor_b, row, noise), all_pairs(8))) << noise;
    EXPECT_TRUE(align(batch(anchor_a, plane, noise), batch(anchor_b, plane, noise), all_pairs(8))) << noise;
  }
  EXPECT_TRUE(align(batch(anchor_a, three, 0.0), batch(anchor_b, three, 0.0), all_pairs(3)));
  EXPECT_FALSE(align(batch(anchor_a, three, 0.0), batch(anchor_b, three, 0.0), all_pairs(2)));
}

// The joint covariance is the inverse of the information of r(d, u_a, u_b), differentiated numerically here.
TYPED_TEST(AlignOf, CovarianceIsThatOfTheNumericJacobian) {
  using G = TypeParam;
  constexpr int Size = Alignment<G>::Size;
  using Vector = Eigen::Matrix<double, Size, 1>;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    test::Random random(seed);
    const G T_w_a = random.pose_of<G>(20.0), T_w_b = T_w_a * somewhere_near<G>(random);
    test::PointsOf<G> points;
    for (const auto& p : test::scattered<G>(random, 10, 20.0)) points.push_back(T_w_a * p);
    const auto a = test::frozen_batch(random, anchor_a, T_w_a, points, {0.1, 0.2});
    const auto b = test::frozen_batch(random, anchor_b, T_w_b, points, {0.15, 0.2});
    const auto at = align(a, b, all_pairs(10));
    ASSERT_TRUE(at);
    Eigen::Matrix<double, Size, Size> information = Eigen::Matrix<double, Size, Size>::Zero();
    information.diagonal().template tail<2 * G::Shared>().setOnes();
    Vector gradient = Vector::Zero();
    gradient.template segment<G::Shared>(G::Dof) = at->shared_a;
    gradient.template tail<G::Shared>() = at->shared_b;
    for (std::size_t k = 0; k < 10; ++k) {
      const auto &i = a.landmarks[k], &j = b.landmarks[k];
      const auto residual = [&](const Vector& d) {
        const G T = at->T_a_b * G::Exp(d.template head<G::Dof>());
        const typename G::SharedVector ua = at->shared_a + d.template segment<G::Shared>(G::Dof);
        const typename G::SharedVector ub = at->shared_b + d.template tail<G::Shared>();
        return typename G::Point(i.position - i.loading * ua - T * typename G::Point(j.position - j.loading * ub));
      };
      Eigen::Matrix<double, G::Dim, Size> J;
      constexpr double h = 1e-5;
      for (int c = 0; c < Size; ++c)
        J.col(c) = (residual(h * Vector::Unit(c)) - residual(-h * Vector::Unit(c))) / (2.0 * h);
      const typename G::PointCovariance R = at->T_a_b.rotation();
      const typename G::PointCovariance W = (i.own_covariance() + R * j.own_covariance() * R.transpose()).inverse();
      information += J.transpose() * W * J;
      gradient += J.transpose() * W * residual(Vector::Zero());
    }
    EXPECT_LT((at->joint * information - Eigen::Matrix<double, Size, Size>::Identity()).cwiseAbs().maxCoeff(), 1e-6)
        << seed;
    EXPECT_LT(gradient.dot(at->joint * gradient), 1e-12) << seed;  // it stands where the cost no longer falls
  }
}

TYPED_TEST(AlignOf, GivesNothingWithoutNoiseToWeighWith) {
  using G = TypeParam;
  test::Random random(1);
  const test::PointsOf<G> points = test::scattered<G>(random, 6, 10.0);
  auto a = test::frozen_batch(random, anchor_a, G(), points, {}), b = a;
  for (auto* batch : {&a, &b})
    for (auto& l : batch->landmarks) {
      l.covariance.setZero();
      l.loading.setZero();
    }
  EXPECT_FALSE(align(a, b, all_pairs(6)));
}

TYPED_TEST(AlignOf, AMirroredSetDoesNotFit) {
  using G = TypeParam;
  test::Random random(4);
  const test::PointsOf<G> points = test::scattered<G>(random, 12, 20.0);
  test::PointsOf<G> mirrored = points;
  for (auto& p : mirrored) p.y() = -p.y();
  const auto alignment = align(test::frozen_batch(random, anchor_a, G(), points, {}),
                               test::frozen_batch(random, anchor_b, G(), mirrored, {}), all_pairs(12));
  EXPECT_TRUE(!alignment || alignment->chi2 > chi2_quantile(0.9999, 12 * G::Dim - G::Dof));
}

}  // namespace
}  // namespace convoy
