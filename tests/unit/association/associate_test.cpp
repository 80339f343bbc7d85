#include <convoy/association/associate.hpp>
#include <convoy/config_error.hpp>
#include <convoy/geometry/groups.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <set>

namespace convoy {
namespace {

using Prior = std::optional<RelativePrior<SE2>>;

const Key anchor_a{{1, 1}, 3}, anchor_b{{2, 1}, 5};

/// Two vehicles in one world. Each sees what lies within 22 m.
struct Meeting {
  explicit Meeting(std::uint64_t seed, double apart_m = 12.0, test::BatchNoise noise = {0.12, 0.1}) : random(seed) {
    const test::Points world = test::scattered(random, 150, 55.0, 2.0);
    const SE2 T_w_a(0.0, 0.0, random.uniform(-3.0, 3.0));
    const SE2 T_w_b(apart_m, 0.0, random.uniform(-3.0, 3.0));
    test::Points seen_a, seen_b;
    std::vector<std::size_t> id_a, id_b;
    for (std::size_t k = 0; k < world.size(); ++k) {
      if ((T_w_a.inverse() * world[k]).norm() < 22.0) seen_a.push_back(world[k]), id_a.push_back(k);
      if ((T_w_b.inverse() * world[k]).norm() < 22.0) seen_b.push_back(world[k]), id_b.push_back(k);
    }
    a = test::frozen_batch(random, anchor_a, T_w_a, seen_a, noise, 40);
    b = test::frozen_batch(random, anchor_b, T_w_b, seen_b, noise, 70);
    T_a_b = T_w_a.inverse() * T_w_b;
    for (std::size_t i = 0; i < id_a.size(); ++i)
      for (std::size_t j = 0; j < id_b.size(); ++j)
        if (id_a[i] == id_b[j]) same.emplace(a.landmarks[i].key, b.landmarks[j].key);
  }

  /// A static bias of this many metres, as in the paper.
  Prior prior(double sigma_m = 22.0, double sigma_rad = 0.3) {
    SE2::Covariance P = Eigen::Vector3d(sigma_m * sigma_m, sigma_m * sigma_m, sigma_rad * sigma_rad).asDiagonal();
    return RelativePrior<SE2>{T_a_b * SE2::Exp(random.draw<3>(P)), P};
  }

  bool all_true(const AssociationResult<SE2>& result) const {
    return std::all_of(result.pairings.begin(), result.pairings.end(),
                       [&](const Pairing& p) { return same.count(p) != 0; });
  }

