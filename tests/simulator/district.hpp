// A district of our own: two blocks, a street through between them, and bends.
#pragma once

#include "world_builder.hpp"

namespace convoy::simulator {

struct DistrictParams {
  double width_m = 150.0;     ///< of the loop's rectangle, west to east; 120 to 200
  double depth_m = 105.0;     ///< south to north; 80 to 150
  double half_width_m = 6.6;  ///< of the streets, parked cars included; 5.5 to 8
  double gap_share = 0.06;    ///< of house lots that are empty; 0 to 0.5
  DetailParams detail;
};

/// Routes: "loop" (closed, clockwise, 400 to 600 m), "loop_beside" (the same, 2 m to the right), "loop_opposite"
/// (counter-clockwise), "through" (open, along the street between the blocks; it shares a part of the loop).
/// @throws std::runtime_error for parameters out of range.
World make_district(std::uint32_t seed, const DistrictParams& params = {});

/// Its plan alone.
StreetPlan plan_district(std::uint32_t seed, const DistrictParams& params = {});

}  // namespace convoy::simulator
