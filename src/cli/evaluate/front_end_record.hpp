// What a front end did, frame by frame, and how it is judged: the file front_end.csv of a vehicle, a row per frame, and
// the entry "front_end" of metrics.json. A frame is an image of a camera, or a scan of a laser and the odometry since
// the scan before.
//
//   frames              frames used
//   ms_p50, p95, max    wall time of one frame, everything from pyramid to filter [ms]; the quantiles are values that
//                       occurred
//   tracked_p50         median of the features found again in a frame, new ones not counted
//   track_length_mean   frames in which a track was found, its first one included, in the mean
//   frames_without_tracks    frames but the first in which nothing was found again
//   exports_per_100m    landmarks exported, per 100 m of the path as it was estimated
//   drift_percent       error of the position at the last frame, over the true distance driven. Both paths begin in
//                       their own first pose: neither scale nor anything else is fitted (SE(3) only)
//   drift_percent_100m  the same of parts of 100 m, each from its own first pose, in the mean (KITTI's measure for one
//                       length); every tenth frame begins one. drift_parts_100m says how many there are
//   odometry_drift_percent   drift_percent of the odometer alone, in the plane
//   lost_epochs         how often the front end was lost and began anew. Each epoch's start is then laid where the
//                       odometer had the vehicle when it was lost. Sensors that measure ranges are never lost
//   path_m              length of the path as it was estimated
// What does not exist is null: drift without truth, everything of a path where there was no odometer.
//
// Of a fleet, times and numbers are of all frames of all vehicles, and lengths, exports, losses and errors are summed
// up before one is divided by the other. A planar fleet lies in the plane z = 0. Where the truth is measured itself, as
// by GPS, its own errors are in drift_percent, above all that of the heading in which the path begins.
#pragma once

#include <convoy/geometry/se2.hpp>
#include <convoy/geometry/se3.hpp>
#include <convoy/submap/facts.hpp>

#include <cstdint>
#include <filesystem>
#include <string_view>
#include <vector>

#include <nlohmann/json.hpp>

#include "scenario/scenario.hpp"

namespace convoy::cli {

struct FrontEndFrame {
  double t_s = 0.0;
  Epoch epoch = 0;       ///< 0: no pose and no path, images alone
  double path_m = 0.0;   ///< driven since the first epoch began, as estimated
  SE3 T_start_body;      ///< live, by this image and all before it; frame of the first epoch's start
  SE3 T_start_odometry;  ///< by the odometer alone
  double took_ms = 0.0;
  std::uint32_t sought = 0;     ///< tracks that were looked for
  std::uint32_t tracked = 0;    ///< of them found
  std::uint32_t started = 0;    ///< new ones
  std::uint32_t landmarks = 0;  ///< of those found: with a depth
  std::uint32_t converged = 0;  ///< of these: will be exported unless something speaks against it
  std::uint32_t exported = 0;   ///< landmarks exported up to now, of all epochs
};

/// Throw ConfigError; the reader with file:line.
void write_front_end(const std::filesystem::path& file, const std::vector<FrontEndFrame>& frames);
std::vector<FrontEndFrame> read_front_end(const std::filesystem::path& file, bool may_be_cut = false);

/// What one vehicle's front end did, and where the vehicle was.
struct FrontEndDrive {
  std::vector<FrontEndFrame> frames;
  std::vector<TruthPose<SE3>> truth;  ///< of the body, any frame, by time; empty: none
};

/// "front_end" of metrics.json; null if there is no frame.
nlohmann::json judge_front_ends(const std::vector<FrontEndDrive>& drives);
/// Of one vehicle.
nlohmann::json judge_front_end(const std::vector<FrontEndFrame>& frames, const std::vector<TruthPose<SE3>>& truth);

/// A planar pose in the plane z = 0.
SE3 in_space(const SE2& pose);
inline const SE3& in_space(const SE3& pose) { return pose; }
template <class G>
std::vector<TruthPose<SE3>> in_space(const std::vector<TruthPose<G>>& truth) {
  std::vector<TruthPose<SE3>> poses;
  for (const TruthPose<G>& pose : truth) poses.push_back({pose.t_s, in_space(pose.T_world_body)});
  return poses;
}

}  // namespace convoy::cli
