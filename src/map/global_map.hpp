// The global map: map = F(set of facts) (paper, Fig. 3; DESIGN B4). Select, solve, drop what contradicts, repeat.
#pragma once

#include <convoy/map/drift_check.hpp>
#include <convoy/map/map.hpp>
#include <convoy/map/selection.hpp>

#include <map>
#include <memory>
#include <optional>
#include <set>
#include <unordered_set>
#include <utility>
#include <vector>

namespace convoy {

/// Which class each landmark is in.
class ClassIndex {
 public:
  ClassIndex() = default;
  explicit ClassIndex(const ClassList& classes);

  /// Index in Selection::classes; empty if it is in none.
  std::optional<int> find(const Key& landmark) const;
  /// Landmarks that are in one.
  std::size_t size() const;

 private:
  std::map<ChainId, std::vector<std::pair<std::uint32_t, int>>> of_chain_;  // landmark's index and class, sorted
};

template <class G>
struct GlobalMap {
  Hash facts = 0;  ///< FactStore::digest() it was built from
  Selection<G> selection;
  std::unique_ptr<Map<G>> map;
  ClassIndex class_of = {};
  std::set<ChainId> unsettled = {};     ///< chains of hypotheses that are ambiguous or wait to be confirmed
  std::set<ChainId> drift_alarms = {};  ///< whose closures show drift that is not white (drift_check.hpp)
  /// Solved from the canonical start to the end, so that it is the same, to the bit, wherever the same facts are held.
  /// False: as MapBuilder::update() left it.
  bool exact = true;
};

/// Never null: an empty store gives an empty map. Selects, solves, leaves out what contradicts the rest, until nothing
/// does:
/// - a hypothesis that contradicts a map without it (beyond `map_residual`; hypothesis_graph.hpp, T5), and with it all
///   that a robust estimate does without (T4);
/// - an absolute fix or an encounter that contradicts a map without it, the worst first, before or after hypotheses by
///   how far beyond its gate each is;
/// - landmarks that could as well be of another class (misfits.hpp).
template <class G>
GlobalMap<G> build_global_map(const FactStore<G>& store, const SelectionParams& params, const Backend<G>& backend);

/// build_global_map() for one store as it grows: the same maps, to the bit, without repeating what the facts alone say;
/// and in between maps that hold what is new at once.
template <class G>
class MapBuilder {
 public:
  /// `backend` must outlive it.
  MapBuilder(const SelectionParams& params, const Backend<G>& backend)
      : params_(params), backend_(backend), selector_(params) {}

  /// `store`: the same in every call, also to update().
  GlobalMap<G> build(const FactStore<G>& store);

  /// Works in what is new since the last call, in time that depends on how much that is. What had been left out stays
  /// out, and what is new is left out if it contradicts the map. That judges each by itself: of several wrong
  /// hypotheses that come at once and support each other it may keep one that build() leaves out. Estimates differ from
  /// those of build() by next to nothing, as long as both leave out the same; how far depends on the way there. With a
  /// backend that has no incremental counterpart: build().
  GlobalMap<G> update(const FactStore<G>& store);

 private:
  Problem<G> problem_of(const FactStore<G>& store, const Selection<G>& selection) const;
  bool exclude_news(const GlobalMap<G>& global, const FactStore<G>& store);
  void finish(GlobalMap<G>& global);

  SelectionParams params_;
  const Backend<G>& backend_;
  Selector<G> selector_;
  DriftCheck<G> drift_check_;
  std::shared_ptr<IncrementalMap<G>> incremental_;  // null: not asked for yet
  std::shared_ptr<const Problem<G>> problem_;       // the last one
  // As of the last map.
  Exclusions excluded_;
  std::unordered_set<Hash> accepted_;                            // hypotheses
  std::unordered_set<Key> measured_fixes_, measured_waypoints_;  // waypoints: that answer encounters
  std::set<ChainId> drift_alarms_;
};

}  // namespace convoy
