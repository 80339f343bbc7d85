// The search by alignment: where one batch lies on another, by votes and likelihood.
#include <convoy/association/alignment_search.hpp>
#include <convoy/association/associate.hpp>
#include <convoy/config_error.hpp>
#include <convoy/geometry/groups.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>

#include <algorithm>
#include <limits>
#include <set>

namespace convoy {
namespace {

constexpr double confidence = 0.9999;

/// A map of a street, and a batch of new landmarks of which the first `common` are of the map. What is up is known.
template <class G>
class Street {
 public:
  explicit Street(std::uint64_t seed, std::size_t in_map = 120, std::size_t fresh = 24, std::size_t common = 12,
                  test::BatchNoise noise = {0.08, 0.0})
      : random(seed) {
    const test::PointsOf<G> world = test::scattered<G>(random, in_map + fresh - common, 40.0, 1.5);
    const test::PointsOf<G> of_map(world.begin(), world.begin() + static_cast<std::ptrdiff_t>(in_map));
    const test::PointsOf<G> of_batch(world.end() - static_cast<std::ptrdiff_t>(fresh), world.end());
    T_map_b = level(random.uniform(-20.0, 20.0), random.uniform(-20.0, 20.0), random.uniform(-3.0, 3.0));
    map = test::frozen_batch(random, {{1, 1}, 0}, G(), of_map, noise);
    batch = test::frozen_batch(random, {{2, 1}, 0}, T_map_b, of_batch, noise);
    for (std::size_t k = 0; k < common; ++k)
      same.emplace(map.landmarks[in_map - common + k].key, batch.landmarks[k].key);
  }

  static G level(double x, double y, double yaw) {
    typename G::Tangent turn = G::Tangent::Zero();
    turn[G::Dof - 1] = yaw;
    typename G::Point t = G::Point::Zero();
    t.template head<2>() << x, y;
    return G::from_rotation(G::Exp(turn).rotation(), t);
  }

  /// A start known to 9 m and 0.15 rad.
  std::optional<RelativePrior<G>> prior() {
    typename G::Tangent sigma = G::Tangent::Constant(0.02);
    sigma.template head<2>().setConstant(9.0);
    if (G::Dim == 3) sigma[2] = 0.5;
    sigma[G::Dof - 1] = 0.15;
    const typename G::Covariance P = sigma.cwiseAbs2().asDiagonal();
    return RelativePrior<G>{T_map_b * G::Exp(random.template draw<G::Dof>(P)), P};
  }

  std::size_t true_pairs(const std::vector<IndexPairing>& pairings) const {
    return static_cast<std::size_t>(std::count_if(pairings.begin(), pairings.end(), [&](const IndexPairing& p) {
      return same.count({map.landmarks[static_cast<std::size_t>(p.first)].key,
                         batch.landmarks[static_cast<std::size_t>(p.second)].key}) != 0;
    }));
  }

  test::Random random;
  Batch<G> map, batch;
  G T_map_b;
  std::set<Pairing> same;
};

template <class G>
class AlignmentSearches : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(AlignmentSearches, Groups);

TYPED_TEST(AlignmentSearches, FindsTheOnePlace) {
  using G = TypeParam;
  int found = 0;
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    Street<G> s(seed);
    const auto result = find_alignments(s.map, s.batch, s.prior(), confidence, {});
    ASSERT_FALSE(result.candidates.empty());
    const CandidateAlignment<G>& best = result.candidates.front();
    const std::size_t right = s.true_pairs(best.pairings);
    found += right >= 10 && best.pairings.size() - right <= 1;
    const typename G::Tangent error = (s.T_map_b.inverse() * best.T_a_b).Log();
    EXPECT_LT(error.dot(best.covariance.inverse() * error), 40.0) << seed;
    EXPECT_GT(result.places, 1000U);
  }
  EXPECT_GE(found, 29);
}

TYPED_TEST(AlignmentSearches, IsTheSameUnderMotionOrderAndNames) {
  using G = TypeParam;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    Street<G> s(seed);
    const auto prior = s.prior();
    const auto before = find_alignments(s.map, s.batch, prior, confidence, {}).candidates.at(0);
    const G M = Street<G>::level(300.0, -70.0, 2.0);
    Batch<G> moved = s.map;
    const typename G::PointCovariance R = M.rotation();
    for (auto& l : moved.landmarks) {
      l.position = M * l.position;
      l.covariance = R * l.covariance * R.transpose();
      l.key.index += 1000;
    }
    std::reverse(moved.landmarks.begin(), moved.landmarks.end());
    auto after =
        find_alignments(moved, s.batch, {{M * prior->mean, prior->covariance}}, confidence, {}).candidates.at(0);
    for (auto& [i, j] : after.pairings) i = static_cast<int>(s.map.landmarks.size()) - 1 - i;
    std::sort(after.pairings.begin(), after.pairings.end());
    EXPECT_EQ(after.pairings, before.pairings) << seed;
    EXPECT_NEAR(after.log_likelihood_ratio, before.log_likelihood_ratio, 1e-3 * before.log_likelihood_ratio);
    EXPECT_LT(((M * before.T_a_b).inverse() * after.T_a_b).Log().norm(), 1e-3);
  }
}

