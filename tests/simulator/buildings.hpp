// Houses on their footprints.
#pragma once

#include "facade.hpp"
#include "ground_mesh.hpp"
#include "polyline.hpp"

namespace convoy::simulator {

/// How much is made of what is how far from the routes.
struct DetailParams {
  double close_m = 40.0;        ///< fronts in sight within this: a texture of their own, windows set back; >= 0
  double middle_m = 140.0;      ///< fronts within this: a coarse texture; blank walls beyond; >= close_m
  double close_texel_m = 0.02;  ///< 0.01 to 0.05
  double middle_texel_m = 0.08;
  double furniture_m = 120.0;  ///< cars, trees and poles within this of a route; >= 0
};

/// Draws the walls of every footprint of the plan. Same footprint, id and seed: same looks.
void add_buildings(SceneBuilder& scene, const GroundMesh& ground, const StreetPlan& plan, const NearLines& routes,
                   const DetailParams& detail, std::uint32_t seed);

/// Light on a wall that looks to `outward`, of full light.
float shade_of(const Eigen::Vector2d& outward);

}  // namespace convoy::simulator
