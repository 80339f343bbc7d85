// A range-bearing EKF-SLAM with odometry, in the plane or in space: right-invariant, landmarks frozen at closing
// anchors (DESIGN B3). In space, too, the odometer is that of a wheeled vehicle: forward speed and yaw rate, both in
// the body frame; roll, pitch and what the suspension does are random walks, known by what is seen alone.
//
// Two filters run side by side. What is exported comes from one that forgets a landmark when it freezes, so that no
// measurement serves two facts (DESIGN R5). Where the vehicle is right now is said by one that remembers them: a live
// pose is no fact and enters no map, so it may use all that was ever seen.
#pragma once

#include <convoy/frontend/front_end.hpp>
#include <convoy/frontend/range_bearing_filter.hpp>
#include <convoy/geometry/groups.hpp>

#include <cstdint>
#include <optional>
#include <vector>

namespace convoy {

struct RangeBearingEkfParams {
  // Odometry noise, one standard deviation.
  double sigma_along_per_sqrt_m = 0.05;      ///< [m/sqrt(m)] along the path, of the distance driven
  double sigma_along_per_sqrt_rad = 0.0;     ///< [m/sqrt(rad)] along the path, of the angle turned
  double sigma_across_per_sqrt_m = 0.01;     ///< [m/sqrt(m)] sideways
  double sigma_heading_per_sqrt_m = 0.01;    ///< [rad/sqrt(m)] of the distance driven
  double sigma_heading_per_sqrt_rad = 0.05;  ///< [rad/sqrt(rad)] of the angle turned
  double sigma_heading_per_sqrt_s = 0.0;     ///< [rad/sqrt(s)] while moving
  double sigma_vertical_per_sqrt_m = 0.01;   ///< [m/sqrt(m)] upwards; in space only
  double sigma_tilt_per_sqrt_m = 0.01;       ///< [rad/sqrt(m)] roll and pitch each, by the road; in space only
  double distance_scale = 1.0;               ///< calibration: true distance per metre of odometry, > 0
  double angle_scale = 1.0;                  ///< calibration: true angle per radian of odometry, > 0
  // Sighting noise, one standard deviation.
  double sigma_range_m = 0.1;      ///< constant part
  double sigma_range_share = 0.0;  ///< part proportional to the range
  double sigma_bearing_rad = 0.02;
  double sigma_elevation_rad = 0.02;     ///< in space only
  double min_sighting_interval_s = 0.0;  ///< sightings of a track closer than this share their errors: not used
  // Tracking.
  double gate = 0.99;                             ///< chi-square confidence of a sighting, Dim dof
  int max_rejections = 5;                         ///< in a row, then the track is dropped and starts anew
  double min_range_m = 0.1, max_range_m = 100.0;  ///< sightings beyond are refused
  double max_odometry_gap_s = 2.0;                ///< a longer silence of the odometry counts as this long
  int max_remembered = 50;  ///< landmarks that the live pose is held by, the latest seen; 0: only the tracked
  // Freeze rule: a landmark may leave when all hold (DESIGN B3).
  int min_sightings = 6;
  double min_parallax_rad = 0.15;  ///< between the rays it was seen along
  double max_sigma_m = 0.4;        ///< largest axis of its covariance relative to the closing anchor
  double nis_confidence = 0.99;    ///< its last innovations lie within this chi-square bound
  int nis_window = 10;
  // Segments.
  double segment_length_m = 25.0;      ///< a segment closes at the first moment after this length with ...
  int min_batch = 6;                   ///< ... at least so many landmarks that may leave,
  double max_segment_length_m = 60.0;  ///< or after this length with whatever there is
  double trail_spacing_m = 1.0;        ///< path between two states of Segment::trail; 0: no trail

