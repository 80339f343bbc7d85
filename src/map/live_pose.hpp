// Where a vehicle is right now: its last anchor in the map continued by what its SLAM says, and the landmarks that its
// SLAM remembers laid onto those of the map (DESIGN B3). Nothing of this is a fact, nor enters any map.
#pragma once

#include <convoy/exchange/message.hpp>
#include <convoy/map/global_map.hpp>

#include <optional>

namespace convoy {

/// T_common_body where `live` was sent, by a map: by the remembered landmarks where they fit points of the map (three;
/// in space four) and tell more than Map::pose(), else that. Empty if the map does not know the chain. The map is asked
/// for covariances, and not changed.
template <class G>
std::optional<Estimate<G>> live_pose(const GlobalMap<G>& map, const LivePose<G>& live);

}  // namespace convoy
