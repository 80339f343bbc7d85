// Unit vectors and small turns of them.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

namespace convoy {

/// Two unit vectors across a unit vector, right-handed with it: the columns of a basis of its tangent plane.
inline Eigen::Matrix<double, 3, 2> across(const Eigen::Vector3d& ray) {
  Eigen::Matrix<double, 3, 2> B;
  B.col(0) = (std::abs(ray.y()) < 0.9 ? Eigen::Vector3d::UnitY() : Eigen::Vector3d::UnitX()).cross(ray).normalized();
  B.col(1) = ray.cross(B.col(0));
  return B;
}

/// The unit vector a small step in that plane away. [rad]
inline Eigen::Vector3d turned(const Eigen::Vector3d& ray, const Eigen::Vector2d& step) {
  return (ray + across(ray) * step).normalized();
}

}  // namespace convoy
