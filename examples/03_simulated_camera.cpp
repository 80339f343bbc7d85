// A car drives down a street of the simulator. What its camera shows at a pixel is a point of the world, by the truth;
// the next frame shows the same point elsewhere.
#include <convoy/simulator/camera.hpp>
#include <convoy/simulator/district.hpp>
#include <convoy/simulator/route_follower.hpp>

#include <cstdio>

using namespace convoy::simulator;

int main() {
  const World world = make_district(1);
  const Route& loop = world.routes.front();
  std::printf("routes:");
  for (const Route& route : world.routes) std::printf(" %s", route.name.c_str());
  std::printf("\n");

  RouteFollower driver(loop, RouteFollowerParams(), VehicleParams());
  const RouteFollower::Start start = driver.start(70.0);
  VehiclePhysics car(VehicleParams(), *world.ground, start.x_m, start.y_m, start.yaw_rad);
  Camera camera(world.scene, CameraParams());

  std::optional<Eigen::Vector3d> point;
  for (std::uint32_t frame = 0; frame < 4; ++frame) {
    for (int step = 0; step < 240; ++step) car.step(driver.step(car.state()));  // for a second
    const auto taken = camera.take(car.state().T_world_body, frame);
    if (!taken) continue;  // dropped
    std::printf("frame %u, %d x %d, after %2.0f m: ", frame, taken->image.width, taken->image.height,
                driver.driven_m());
    if (!point) point = camera.truth().world_point(440.0, 270.0);
    const auto pixel = point ? camera.truth().project(*point) : std::nullopt;
    if (pixel) std::printf("the point is at (%.0f, %.0f)\n", pixel->x(), pixel->y());
    else std::printf("the point is not in view\n");
  }
}
