// FactStore: the submaps of all vehicles, one grow-only set of facts (paper, Fig. 3; DESIGN A2, B4).
// Inserting is idempotent, commutative and associative: the same facts give the same store in any order.
#pragma once

#include <convoy/submap/facts.hpp>

#include <array>
#include <cstdint>
#include <map>
#include <type_traits>
#include <vector>

namespace convoy {

/// Why a fact was not taken in. Anything but `inserted` leaves the store as it was.
enum class Insertion : std::uint8_t {
  inserted,
  duplicate,        ///< the same content was there already
  conflict,         ///< another content stands under this key: its author broke the protocol
  unknown_vehicle,  ///< not on the roster
  not_finite,       ///< a NaN or an infinity
  not_covariance,   ///< a covariance that is not symmetric positive semidefinite
  out_of_range,     ///< a position, abscissa, index or size beyond the plausible limits
  malformed,        ///< empty or unordered pairings, a first anchor that is not the origin, vehicle 0
  over_share,       ///< its author has filled its share of this store (FactLimits)
};
inline constexpr int insertion_count = 9;
const char* to_string(Insertion result);

/// Half-open range of indices [first, end).
struct IndexRange {
  std::uint32_t first = 0, end = 0;
  bool operator==(const IndexRange&) const = default;
};

/// What one vehicle says it knows of one kind of one chain.
struct ChainMark {
  ChainId chain;
  FactKind kind = FactKind::anchor;
  std::uint32_t high_water = 0;  ///< one past the highest index known to exist
  std::uint32_t count = 0;       ///< facts held below it
  Hash hash = 0;                 ///< sum of their content hashes modulo 2^64
  bool operator==(const ChainMark&) const = default;
};

/// Plausibility limits of facts; what lies beyond is refused.
struct FactLimits {
  double max_coordinate_m = 1e6;
  double max_sigma_m = 1e5;
  std::uint32_t max_index = 10'000'000;
  std::uint32_t max_pairings = 4096;
  /// What one vehicle may fill, so that it cannot crowd out the others: chains (one per restart) and facts of all of
  /// them. A landmark takes 0.4 KB of memory.
  std::uint32_t max_chains_per_vehicle = 1000;
  std::uint64_t max_facts_per_vehicle = 500'000;
  std::uint32_t max_rumoured_chains = 256;  ///< of which no fact is held; what is said of more is not believed
  std::vector<VehicleId> roster;            ///< vehicles accepted; empty: everyone
};

template <class G>
class FactStore {
 public:
  explicit FactStore(FactLimits limits = {}) : limits_(std::move(limits)) {}

  /// Each checks the fact, then keeps it. A second content under a used key is refused and its author flagged; what
  /// was held stays (so that a stranger cannot overwrite what is known).
  Insertion insert(const AnchorFact<G>& fact);
  Insertion insert(const LandmarkFact<G>& fact);
  Insertion insert(const PriorFact<G>& fact);
  Insertion insert(const AssociationFact& fact);
  Insertion insert(const VerdictFact& fact);
  Insertion insert(const AbsoluteFixFact<G>& fact);
  Insertion insert(const EncounterFact<G>& fact);
  Insertion insert(const WaypointFact<G>& fact);

  /// What insert() would say of the fact itself: `inserted`, or why it is refused.
  Insertion check(const AnchorFact<G>& fact) const;
  Insertion check(const LandmarkFact<G>& fact) const;
  Insertion check(const PriorFact<G>& fact) const;
  Insertion check(const AssociationFact& fact) const;
  Insertion check(const VerdictFact& fact) const { return check(fact.key); }
  Insertion check(const AbsoluteFixFact<G>& fact) const;
  Insertion check(const EncounterFact<G>& fact) const;
  Insertion check(const WaypointFact<G>& fact) const;

  template <class Fact>
  using Sequence = std::map<std::uint32_t, Fact>;

  /// All that is held of one chain, each kind in index order.
  struct Chain {
    Sequence<AnchorFact<G>> anchors;
    Sequence<LandmarkFact<G>> landmarks;
    Sequence<PriorFact<G>> priors;
    Sequence<AssociationFact> associations;
    Sequence<VerdictFact> verdicts;
    Sequence<AbsoluteFixFact<G>> absolute_fixes;
    Sequence<EncounterFact<G>> encounters;
    Sequence<WaypointFact<G>> waypoints;
    std::map<std::uint32_t, std::vector<std::uint32_t>> batches;  ///< anchor -> its landmarks, ascending
    std::array<ChainMark, fact_kind_count> marks;
    /// One past the highest index that its author or a fact held proves to exist: at most marks[kind].high_water.
    std::array<std::uint32_t, fact_kind_count> proven{};
    std::uint64_t facts = 0;   ///< held, of all kinds
    bool equivocated = false;  ///< its author used a key twice
  };
  const std::map<ChainId, Chain>& chains() const { return chains_; }

  /// visit(sequence) with all facts of one kind of a chain.
  template <class Visit>
  static decltype(auto) with_sequence(const Chain& chain, FactKind kind, Visit&& visit) {
    switch (kind) {
      case FactKind::anchor: return visit(chain.anchors);
      case FactKind::landmark: return visit(chain.landmarks);
      case FactKind::prior: return visit(chain.priors);
      case FactKind::association: return visit(chain.associations);
      case FactKind::verdict: return visit(chain.verdicts);
      case FactKind::absolute_fix: return visit(chain.absolute_fixes);
      case FactKind::encounter: return visit(chain.encounters);
      case FactKind::waypoint: break;
    }
    return visit(chain.waypoints);
  }