TYPED_TEST(AlignmentSearches, IsDeterministicToTheBit) {
  using G = TypeParam;
  Street<G> s(3);
  const auto prior = s.prior();
  const auto x = find_alignments(s.map, s.batch, prior, confidence, {}),
             y = find_alignments(s.map, s.batch, prior, confidence, {});
  ASSERT_EQ(x.candidates.size(), y.candidates.size());
  for (std::size_t k = 0; k < x.candidates.size(); ++k) {
    EXPECT_EQ(x.candidates[k].pairings, y.candidates[k].pairings);
    EXPECT_EQ(x.candidates[k].log_likelihood_ratio, y.candidates[k].log_likelihood_ratio);
    EXPECT_EQ(x.candidates[k].T_a_b.translation(), y.candidates[k].T_a_b.translation());
  }
}

// What is paired by chance is no likelier than its number of places lets expect.
TYPED_TEST(AlignmentSearches, ChanceIsNotTakenForAPlace) {
  using G = TypeParam;
  AssociationParams params;
  params.method = SearchMethod::alignment;
  int accepted = 0;
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    Street<G> s(seed), other(5000 + seed);
    accepted += associate(other.map, s.batch, s.prior(), params).decision == Decision::accepted;
  }
  EXPECT_EQ(accepted, 0);
}

// Along a wall whatever is laid onto it finds partners; the disc around each of its landmarks is mostly empty.
TYPED_TEST(AlignmentSearches, AlongAWallPartnersAreChance) {
  using G = TypeParam;
  double chance = 0.0;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    test::Random random(seed);
    const auto wall = [&](VehicleId v, std::size_t size, const G& T) {
      test::PointsOf<G> points;
      for (std::size_t k = 0; k < size; ++k) {
        typename G::Point p = G::Point::Zero();
        p.x() = random.uniform(-30.0, 30.0);
        if constexpr (G::Dim == 3) p.z() = random.uniform(0.0, 6.0);
        points.push_back(p);
      }
      return test::frozen_batch(random, {{v, 1}, 0}, T, points, {0.1, 0.0});
    };
    const Batch<G> a = wall(1, 120, G()), b = wall(2, 20, Street<G>::level(3.0, 2.0, 0.1));
    typename G::Tangent sigma = G::Tangent::Constant(0.02);
    sigma.template head<2>().setConstant(9.0);
    sigma[G::Dof - 1] = 0.15;
    const std::optional<RelativePrior<G>> prior =
        RelativePrior<G>{Street<G>::level(5.0, 0.0, 0.05), sigma.cwiseAbs2().asDiagonal()};
    const auto found = find_alignments(a, b, prior, confidence, AlignmentSearchParams{});
    chance += found.chance_pairings / 20.0;
  }
  EXPECT_GE(chance, 1.0);
}

TYPED_TEST(AlignmentSearches, AMapThatRepeatsIsAmbiguous) {
  using G = TypeParam;
  AssociationParams params;
  params.method = SearchMethod::alignment;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    Street<G> s(seed, 60);
    const std::size_t once = s.map.landmarks.size();
    for (std::size_t k = 0; k < once; ++k) {  // the same again, 6 m on
      LandmarkFact<G> l = s.map.landmarks[k];
      l.position.x() += 6.0;
      l.key.index += static_cast<std::uint32_t>(once);
      s.map.landmarks.push_back(l);
    }
    const auto result = associate(s.map, s.batch, s.prior(), params);
    EXPECT_EQ(result.decision, Decision::ambiguous) << seed << ": " << to_string(result.rejection);
    EXPECT_EQ(result.runner_up_pairings.size(), static_cast<std::size_t>(result.runner_up));
    EXPECT_EQ(result.statements().size(), 2U);
  }
}

