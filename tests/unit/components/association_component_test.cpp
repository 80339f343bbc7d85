#include <convoy/components/association_component.hpp>
#include <convoy/exchange/in_process.hpp>
#include <convoy/geometry/groups.hpp>

#include "../association/sparse_street.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <set>

namespace convoy {
namespace {

using Street = test::SparseStreet<SE2>;

/// A vehicle that is told the facts of two others, and answers for what vehicle `self` has done in an earlier epoch.
class Listener {
 public:
  explicit Listener(VehicleId self)
      : exchange_(network_.join()),
        teller_(network_.join()),
        manager_({self, 2}, *exchange_, {}),
        association_(manager_, {}) {
    manager_.open_chain(0.0, {});
  }
  void tell(const Street::Fact& fact) {
    Payload<SE2> payload;
    if (const auto* anchor = std::get_if<AnchorFact<SE2>>(&fact)) payload = *anchor;
    else if (const auto* prior = std::get_if<PriorFact<SE2>>(&fact)) payload = *prior;
    else payload = LandmarkBatch<SE2>{{std::get<LandmarkFact<SE2>>(fact)}};
    EXPECT_EQ(teller_->send({{9, 1}, payload}), SendStatus::sent);
  }
  /// Looks at most so often. Returns how often it did.
  int look(int searches = 8) {
    manager_.step(now_s_ += 0.1);
    return association_.step(searches);
  }
  void look_at_all() {
    while (look() > 0) {
    }
  }
  std::set<std::vector<Pairing>> stated() const {
    std::set<std::vector<Pairing>> all;
    for (const auto& [id, chain] : manager_.store().chains())
      for (const auto& [index, association] : chain.associations) all.insert(association.pairings);
    return all;
  }
  const AssociationCounters& counters() const { return association_.counters(); }
  std::size_t held() const { return manager_.store().size(); }

 private:
  InProcessNetwork<SE2> network_;
  std::unique_ptr<SubmapExchange<SE2>> exchange_, teller_;
  SubmapManager<SE2> manager_;
  AssociationComponent<SE2> association_;
  double now_s_ = 0.0;
};

// Of a street where most batches say too little by themselves: seeds that have some of every kind.
constexpr double kept = 0.3, noise_m = 0.3;

TEST(AssociationComponent, StatesTheSameWhateverTheOrderOfArrivalAndWhoeverLooks) {
  std::size_t sets = 0;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    const Street street(seed, kept, noise_m);
    std::set<std::vector<Pairing>> first;
    for (int order = 0; order < 6; ++order) {
      std::vector<Street::Fact> facts = street.facts;
      std::mt19937_64 shuffle(static_cast<std::uint64_t>(order));
      if (order > 0) std::shuffle(facts.begin(), facts.end(), shuffle);
      Listener listener(order % 2 == 0 ? 1 : 2);
      for (std::size_t k = 0; k < facts.size(); ++k) {
        listener.tell(facts[k]);
        if (k % 7 == 0) listener.look(1);
      }
      listener.look_at_all();
      if (order == 0) first = listener.stated();
      EXPECT_EQ(listener.stated(), first) << "seed " << seed << ", order " << order;
    }
    sets += first.size();
  }
  EXPECT_GE(sets, 10U);
}

TEST(AssociationComponent, ABatchThatSaysTooLittleWaitsForItsNeighbours) {
  std::size_t later = 0, waited = 0;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    const Street street(seed, kept, noise_m);
    Listener listener(1);
    const auto anchor_of = [](const Street::Fact& fact) {
      if (const auto* landmark = std::get_if<LandmarkFact<SE2>>(&fact)) return landmark->anchor;
      if (const auto* anchor = std::get_if<AnchorFact<SE2>>(&fact)) return anchor->key.index;
      return 0U;
    };
    std::set<std::vector<Pairing>> before;
    for (std::uint32_t k = 0; k <= Street::stops; ++k) {
      for (const auto& fact : street.facts)
        if (anchor_of(fact) == k) listener.tell(fact);
      listener.look_at_all();
      waited += listener.counters().waiting;
      // What is new, and of batches that had all arrived before.
      for (const auto& pairings : listener.stated()) {
        const auto index_of = [&](const Key& key) {
          for (const auto& fact : street.facts)
            if (const auto* l = std::get_if<LandmarkFact<SE2>>(&fact); l != nullptr && l->key == key) return l->anchor;
          return 0U;
        };
        if (before.count(pairings) == 0 && index_of(pairings.front().first) < k &&
            index_of(pairings.front().second) < k)
          ++later;
      }
      before = listener.stated();
    }
  }
  EXPECT_GE(waited, 2U);
  EXPECT_GE(later, 2U);
}

TEST(AssociationComponent, DoesNoMoreInAStepThanItMay) {
  const Street street(1, 0.5, 0.1);
  Listener listener(1);
  for (const auto& fact : street.facts) listener.tell(fact);
  std::uint64_t before = 0;
  int steps = 0;
  for (; listener.look(3) > 0; ++steps) {
    EXPECT_LE(listener.counters().searches - before, 3U);
    before = listener.counters().searches;
  }
  EXPECT_GE(steps, 8);  // 28 pairs of batches of at least one of which it answers for
}

}  // namespace
}  // namespace convoy
