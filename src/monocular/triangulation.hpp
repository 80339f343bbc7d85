// A track's bearing and inverse depth in one of its views, by least squares over all of them, the poses taken as known.
#pragma once

#include <convoy/geometry/se3.hpp>
#include <convoy/monocular/camera_model.hpp>

#include <optional>
#include <vector>

namespace convoy {

/// A pixel of a track and the camera that saw it.
struct TrackView {
  SE3 T_frame_camera;  ///< in whatever frame all views share
  Eigen::Vector2d pixel;
};

struct Triangulation {
  std::size_t anchor = 0;            ///< the view in whose camera it is told
  Eigen::Vector3d bearing;           ///< unit vector
  double inverse_depth = 0.0;        ///< [1/m]
  double sigma_inverse_depth = 0.0;  ///< [1/m] by the noise of the pixels alone
  double worst_px = 0.0;             ///< largest distance between a pixel and where the point is seen
};

/// Nothing if it does not converge to a point in front of all cameras. Needs two views or more.
std::optional<Triangulation> triangulate(const CameraModel& camera, const std::vector<TrackView>& views,
                                         std::size_t anchor, double sigma_px);

/// The largest set of views that see one point to `tolerance_px`, ascending; tries all pairs.
std::vector<std::size_t> consistent_views(const CameraModel& camera, const std::vector<TrackView>& views,
                                          double tolerance_px);

}  // namespace convoy