TYPED_TEST(AlignmentSearches, LooksTellWhatGeometryCannot) {
  using G = TypeParam;
  Street<G> s(2, 60);
  const std::size_t once = s.map.landmarks.size();
  for (std::size_t k = 0; k < once; ++k) {
    LandmarkFact<G> l = s.map.landmarks[k];
    l.position.x() += 6.0;
    l.key.index += static_cast<std::uint32_t>(once);
    l.descriptor.bytes[0] = 1;
    s.map.landmarks.push_back(l);
  }
  const LooksAlike<G> looks_alike = [](const LandmarkFact<G>& i, const LandmarkFact<G>& j) {
    return i.descriptor.bytes == j.descriptor.bytes;
  };
  AssociationParams params;
  params.method = SearchMethod::alignment;
  const auto prior = s.prior();
  EXPECT_EQ(associate(s.map, s.batch, prior, params).decision, Decision::ambiguous);
  const auto told = associate(s.map, s.batch, prior, params, looks_alike);
  EXPECT_EQ(told.decision, Decision::accepted) << to_string(told.rejection);
  for (const Pairing& p : told.pairings) EXPECT_EQ(s.same.count(p), 1U);
}

// Whatever may lie anywhere, the work is bounded beforehand.
TYPED_TEST(AlignmentSearches, MoreThanTheBudgetIsCutOff) {
  using G = TypeParam;
  Street<G> s(1);
  auto prior = s.prior();
  AlignmentSearchParams params;
  params.max_votes = 1000;
  const auto result = find_alignments(s.map, s.batch, prior, confidence, params);
  EXPECT_TRUE(result.cut_off);
  EXPECT_TRUE(result.candidates.empty());
  EXPECT_EQ(result.votes, 0U);
  AssociationParams all;
  all.method = SearchMethod::alignment;
  all.alignment = params;
  EXPECT_EQ(associate(s.map, s.batch, prior, all).rejection, Rejection::search_cut_off);
}

// A batch far from the point that the prior turns it about: the middle heading sees nothing, others see everything.
TYPED_TEST(AlignmentSearches, TheBudgetHoldsWhateverTheMiddleHeadingSees) {
  using G = TypeParam;
  test::Random random(4);
  const test::PointsOf<G> points = test::scattered<G>(random, 120, 40.0, 1.5);
  const auto a = test::frozen_batch(random, {{1, 1}, 0}, Street<G>::level(0.0, -100.0, 0.0), points, {0.08, 0.0});
  const auto b = test::frozen_batch(random, {{2, 1}, 0}, Street<G>::level(-500.0, 0.0, 0.0), points, {0.08, 0.0});
  typename G::Tangent sigma = G::Tangent::Constant(0.02);
  sigma.template head<2>().setConstant(9.0);
  sigma[G::Dof - 1] = 0.15;
  const std::optional<RelativePrior<G>> prior =
      RelativePrior<G>{Street<G>::level(-500.0, 0.0, 0.0), sigma.cwiseAbs2().asDiagonal()};
  AlignmentSearchParams params;
  const auto whole = find_alignments(a, b, prior, confidence, params);
  ASSERT_FALSE(whole.cut_off);
  params.max_votes = whole.votes / 2;
  const auto half = find_alignments(a, b, prior, confidence, params);
  EXPECT_TRUE(half.cut_off);
  EXPECT_TRUE(half.candidates.empty());
  EXPECT_LE(half.votes, params.max_votes + a.landmarks.size());
}

