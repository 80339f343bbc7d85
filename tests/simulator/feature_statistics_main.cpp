// convoy_simulator_feature_statistics [--frames N] [district | FILE.osm]...: prints what tracking makes of a drive down
// the test street, and once around the first route of each world; of the first N frames, to save time.
#include "district.hpp"
#include "feature_statistics.hpp"
#include "osm_world.hpp"
#include "route_follower.hpp"
#include "test_street.hpp"
#include "vehicle_physics.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <limits>
#include <string>

namespace {

using namespace convoy::simulator;

struct Drive {
  Scene scene;
  std::vector<Eigen::Isometry3d> T_world_body;  ///< one per frame
  double frame_m = 0.8;                         ///< from one to the next
};

/// 8 m/s at 10 Hz with some sway.
Drive test_drive() {
  Drive drive{test_street(300.0), {}, 0.8};
  for (int i = 0; i < 300; ++i) {
    Eigen::Isometry3d T_world_body = Eigen::Isometry3d::Identity();
    T_world_body.translation() = Eigen::Vector3d(0.8 * i, -2.0, 0.0);
    T_world_body.linear() = Eigen::AngleAxisd(0.05 * std::sin(0.05 * i), Eigen::Vector3d::UnitZ()).toRotationMatrix();
    drive.T_world_body.push_back(T_world_body);
  }
  return drive;
}

/// Once around the world's first route at 2 m/s, as convoy sim drives it.
Drive drive_around(World world) {
  RouteFollowerParams driver;
  driver.laps = 1;
  RouteFollower follower(world.routes.front(), driver, VehicleParams());
  const RouteFollower::Start start = follower.start();
  VehiclePhysics vehicle(VehicleParams(), *world.ground, start.x_m, start.y_m, start.yaw_rad);
  Drive drive;
  while (!follower.finished()) {
    for (int i = 0; i < 24; ++i) vehicle.step(follower.step(vehicle.state()));
    drive.T_world_body.push_back(vehicle.state().T_world_body);
  }
  drive.scene = std::move(world.scene);
  drive.frame_m = driver.speed_mps / 10.0;
  return drive;
}

void report(const std::string& name, Drive drive, std::size_t most) {
  drive.T_world_body.resize(std::min(most, drive.T_world_body.size()), Eigen::Isometry3d::Identity());
  FeatureParams params;
  params.second_reach = static_cast<std::size_t>(std::lround(8.0 / drive.frame_m));  // 8 m
  const FeatureStatistics s = feature_statistics(drive.scene, {}, drive.T_world_body, params);
  std::printf("%s: %zu frames, %zu tracks: median %.0f, p95 %.0f frames\n", name.c_str(), s.frames, s.tracks,
              s.median_track, s.p95_track);
  std::printf("  %.1f %% of %zu matches within 2.5 px of the truth\n", 100.0 * s.good_matches, s.matches);
  std::printf(
      "  second vehicle finds %.1f %% of %zu patches that it sees; warped as if facing %.1f %%, by surface %.1f %%\n",
      100.0 * s.found_by_second[0], s.mapped, 100.0 * s.found_by_second[1], 100.0 * s.found_by_second[2]);
  std::printf("  %.2f %% of %zu wrong pairs above 0.8\n", 100.0 * s.wrong_pairs, s.pairs);
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    const bool limited = argc > 2 && std::string(argv[1]) == "--frames";
    const std::size_t most = limited ? std::stoul(argv[2]) : std::numeric_limits<std::size_t>::max();
    report("test street", test_drive(), most);
    for (int i = limited ? 3 : 1; i < argc; ++i) {
      const std::string name = argv[i];
      report(name, drive_around(name == "district" ? make_district(1) : load_osm(name)), most);
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
  }
  return 0;
}
