// convoy_simulator_feature_statistics: prints the statistics of a drive down the test street.
#include "feature_statistics.hpp"
#include "test_street.hpp"

#include <cmath>
#include <cstdio>
#include <functional>

namespace {

using namespace convoy::simulator;

struct Drive {
  Scene scene;
  std::vector<Eigen::Isometry3d> T_world_body;  ///< one per frame
};

/// 8 m/s at 10 Hz with some sway.
Drive test_drive() {
  Drive drive{test_street(300.0), {}};
  for (int i = 0; i < 300; ++i) {
    Eigen::Isometry3d T_world_body = Eigen::Isometry3d::Identity();
    T_world_body.translation() = Eigen::Vector3d(0.8 * i, -2.0, 0.0);
    T_world_body.linear() = Eigen::AngleAxisd(0.05 * std::sin(0.05 * i), Eigen::Vector3d::UnitZ()).toRotationMatrix();
    drive.T_world_body.push_back(T_world_body);
  }
  return drive;
}

void report(const char* name, const std::function<Drive()>& make) {
  const Drive drive = make();
  const FeatureStatistics s = feature_statistics(drive.scene, {}, drive.T_world_body);
  std::printf("%s: %zu frames, %zu tracks: median %.0f, p95 %.0f frames\n", name, s.frames, s.tracks, s.median_track,
              s.p95_track);
  std::printf("  %.1f %% of %zu matches within 2.5 px of the truth\n", 100.0 * s.good_matches, s.matches);
  std::printf("  second vehicle finds %.1f %% of %zu patches that it sees\n", 100.0 * s.found_by_second, s.mapped);
  std::printf("  %.2f %% of %zu wrong pairs above 0.8\n", 100.0 * s.wrong_pairs, s.pairs);
}

}  // namespace

int main() { report("test street", test_drive); }
