// The global map: map = F(set of facts) (paper, Fig. 3; DESIGN B4). Select, solve, drop what contradicts, repeat.
#pragma once

#include <convoy/map/map.hpp>
#include <convoy/map/selection.hpp>

#include <memory>

namespace convoy {

template <class G>
struct GlobalMap {
  Hash facts = 0;  ///< FactStore::digest() it was built from
  Selection<G> selection;
  std::unique_ptr<Map<G>> map;
};

/// Never null: an empty store gives an empty map. The most contradicting hypothesis (r^T Z^-1 r of its own alignment
/// against the map, beyond `map_residual`) is dropped, one at a time, until none is left. Then landmarks that could as well be
/// of another class leave theirs (an absolute fix that contradicts a map without it goes like a hypothesis, the worse of the two
/// first): a map of many batches tells neighbours apart that two batches cannot.
template <class G>
GlobalMap<G> build_global_map(const FactStore<G>& store, const SelectionParams& params, const Backend<G>& backend);

}  // namespace convoy
