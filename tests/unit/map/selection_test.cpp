#include <convoy/config_error.hpp>
#include <convoy/map/selection.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>

namespace convoy {
namespace {

using test::SampleFleet;
using test::Store;
using test::unconfirmed_too;

HypothesisState state_of(const Selection<SE2>& selection, Hash id) {
  for (const auto& h : selection.hypotheses)
    if (h.id == id) return h.state;
  ADD_FAILURE() << "not stated";
  return HypothesisState::waiting;
}
HypothesisState state_of(const Store& store, Hash id) { return state_of(select(store, unconfirmed_too), id); }

/// Two vehicles with one batch each of the same place, and one of vehicle 3.
struct Place {
  explicit Place(std::uint64_t seed = 1) : fleet(seed) {
    for (const VehicleId v : {1U, 2U, 3U}) {
      fleet.start(v, SE2(-10.0 * v, 0.0, 0.0), test::paper_bias);
      anchors.push_back(fleet.stop(v, SE2(2.0 * v, 0.0, 0.3 * v)));
    }
  }
  std::vector<Pairing> common(int a, int b, std::size_t count = 1000) const {
    return fleet.common(anchors[static_cast<std::size_t>(a)], anchors[static_cast<std::size_t>(b)], count);
  }
  SampleFleet fleet;
  std::vector<Key> anchors;
};

/// Each landmark of a with the next one's partner in b.
std::vector<Pairing> rotated(std::vector<Pairing> pairs) {
  std::vector<Key> second;
  for (const auto& p : pairs) second.push_back(p.second);
  std::rotate(second.begin(), second.begin() + 1, second.end());
  for (std::size_t k = 0; k < pairs.size(); ++k) pairs[k].second = second[k];
  return canonical(pairs);
}

TEST(Select, AcceptsWhatAligns) {
  Place place;
  const auto pairs = place.common(0, 1);
  ASSERT_GE(pairs.size(), 8U);
  const Hash id = place.fleet.associate(2, pairs);
  const auto selection = select(place.fleet.store(), unconfirmed_too);
  ASSERT_EQ(selection.hypotheses.size(), 1U);
  const auto& h = selection.hypotheses[0];
  EXPECT_EQ(h.id, id);
  EXPECT_EQ(h.state, HypothesisState::accepted);
  EXPECT_EQ(h.batch_a, place.anchors[0]);
  EXPECT_EQ(h.batch_b, place.anchors[1]);
  EXPECT_EQ(h.author, test::chain_of(2));
  const SE2 truth = place.fleet.truth.at(h.batch_a).inverse() * place.fleet.truth.at(h.batch_b);
  EXPECT_LT((h.alignment.T_a_b.inverse() * truth).Log().norm(), 0.5);
  ASSERT_EQ(selection.classes.size(), pairs.size());
  for (std::size_t k = 0; k < pairs.size(); ++k)
    EXPECT_TRUE(std::ranges::equal(selection.classes[k], std::vector{pairs[k].first, pairs[k].second}));
}

TEST(Select, RefusesWhatIsMalformed) {
  Place place;
  const auto pairs = place.common(0, 1), others = place.common(0, 2);
  ASSERT_GE(pairs.size(), 8U);
  std::vector<Pairing> few(pairs.begin(), pairs.begin() + 4);
  std::vector<Pairing> three_batches(pairs.begin(), pairs.begin() + 5);
  three_batches.push_back(*std::find_if(others.begin(), others.end(), [&](const Pairing& p) {
    return std::none_of(pairs.begin(), pairs.begin() + 5, [&](const Pairing& q) { return q.first == p.first; });
  }));
  std::vector<Pairing> twice(pairs.begin(), pairs.begin() + 6);
  twice.emplace_back(pairs[0].first, pairs[7].second);
  std::vector<Pairing> within;  // one batch with itself
  for (std::size_t k = 0; k < 6; ++k) within.emplace_back(pairs[k].first, pairs[k + 1].first);
  for (const auto& bad : {few, three_batches, twice, within}) {
    Place fresh;
    const Hash id = fresh.fleet.associate(1, canonical(bad));
    const auto selection = select(fresh.fleet.store(), unconfirmed_too);
    EXPECT_EQ(state_of(selection, id), HypothesisState::malformed);
    EXPECT_TRUE(selection.classes.empty());
  }
}

TEST(Select, RefusesWhatDoesNotAlign) {
  Place place;
  const auto pairs = place.common(0, 1);
  const Hash id = place.fleet.associate(1, rotated(pairs));
  EXPECT_EQ(state_of(place.fleet.store(), id), HypothesisState::geometry);
}

TEST(Select, WaitsForLandmarksAndAnchorsAndThenNoLonger) {
  Place place;
  const auto pairs = place.common(0, 1);
  const Hash id = place.fleet.associate(1, pairs);
  const auto without = [&](auto missing) {
    std::vector<test::Fact> facts;
    std::copy_if(place.fleet.facts.begin(), place.fleet.facts.end(), std::back_inserter(facts),
                 [&](const test::Fact& fact) { return !missing(fact); });
    return SampleFleet::store_of(facts);
  };
  const auto is = [](const test::Fact& fact, const Key& key, auto kind) {
    const auto* f = std::get_if<decltype(kind)>(&fact);
    return f != nullptr && f->key == key;
  };
  for (const Key& key : {pairs[0].first, pairs[3].second})
    EXPECT_EQ(state_of(without([&](const auto& f) { return is(f, key, test::Landmark{}); }), id),
              HypothesisState::waiting);
  for (const Key& key : {place.anchors[0], place.anchors[1]})
    EXPECT_EQ(state_of(without([&](const auto& f) { return is(f, key, test::Anchor{}); }), id),
              HypothesisState::waiting);
  EXPECT_EQ(state_of(place.fleet.store(), id), HypothesisState::accepted);
}

TEST(Select, TheLastVerdictOfEachAuthorCountsAndOneVetoIsEnough) {
  Place place;
  const Hash id = place.fleet.associate(1, place.common(0, 1));
  const auto now = [&] { return state_of(place.fleet.store(), id); };
  place.fleet.judge(3, id, false);
  EXPECT_EQ(now(), HypothesisState::accepted);
  place.fleet.judge(2, id, true);
  EXPECT_EQ(now(), HypothesisState::vetoed);
  place.fleet.judge(3, id, false);  // another's approval does not lift it
  EXPECT_EQ(now(), HypothesisState::vetoed);
  place.fleet.judge(2, id, false);
  EXPECT_EQ(now(), HypothesisState::accepted);
  place.fleet.judge(3, id, true);
  place.fleet.judge(2, id, false);
  EXPECT_EQ(now(), HypothesisState::vetoed);
  place.fleet.judge(1, id + 1, false);  // of another hypothesis
  EXPECT_EQ(now(), HypothesisState::vetoed);
  place.fleet.judge(3, id, false);
  EXPECT_EQ(now(), HypothesisState::accepted);
}

TEST(Select, OfTwoThatMakeOneBatchsLandmarksTheSameTheSmallerLoses) {
  // 1-2 and 2-3 are right. A false 1-3 hypothesis, shifted by one landmark, would join two landmarks of batch 1.
  // Its landmarks lie on a regular row, so that it aligns.
  std::vector<test::Fact> facts;
  for (const VehicleId v : {1U, 2U, 3U}) {
    facts.emplace_back(test::prior(v));
    facts.emplace_back(test::anchor(v, 0));
    facts.emplace_back(test::anchor(v, 1));
    for (std::uint32_t i = 0; i < 12; ++i) {
      auto l = test::landmark(v, i);
      l.anchor = 1;
      l.position = {3.0 * i, 0.0};
      l.loading.setZero();
      facts.emplace_back(l);
    }
  }
  const auto row = [](VehicleId a, VehicleId b, std::uint32_t count, std::uint32_t shift) {
    std::vector<Pairing> pairs;
    for (std::uint32_t i = 0; i < count; ++i) pairs.emplace_back(test::key_of(a, i), test::key_of(b, i + shift));
    return canonical(pairs);
  };
  const auto right_12 = row(1, 2, 12, 0), right_23 = row(2, 3, 11, 0);
  const auto wrong_13 = row(1, 3, 8, 1);
  const auto with = [&](const std::vector<std::vector<Pairing>>& hypotheses) {
    auto all = facts;
    std::uint32_t index = 0;
    for (const auto& pairs : hypotheses) all.emplace_back(test::association(3, index++, pairs));
    return SampleFleet::store_of(all);
  };
  const auto state = [](const Store& store, const std::vector<Pairing>& pairs) {
    return state_of(store, hypothesis_id(pairs));
  };

  EXPECT_EQ(state(with({wrong_13}), wrong_13), HypothesisState::accepted);  // alone nothing speaks against it
  EXPECT_EQ(state(with({right_12, wrong_13}), wrong_13), HypothesisState::accepted);
  for (const auto& order : {std::vector{right_12, right_23, wrong_13}, std::vector{wrong_13, right_23, right_12}}) {
    const Store store = with(order);
    EXPECT_EQ(state(store, right_12), HypothesisState::accepted);
    EXPECT_EQ(state(store, right_23), HypothesisState::accepted);
    EXPECT_EQ(state(store, wrong_13), HypothesisState::class_conflict);
    for (const auto& members : select(store, unconfirmed_too).classes) {
      std::set<Key> batches;
      for (const Key& key : members) EXPECT_TRUE(batches.insert(store.landmark(key)->anchor_key()).second);
    }
  }
  // With more support than one of the others it stays, and that one goes.
  const auto weak_23 = row(2, 3, 6, 0);
  const Store store = with({right_12, weak_23, wrong_13});
  EXPECT_EQ(state(store, wrong_13), HypothesisState::accepted);
  EXPECT_EQ(state(store, weak_23), HypothesisState::class_conflict);
  // A hypothesis that conflicts enters not at all, not with the half of it that would fit.
  for (const auto& members : select(store, unconfirmed_too).classes)
    EXPECT_FALSE(std::count(members.begin(), members.end(), test::key_of(2, 5)) &&
                 std::count(members.begin(), members.end(), test::key_of(3, 5)));
}

TEST(Select, TheSameStatementOfTwoAuthorsHasNoEffect) {
  Place once, twice;
  once.fleet.associate(1, once.common(0, 1));
  twice.fleet.associate(1, twice.common(0, 1));
  twice.fleet.associate(2, twice.common(0, 1));
  twice.fleet.associate(3, twice.common(0, 1));
  const auto a = select(once.fleet.store(), unconfirmed_too), b = select(twice.fleet.store(), unconfirmed_too);
  EXPECT_EQ(b.hypotheses.size(), 1U);
  EXPECT_EQ(a.digest(), b.digest());
  EXPECT_EQ(a.classes, b.classes);
  EXPECT_EQ(test::built(once.fleet.store(), unconfirmed_too).map->digest(),
            test::built(twice.fleet.store(), unconfirmed_too).map->digest());
  EXPECT_EQ(once.fleet.store().digest(), twice.fleet.store().digest());
}

TEST(Select, TransitivePairsMergeAndClosingTheTriangleAddsNothing) {
  Place open;
  open.fleet.associate(2, open.common(0, 1));
  open.fleet.associate(3, open.common(1, 2));
  Place closed;
  closed.fleet.associate(2, closed.common(0, 1));
  closed.fleet.associate(3, closed.common(1, 2));
  // Only what both others have in common, so that the third side says nothing new.
  std::vector<Pairing> third;
  const auto ab = closed.common(0, 1), bc = closed.common(1, 2);
  for (const auto& p : ab)
    for (const auto& q : bc)
      if (p.second == q.first) third.emplace_back(p.first, q.second);
  ASSERT_GE(third.size(), 5U);
  closed.fleet.associate(1, canonical(third));
  const auto a = select(open.fleet.store(), unconfirmed_too), b = select(closed.fleet.store(), unconfirmed_too);
  EXPECT_TRUE(std::any_of(a.classes.begin(), a.classes.end(), [](const auto& c) { return c.size() == 3; }));
  EXPECT_EQ(a.classes, b.classes);
  EXPECT_EQ(test::built(open.fleet.store(), unconfirmed_too).map->poses().back().translation(),
            test::built(closed.fleet.store(), unconfirmed_too).map->poses().back().translation());
}

TEST(Select, TakesTheStrongestFirstWhateverTheOrderOfArrival) {
  auto fleet = test::street_fleet(3);
  const auto reference = select(fleet.store(), SelectionParams{});
  ASSERT_GE(reference.hypotheses.size(), 5U);
  for (std::size_t k = 1; k < reference.hypotheses.size(); ++k) {
    const auto &p = reference.hypotheses[k - 1], &q = reference.hypotheses[k];
    EXPECT_TRUE(p.pairings->size() > q.pairings->size() || (p.pairings->size() == q.pairings->size() && p.id < q.id));
  }
  for (int round = 0; round < 10; ++round) {
    std::shuffle(fleet.facts.begin(), fleet.facts.end(), fleet.random().engine());
    const auto again = select(fleet.store(), SelectionParams{});
    EXPECT_EQ(again.digest(), reference.digest());
    EXPECT_EQ(again.classes, reference.classes);
  }
}

TEST(Select, LeavesOutWhatTheMapExcluded) {
  Place place;
  const Hash id = place.fleet.associate(1, place.common(0, 1));
  const auto selection = select(place.fleet.store(), unconfirmed_too, Exclusions{{id}, {}, {}});
  EXPECT_EQ(state_of(selection, id), HypothesisState::map_residual);
  EXPECT_TRUE(selection.classes.empty());
}

TEST(Select, RefusesParametersOutOfRange) {
  const auto refusal = [](auto change) -> std::string {
    SelectionParams params;
    change(params);
    try {
      Selector<SE2> selector(params);
    } catch (const RangeError& error) {
      return error.what();
    }
    return "accepted";
  };
  using P = SelectionParams;
  EXPECT_EQ(refusal([](P&) {}), "accepted");
  EXPECT_EQ(refusal([](P& p) { p.min_pairings = 2; }),
            "map: min_pairings must be 3 or more; two pairs align with anything (it is 2)");
  EXPECT_EQ(refusal([](P& p) { p.residual = 0.0; }), "map: residual must lie in (0, 1) (it is 0)");
  EXPECT_EQ(refusal([](P& p) { p.map_residual = 1.5; }), "map: map_residual must lie in (0, 1) (it is 1.5)");
  EXPECT_EQ(refusal([](P& p) { p.max_runner_up_share = 2.0; }),
            "map: max_runner_up_share must lie in (0, 1] (it is 2)");
  EXPECT_EQ(refusal([](P& p) { p.slack.scale = -1.0; }), "map: scale_slack must be >= 0 (it is -1)");
  EXPECT_EQ(refusal([](P& p) { p.slack.heading_rad_per_m = NAN; }),
            "map: heading_slack_rad_per_m must be >= 0 (it is nan)");
  EXPECT_EQ(refusal([](P& p) { p.slack.scale = INFINITY; }), "map: scale_slack must be >= 0 (it is inf)");
  EXPECT_EQ(refusal([](P& p) { p.min_confirmed = 0; }),
            "map: min_confirmed must be 1 or more; 1 trusts the first association (it is 0)");
  EXPECT_EQ(refusal([](P& p) { p.separation = 1.0; }), "map: separation must lie in (0, 1) (it is 1)");
  EXPECT_EQ(refusal([](P& p) { p.fix_correlation_s = -60.0; }), "map: fix_correlation_s must be >= 0 (it is -60)");
  EXPECT_EQ(refusal([](P& p) { p.fix_residual = NAN; }), "map: fix_residual must lie in (0, 1) (it is nan)");
}

}  // namespace
}  // namespace convoy
