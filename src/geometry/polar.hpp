// Where a sensor sees a point, as polar coordinates in its body frame: (range, bearing) in the plane, (range, bearing,
// elevation) in space. [m, rad, rad] The bearing counts from straight ahead, positive to the left; the elevation from
// the plane of the body's x and y axes, positive upwards, in [-pi/2, pi/2].
#pragma once

#include <convoy/geometry/se2.hpp>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace convoy {

/// The unit vector towards what is seen; times the range, the point itself.
inline Eigen::Vector2d ray_of(const Eigen::Vector2d& polar) { return {std::cos(polar[1]), std::sin(polar[1])}; }
inline Eigen::Vector3d ray_of(const Eigen::Vector3d& polar) {
  const double level = std::cos(polar[2]);
  return {level * std::cos(polar[1]), level * std::sin(polar[1]), std::sin(polar[2])};
}

/// The inverse: polar coordinates of a point. [m] -> [m, rad, rad]
inline Eigen::Vector2d polar_of(const Eigen::Vector2d& p) { return {p.norm(), std::atan2(p.y(), p.x())}; }
inline Eigen::Vector3d polar_of(const Eigen::Vector3d& p) {
  return {p.norm(), std::atan2(p.y(), p.x()), std::atan2(p.z(), std::hypot(p.x(), p.y()))};
}

/// d(point) / d(polar coordinates).
inline Eigen::Matrix2d point_jacobian(const Eigen::Vector2d& polar) {
  const Eigen::Vector2d ray = ray_of(polar);
  Eigen::Matrix2d J;
  J.col(0) = ray;
  J.col(1) = polar[0] * Eigen::Vector2d(-ray.y(), ray.x());
  return J;
}
inline Eigen::Matrix3d point_jacobian(const Eigen::Vector3d& polar) {
  const Eigen::Vector3d ray = ray_of(polar);
  Eigen::Matrix3d J;
  J.col(0) = ray;
  J.col(1) = polar[0] * Eigen::Vector3d(-ray.y(), ray.x(), 0.0);
  J.col(2) =
      polar[0] * Eigen::Vector3d(-ray.z() * std::cos(polar[1]), -ray.z() * std::sin(polar[1]), std::cos(polar[2]));
  return J;
}

/// d(polar coordinates) / d(point); closer than 1 mm to the sensor, or to straight above it, the angles mean nothing.
inline Eigen::Matrix2d polar_jacobian(const Eigen::Vector2d& p) {
  const double range = std::max(p.norm(), 1e-3);
  Eigen::Matrix2d J;
  J.row(0) = p.transpose() / range;
  J.row(1) = Eigen::RowVector2d(-p.y(), p.x()) / (range * range);
  return J;
}
inline Eigen::Matrix3d polar_jacobian(const Eigen::Vector3d& p) {
  const double range = std::max(p.norm(), 1e-3), level = std::max(std::hypot(p.x(), p.y()), 1e-3);
  Eigen::Matrix3d J;
  J.row(0) = p.transpose() / range;
  J.row(1) = Eigen::RowVector3d(-p.y(), p.x(), 0.0) / (level * level);
  J.row(2) = Eigen::RowVector3d(-p.x() * p.z() / level, -p.y() * p.z() / level, level) / (range * range);
  return J;
}

/// a - b, angles wrapped to (-pi, pi].
template <int Dim>
Eigen::Matrix<double, Dim, 1> polar_difference(const Eigen::Matrix<double, Dim, 1>& a,
                                               const Eigen::Matrix<double, Dim, 1>& b) {
  Eigen::Matrix<double, Dim, 1> d = a - b;
  for (int i = 1; i < Dim; ++i) d[i] = wrap_angle(d[i]);
  return d;
}

/// The angle between two unit vectors, [0, pi]. [rad]
template <class Vector>
double angle_between(const Vector& a, const Vector& b) {
  return 2.0 * std::asin(std::min(1.0, 0.5 * (a - b).norm()));
}

}  // namespace convoy
