// The paper's experiment (Section V) at landmark level: two vehicles on one urban street, the second 20 m behind the
// first, each with an odometer and a camera of its own, neither knowing where the other started.
//
// World frame = common frame: the start pose of the front vehicle (vehicle 1), x along the street. Vehicle 2 starts
// at (-gap, 0, 0). Both drive at the same time along the centre line of an S-shaped course of straights and bends.
//
// In space the course is the same seen from above, and climbs and falls: at s metres (as seen from above) its grade is
// max_grade sin(2 pi s / grade_wave_m), level and at height 0 where the front vehicle starts. A vehicle pitches with
// the road and does not lean. Landmarks stand at different heights; what sees them sees how far above or below, too.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "scenario/scenario.hpp"

namespace convoy::cli {

struct StreetParams {
  /// The course from the front vehicle's start: straights [m] with a 90 degree bend between each two.
  std::vector<double> straights_m = {70.0, 55.0, 60.0, 50.0};
  std::vector<int> turns = {+1, -1, -1};  ///< one fewer than straights: +1 left, -1 right
  double bend_radius_m = 9.0;             ///< of the centre line, > 0 [m]
  double distance_m = 270.0;              ///< the run ends when the front vehicle has driven this, <= course [m]
  double gap_m = 20.0;                    ///< the back vehicle starts this far behind, along the street [m]

  // driving
  double speed_m_s = 2.0;          ///< cruising speed, > 0 [m/s]
  double bend_speed_m_s = 1.4;     ///< speed limit in bends, > 0 [m/s]
  double acceleration_m_s2 = 0.6;  ///< from rest, and when braking for a bend, > 0 [m/s^2]
  double speed_variation = 0.05;   ///< slow variation of the cruising speed, share of it, 0..0.5

  // landmarks: poles, corners, facade marks; irregular, none closer to another than the spacing
  double landmarks_per_metre = 1.0;  ///< of street, both sides together, 0..2 [1/m]
  double landmark_spacing_m = 1.2;   ///< Poisson disc [m]
  double landmark_near_m = 3.0;      ///< least distance to the centre line [m]
  double landmark_far_m = 9.0;       ///< greatest distance to the centre line [m]

  // in space only
  double max_grade = 0.06;         ///< rise per metre, 0..0.3
  double grade_wave_m = 180.0;     ///< from one climb to the next, > 0 [m]
  double landmark_height_m = 8.0;  ///< landmarks stand 0 to this much above the road beside them, >= 0 [m]

  // camera with a tracker, as range and bearing; a sighting's track is the landmark's number
  double camera_rate_hz = 10.0;
  double field_of_view_rad = 2.0 * M_PI / 3.0;  ///< full angle: +-60 degrees [rad]
  double range_min_m = 2.0;
  double range_max_m = 20.0;
  double detectability = 0.7;   ///< share of the landmarks that a vehicle can see at all, drawn per vehicle
  double dropout = 0.1;         ///< share of the sightings that fail
  double range_sigma_m = 0.05;  ///< standard deviation of a range r: range_sigma_m + range_sigma_share * r
  double range_sigma_share = 0.02;
  double bearing_sigma_rad = 0.5 * M_PI / 180.0;
  double elevation_sigma_rad = 0.5 * M_PI / 180.0;  ///< in space only

  // odometer: mean body velocity from its stamp to the next
  double odometry_rate_hz = 20.0;
  double speed_scale_sigma = 0.005;  ///< standard deviation of the speed's scale error, drawn once per run
  double speed_sigma_m_s = 0.03;     ///< white noise of one reading [m/s]
  /// White noise density of the yaw rate: 0.3 deg/sqrt(s), at 2 m/s a heading random walk of 0.21 deg/sqrt(m).
  double yaw_rate_density_rad_sqrt_s = 0.3 * M_PI / 180.0;
  double yaw_bias_sigma_rad_s = 0.01 * M_PI / 180.0;         ///< of the bias at the start [rad/s]
  double yaw_bias_walk_rad_s_sqrt_s = 0.001 * M_PI / 180.0;  ///< random walk of the bias [rad/s/sqrt(s)]

  // static prior of the back vehicle (paper: "a 22-meter circle"): mean = the common frame's origin
  double prior_circle_m = 22.0;  ///< radius that holds 95 % of the probability [m]
  double prior_heading_sigma_rad = 0.3;
  double prior_height_sigma_m = 1.0;   ///< in space only [m]
  double prior_tilt_sigma_rad = 0.05;  ///< of roll and pitch each, in space only
};

/// The same arguments give the same scenario. Readings are rounded to 1e-6 of their unit, as a sensor's are, so that
/// the last digit of a maths library does not show. Every draw belongs to a stream of its own, keyed by (seed,
/// vehicle, sensor): changing the noise of one sensor leaves all other readings alone.
/// Throws ConfigError if a parameter is out of its range.
template <class G>
Scenario<G> make_street(const StreetParams& params, std::uint64_t seed);

}  // namespace convoy::cli
