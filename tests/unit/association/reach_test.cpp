#include <convoy/association/reach.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include "../sample_facts.hpp"
#include "sparse_street.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>

namespace convoy {
namespace {

constexpr std::array reaches{Reach::alone, Reach::with_previous, Reach::with_both};

template <class G>
class ReachIn : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(ReachIn, Groups);

TEST(Reach, TakesTheBatchesBesideOne) {
  const Key third{{4, 2}, 3}, first{{4, 2}, 0};
  EXPECT_EQ(batches_within(third, Reach::alone), (std::vector<Key>{third}));
  EXPECT_EQ(batches_within(third, Reach::with_previous), (std::vector<Key>{{{4, 2}, 2}, third}));
  EXPECT_EQ(batches_within(third, Reach::with_both), (std::vector<Key>{{{4, 2}, 2}, third, {{4, 2}, 4}}));
  EXPECT_EQ(batches_within(first, Reach::with_both), (std::vector<Key>{first, {{4, 2}, 1}}));
}

TEST(Reach, KeepsTheTwoOfOneChainApart) {
  const auto at = [](std::uint32_t index) { return Key{{4, 2}, index}; };
  EXPECT_TRUE(apart(at(3), at(4), Reach::alone));
  EXPECT_FALSE(apart(at(3), at(4), Reach::with_previous));
  EXPECT_TRUE(apart(at(3), at(5), Reach::with_previous));
  EXPECT_FALSE(apart(at(3), at(5), Reach::with_both));
  EXPECT_TRUE(apart(at(3), at(6), Reach::with_both));
  EXPECT_TRUE(apart(at(3), {{5, 2}, 3}, Reach::with_both));
}

// The squared error of what is joined, by the covariance that is stated, in the mean over seeds.
TYPED_TEST(ReachIn, PutsNeighboursIntoTheFrameOfTheBatchWithTheDriftInBetween) {
  using G = TypeParam;
  double normalised = 0.0;
  int landmarks = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    const test::SparseStreet<G> street(seed, 0.5, 0.08);
    const FactStore<G> store = street.store();
    const Key anchor{street.chain(1), 2};
    const Batch<G> joined = joined_batch(store, anchor, Reach::with_both);
    std::size_t size = 0;
    for (const Key& key : batches_within(anchor, Reach::with_both)) size += batch_of(store, key).landmarks.size();
    ASSERT_EQ(joined.landmarks.size(), size);
    EXPECT_TRUE(std::is_sorted(joined.landmarks.begin(), joined.landmarks.end(),
                               [](const auto& i, const auto& j) { return i.key < j.key; }));
    for (const auto& l : joined.landmarks) {
      const typename G::Point p = street.truth.at(anchor).inverse() * street.points[street.thing_of.at(l.key)];
      const typename G::Point error = l.position - p;
      if (l.anchor == anchor.index) {
        EXPECT_EQ(l.position, store.landmark(l.key)->position);
        EXPECT_EQ(l.covariance, store.landmark(l.key)->covariance);
        continue;
      }
      EXPECT_TRUE(l.loading.isZero(0.0)) << "it is of another batch, whose errors are others";
      normalised += squared_mahalanobis(error, l.covariance) / G::Dim;
      ++landmarks;
    }
  }
  EXPECT_NEAR(normalised / landmarks, 1.0, 0.15);
}

// What a ladder of searches comes to, as the component climbs it.
template <class G>
std::pair<std::vector<Pairing>, Reach> searched(const FactStore<G>& store, const Key& a, const Key& b) {
  for (Reach reach = Reach::alone;;) {
    const auto result = associate(store, a, b, reach, AssociationParams{});
    if (result.decision == Decision::accepted) return {result.pairings, reach};
    const auto next = next_reach(result, a, b, reach);
    if (!next || a.index + 1 > test::SparseStreet<G>::stops || b.index + 1 > test::SparseStreet<G>::stops)
      return {{}, reach};
    reach = *next;
  }
}

TYPED_TEST(ReachIn, FindsByItsNeighboursWhatABatchAloneDoesNot) {
  using G = TypeParam;
  std::array<int, 3> found{};
  int wrong = 0;
  for (std::uint64_t seed = 1; seed <= 25; ++seed) {
    const test::SparseStreet<G> street(seed, 0.3, 0.3);
    const FactStore<G> store = street.store();
    for (std::uint32_t k = 1; k < test::SparseStreet<G>::stops; ++k) {
      const Key a{street.chain(1), k}, b{street.chain(2), k};
      const auto [pairings, reach] = searched(store, a, b);
      if (pairings.empty()) continue;
      ++found[static_cast<std::size_t>(reach)];
      wrong += street.is_true(pairings) ? 0 : 1;
      for (const auto& [i, j] : pairings) {
        EXPECT_EQ(store.landmark(i)->anchor_key(), a);
        EXPECT_EQ(store.landmark(j)->anchor_key(), b);
      }
    }
  }
  EXPECT_EQ(wrong, 0);
  EXPECT_GT(found[0], 0);
  EXPECT_GE(found[1], 10);
  EXPECT_GE(found[2], 5);
}

// A landmark that names an anchor and is not among those that the anchor counts belongs to no batch.
TEST(Reach, IsOfWhatTheAnchorsCount) {
  test::Store store;
  store.insert(test::prior(1));
  auto anchor = test::anchor(1, 1);
  anchor.first_landmark = 4;
  anchor.landmark_count = 4;
  store.insert(anchor);
  auto stray = test::landmark(1, 500);
  stray.anchor = 1;
  store.insert(stray);
  for (const std::uint32_t i : {6U, 4U, 7U}) store.insert(test::landmark(1, i));
  EXPECT_FALSE(complete(store, test::key_of(1, 1))) << "four have come, and one of them is none of it";
  store.insert(test::landmark(1, 5));
  EXPECT_TRUE(complete(store, test::key_of(1, 1)));
  EXPECT_EQ(joined_batch(store, test::key_of(1, 1), Reach::alone).landmarks.size(), 4U);
}

TEST(Reach, TakesTwoBatchesInEitherOrderAndRefusesWhatHasNotArrived) {
  const test::SparseStreet<SE2> street(1, 0.5, 0.1);
  const FactStore<SE2> store = street.store();
  const Key a{street.chain(1), 2}, b{street.chain(2), 2};
  for (const Reach reach : reaches) {
    const auto there = associate(store, a, b, reach, AssociationParams{});
    EXPECT_FALSE(there.pairings.empty());
    EXPECT_EQ(associate(store, b, a, reach, AssociationParams{}).pairings, there.pairings);
  }
  const Key last{street.chain(1), test::SparseStreet<SE2>::stops}, never{street.chain(7), 1};
  EXPECT_EQ(associate(store, last, b, Reach::with_both, AssociationParams{}).rejection, Rejection::unfit);
  EXPECT_EQ(associate(store, a, never, Reach::alone, AssociationParams{}).rejection, Rejection::unfit);
}

TEST(Reach, HugeBatchesAreRefusedWithWhatIsJoined) {
  const test::SparseStreet<SE2> street(1, 0.5, 0.1);
  const FactStore<SE2> store = street.store();
  const Key a{street.chain(1), 2}, b{street.chain(2), 2};
  AssociationParams params;
  params.max_landmarks = batch_of(store, a).landmarks.size() + batch_of(store, b).landmarks.size();
  EXPECT_NE(associate(store, a, b, Reach::alone, params).rejection, Rejection::search_cut_off);
  EXPECT_EQ(associate(store, a, b, Reach::with_both, params).rejection, Rejection::search_cut_off);
  EXPECT_EQ(next_reach(associate(store, a, b, Reach::with_both, params), a, b, Reach::alone), std::nullopt);
}

TEST(Reach, GoesOnWhereMoreMayHelpAndEndsWhereItMayNot) {
  const Key a{{1, 1}, 3}, b{{2, 1}, 5};
  AssociationResult<SE2> result;
  const auto next = [&](Rejection rejection, Decision decision, Reach reach) {
    result.rejection = rejection;
    result.decision = decision;
    return next_reach(result, a, b, reach);
  };
  EXPECT_EQ(next(Rejection::not_rejected, Decision::accepted, Reach::alone), std::nullopt);
  for (const Rejection final :
       {Rejection::too_few_candidates, Rejection::too_few_pairings, Rejection::prior, Rejection::repeats})
    for (const Reach reach : reaches) EXPECT_EQ(next(final, Decision::none, reach), std::nullopt) << to_string(final);
  for (const Rejection weak : {Rejection::chance, Rejection::runner_up, Rejection::geometry}) {
    const Decision decision = weak == Rejection::runner_up ? Decision::ambiguous : Decision::none;
    EXPECT_EQ(next(weak, decision, Reach::alone), Reach::with_previous) << to_string(weak);
    EXPECT_EQ(next(weak, decision, Reach::with_previous), Reach::with_both) << to_string(weak);
    EXPECT_EQ(next(weak, decision, Reach::with_both), std::nullopt) << to_string(weak);
  }
  result.rejection = Rejection::chance;
  EXPECT_EQ(next_reach(result, Key{{1, 1}, 3}, Key{{1, 1}, 4}, Reach::alone), std::nullopt) << "they share a batch";
  EXPECT_EQ(next_reach(result, Key{{1, 1}, 0}, Key{{2, 1}, 0}, Reach::alone), Reach::with_both) << "none before them";
  EXPECT_EQ(next_reach(result, Key{{1, 1}, 0}, Key{{2, 1}, 1}, Reach::alone), Reach::with_previous);
}

}  // namespace
}  // namespace convoy
