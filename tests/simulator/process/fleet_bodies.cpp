#include "fleet_bodies.hpp"

#include <convoy/simulator/scene_builder.hpp>
#include <convoy/simulator/street_furniture.hpp>
#include <convoy/simulator/vehicle_params.hpp>

#include <iterator>
#include <utility>

namespace convoy::simulator {

std::uint32_t add_bodies(World& world, int vehicles, std::uint32_t seed) {
  SceneBuilder own;
  const StreetTextures painted = paint_car_textures(own, seed);
  const auto first_texture = static_cast<TextureId>(world.scene.textures.size());
  std::move(own.scene.textures.begin(), own.scene.textures.end(), std::back_inserter(world.scene.textures));
  const auto first = static_cast<std::uint32_t>(world.scene.objects.size());
  for (int i = 0; i < vehicles; ++i) {
    Object body;
    body.meshes = car_model(painted, static_cast<std::size_t>(i) % 8, VehicleParams().height_m);
    for (Mesh& mesh : body.meshes) mesh.texture += first_texture;
    world.scene.objects.push_back(std::move(body));
  }
  return first;
}

void place_body(World& world, std::uint32_t object, const Eigen::Isometry3d& T_world_body) {
  // The model's origin is under its middle.
  world.scene.objects[object].T_world_object =
      T_world_body * Eigen::Translation3d(VehicleParams().wheelbase_m / 2.0, 0.0, 0.0);
}

}  // namespace convoy::simulator
