// Where geometry says little, or what comes in is no number: no crash, no endless search, no guess.
#include <convoy/association/associate.hpp>
#include <convoy/geometry/groups.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <string>

namespace convoy {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

class Degenerate : public testing::TestWithParam<SearchMethod> {
 protected:
  using Prior = std::optional<RelativePrior<SE2>>;

  /// Both vehicles see all of these points.
  static AssociationResult<SE2> associated(const test::Points& points, double sigma_m, std::uint64_t seed = 1,
                                           const test::BatchNoise& noise = {0.05, 0.02}) {
    test::Random random(seed);
    const SE2 T_a_b(0.5, -0.3, 0.1);
    const auto a = test::frozen_batch(random, {{1, 1}, 1}, SE2(), points, noise);
    const auto b = test::frozen_batch(random, {{2, 1}, 1}, T_a_b, points, noise);
    RelativePrior<SE2> prior{T_a_b, Eigen::Vector3d(sigma_m * sigma_m, sigma_m * sigma_m, 0.02).asDiagonal()};
    AssociationParams params;
    params.method = GetParam();
    return associate(a, b, Prior(prior), params);
  }
  static test::Points line(int count, double step_m, double first_m = 0.0) {
    test::Points points;
    for (int k = 0; k < count; ++k) points.emplace_back(first_m + step_m * k, 0.0);
    return points;
  }
};
INSTANTIATE_TEST_SUITE_P(By, Degenerate, testing::Values(SearchMethod::alignment, SearchMethod::gcbb),
                         [](const auto& by) { return std::string(to_string(by.param)); });

TEST_P(Degenerate, TwoPointsDecideNothing) {
  EXPECT_EQ(associated({{0.0, 0.0}, {5.0, 0.0}}, 5.0).rejection, Rejection::too_few_candidates);
}

TEST_P(Degenerate, ARowOfEqualStepsIsNotAcceptedAnywhere) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed)
    EXPECT_NE(associated(line(30, 3.0), 8.0, seed).decision, Decision::accepted) << seed;
}

TEST_P(Degenerate, ARegularGridIsNotAcceptedAnywhere) {
  test::Points grid;
  for (int x = 0; x < 7; ++x)
    for (int y = 0; y < 7; ++y) grid.emplace_back(4.0 * x, 4.0 * y);
  for (std::uint64_t seed = 1; seed <= 10; ++seed)
    EXPECT_NE(associated(grid, 8.0, seed).decision, Decision::accepted) << seed;
}

TEST_P(Degenerate, WhatCoincidesIsPairedWithNothing) {
  const test::Points heap(12, SE2::Point(3.0, 4.0));
  for (std::uint64_t seed = 1; seed <= 10; ++seed)
    EXPECT_NE(associated(heap, 5.0, seed).decision, Decision::accepted) << seed;
}

// Irregular steps in a row are a pattern of their own, but a weak one: some other place may come near.
TEST_P(Degenerate, ARowOfUnequalStepsIsTheRightPlaceOrNone) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    test::Random random(seed);
    test::Points row;
    for (double x = 0.0; row.size() < 25; x += random.uniform(1.5, 6.0)) row.emplace_back(x, 0.0);
    const auto result = associated(row, 5.0, seed);
    if (result.decision != Decision::accepted) continue;
    for (const auto& [i, j] : result.pairings) EXPECT_EQ(i.index, j.index) << seed;
  }
}

TEST_P(Degenerate, HugeUncertaintyStaysWithinItsBudgetAndIsNeverAccepted) {
  test::Random random(3);
  const test::Points points = test::scattered(random, 40, 15.0);
  const auto result = associated(points, 200.0, 3, {20.0, 0.0});  // everything is compatible with everything
  EXPECT_NE(result.decision, Decision::accepted);
  EXPECT_LE(result.nodes,
            std::max<std::uint64_t>(AssociationParams().alignment.max_votes, AssociationParams().max_nodes));
}

