// A monocular EKF-SLAM with an odometer, without its images: pixels of tracks go in, poses and converged landmarks come
// out. Right-invariant, landmarks initialised late, frozen at closing anchors (DESIGN B3).
//
// Per frame: predictions() says where to look, update() takes what was found there and what was found anew. Landmarks
// are points of the world; frame of the body: x ahead, y left, z up; of the camera: x right, y down, z ahead.
#pragma once

#include <convoy/frontend/front_end.hpp>
#include <convoy/geometry/se3.hpp>
#include <convoy/monocular/monocular_filter.hpp>

#include <cstdint>
#include <map>
#include <optional>
#include <vector>

namespace convoy {

class MonocularEkf final : public FrontEnd<SE3> {
 public:
  /// T_body_camera: where the camera is fixed to the body, whose origin is where the odometer measures (the middle of
  /// the rear axle). Throws ConfigError when a parameter is out of its range.
  MonocularEkf(const MonocularParams& params, const CameraModel& camera, const SE3& T_body_camera);

  /// From `stamp_s` on the vehicle moves at v [m/s] forward and omega [rad/s] to the left, until the next call. Returns
  /// false and counts if the input is refused.
  bool on_odometry(double stamp_s, double v_mps, double omega_radps);

  /// Where the tracks should be in an image taken at `stamp_s`. Moves the filter there; empty, and counted, if time
  /// would run backwards.
  std::vector<FeaturePrediction> predictions(double stamp_s);

  /// The tracks found in that image. One that the filter does not follow becomes a candidate. Moves the filter to
  /// `stamp_s`; nothing, and counted, if time would run backwards. An image in which nothing was found is no input.
  std::optional<FrameReport> update(double stamp_s, const std::vector<FeatureObservation>& observations);

  /// What this landmark looks like, exported with it. Kept as long as the track is followed; false if it is not.
  bool describe(std::uint64_t track, const Descriptor& descriptor);

  /// Nothing was measured, but it is `stamp_s` by now. Returns false if time would run backwards.
  bool on_time(double stamp_s);

  /// Closes the segment here and now, with whatever may leave: at the end of a run, or before a long stop.
  void finish();

  /// Images are there and make no sense any more: begin anew, with a new epoch.
  bool lost() const { return filter_.lost(); }
  bool follows(std::uint64_t track) const { return filter_.follows(track); }

  FrontEndState<SE3> state() const override;
  bool scales_landmarks() const override { return true; }
  std::vector<Segment<SE3>> take_segments() override;
  const MonocularFilter& filter() const { return filter_; }
  const MonocularCounters& counters() const { return filter_.counters(); }

 private:
  bool acceptable(double stamp_s) const;
  void advance_to(double stamp_s);
  void apply_step();
  void close_segment_if_due(bool at_frame);
  void close_segment(const std::vector<std::size_t>& frozen);
  FrontEndState<SE3> state_of(double stamp_s, double abscissa_m, const SE3& pose, const SE3::Covariance& P) const;

  MonocularParams params_;
  std::optional<double> stamp_s_;
  double v_mps_ = 0.0, omega_radps_ = 0.0;
  SE3 anchor_;  // T_slam_anchor of the last anchor
  double abscissa_m_ = 0.0, anchor_abscissa_m_ = 0.0;
  SE3::Covariance anchor_drift_ = SE3::Covariance::Zero();  // cumulative up to the last anchor, slam frame
  OdometryStep step_;                                       // that the filter has not made yet
  MonocularFilter filter_;
  std::map<std::uint64_t, Descriptor> descriptors_;
  std::vector<Segment<SE3>> segments_;
};

}  // namespace convoy