  /// visit(fact) with every fact held, in canonical order of chains, then kinds, then indices.
  template <class Visit>
  void for_each_fact(Visit&& visit) const {
    for (const auto& [id, chain] : chains_)
      for (int kind = 0; kind < fact_kind_count; ++kind)
        with_sequence(chain, static_cast<FactKind>(kind), [&](const auto& sequence) {
          for (const auto& [index, fact] : sequence) visit(fact);
        });
  }

  /// Null if not held.
  const AnchorFact<G>* anchor(const Key& key) const;
  const LandmarkFact<G>* landmark(const Key& key) const;
  const PriorFact<G>* prior(const ChainId& chain) const;

  /// True if exactly this fact is held: the same content under its key.
  template <class Fact>
  bool holds(const Fact& fact) const {
    const auto chain = chains_.find(fact.key.chain);
    if (chain == chains_.end()) return false;
    const auto& held = sequence_of<Fact>(chain->second);
    const auto it = held.find(fact.key.index);
    return it != held.end() && hash_of(it->second) == hash_of(fact);
  }

  /// True if somebody has stated this hypothesis.
  bool stated(Hash hypothesis) const { return statements_.count(hypothesis) != 0; }

  /// The chain that this vehicle writes: it takes no share.
  void set_own(const ChainId& chain) { own_ = chain; }

  /// Somebody says that there are facts up to `high_water`, one past the highest index. It can only raise the mark.
  void announce(const ChainId& chain, FactKind kind, std::uint32_t high_water);
  /// Their author says so: what others have said beyond that, and no fact proves, is forgotten.
  void announce_own(const ChainId& author, FactKind kind, std::uint32_t high_water);
  /// Forgets what is said of a chain of which no fact is held.
  void forget_rumours(const ChainId& chain);
  bool is_full_of_rumours() const { return rumoured_ >= limits_.max_rumoured_chains; }
  /// Whether further facts of a vehicle are refused as over_share.
  bool is_full(const ChainId& chain) const;

  /// Indices said to exist and not held, ascending, from `from` on. At most `max_ranges`.
  std::vector<IndexRange> missing(const ChainId& chain, FactKind kind, std::size_t max_ranges = 64,
                                  std::uint32_t from = 0) const;
  std::uint64_t missing_count() const;

  /// Every (chain, kind) of which at least one fact is proven to exist, in canonical order. Only what is proven is
  /// told, so that a false announcement goes no further.
  std::vector<ChainMark> marks() const;
  /// Those of one chain.
  std::vector<ChainMark> marks_of(const ChainId& chain) const;

  /// Equal for equal sets of facts, whatever the order of arrival. Associations count by their pairings, not by the key
  /// under which some author stated them.
  Hash digest() const { return digest_; }
  /// Equal for equal sets of facts, statements of one hypothesis by several authors included: the sum of all hashes.
  Hash holdings() const { return holdings_; }

  /// Raised by every insertion: "has anything changed since?"
  std::uint64_t revision() const { return revision_; }
  std::uint64_t size() const { return size_; }
  const std::array<std::uint64_t, insertion_count>& insertions() const { return insertions_; }
  const FactLimits& limits() const { return limits_; }

 private:
  template <class Fact>
  static const Sequence<Fact>& sequence_of(const Chain& chain) {
    constexpr FactKind kind = kind_of<Fact>;
    if constexpr (kind == FactKind::anchor) return chain.anchors;
    else if constexpr (kind == FactKind::landmark) return chain.landmarks;
    else if constexpr (kind == FactKind::prior) return chain.priors;
    else if constexpr (kind == FactKind::association) return chain.associations;
    else if constexpr (kind == FactKind::verdict) return chain.verdicts;
    else if constexpr (kind == FactKind::absolute_fix) return chain.absolute_fixes;
    else if constexpr (kind == FactKind::encounter) return chain.encounters;
    else return chain.waypoints;
  }
  template <class Fact>
  Insertion keep(Sequence<Fact> Chain::*sequence, FactKind kind, const Fact& fact, Insertion check);
  Insertion count(Insertion result);
  bool has_room_for(const ChainId& chain) const;
  Chain* rumoured(const ChainId& chain, FactKind kind, std::uint32_t high_water);
  void prove(const ChainId& chain, FactKind kind, std::uint32_t high_water);
  Insertion check(const Key& key) const;
  Insertion check(const ChainState<G>& state) const;
  Insertion check(const PersistentDrift& persistent) const;

  FactLimits limits_;
  /// What is held of one vehicle, own chain aside.
  struct Share {
    std::uint32_t chains = 0;
    std::uint64_t facts = 0;
  };
  ChainId own_;
  std::uint32_t rumoured_ = 0;  // chains of which no fact is held
  std::map<ChainId, Chain> chains_;
  std::map<VehicleId, Share> shares_;
  std::map<Hash, std::uint32_t> statements_;  // hypotheses by content: digest counts each once
  std::array<std::uint64_t, insertion_count> insertions_{};
  Hash digest_ = 0;
  Hash holdings_ = 0;
  std::uint64_t revision_ = 0;
  std::uint64_t size_ = 0;
};

}  // namespace convoy
