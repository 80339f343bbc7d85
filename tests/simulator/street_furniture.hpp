// What stands in a street. All are drawn into pieces of the scene, feet at `foot` (world frame).
#pragma once

#include "street_textures.hpp"

namespace convoy::simulator {

inline constexpr double car_length_m = 4.4, car_width_m = 1.74;

/// Meshes of a car about its middle: x ahead, z = 0 on the ground.
std::vector<Mesh> car_model(const StreetTextures& textures, std::size_t paint, double height_m);
/// Every mesh of `model` turned and moved into the pieces about its place.
void place(SceneBuilder& scene, const std::vector<Mesh>& model, const Eigen::Vector3d& foot, double yaw_rad);

void add_tree(SceneBuilder& scene, const StreetTextures& textures, const Eigen::Vector3d& foot, Stream& random);
void add_lamp(SceneBuilder& scene, const StreetTextures& textures, const Eigen::Vector3d& foot, double yaw_rad);
void add_sign(SceneBuilder& scene, const StreetTextures& textures, const Eigen::Vector3d& foot, double yaw_rad,
              Stream& random);
void add_bin(SceneBuilder& scene, const StreetTextures& textures, const Eigen::Vector3d& foot, double yaw_rad);
void add_bollard(SceneBuilder& scene, const StreetTextures& textures, const Eigen::Vector3d& foot);

}  // namespace convoy::simulator