  /// Covariance of the polar coordinates of a sighting at this range, see polar.hpp.
  template <class G>
  typename G::PointCovariance sighting_noise(double range_m) const {
    typename G::Point sigma;
    sigma[G::Dim - 1] = sigma_elevation_rad;  // in the plane, the bearing takes its place
    sigma[0] = sigma_range_m + sigma_range_share * range_m;
    sigma[1] = sigma_bearing_rad;
    return sigma.cwiseAbs2().asDiagonal();
  }
};

/// Throws ConfigError when a value is out of its range.
void validate(const RangeBearingEkfParams& params);

/// Inputs that were not used, by reason.
struct RangeBearingEkfCounters {
  std::uint64_t sightings_used = 0;
  std::uint64_t sightings_thinned = 0;  ///< sooner than min_sighting_interval_s after the last of the same track
  std::uint64_t sightings_gated = 0;    ///< beyond the chi-square gate
  std::uint64_t sightings_invalid = 0;  ///< not finite, out of range, or older than the filter
  std::uint64_t odometry_invalid = 0;   ///< not finite or going back in time
  std::uint64_t tracks_dropped = 0;     ///< after too many rejections
  std::uint64_t landmarks_frozen = 0;
};

template <class G>
class RangeBearingEkf final : public FrontEnd<G> {
 public:
  explicit RangeBearingEkf(const RangeBearingEkfParams& params);

  /// From `stamp_s` on the vehicle moves at v [m/s] forward and omega [rad/s] to the left, until the next call.
  /// Returns false and counts if the input is refused.
  bool on_odometry(double stamp_s, double v_mps, double omega_radps);

  /// Landmark `track` (a name that lasts as long as the tracker follows it) was seen at these polar coordinates
  /// (polar.hpp): range [m], bearing [rad, left positive], and in space elevation [rad, up positive, within +-pi/2].
  /// Moves the filter to `stamp_s` first. Returns false if the sighting was not used.
  bool on_sighting(double stamp_s, std::uint64_t track, const typename G::Point& polar);
  bool on_sighting(double stamp_s, std::uint64_t track, double range_m, double bearing_rad) requires(G::Dim == 2) {
    return on_sighting(stamp_s, track, typename G::Point(range_m, bearing_rad));
  }
  bool on_sighting(double stamp_s, std::uint64_t track, double range_m, double bearing_rad,
                   double elevation_rad) requires(G::Dim == 3) {
    return on_sighting(stamp_s, track, typename G::Point(range_m, bearing_rad, elevation_rad));
  }

  /// Nothing was measured, but it is `stamp_s` by now: moves the filter there. Returns false if time would run
  /// backwards.
  bool on_time(double stamp_s);

  /// Closes the segment here and now, with whatever may leave: at the end of a run, or before a long stop.
  void finish() { close_segment(freezable()); }

  FrontEndState<G> state() const override;
  FrontEndState<G> exportable_state() const override;
  RelativeLandmarks<G> remembered() const override;
  std::vector<Segment<G>> take_segments() override;
  const RangeBearingEkfCounters& counters() const { return counters_; }
  std::size_t tracked() const { return filter_.tracks().size(); }

 private:
  void advance_to(double stamp_s);
  void move(double distance_m, double angle_rad, double dt_s);
  void remember(std::uint64_t id, const typename G::Point& polar);
  void clone_if_due();
  FrontEndState<G> state_of(double stamp_s, double abscissa_m, const G& pose, const typename G::Covariance& P) const;
  bool may_freeze(std::size_t track) const;
  std::vector<std::size_t> freezable() const;
  void close_segment_if_due();
  void close_segment(const std::vector<std::size_t>& frozen);

  RangeBearingEkfParams params_;
  double gate_chi2_ = 0.0;
  std::optional<double> stamp_s_;
  double v_mps_ = 0.0, omega_radps_ = 0.0;
  G anchor_;  // T_slam_anchor of the last anchor
  double abscissa_m_ = 0.0;
  double anchor_abscissa_m_ = 0.0;
  double clone_abscissa_m_ = 0.0;                                // of the last clone or anchor
  typename G::Covariance anchor_drift_ = G::Covariance::Zero();  // cumulative up to the last anchor, slam frame
  RangeBearingFilter<G> filter_;                                 // what is exported comes from here
  RangeBearingFilter<G> memory_;                                 // the live pose comes from here
  std::vector<Segment<G>> segments_;
  RangeBearingEkfCounters counters_;
};

}  // namespace convoy