TEST_P(Degenerate, WhatIsNoNumberOrNoCovarianceIsRefused) {
  test::Random random(5);
  const test::Points points = test::scattered(random, 20, 15.0);
  const auto a = test::frozen_batch(random, {{1, 1}, 1}, SE2(), points, {0.05, 0.02});
  const auto b = test::frozen_batch(random, {{2, 1}, 1}, SE2(), points, {0.05, 0.02});
  const RelativePrior<SE2> prior{SE2(), SE2::Covariance::Identity()};
  AssociationParams params;
  params.method = GetParam();
  const auto spoilt = [&](auto spoil) {
    Batch<SE2> x = a, y = b;
    RelativePrior<SE2> p = prior;
    spoil(x.landmarks[3], y.landmarks[4], p);
    return associate(x, y, Prior(p), params).rejection;
  };
  using L = LandmarkFact<SE2>;
  using P = RelativePrior<SE2>;
  ASSERT_EQ(spoilt([](L&, L&, P&) {}), Rejection::not_rejected);
  EXPECT_EQ(spoilt([](L& l, L&, P&) { l.position.x() = nan; }), Rejection::unfit);
  EXPECT_EQ(spoilt([](L&, L& l, P&) { l.covariance(0, 0) = nan; }), Rejection::unfit);
  EXPECT_EQ(spoilt([](L&, L& l, P&) { l.covariance(0, 0) = -1.0; }), Rejection::unfit);
  EXPECT_EQ(spoilt([](L& l, L&, P&) { l.covariance << 1.0, 2.0, 2.0, 1.0; }), Rejection::unfit);
  EXPECT_EQ(spoilt([](L& l, L&, P&) { l.loading(0, 0) = nan; }), Rejection::unfit);
  EXPECT_EQ(spoilt([](L& l, L&, P&) { l.loading(0, 0) = 10.0; }), Rejection::unfit) << "more than the covariance";
  EXPECT_EQ(spoilt([](L&, L&, P& p) { p.covariance(2, 2) = -1.0; }), Rejection::unfit);
  Batch<SE2> drifting = b;
  drifting.drift_m2_per_m = 1e-4;
  EXPECT_EQ(associate(a, drifting, Prior(prior), params).rejection, Rejection::unfit) << "no abscissa";
  EXPECT_EQ(spoilt([](L&, L&, P& p) { p.mean = SE2(nan, 0.0, 0.0); }), Rejection::unfit);
}

// Known to sigma_m along x, to 5 cm across, and seen off_m from where it is.
void loosen(LandmarkFact<SE2>& l, double sigma_m, double off_m = 0.0) {
  l.position.x() += off_m;
  l.covariance = Eigen::Vector2d(sigma_m * sigma_m, 0.05 * 0.05).asDiagonal();
}

// One that is hardly known agrees with anything, also with what lies far away from everything else.
TEST_P(Degenerate, AVeryUncertainLandmarkBreaksNothing) {
  for (const double usual_m : {0.05, 0.5}) {
    for (const double sigma_m : {3.5, 4.5, 15.0, 1e3}) {
      test::Random random(8);
      test::Points points = test::scattered(random, 15, 20.0, 3.0);
      points.emplace_back(50.0, 0.0);
      auto a = test::frozen_batch(random, {{1, 1}, 1}, SE2(), points, {0.05, 0.0});
      auto b = test::frozen_batch(random, {{2, 1}, 1}, SE2(), points, {0.05, 0.0});
      for (Batch<SE2>* batch : {&a, &b})
        for (auto& l : batch->landmarks) loosen(l, usual_m);
      loosen(b.landmarks.back(), sigma_m, 2.5 * sigma_m);
      AssociationParams params;
      params.method = GetParam();
      const auto result = associate(a, b, Prior(RelativePrior<SE2>{SE2(), SE2::Covariance::Identity()}), params);
      EXPECT_EQ(result.decision, Decision::accepted)
          << usual_m << " m beside " << sigma_m << " m: " << to_string(result.rejection);
      EXPECT_GE(result.pairings.size(), 10U);
      for (const auto& [i, j] : result.pairings) EXPECT_EQ(i.index, j.index);
    }
  }
}

