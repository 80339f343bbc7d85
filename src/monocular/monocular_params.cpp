#include <convoy/config_error.hpp>
#include <convoy/monocular/monocular_params.hpp>

#include <string>

namespace convoy {
namespace {

void require(bool ok, const char* text) {
  if (!ok) throw ConfigError(std::string("monocular front end: ") + text);
}

bool confidence(double p) { return p > 0.0 && p < 1.0; }

}  // namespace

void validate(const MonocularParams& p) {
  require(p.sigma_along_per_sqrt_m >= 0 && p.sigma_along_per_sqrt_rad >= 0 && p.sigma_across_per_sqrt_m >= 0 &&
              p.sigma_heading_per_sqrt_m >= 0 && p.sigma_heading_per_sqrt_rad >= 0 && p.sigma_heading_per_sqrt_s >= 0 &&
              p.sigma_vertical_per_sqrt_m >= 0 && p.sigma_tilt_per_sqrt_m >= 0 && p.sigma_scale >= 0 &&
              p.sigma_yaw_bias_radps >= 0 && p.sigma_yaw_bias_walk_per_sqrt_s >= 0,
          "odometry sigmas must be >= 0");
  require(p.distance_scale > 0 && p.angle_scale > 0, "odometry scales must be > 0; 1 means calibrated");
  require(p.max_odometry_gap_s > 0, "max_odometry_gap_s must be > 0");
  require(p.sigma_pixel > 0, "sigma_pixel must be > 0");
  require(confidence(p.inlier) && confidence(p.rescue) && confidence(p.candidate_confidence) &&
              confidence(p.nis_confidence),
          "confidences must lie in (0, 1)");
  require(p.max_rejections >= 1 && p.max_unseen_frames >= 1 && p.min_inliers >= 1 && p.lost_frames >= 1 &&
              p.slip_window >= 1 && p.min_sightings >= 1 && p.min_confirmations >= 0 && p.nis_window >= 1 &&
              p.frozen_after_frames >= 1 && p.max_landmarks >= 1,
          "counts must be positive");
  require(p.min_views >= 3 && p.max_window >= p.min_views && p.max_window <= 64,
          "needs 3 <= min_views <= max_window <= 64");
  require(p.clone_spacing_m > 0 && p.trail_spacing_m >= 0, "needs clone_spacing_m > 0 and trail_spacing_m >= 0");
  require(p.max_depth_share > 0 && p.max_depth_share <= 1 && p.candidate_depth_m > 0 && p.max_landmark_distance_m > 0 &&
              p.linearity > 0,
          "needs 0 < max_depth_share <= 1, and depths, distances and linearity > 0");
  require(p.slip_share >= 0 && p.slip_yaw_rad >= 0 && p.slip_threshold > 0, "needs slips >= 0, slip_threshold > 0");
  require(p.lost_length_m >= 0, "lost_length_m must be >= 0");
  require(p.max_sigma_m > 0, "max_sigma_m must be > 0");
  require(p.segment_length_m > 0 && p.max_segment_length_m >= p.segment_length_m && p.min_batch >= 1,
          "needs 0 < segment_length_m <= max_segment_length_m and min_batch >= 1");
}

}  // namespace convoy
