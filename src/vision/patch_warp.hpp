// How the surroundings of a point look from elsewhere, if they are a plane.
#pragma once

#include <convoy/geometry/se3.hpp>
#include <convoy/monocular/camera_model.hpp>

#include <optional>

namespace convoy {

/// Which way the plane about a point faces; nothing is known of it.
enum class PatchPlane : std::uint8_t {
  towards_camera,   ///< its normal is the ray that the point was first seen along
  fronto_parallel,  ///< its normal is the axis of the camera that first saw it
};

struct PatchWarp {
  Eigen::Vector2d pixel;  ///< where the point is seen now
  Eigen::Matrix2d
      now_from_ref;  ///< affine part, there, of the homography that the plane induces: d pixel now / d pixel ref
};

/// Of the point that camera frame "ref" saw at `pixel_ref`. `inverse_distance`: 1 / its distance from that camera
/// [1/m],
/// >= 0 (0: infinitely far); `T_now_ref` maps points of camera frame ref into camera frame now. Nothing if the point is
/// not before the camera now, the plane is seen from behind or edgewise (within 8 degrees), or a number is not finite.
std::optional<PatchWarp> warp_of_plane(const CameraModel& camera, const Eigen::Vector2d& pixel_ref,
                                       double inverse_distance, const SE3& T_now_ref,
                                       PatchPlane plane = PatchPlane::towards_camera);

}  // namespace convoy