  test::Random random;
  Batch<SE2> a, b;
  SE2 T_a_b;
  std::set<Pairing> same;
};

class Associate : public testing::TestWithParam<SearchMethod> {
 protected:
  static AssociationParams params() {
    AssociationParams params;
    params.method = GetParam();
    return params;
  }
};
INSTANTIATE_TEST_SUITE_P(By, Associate, testing::Values(SearchMethod::alignment, SearchMethod::gcbb),
                         [](const auto& by) { return std::string(to_string(by.param)); });

TEST_P(Associate, AcceptsAnOverlapAndPairsOnlyWhatIsTheSame) {
  for (const bool known : {true, false}) {
    int accepted = 0, offered = 0;
    for (std::uint64_t seed = 1; seed <= 60; ++seed) {
      Meeting m(seed);
      if (m.same.size() < 7) continue;
      ++offered;
      const auto result = associate(m.a, m.b, known ? m.prior() : Prior{}, params());
      if (result.decision != Decision::accepted) continue;
      ++accepted;
      EXPECT_EQ(result.rejection, Rejection::not_rejected);
      EXPECT_TRUE(m.all_true(result)) << seed;
      EXPECT_EQ(result.support, static_cast<int>(result.pairings.size()));
      EXPECT_EQ(canonical(result.pairings), result.pairings);
      EXPECT_LT((result.alignment.T_a_b.inverse() * m.T_a_b).Log().norm(), 0.6) << seed;
    }
    ASSERT_GE(offered, 50);
    EXPECT_GE(accepted, offered * 8 / 10) << accepted << " of " << offered;
  }
}

TEST_P(Associate, RefusesWhereThereIsNoOverlap) {
  int searched = 0;
  for (std::uint64_t seed = 1; seed <= 300; ++seed) {
    Meeting m(seed), other(10'000 + seed);  // b is of another world
    const Prior priors[] = {std::nullopt, m.prior()};
    for (const Prior& prior : priors) {
      const auto result = associate(m.a, other.b, prior, params());
      EXPECT_NE(result.decision, Decision::accepted) << seed;
      EXPECT_NE(result.rejection, Rejection::not_rejected);
      searched += result.nodes > 0;
    }
  }
  EXPECT_GE(searched, 500);  // they had to be searched to be refused
}

TEST_P(Associate, RefusesAMirroredWorld) {
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    Meeting m(seed, 0.0);
    const Eigen::Matrix2d mirror = Eigen::Vector2d(1.0, -1.0).asDiagonal();
    for (auto& l : m.b.landmarks) {
      l.position = mirror * l.position;
      l.covariance = mirror * l.covariance * mirror;
      l.loading = mirror * l.loading;
    }
    const auto result = associate(m.a, m.b, Prior{}, params());
    EXPECT_NE(result.decision, Decision::accepted) << seed;
    if (GetParam() == SearchMethod::gcbb) {  // distances alone fit a mirror image
      EXPECT_EQ(result.rejection, Rejection::geometry) << seed;
    }
  }
}

/// a sees a pattern twice, 30 m apart; b sees it once.
std::pair<Batch<SE2>, Batch<SE2>> repeated_pattern(std::uint64_t seed, const SE2& T_w_b) {
  test::Random random(seed);
  const test::Points pattern = test::scattered(random, 9, 10.0, 2.5);
  test::Points both = pattern;
  for (const auto& p : pattern) both.emplace_back(p.x() + 30.0, p.y());
  return {test::frozen_batch(random, anchor_a, SE2(15.0, 0.0, 0.3), both, {0.1, 0.05}),
          test::frozen_batch(random, anchor_b, T_w_b, pattern, {0.1, 0.05})};
}

TEST_P(Associate, ARepeatedPatternIsAmbiguousUntilThePriorTellsWhich) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    const SE2 T_w_b(-2.0, 1.0, -0.8);
    const auto [a, b] = repeated_pattern(seed, T_w_b);
    const auto result = associate(a, b, Prior{}, params());
    EXPECT_EQ(result.decision, Decision::ambiguous) << seed;
    EXPECT_EQ(result.rejection, Rejection::repeats);
    EXPECT_GE(result.runner_up, 6);
    RelativePrior<SE2> near{SE2(15.0, 0.0, 0.3).inverse() * T_w_b, SE2::Covariance::Zero()};
    near.covariance.diagonal() << 4.0, 4.0, 0.01;
    const auto told = associate(a, b, Prior{near}, params());
    EXPECT_EQ(told.decision, Decision::accepted) << seed << ": " << to_string(told.rejection);
    for (const auto& [i, j] : told.pairings) EXPECT_EQ(i.index, j.index);  // the first copy
  }
}

TEST_P(Associate, IsTheSameAfterARigidMotionOfEitherBatch) {
  int accepted = 0;
  for (std::uint64_t seed = 1; seed <= 25; ++seed) {
    Meeting m(seed);
    const Prior prior = m.prior();
    const auto reference = associate(m.a, m.b, prior, params());
    accepted += reference.decision == Decision::accepted;
    const SE2 X = m.random.pose(200.0);
    const auto moved = [&](Batch<SE2> batch) {
      const Eigen::Matrix2d R = X.rotation();
      for (auto& l : batch.landmarks) {
        l.position = X * l.position;
        l.covariance = R * l.covariance * R.transpose();
        l.loading = R * l.loading;
      }
      return batch;
    };
    const SE2::Adjoint Ad = X.adjoint();  // T X^-1 with the error on its right
    const Prior with_b{RelativePrior<SE2>{prior->mean * X.inverse(), Ad * prior->covariance * Ad.transpose()}};
    const Prior with_a{RelativePrior<SE2>{X * prior->mean, prior->covariance}};
    for (const auto& other :
         {associate(m.a, moved(m.b), with_b, params()), associate(moved(m.a), m.b, with_a, params())}) {
      EXPECT_EQ(other.decision, reference.decision) << seed;
      EXPECT_EQ(other.pairings, reference.pairings) << seed;
    }
  }
  EXPECT_GE(accepted, 15);
}

