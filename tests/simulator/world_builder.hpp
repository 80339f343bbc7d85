// From a plan to a place.
#pragma once

#include "buildings.hpp"
#include "world.hpp"

namespace convoy::simulator {

/// Builds everything that stands still. Same plan and seed: the same world, to the bit.
World build_world(const StreetPlan& plan, std::uint32_t seed, const DetailParams& detail);

}  // namespace convoy::simulator
