#include <convoy/config_error.hpp>
#include <convoy/monocular/monocular_params.hpp>

#include <string>

namespace convoy {
namespace {

void require(bool ok, const char* text) {
  if (!ok) throw ConfigError(std::string("monocular front end: ") + text);
}

/// With the name of the entry that is at fault.
void require(bool ok, const char* name, double value, const char* range) {
  if (!ok) throw RangeError("monocular front end", name, value, range);
}
void at_least_0(const char* name, double value) { require(value >= 0, name, value, "be >= 0"); }
void above_0(const char* name, double value) { require(value > 0, name, value, "be > 0"); }
void at_least_1(const char* name, int value) { require(value >= 1, name, value, "be 1 or more"); }

bool confidence(double p) { return p > 0.0 && p < 1.0; }

}  // namespace

MonocularParams street_params() {
  MonocularParams p;
  p.sigma_pixel = 0.5;
  p.sigma_along_per_sqrt_m = 0.003;
  p.sigma_scale = 0.002;
  p.sigma_vertical_per_sqrt_m = 0.02;
  p.sigma_tilt_per_sqrt_m = 0.01;
  return p;
}

void validate(const MonocularParams& p) {
  at_least_0("sigma_along_per_sqrt_m", p.sigma_along_per_sqrt_m);
  at_least_0("sigma_along_per_sqrt_rad", p.sigma_along_per_sqrt_rad);
  at_least_0("sigma_across_per_sqrt_m", p.sigma_across_per_sqrt_m);
  at_least_0("sigma_heading_per_sqrt_m", p.sigma_heading_per_sqrt_m);
  at_least_0("sigma_heading_per_sqrt_rad", p.sigma_heading_per_sqrt_rad);
  at_least_0("sigma_heading_per_sqrt_s", p.sigma_heading_per_sqrt_s);
  at_least_0("sigma_vertical_per_sqrt_m", p.sigma_vertical_per_sqrt_m);
  at_least_0("sigma_tilt_per_sqrt_m", p.sigma_tilt_per_sqrt_m);
  at_least_0("sigma_scale", p.sigma_scale);
  at_least_0("sigma_yaw_bias_radps", p.sigma_yaw_bias_radps);
  at_least_0("sigma_yaw_bias_walk_per_sqrt_s", p.sigma_yaw_bias_walk_per_sqrt_s);
  above_0("distance_scale", p.distance_scale);
  above_0("angle_scale", p.angle_scale);
  above_0("max_odometry_gap_s", p.max_odometry_gap_s);
  above_0("sigma_pixel", p.sigma_pixel);
  above_0("max_landmark_distance_m", p.max_landmark_distance_m);
  above_0("max_sigma_m", p.max_sigma_m);
  above_0("segment_length_m", p.segment_length_m);
  require(p.max_segment_length_m >= p.segment_length_m, "max_segment_length_m", p.max_segment_length_m,
          "be segment_length_m or more");
  at_least_0("trail_spacing_m", p.trail_spacing_m);
  at_least_1("max_landmarks", p.max_landmarks);
  at_least_1("min_sightings", p.min_sightings);
  at_least_1("min_batch", p.min_batch);
  require(confidence(p.inlier) && confidence(p.rescue) && confidence(p.candidate_confidence) &&
              confidence(p.nis_confidence),
          "confidences must lie in (0, 1)");
  require(p.max_rejections >= 1 && p.max_unseen_frames >= 1 && p.min_inliers >= 1 && p.lost_frames >= 1 &&
              p.slip_window >= 1 && p.min_confirmations >= 0 && p.nis_window >= 1 && p.frozen_after_frames >= 1,
          "counts must be positive");
  require(p.min_views >= 3 && p.max_window >= p.min_views && p.max_window <= 64,
          "needs 3 <= min_views <= max_window <= 64");
  require(p.clone_spacing_m > 0, "clone_spacing_m must be > 0");
  require(p.max_depth_share > 0 && p.max_depth_share <= 1 && p.candidate_depth_m > 0 && p.linearity > 0,
          "needs 0 < max_depth_share <= 1, and depths, distances and linearity > 0");
  require(p.slip_share >= 0 && p.slip_yaw_rad >= 0 && p.slip_threshold > 0, "needs slips >= 0, slip_threshold > 0");
  require(p.lost_length_m >= 0, "lost_length_m must be >= 0");
}

}  // namespace convoy
