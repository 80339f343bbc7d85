// SE(2), the group of planar poses. T_a_b maps points of frame b into frame a: p_a = R p_b + t.
// Tangent vectors are (rho_x, rho_y, theta): metres, metres, radians. Perturbations are on the right (body frame):
// T <- T * Exp(d), d ~ N(0, P) (DESIGN: notation). SE3 offers the same members, so that every algorithm above is
// written once, as a template over the group.
#pragma once

#include <Eigen/Core>
#include <cmath>

namespace convoy {

/// Wraps an angle to (-pi, pi]. [rad]
inline double wrap_angle(double angle_rad) { return std::remainder(angle_rad, 2.0 * M_PI); }

class SE2 {
 public:
  static constexpr int Dof = 3;  ///< dimension of the tangent space
  static constexpr int Dim = 2;  ///< dimension of the points the group acts on
  using Tangent = Eigen::Vector3d;
  using Point = Eigen::Vector2d;
  using Adjoint = Eigen::Matrix3d;
  using Covariance = Eigen::Matrix3d;       ///< of a right perturbation, order (rho, theta)
  using PointCovariance = Eigen::Matrix2d;  ///< of a point [m^2]
  using PointJacobian = Eigen::Matrix<double, 2, 3>;
  static constexpr int Shared = 12;  ///< number of error components that the landmarks of a batch share (DESIGN B3)
  using Loading = Eigen::Matrix<double, 2, Shared>;  ///< how a landmark moves with them [m]
  using SharedVector = Eigen::Matrix<double, Shared, 1>;

  SE2() = default;
  SE2(double x_m, double y_m, double theta_rad) : t_(x_m, y_m), theta_(wrap_angle(theta_rad)) {}
  SE2(const Point& t_m, double theta_rad) : t_(t_m), theta_(wrap_angle(theta_rad)) {}

  /// From a rotation matrix (2 x 2, orthonormal, determinant 1) and a translation [m].
  static SE2 from_rotation(const Eigen::Matrix2d& R, const Point& t_m) { return {t_m, std::atan2(R(1, 0), R(0, 0))}; }

  const Point& translation() const { return t_; }
  double theta() const { return theta_; }
  Eigen::Matrix2d rotation() const {
    const double c = std::cos(theta_), s = std::sin(theta_);
    return (Eigen::Matrix2d() << c, -s, s, c).finished();
  }

  SE2 operator*(const SE2& b) const { return {t_ + rotation() * b.t_, theta_ + b.theta_}; }
  Point operator*(const Point& p) const { return t_ + rotation() * p; }
  SE2 inverse() const { return {-(rotation().transpose() * t_), -theta_}; }

  /// Ad_X = [[R, -J t], [0, 1]] with J = [[0, -1], [1, 0]]: X Exp(d) = Exp(Ad_X d) X.
  Adjoint adjoint() const;

  /// ad_d, the derivative of Ad_Exp(d) at the identity: ad_d e = [d, e].
  static Adjoint ad(const Tangent& d);

  static SE2 Exp(const Tangent& d);

  Tangent Log() const;

  /// d(T * p) / d(right perturbation of T) = R [I, J p].  2 x 3
  PointJacobian act_jacobian(const Point& p) const;

  /// Inverse of the right Jacobian at d: Log(Exp(d) Exp(e)) = d + Jr_inv(d) e + O(e^2).
  static Adjoint right_jacobian_inverse(const Tangent& d);

 private:
  Point t_ = Point::Zero();
  double theta_ = 0.0;
};

}  // namespace convoy
