// Selection: which hypotheses enter the map, and the classes of landmarks they amount to. A deterministic function of
// the set of facts (DESIGN B4): everybody who holds the same facts selects the same.
#pragma once

#include <convoy/map/class_list.hpp>
#include <convoy/map/consensus.hpp>
#include <convoy/map/hypothesis.hpp>

#include <map>
#include <set>
#include <unordered_map>
#include <utility>
#include <vector>

namespace convoy {

struct SelectionParams {
  int min_pairings = 5;
  double residual = 0.99;        ///< chi-square confidence of a hypothesis' own alignment
  double map_residual = 0.9999;  ///< confidence beyond which a hypothesis contradicts priors, others, or the solved map
  double max_runner_up_share = 0.25;  ///< of the weight (pairings) of the set that holds together; beyond: ambiguous
  DriftSlack slack{0.01, 1e-4};       ///< persistent drift errors that alone contradict nothing
  int min_confirmed = 2;              ///< hypotheses that must hold together to link two chains; 1: the first one may
  double separation = 0.9;  ///< confidence, (0, 1): a landmark leaves its class unless all others fit that much worse
  /// Errors of a receiver of absolute positions hang together for about this long: one fix per chain and time enters.
  /// [s]
  double fix_correlation_s = 60.0;
  /// Confidence beyond which a fix or an encounter contradicts the map of all the others and is dropped.
  double fix_residual = 0.99;
  bool common_frame_is_enu = false;  ///< the common frame is that of the absolute fixes, and no datum is looked for
  VehicleId reference = 0;  ///< whose start is the common frame if no static bias is known; 0: see build_problem()
};

/// Throws RangeError.
void validate(const SelectionParams& params);

/// An encounter and the waypoint of the other vehicle that answers it.
struct SelectedEncounter {
  Key encounter, waypoint;
  auto operator<=>(const SelectedEncounter&) const = default;
};

template <class G>
struct Selection {
  std::vector<Hypothesis<G>> hypotheses;  ///< all stated ones: most pairings first, then by id
  ClassList classes;                      ///< of two or more
  /// The facts of the members of `classes`, in the store that was selected from, while that lives.
  std::vector<const LandmarkFact<G>*> landmarks;
  std::vector<Key> fixes;                     ///< absolute fixes that enter the map; sorted
  std::vector<SelectedEncounter> encounters;  ///< that enter the map; sorted
  /// Hash of the classes, fixes and encounters.
  Hash digest() const;
};

/// What an earlier look at the map has shown not to fit.
struct Exclusions {
  std::set<Hash> hypotheses;      ///< contradict the rest of the map
  std::set<Key> landmarks;        ///< fit another class better than the one their pairings put them into
  std::set<Key> fixes = {};       ///< contradict the rest of the map
  std::set<Key> encounters = {};  ///< the same
  std::size_t size() const { return hypotheses.size() + landmarks.size() + fixes.size() + encounters.size(); }
};

template <class G>
Selection<G> select(const FactStore<G>& store, const SelectionParams& params, const Exclusions& excluded = {});

/// select() for one store as it grows. A hypothesis whose facts are all held is examined once, since facts never
/// change; the answers are those of select(), to the bit.
template <class G>
class Selector {
 public:
  explicit Selector(const SelectionParams& params);

  /// `store`: the same in every call.
  Selection<G> select(const FactStore<G>& store, const Exclusions& excluded = {});

 private:
  // What a hypothesis amounts to by itself: its state, batches and alignment. Its pairings by the numbers of landmarks.
  struct Examined {
    Hypothesis<G> hypothesis;
    std::vector<std::pair<int, int>> pairs;
    std::size_t member = 0;  // of the group of its two chains, if accepted
    bool confined = false;   // no double of the place could have escaped notice
  };
  // The hypotheses between two chains, and which of them hold together.
  struct Group {
    std::vector<Hash> members;
    Relation together;
    std::vector<std::size_t> active;        // when last asked: the members, and ...
    std::vector<HypothesisState> state_of;  // ... what became of each of them
  };
  void read(const FactStore<G>& store);
  void read_associations(const FactStore<G>& store);
  const Examined& examine(const FactStore<G>& store, const Hypothesis<G>& hypothesis);
  Examined examined(const FactStore<G>& store, const std::vector<Pairing>& pairings);
  std::size_t join_group(const FactStore<G>& store, Hash id, const Examined& examined);
  bool hold_together(const FactStore<G>& store, const Examined& h, const Examined& k) const;
  using ByChains = std::map<std::pair<ChainId, ChainId>, std::vector<Hypothesis<G>*>>;
  void find_consensus(std::vector<Hypothesis<G>>& hypotheses);
  std::vector<int> weights_of(const Group& group, const std::vector<Hypothesis<G>*>& members) const;
  void decide(Group& group, const std::vector<int>& weights) const;
  void demand_confirmation(std::vector<Hypothesis<G>>& hypotheses) const;
  int number(const FactStore<G>& store, const Key& landmark);
  void put_in_order();

  SelectionParams params_;
  double map_residual_chi2_;  // what params_.map_residual is a confidence of
  std::unordered_map<Hash, Examined> examined_;
  std::map<std::pair<ChainId, ChainId>, Group> groups_;
  // Landmarks and batches by number, in the order in which they were met: names only, no result depends on them.
  std::map<Key, int> landmark_number_, batch_number_;
  std::vector<Key> keys_;
  std::vector<const LandmarkFact<G>*> landmarks_;
  std::vector<int> batch_of_;  // of each landmark
  std::vector<int> in_order_;  // numbers of landmarks by key, as far as put_in_order() has come
  bool read_ = false;
  std::uint64_t revision_ = 0;
  std::vector<Hypothesis<G>> stated_;                             // at that revision of the store
  std::map<ChainId, std::set<std::uint32_t>> read_associations_;  // indices
  std::unordered_map<Hash, ChainId> author_of_;
  std::set<Hash> vetoed_;
};

}  // namespace convoy
