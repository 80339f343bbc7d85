// A camera of an installed convoy looks at a wall that stands in the sky.
#include <convoy/simulator/camera.hpp>
#include <convoy/simulator/district.hpp>
#include <convoy/simulator/vehicle_physics.hpp>

#include <cstdio>

int main() {
  using namespace convoy::simulator;
  Scene scene;
  scene.textures = {{1, 1, {255}}, {1, 1, {0}}};
  Mesh wall;
  wall.texture = 1;
  for (const auto& [y, z] : {std::pair{5.0F, -5.0F}, {-5.0F, -5.0F}, {-5.0F, 5.0F}, {5.0F, 5.0F}})
    wall.vertices.push_back({{10.0F, y, z}, {0.0F, 0.0F}});
  wall.triangles = {{0, 1, 2}, {0, 2, 3}};
  scene.meshes = {wall};
  Camera camera(scene, {});
  const auto frame = camera.take(Eigen::Isometry3d::Identity(), 0);
  const auto seen = camera.truth().world_point(320.0, 240.0);
  if (!frame || !seen) return 1;
  std::printf("a wall %.2f m ahead, grey %d\n", seen->x(), frame->image.at(320, 240));
  return std::abs(seen->x() - 10.0) < 1e-6 && plan_district(1).routes.front().closed ? 0 : 2;
}
