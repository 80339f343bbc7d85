// The paper's Section II in its own words: the bias b = (b_x, b_y, b_theta) that takes what the SLAM says (v, l) to the
// unbiased frame (v_u, l_u). Kept to be read beside the paper and to test drift_model.hpp against.
#pragma once

#include <convoy/geometry/se2.hpp>

namespace convoy::paper {

struct Bias {
  Eigen::Vector3d b = Eigen::Vector3d::Zero();    ///< (b_x, b_y, b_theta) [m, m, rad]
  Eigen::Matrix3d P_b = Eigen::Matrix3d::Zero();  ///< of an additive error on b
};

/// Eq. 1: v_u = R(b_theta) v + b. v = (x, y, theta), rotation about the SLAM's origin.
inline Eigen::Vector3d unbiased_pose(const Bias& bias, const Eigen::Vector3d& v) {
  const double c = std::cos(bias.b[2]), s = std::sin(bias.b[2]);
  return {c * v[0] - s * v[1] + bias.b[0], s * v[0] + c * v[1] + bias.b[1], v[2] + bias.b[2]};
}

/// Eq. 2: l_u = R(b_theta) l + (b_x, b_y).
inline Eigen::Vector2d unbiased_landmark(const Bias& bias, const Eigen::Vector2d& l) {
  return SE2(bias.b.head<2>(), bias.b[2]) * l;
}

/// Eq. 3-4: b_s = b_{s-1} + eps, P_b(s) = P_b(s-1) + ds P_eps; ds [m] >= 0, P_eps per metre.
inline Bias propagated(const Bias& bias, double ds_m, const Eigen::Matrix3d& P_eps) {
  return {bias.b, bias.P_b + ds_m * P_eps};
}

/// The bias that an anchor's estimate amounts to: B = T X^^-1.
inline Eigen::Vector3d bias_of(const SE2& T_common_body, const SE2& T_slam_body) {
  const SE2 B = T_common_body * T_slam_body.inverse();
  return {B.translation().x(), B.translation().y(), B.theta()};
}

}  // namespace convoy::paper
