#include <convoy/geometry/se3.hpp>

#include <cmath>

namespace convoy {
namespace {

// Below this angle [rad] the closed forms lose digits, and the series written out here have none missing.
constexpr double small = 0.1;

/// (a - sin a) / a^3.
double third_order(double a) {
  const double a2 = a * a;
  if (a < small) return 1.0 / 6.0 - a2 / 120.0 + a2 * a2 / 5040.0 - a2 * a2 * a2 / 362880.0;
  return (a - std::sin(a)) / (a2 * a);
}

/// I + (1 - cos a) / a^2 W + (a - sin a) / a^3 W^2, W = [theta]x, a = |theta|.
Eigen::Matrix3d left_jacobian(const Eigen::Vector3d& theta) {
  const double a = theta.norm(), half = 0.5 * a;
  const double h = half < 1e-4 ? 1.0 - half * half / 6.0 : std::sin(half) / half;
  const Eigen::Matrix3d W = skew(theta);
  return Eigen::Matrix3d::Identity() + 0.5 * h * h * W + third_order(a) * W * W;
}

/// I - W / 2 + (1 / a^2 - cot(a / 2) / (2 a)) W^2.
Eigen::Matrix3d left_jacobian_inverse(const Eigen::Vector3d& theta) {
  const double a = theta.norm(), a2 = a * a;
  const double c = a < small ? 1.0 / 12.0 + a2 / 720.0 + a2 * a2 / 30240.0 + a2 * a2 * a2 / 1209600.0
                             : 1.0 / a2 - std::cos(0.5 * a) / (2.0 * a * std::sin(0.5 * a));
  const Eigen::Matrix3d W = skew(theta);
  return Eigen::Matrix3d::Identity() - 0.5 * W + c * W * W;
}

/// Q(rho, theta) of the left Jacobian.
Eigen::Matrix3d coupling(const Eigen::Vector3d& rho, const Eigen::Vector3d& theta) {
  const double a = theta.norm(), a2 = a * a;
  double fourth, fifth;  // (a^2 + 2 cos a - 2) / (2 a^4), (2 a - 3 sin a + a cos a) / (2 a^5)
  if (a < small) {
    fourth = 1.0 / 24.0 - a2 / 720.0 + a2 * a2 / 40320.0 - a2 * a2 * a2 / 3628800.0;
    fifth = 1.0 / 120.0 - a2 / 2520.0 + a2 * a2 / 120960.0 - a2 * a2 * a2 / 9979200.0;
  } else {
    fourth = (a2 + 2.0 * std::cos(a) - 2.0) / (2.0 * a2 * a2);
    fifth = (2.0 * a - 3.0 * std::sin(a) + a * std::cos(a)) / (2.0 * a2 * a2 * a);
  }
  const Eigen::Matrix3d P = skew(rho), W = skew(theta);
  const Eigen::Matrix3d WP = W * P, PW = P * W, WPW = WP * W;
  return 0.5 * P + third_order(a) * (WP + PW + WPW) + fourth * (W * WP + PW * W - 3.0 * WPW) +
         fifth * (WPW * W + W * WPW);
}

}  // namespace

SE3 SE3::from_rotation(const Eigen::Matrix3d& R, const Point& t_m) {
  // Four ways to the same quaternion, each divided by another component: the largest one loses nothing.
  const double w = 1.0 + R.trace(), x = 1.0 + R(0, 0) - R(1, 1) - R(2, 2), y = 1.0 - R(0, 0) + R(1, 1) - R(2, 2),
               z = 1.0 - R(0, 0) - R(1, 1) + R(2, 2);
  const double wx = R(2, 1) - R(1, 2), wy = R(0, 2) - R(2, 0), wz = R(1, 0) - R(0, 1);
  const double xy = R(0, 1) + R(1, 0), xz = R(0, 2) + R(2, 0), yz = R(1, 2) + R(2, 1);
  if (w >= x && w >= y && w >= z) return {{w, wx, wy, wz}, t_m};
  if (x >= y && x >= z) return {{wx, x, xy, xz}, t_m};
  if (y >= z) return {{wy, xy, y, yz}, t_m};
  return {{wz, xz, yz, z}, t_m};
}

SE3::Adjoint SE3::adjoint() const {
  const Eigen::Matrix3d R = rotation();
  Adjoint A;
  A << R, skew(t_) * R, Eigen::Matrix3d::Zero(), R;
  return A;
}

SE3::Adjoint SE3::ad(const Tangent& d) {
  const Eigen::Matrix3d turn = skew(d.tail<3>());
  Adjoint A;
  A << turn, skew(d.head<3>()), Eigen::Matrix3d::Zero(), turn;
  return A;
}

SE3 SE3::Exp(const Tangent& d) {
  const Point theta = d.tail<3>();
  const double angle = theta.norm();
  const double half = 0.5 * angle;
  const double scale = angle < small ? 0.5 - half * half / 12.0 + half * half * half * half / 240.0 -
                                           half * half * half * half * half * half / 10080.0
                                     : std::sin(half) / angle;
  Quaternion q;
  q << std::cos(half), scale * theta;
  return {q, left_jacobian(theta) * d.head<3>()};
}

SE3::Tangent SE3::Log() const {
  const Point v = q_.tail<3>();
  const double n = v.norm(), w = q_[0];
  const double scale = n < 1e-8 ? 2.0 / w : 2.0 * std::atan2(n, w) / n;
  const Point theta = scale * v;
  Tangent d;
  d << left_jacobian_inverse(theta) * t_, theta;
  return d;
}

SE3::PointJacobian SE3::act_jacobian(const Point& p) const {
  const Eigen::Matrix3d R = rotation();
  PointJacobian H;
  H << R, -R * skew(p);
  return H;
}

SE3::Adjoint SE3::right_jacobian_inverse(const Tangent& d) {
  const Point rho = -d.head<3>(), theta = -d.tail<3>();
  const Eigen::Matrix3d J_inv = left_jacobian_inverse(theta);
  Adjoint A;
  A << J_inv, -J_inv * coupling(rho, theta) * J_inv, Eigen::Matrix3d::Zero(), J_inv;
  return A;
}

}  // namespace convoy