TYPED_TEST(AlignmentSearches, GeometryThatFixesNothingIsNoPlace) {
  using G = TypeParam;
  AssociationParams params;
  params.method = SearchMethod::alignment;
  const auto row = [](std::size_t count, double step_m) {
    test::PointsOf<G> points;
    for (std::size_t k = 0; k < count; ++k) {
      points.push_back(G::Point::Zero());
      points.back().x() = step_m * static_cast<double>(k);
    }
    return points;
  };
  Street<G> s(1);
  const auto prior = s.prior();
  for (const auto& points : {row(0, 0.0), row(1, 0.0), row(2, 3.0), row(12, 0.0), row(12, 3.0)}) {
    Batch<G> a = test::frozen_batch(s.random, {{1, 1}, 0}, G(), points, {0.05, 0.0});
    Batch<G> b = test::frozen_batch(s.random, {{2, 1}, 0}, G(), points, {0.05, 0.0});
    EXPECT_NE(associate(a, b, prior, params).decision, Decision::accepted) << points.size();
    EXPECT_NE(associate(s.map, b, prior, params).decision, Decision::accepted) << points.size();
    find_alignments(a, s.batch, prior, confidence, {});
  }
}

TEST(AlignmentSearch, WithoutAPriorEveryPlaceIsTried) {
  int found = 0;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    Street<SE2> s(seed);
    const auto result = find_alignments<SE2>(s.map, s.batch, {}, confidence, {});
    ASSERT_FALSE(result.candidates.empty());
    found += s.true_pairs(result.candidates.front().pairings) >= 10;
  }
  EXPECT_GE(found, 9);
}

TEST(AlignmentSearch, AMirrorImageIsNoPlace) {
  AssociationParams params;
  params.method = SearchMethod::alignment;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    Street<SE2> s(seed);
    const Eigen::Matrix2d mirror = Eigen::Vector2d(1.0, -1.0).asDiagonal();
    for (auto& l : s.batch.landmarks) {
      l.position = mirror * l.position;
      l.covariance = mirror * l.covariance * mirror;
    }
    EXPECT_NE(associate(s.map, s.batch, s.prior(), params).decision, Decision::accepted) << seed;
  }
}

TEST(AlignmentSearch, InSpaceItTakesAPriorThatKnowsWhatIsUp) {
  Street<SE3> s(1);
  auto prior = s.prior();
  EXPECT_TRUE(has_level<SE3>(prior));
  EXPECT_FALSE(has_level<SE3>(std::nullopt));
  prior->covariance(3, 3) = 0.3 * 0.3;
  EXPECT_FALSE(has_level<SE3>(prior));
  EXPECT_TRUE(has_level<SE2>(std::nullopt));
}

// Drift within a long batch: without it, its two ends do not lie in one place.
TEST(AlignmentSearch, KnowsTheDriftWithinABatch) {
  int told = 0, untold = 0;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    Street<SE2> s(seed, 120, 24, 24, {0.05, 0.0});
    constexpr double sigma_m = 0.35;
    const SE2::Point shift(s.random.normal(sigma_m), s.random.normal(sigma_m));
    for (std::size_t k = 0; k < s.batch.landmarks.size(); ++k) {
      const bool late = s.batch.landmarks[k].position.x() > -s.T_map_b.inverse().translation().x();
      s.batch.abscissa_m.push_back(late ? 40.0 : 0.0);
      if (late) s.batch.landmarks[k].position += 2.0 * shift;
    }
    const auto prior = s.prior();
    untold += static_cast<int>(
        s.true_pairs(find_alignments<SE2>(s.map, s.batch, prior, confidence, {}).candidates.at(0).pairings));
    s.batch.drift_m2_per_m = 4.0 * sigma_m * sigma_m / 40.0;
    told += static_cast<int>(
        s.true_pairs(find_alignments<SE2>(s.map, s.batch, prior, confidence, {}).candidates.at(0).pairings));
  }
  EXPECT_GT(told, untold + 20);
}

TEST(AlignmentSearchParams, AreChecked) {
  const auto refused = [](auto change) {
    AlignmentSearchParams params;
    change(params);
    try {
      validate(params);
    } catch (const ConfigError&) {
      return true;
    }
    return false;
  };
  using P = AlignmentSearchParams;
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(refused([](P&) {}));
  for (const double bad : {0.0, 1.0, nan}) EXPECT_TRUE(refused([&](P& p) { p.gate = bad; }));
  for (const double bad : {0.0, -1.0, nan}) {
    EXPECT_TRUE(refused([&](P& p) { p.min_odds = bad; }));
    EXPECT_TRUE(refused([&](P& p) { p.density_radius_m = bad; }));
  }
  EXPECT_TRUE(refused([](P& p) { p.max_proposals = 1; }));
  EXPECT_TRUE(refused([](P& p) { p.max_votes = 0; }));
}

}  // namespace
}  // namespace convoy