// Everybody lists a batch in the order of its keys. Another order may choose another of several largest sets to begin
// with, but not another place.
TEST_P(Associate, DoesNotDependOnTheOrderOfTheLandmarks) {
  int accepted = 0, same_pairings = 0;
  for (std::uint64_t seed = 1; seed <= 50; ++seed) {
    Meeting m(seed);
    const Prior prior = m.prior();
    const auto reference = associate(m.a, m.b, prior, params());
    std::shuffle(m.a.landmarks.begin(), m.a.landmarks.end(), m.random.engine());
    std::shuffle(m.b.landmarks.begin(), m.b.landmarks.end(), m.random.engine());
    const auto shuffled = associate(m.a, m.b, prior, params());
    EXPECT_EQ(shuffled.decision, reference.decision) << seed;
    if (reference.decision != Decision::accepted) continue;
    ++accepted;
    same_pairings += shuffled.pairings == reference.pairings;
    EXPECT_TRUE(m.all_true(shuffled)) << seed;
  }
  EXPECT_GE(accepted, 40);
  EXPECT_GE(same_pairings, accepted * 9 / 10);
}

TEST_P(Associate, DoesNotDependOnTheOrderOfArrival) {
  Meeting m(1);
  std::vector<LandmarkFact<SE2>> facts = m.a.landmarks;
  facts.insert(facts.end(), m.b.landmarks.begin(), m.b.landmarks.end());
  const Prior prior = m.prior();
  const auto reference = associate(m.a, m.b, prior, params());
  ASSERT_EQ(reference.decision, Decision::accepted);
  for (int round = 0; round < 20; ++round) {
    std::shuffle(facts.begin(), facts.end(), m.random.engine());
    FactStore<SE2> store;
    for (const auto& fact : facts) ASSERT_EQ(store.insert(fact), Insertion::inserted);
    const auto result = associate(batch_of(store, anchor_a), batch_of(store, anchor_b), prior, params());
    EXPECT_EQ(result.pairings, reference.pairings);
    EXPECT_EQ(result.alignment.joint, reference.alignment.joint);
  }
}

TEST_P(Associate, IsDeterministicToTheBit) {
  Meeting m(1);
  const Prior prior = m.prior();
  const auto first = associate(m.a, m.b, prior, params()), second = associate(m.a, m.b, prior, params());
  ASSERT_EQ(first.decision, Decision::accepted) << to_string(first.rejection);
  EXPECT_EQ(first.pairings, second.pairings);
  EXPECT_EQ(first.nodes, second.nodes);
  EXPECT_EQ(first.alignment.T_a_b.translation(), second.alignment.T_a_b.translation());
  EXPECT_EQ(first.alignment.joint, second.alignment.joint);
  EXPECT_EQ(first.expected_false_alarms, second.expected_false_alarms);
}

TEST(LargestSet, IsDecidedOnAsByFigure5AsWritten) {
  AssociationParams quick, literal;
  quick.method = SearchMethod::gcbb;
  literal.method = SearchMethod::fig5;
  literal.max_nodes = 100'000'000;
  int accepted = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    Meeting m(seed);
    for (auto* batch : {&m.a, &m.b}) {  // Fig. 5 is exponential
      auto& l = batch->landmarks;
      std::stable_sort(l.begin(), l.end(), [&](const auto& p, const auto& q) {
        const auto common = [&](const auto& x) {
          return std::any_of(m.same.begin(), m.same.end(),
                             [&](const Pairing& s) { return s.first == x.key || s.second == x.key; });
        };
        return common(p) > common(q);
      });
      if (l.size() > 10) l.resize(10);
      if (seed % 3 == 0) std::reverse(l.begin(), l.end());
    }
    const Prior prior = m.prior(10.0, 0.2);
    const auto fast = associate(m.a, m.b, prior, quick), slow = associate(m.a, m.b, prior, literal);
    EXPECT_NE(slow.rejection, Rejection::search_cut_off) << seed;
    EXPECT_EQ(fast.decision, slow.decision) << seed;
    EXPECT_EQ(fast.rejection, slow.rejection) << seed;
    if (fast.decision == Decision::accepted) {
      EXPECT_EQ(fast.pairings, slow.pairings) << seed;
      ++accepted;
    }
  }
  EXPECT_GE(accepted, 15);
}

