// Parameters of the monocular front end.
#pragma once

#include <convoy/geometry/se3.hpp>

namespace convoy {

struct MonocularParams {
  // Odometry noise, one standard deviation; see odometry_noise.hpp.
  double sigma_along_per_sqrt_m = 0.02;       ///< [m/sqrt(m)] along the path, of the distance driven
  double sigma_along_per_sqrt_rad = 0.0;      ///< [m/sqrt(rad)] along the path, of the angle turned
  double sigma_across_per_sqrt_m = 0.01;      ///< [m/sqrt(m)] sideways
  double sigma_heading_per_sqrt_m = 0.001;    ///< [rad/sqrt(m)] of the distance driven
  double sigma_heading_per_sqrt_rad = 0.004;  ///< [rad/sqrt(rad)] of the angle turned
  double sigma_heading_per_sqrt_s = 0.0;      ///< [rad/sqrt(s)] while moving
  double sigma_vertical_per_sqrt_m = 0.01;    ///< [m/sqrt(m)] upwards
  double sigma_tilt_per_sqrt_m = 0.001;       ///< [rad/sqrt(m)] roll and pitch each, by the road
  double distance_scale = 1.0;                ///< calibration: true distance per metre of odometry, > 0
  double angle_scale = 1.0;                   ///< calibration: true angle per radian of odometry, > 0
  /// Standard deviation of what the calibration leaves of the distance scale. It is considered, never estimated: one
  /// camera cannot see it.
  double sigma_scale = 0.005;
  double sigma_yaw_bias_radps = 0.0003;          ///< [rad/s] of the yaw rate's bias at the start
  double sigma_yaw_bias_walk_per_sqrt_s = 1e-5;  ///< [rad/s/sqrt(s)] of its random walk
  double max_odometry_gap_s = 2.0;               ///< a longer silence of the odometry counts as this long

  // Pixels.
  /// [px] of a matched pixel, each axis, as if each image erred anew. Where the errors of one patch hang together over
  /// 15 to 40 images, 2.6 times their standard deviation is consistent, and itself is not (tested).
  double sigma_pixel = 1.0;
  double inlier = 0.95;        ///< chi-square confidence of a match given one other match (1-point RANSAC), 2 dof
  double rescue = 0.99;        ///< and given all inliers
  int max_rejections = 4;      ///< in a row, then the track is dropped
  int max_unseen_frames = 20;  ///< then a landmark that has not converged is dropped

  // Late initialisation.
  double clone_spacing_m = 0.25;          ///< path between two clones of the pose
  int max_window = 16;                    ///< clones that candidates are triangulated over
  int min_views = 4;                      ///< >= 3
  double max_depth_share = 0.5;           ///< largest sigma of the inverse depth, of the inverse depth
  double candidate_confidence = 0.95;     ///< chi-square confidence of a candidate's pixels
  double candidate_depth_m = 12.0;        ///< where a candidate of unknown depth is looked for, within a factor of 3
  double max_landmark_distance_m = 80.0;  ///< no landmark starts further away
  int max_landmarks = 250;                ///< in the state at once; beyond, none starts
  double linearity = 0.1;                 ///< index below which an inverse depth becomes a point (Civera 2007, eq. 36)

  // Wheel slip.
  double slip_share = 0.5;      ///< [m/m] standard deviation of a slipping wheel's distance
  double slip_yaw_rad = 0.03;   ///< [rad] and of the heading over one frame
  double slip_threshold = 4.5;  ///< standard deviations of the windowed odometry innovation that count as slip
  int slip_window = 10;         ///< frames

  // Loss.
  int min_inliers = 6;          ///< fewer, though as many tracks were seen, is a failing frame
  int lost_frames = 25;         ///< failing frames in a row, ...
  double lost_length_m = 15.0;  ///< and path driven during them, that make it lost

  // Freeze rule: a landmark that has left the view may leave the filter when all hold (DESIGN B3).
  int min_sightings = 5;         ///< inliers, those it was started from included
  int min_confirmations = 3;     ///< of them after its start
  double max_sigma_m = 0.4;      ///< largest axis of its covariance relative to the closing anchor
  double nis_confidence = 0.99;  ///< its last innovations lie within this chi-square bound, their sum too
  int nis_window = 10;
  int frozen_after_frames = 3;  ///< not seen for so many frames: it has left the view

  // Segments.
  double segment_length_m = 20.0;      ///< a segment closes at the first frame after this length with ...
  int min_batch = 6;                   ///< ... at least so many landmarks that may leave,
  double max_segment_length_m = 40.0;  ///< or after this length with whatever there is
  double trail_spacing_m = 2.0;        ///< path between two states of Segment::trail; 0: no trail
};

/// What differs from MonocularParams where pixels come from active search and a car with encoders on its wheels drives
/// on a street: patches are found to half a pixel; the odometer's distance is calibrated to 0.2 %, so that what warped
/// patches err by in common does not become scale; the tilt of a street changes for metres in one sense, which white
/// noise must cover.
MonocularParams street_params();

/// Throws ConfigError when a value is out of its range.
void validate(const MonocularParams& params);

}  // namespace convoy
