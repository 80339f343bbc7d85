#include <convoy/association/alignment.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

namespace convoy {
namespace {

const Key anchor_a{{1, 1}, 1}, anchor_b{{2, 1}, 1};

std::vector<IndexPairing> all_pairs(int n) {
  std::vector<IndexPairing> pairs;
  for (int k = 0; k < n; ++k) pairs.emplace_back(k, k);
  return pairs;
}

TEST(Align, RecoversAKnownMotion) {
  for (std::uint64_t seed = 1; seed <= 50; ++seed) {
    test::Random random(seed);
    const SE2 T_w_a = random.pose(100.0), T_w_b = random.pose(100.0);
    const test::Points points = test::scattered(random, 12, 20.0);
    const test::BatchNoise exact{0.1, 0.1, 0.0};
    const auto a = test::frozen_batch(random, anchor_a, T_w_a, points, exact);
    const auto b = test::frozen_batch(random, anchor_b, T_w_b, points, exact);
    const auto alignment = align(a, b, all_pairs(12));
    ASSERT_TRUE(alignment);
    EXPECT_LT((alignment->T_a_b.inverse() * T_w_a.inverse() * T_w_b).Log().norm(), 1e-9) << seed;
    EXPECT_LT(alignment->chi2, 1e-12);
    EXPECT_EQ(alignment->dof, 21);
  }
}

struct Sums {
  int runs = 0;
  double pose = 0.0, chi2 = 0.0, fresh = 0.0;
};

// Fresh: a thirteenth pair, which the alignment has not seen.
Sums monte_carlo(double shared_m) {
  Sums sums;
  for (std::uint64_t seed = 1; seed <= 400; ++seed) {
    test::Random random(seed);
    const SE2 T_w_a = random.pose(20.0), T_w_b = T_w_a * SE2(random.normal(8.0), random.normal(8.0), random.normal());
    test::Points points;
    for (const auto& p : test::scattered(random, 13, 20.0)) points.push_back(T_w_a * p);
    const auto a = test::frozen_batch(random, anchor_a, T_w_a, points, {0.1, shared_m});
    const auto b = test::frozen_batch(random, anchor_b, T_w_b, points, {0.15, shared_m});
    const auto alignment = align(a, b, all_pairs(12));
    EXPECT_TRUE(alignment);
    if (!alignment) continue;
    ++sums.runs;
    const SE2 error = alignment->T_a_b.inverse() * (T_w_a.inverse() * T_w_b);
    sums.pose += squared_mahalanobis(error.Log(), alignment->covariance());
    sums.chi2 += alignment->chi2;
    sums.fresh += residual_chi2(*alignment, a.landmarks[12], b.landmarks[12]);
  }
  return sums;
}

bool in_band(double sum, double dof) { return sum > chi2_quantile(0.001, dof) && sum < chi2_quantile(0.999, dof); }

TEST(Align, StatesTheCovarianceThatItsErrorsHave) {
  for (const double shared_m : {0.0, 0.3}) {
    const Sums s = monte_carlo(shared_m);
    ASSERT_EQ(s.runs, 400);
    EXPECT_TRUE(in_band(s.pose, 3.0 * s.runs)) << s.pose / (3.0 * s.runs);
    EXPECT_TRUE(in_band(s.chi2, 21.0 * s.runs)) << s.chi2 / (21.0 * s.runs);
    EXPECT_TRUE(in_band(s.fresh, 2.0 * s.runs)) << s.fresh / (2.0 * s.runs);
    for (const double factor : {0.7, 1.5}) {  // covariances that are wrong would be noticed
      EXPECT_FALSE(in_band(s.pose / factor, 3.0 * s.runs));
      EXPECT_FALSE(in_band(s.fresh / factor, 2.0 * s.runs));
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

TEST(Align, GivesNothingWithoutNoiseToWeighWith) {
  test::Random random(1);
  const test::Points points = test::scattered(random, 6, 10.0);
  auto a = test::frozen_batch(random, anchor_a, SE2(), points, {}), b = a;
  for (auto* batch : {&a, &b})
    for (auto& l : batch->landmarks) {
      l.covariance.setZero();
      l.loading.setZero();
    }
  EXPECT_FALSE(align(a, b, all_pairs(6)));
}

TEST(Align, AMirroredSetDoesNotFit) {
  test::Random random(4);
  const test::Points points = test::scattered(random, 12, 20.0);
  test::Points mirrored;
  for (const auto& p : points) mirrored.emplace_back(p.x(), -p.y());
  const auto alignment = align(test::frozen_batch(random, anchor_a, SE2(), points, {}),
                               test::frozen_batch(random, anchor_b, SE2(), mirrored, {}), all_pairs(12));
  EXPECT_TRUE(!alignment || alignment->chi2 > chi2_quantile(0.9999, 21));
}

}  // namespace
}  // namespace convoy
