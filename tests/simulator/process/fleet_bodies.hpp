// The fleet's own vehicles as they are seen by one another.
#pragma once

#include <convoy/simulator/world.hpp>

#include <cstdint>

namespace convoy::simulator {

/// Adds a car to the world's objects for each vehicle. The index of the first.
std::uint32_t add_bodies(World& world, int vehicles, std::uint32_t seed);

/// Where the car is, by where the vehicle's body is.
void place_body(World& world, std::uint32_t object, const Eigen::Isometry3d& T_world_body);

}  // namespace convoy::simulator
