#include <convoy/vision/patch_warp.hpp>

#include <Eigen/Dense>

#include <cmath>

namespace convoy {
namespace {

using Basis = Eigen::Matrix<double, 3, 2>;

/// Two unit vectors perpendicular to n and to each other.
Basis tangents(const Eigen::Vector3d& n) {
  Basis T;
  T.col(0) = n.unitOrthogonal();
  T.col(1) = n.cross(T.col(0));
  return T;
}

}  // namespace

// All lengths are in units of the distance, so that a point may be infinitely far: X = ray + T a are points of the
// plane, R X + t / distance the same points now. Then d now / d ref = (J_now R T) (J_ref T)^-1.
std::optional<PatchWarp> warp_of_plane(const CameraModel& camera, const Eigen::Vector2d& pixel_ref,
                                       double inverse_distance, const SE3& T_now_ref, PatchPlane plane) {
  constexpr double min_cosine = 0.14;
  if (!pixel_ref.allFinite() || !(inverse_distance >= 0.0) || !std::isfinite(inverse_distance)) return std::nullopt;
  const Eigen::Vector3d ray = camera.ray(pixel_ref);
  const Eigen::Matrix3d R = T_now_ref.rotation();
  const Eigen::Vector3d now = R * ray + inverse_distance * T_now_ref.translation();
  if (!now.allFinite()) return std::nullopt;
  const auto seen_ref = camera.project(ray), seen_now = camera.project(now);
  if (!seen_ref || !seen_now) return std::nullopt;
  const Eigen::Vector3d normal = plane == PatchPlane::towards_camera ? ray : Eigen::Vector3d::UnitZ();
  if ((R * normal).dot(now) < min_cosine * now.norm()) return std::nullopt;
  const Basis T = tangents(normal);
  const Eigen::Matrix2d ref = seen_ref->jacobian * T;
  if (!(std::abs(ref.determinant()) > 0.0)) return std::nullopt;
  const PatchWarp warp{seen_now->pixel, seen_now->jacobian * R * T * ref.inverse()};
  if (!warp.pixel.allFinite() || !warp.now_from_ref.allFinite()) return std::nullopt;
  return warp;
}

}  // namespace convoy
