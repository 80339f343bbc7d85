// Landmarks that could as well be of another class than the one their pairings put them into (DESIGN B5): a map of many
// batches tells neighbours apart that two batches cannot.
#pragma once

#include <convoy/map/map.hpp>
#include <convoy/map/selection.hpp>

#include <set>

namespace convoy {

/// Each batch is laid onto a map that has not heard of it. Where another class, an exchange with a neighbour, or a
/// neighbour in no class is conceivable, a landmark must fit its own class well and clearly better, or it is a misfit.
/// `batches`: anchors of those to be judged; null: all.
template <class G>
std::set<Key> misfits(const FactStore<G>& store, const Map<G>& map, const SelectionParams& params,
                      const std::set<Key>* batches = nullptr);

}  // namespace convoy
