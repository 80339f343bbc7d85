// Streets and footprints as on a plan, before anything is built: both the district of our own and a map of a real place
// come to this, and world_builder.hpp makes a World of it.
#pragma once

#include "ground.hpp"

#include <Eigen/Core>

#include <cstdint>
#include <string>
#include <vector>

namespace convoy::simulator {

/// A street without branches. World frame [m].
struct Street {
  std::vector<Eigen::Vector2d> line;  ///< its middle; >= 2 points, neighbours apart
  double half_width_m = 4.0;          ///< middle to kerb, parked cars included
  int lanes = 2;                      ///< over the whole width; 1: nothing is painted along it; 0: bare road
  bool two_way = true;
  std::uint32_t id = 0;  ///< what is drawn at random along it is drawn by this
};

/// Outline of a building, counter-clockwise, simple. World frame [m].
struct Outline {
  std::vector<Eigen::Vector2d> corners;
  double height_m = 12.0;
  std::uint32_t id = 0;  ///< its looks are drawn by this
};

struct StreetPlan {
  std::vector<Street> streets;
  std::vector<Outline> footprints;
  std::vector<Route> routes;
  std::string attribution;
};

}  // namespace convoy::simulator
