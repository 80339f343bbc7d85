// What the odometer said since the last frame, in one step: the filter moves once per frame.
#pragma once

#include <convoy/geometry/se3.hpp>

#include <cmath>

namespace convoy {

struct OdometryStep {
  SE3 motion;
  SE3::Covariance noise = SE3::Covariance::Zero();  ///< of a right perturbation of the motion
  SE3::Tangent by_bias = SE3::Tangent::Zero();      ///< its derivative by the yaw rate's bias
  SE3::Tangent by_scale = SE3::Tangent::Zero();     ///< and by the distance's scale error
  double length_m = 0.0, angle_rad = 0.0;           ///< driven and turned, both >= 0
  double moving_s = 0.0;

  bool moved() const { return length_m > 0.0 || angle_rad > 0.0; }

  /// distance_m ahead, then so much to the left, along an arc; variance as of odometry_variance().
  void append(double distance_m, double turn_rad, double dt_s, const SE3::Tangent& variance) {
    SE3::Tangent u = SE3::Tangent::Zero();
    u[0] = distance_m;
    u[5] = turn_rad;
    const SE3 step = SE3::Exp(u);
    const SE3::Adjoint back = step.inverse().adjoint();
    const SE3::Adjoint Jr = SE3::Adjoint::Identity() - 0.5 * SE3::ad(u);  // to second order
    motion = motion * step;
    noise = back * noise * back.transpose();
    noise.diagonal() += variance;
    by_bias = back * by_bias - dt_s * Jr.col(5);
    by_scale = back * by_scale + distance_m * Jr.col(0);
    length_m += std::abs(distance_m);
    angle_rad += std::abs(turn_rad);
    moving_s += dt_s;
  }

  /// What followed.
  void append(const OdometryStep& next) {
    const SE3::Adjoint back = next.motion.inverse().adjoint();
    motion = motion * next.motion;
    noise = back * noise * back.transpose() + next.noise;
    by_bias = back * by_bias + next.by_bias;
    by_scale = back * by_scale + next.by_scale;
    length_m += next.length_m;
    angle_rad += next.angle_rad;
    moving_s += next.moving_s;
  }
};

}  // namespace convoy