// By chi-square alone it would fit better than the right one.
TEST_P(Degenerate, AnUncertainLandmarkTakesNobodysPartner) {
  test::Random random(8);
  test::Points points = test::scattered(random, 12, 12.0, 3.0);
  const auto beside = [](std::size_t k) { return SE2::Point(0.9 * std::cos(k), 0.9 * std::sin(k)); };
  for (std::size_t k = 0; k < 4; ++k) points.emplace_back(points[k] + beside(k));
  const auto a = test::frozen_batch(random, {{1, 1}, 1}, SE2(), points, {0.05, 0.0});
  auto b = test::frozen_batch(random, {{2, 1}, 1}, SE2(), points, {0.05, 0.0});
  for (std::size_t k = 0; k < 4; ++k) {
    b.landmarks[12 + k].position -= beside(k);
    b.landmarks[12 + k].covariance = 0.45 * 0.45 * Eigen::Matrix2d::Identity();
  }
  AssociationParams params;
  params.method = GetParam();
  const auto result = associate(a, b, Prior(RelativePrior<SE2>{SE2(), SE2::Covariance::Identity()}), params);
  EXPECT_EQ(result.decision, Decision::accepted) << to_string(result.rejection);
  int well_known = 0;
  for (const auto& [i, j] : result.pairings) {
    EXPECT_EQ(i.index, j.index);
    well_known += j.index <= 12 ? 1 : 0;
  }
  EXPECT_EQ(well_known, 12);
}

// Of a double that shows too little to be stated, the place with more in view is not to be stated alone.
TEST_P(Degenerate, ADoubleThatCannotBeStatedLeavesNothingToState) {
  int ambiguous = 0;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    test::Random random(seed);
    const test::Points pattern = test::scattered(random, 8, 8.0, 2.0);
    test::Points seen = pattern;
    for (std::size_t k = 0; k < 4; ++k) seen.emplace_back(pattern[k].x() + 25.0, pattern[k].y());
    const auto a = test::frozen_batch(random, {{1, 1}, 1}, SE2(), seen, {0.03, 0.01});
    const auto b = test::frozen_batch(random, {{2, 1}, 1}, SE2(), pattern, {0.03, 0.01});
    AssociationParams params;
    params.method = GetParam();
    const RelativePrior<SE2> prior{SE2(10.0, 0.0, 0.0), Eigen::Vector3d(100.0, 25.0, 0.001).asDiagonal()};
    const auto result = associate(a, b, Prior(prior), params);
    ambiguous += result.decision == Decision::ambiguous ? 1 : 0;
    if (result.decision != Decision::accepted) {
      EXPECT_NE(result.statements().size(), 1U) << seed;
    }
    for (const auto& pairings : result.statements()) EXPECT_GE(pairings.size(), 5U) << seed;
  }
  if (GetParam() == SearchMethod::alignment) {
    EXPECT_GE(ambiguous, 5);
  }
}

// The keys name things and do nothing else.
TEST_P(Degenerate, NamesDoNotMatter) {
  test::Random random(6);
  const test::Points points = test::scattered(random, 25, 15.0);
  const auto a = test::frozen_batch(random, {{1, 1}, 1}, SE2(), points, {0.05, 0.02});
  const auto b = test::frozen_batch(random, {{2, 1}, 1}, SE2(), points, {0.05, 0.02});
  AssociationParams params;
  params.method = GetParam();
  const Prior prior = RelativePrior<SE2>{SE2(), 4.0 * SE2::Covariance::Identity()};
  const auto before = associate(a, b, prior, params);
  Batch<SE2> c = a;
  c.anchor = {{7, 3}, 9};
  for (auto& l : c.landmarks) l.key = {{7, 3}, 1000 + 2 * l.key.index};
  Batch<SE2> d = b;
  d.anchor = {{9, 3}, 2};
  for (auto& l : d.landmarks) l.key = {{9, 3}, 5 + 3 * l.key.index};
  const auto after = associate(c, d, prior, params);
  ASSERT_EQ(after.pairings.size(), before.pairings.size());
  for (std::size_t k = 0; k < after.pairings.size(); ++k) {
    EXPECT_EQ(after.pairings[k].first.index, 1000 + 2 * before.pairings[k].first.index);
    EXPECT_EQ(after.pairings[k].second.index, 5 + 3 * before.pairings[k].second.index);
  }
  EXPECT_EQ(after.decision, before.decision);
  EXPECT_EQ(after.log_likelihood_ratio, before.log_likelihood_ratio);
}

}  // namespace
}  // namespace convoy
