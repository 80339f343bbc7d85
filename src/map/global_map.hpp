// The global map: map = F(set of facts) (paper, Fig. 3; DESIGN B4). Select, solve, drop what contradicts, repeat.
#pragma once

#include <convoy/map/drift_check.hpp>
#include <convoy/map/map.hpp>
#include <convoy/map/selection.hpp>

#include <map>
#include <memory>
#include <set>

namespace convoy {

template <class G>
struct GlobalMap {
  Hash facts = 0;  ///< FactStore::digest() it was built from
  Selection<G> selection;
  std::unique_ptr<Map<G>> map;
  std::map<Key, int> class_of = {};     ///< of each landmark in a class: its index in Selection::classes
  std::set<ChainId> unsettled = {};     ///< chains of hypotheses that are ambiguous or wait to be confirmed
  std::set<ChainId> drift_alarms = {};  ///< whose closures show drift that is not white (drift_check.hpp)
};

/// Never null: an empty store gives an empty map. The most contradicting hypothesis (r^T Z^-1 r of its own alignment
/// against the map, beyond `map_residual`) is dropped, one at a time, until none is left; an absolute fix that contradicts a
/// map without it goes likewise, the worse of the two first. Then landmarks that could as well be of another class leave
/// theirs: a map of many batches tells neighbours apart that two batches cannot.
template <class G>
GlobalMap<G> build_global_map(const FactStore<G>& store, const SelectionParams& params, const Backend<G>& backend);

/// build_global_map() for one store as it grows: the same maps, to the bit, without repeating what the facts alone say.
template <class G>
class MapBuilder {
 public:
  /// `backend` must outlive it.
  MapBuilder(const SelectionParams& params, const Backend<G>& backend)
      : params_(params), backend_(backend), selector_(params) {}

  /// `store`: the same in every call, or a replica of it.
  GlobalMap<G> build(const FactStore<G>& store);

 private:
  SelectionParams params_;
  const Backend<G>& backend_;
  Selector<G> selector_;
  DriftCheck<G> drift_check_;
};

}  // namespace convoy