TEST_P(Associate, SaysWhyNot) {
  Meeting m(1);
  const Prior prior = m.prior();
  ASSERT_EQ(associate(m.a, m.b, prior, params()).decision, Decision::accepted);
  const auto reason = [&](const Batch<SE2>& a, const Batch<SE2>& b, const Prior& p, auto change) {
    AssociationParams changed = params();
    change(changed);
    return associate(a, b, p, changed).rejection;
  };
  using P = AssociationParams;
  Batch<SE2> few = m.a;
  few.landmarks.resize(4);
  EXPECT_EQ(reason(few, m.b, prior, [](P&) {}), Rejection::too_few_candidates);
  EXPECT_EQ(reason(m.a, m.b, prior, [](P& p) { p.max_nodes = p.alignment.max_votes = 2; }), Rejection::search_cut_off);
  if (GetParam() == SearchMethod::gcbb) {
    EXPECT_EQ(reason(m.a, m.b, prior, [](P& p) { p.max_candidates = 10; }), Rejection::search_cut_off);
  }
  EXPECT_EQ(reason(m.a, m.b, prior, [](P& p) { p.min_pairings = 18; }), Rejection::too_few_pairings);
  EXPECT_EQ(reason(m.a, m.b, prior, [](P& p) { p.max_false_alarms = p.max_chance_places = 1e-300; }),
            Rejection::chance);
  Prior far = prior;
  far->mean = SE2(500.0, 0.0, 0.0) * far->mean;
  EXPECT_EQ(reason(m.a, m.b, far, [](P&) {}), Rejection::too_few_candidates);
}

TEST(AssociationParams, AreChecked) {
  const auto refused = [](auto change) {
    AssociationParams params;
    change(params);
    try {
      validate(params);
    } catch (const ConfigError&) {
      return true;
    }
    return false;
  };
  using P = AssociationParams;
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(refused([](P&) {}));
  for (const double share : {0.0, 1.0, -0.1, nan}) {
    EXPECT_TRUE(refused([&](P& p) { p.constraints.compatibility = share; }));
    EXPECT_TRUE(refused([&](P& p) { p.constraints.distance = share; }));
    EXPECT_TRUE(refused([&](P& p) { p.residual = share; }));
    EXPECT_TRUE(refused([&](P& p) { p.separation = share; }));
  }
  EXPECT_TRUE(refused([](P& p) { p.constraints.min_distance_m = -1.0; }));
  EXPECT_TRUE(refused([](P& p) { p.min_pairings = 2; }));
  EXPECT_TRUE(refused([](P& p) { p.max_false_alarms = 0.0; }));
  EXPECT_TRUE(refused([](P& p) { p.max_runner_up_share = 0.0; }));
  EXPECT_TRUE(refused([](P& p) { p.max_nodes = 0; }));
  EXPECT_TRUE(refused([](P& p) { p.max_candidates = 0; }));
  EXPECT_TRUE(refused([](P& p) { p.max_landmarks = 0; }));
  EXPECT_TRUE(refused([](P& p) { p.max_doubt = 1.5; }));
  EXPECT_TRUE(refused([](P& p) { p.min_similarity = -1.5; }));
  EXPECT_TRUE(refused([](P& p) { p.constraints.heading = 1.0; }));
}

}  // namespace
}  // namespace convoy
