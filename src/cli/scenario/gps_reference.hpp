// Reference poses of a drive from GPS and dead reckoning: over a piece of the way dead reckoning has the right shape,
// and GPS says where that shape lies. Made to judge by, and seen by no vehicle.
#pragma once

#include <Eigen/Core>
#include <convoy/geometry/groups.hpp>
#include <optional>
#include <vector>

#include "scenario/scenario.hpp"

namespace convoy::cli {

struct ReckonedPose {
  double t_s = 0.0;
  double driven_m = 0.0;
  SE2 T_local_body;
};

/// A drive by dead reckoning, at any moment.
class ReckonedPath {
 public:
  /// Odometry by time, at least one; its velocities hold until the next. Other events are skipped.
  explicit ReckonedPath(const std::vector<SensorEvent>& odometry);
  /// Before the first and after the last odometry the vehicle stands.
  ReckonedPose at(double t_s) const;
  double begin_s() const { return poses_.front().t_s; }
  double end_s() const { return poses_.back().t_s; }

 private:
  std::vector<ReckonedPose> poses_;
  std::vector<SE2::Tangent> velocities_;
};

struct GpsFix {
  double t_s = 0.0;
  Eigen::Vector2d antenna_m;  ///< east, north
};

struct GpsReferenceParams {
  Eigen::Vector2d lever_m = Eigen::Vector2d::Zero();  ///< the antenna in the body frame [m]
  double span_m = 40.0;                               ///< way to either side that is laid onto GPS [m]
  double fix_spacing_m = 0.3;   ///< fixes closer together along the way say the same and count once [m]
  double max_residual_m = 2.0;  ///< a fix further from the fit is a jump [m]
  double min_share = 0.7;       ///< of the fixes of a span that must be none, 0.6..1
  double min_spread_m = 30.0;   ///< way between the first and the last of them: what a heading takes [m]
  double max_gap_m = 20.0;      ///< way to the nearest of them [m]
};

struct GpsReference {
  std::vector<TruthPose<SE2>> poses;  ///< by time, in GPS's plane
  std::vector<double> residuals_m;    ///< of the fix nearest along the way, of each pose
};

/// One pose each `period_s` while GPS allows it: where it has gaps or jumps there is none. Fixes by time.
GpsReference gps_reference(const ReckonedPath& path, const std::vector<GpsFix>& fixes, double period_s,
                           const GpsReferenceParams& params);

}  // namespace convoy::cli
