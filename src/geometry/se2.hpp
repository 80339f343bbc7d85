// SE(2), the group of planar poses. T_a_b maps points of frame b into frame a: p_a = R p_b + t.
// Tangent vectors are (rho_x, rho_y, theta): metres, metres, radians. Perturbations are on the right (body frame):
// T <- T * Exp(d), d ~ N(0, P) (DESIGN: notation). SE3 offers the same members, so that every algorithm above is
// written once, as a template over the group.
#pragma once

#include <Eigen/Core>
#include <Eigen/LU>
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
  Adjoint adjoint() const {
    Adjoint A = Adjoint::Identity();
    A.topLeftCorner<2, 2>() = rotation();
    A(0, 2) = t_.y();
    A(1, 2) = -t_.x();
    return A;
  }

  /// ad_d, the derivative of Ad_Exp(d) at the identity: ad_d e = [d, e].
  static Adjoint ad(const Tangent& d) {
    Adjoint A;
    A << 0.0, -d[2], d[1], d[2], 0.0, -d[0], 0.0, 0.0, 0.0;
    return A;
  }

  static SE2 Exp(const Tangent& d) {
    const auto [a, b] = arc_coefficients(d[2]);
    return {a * d[0] - b * d[1], b * d[0] + a * d[1], d[2]};
  }

  Tangent Log() const {
    const auto [a, b] = arc_coefficients(theta_);
    const double n = a * a + b * b;
    return {(a * t_.x() + b * t_.y()) / n, (-b * t_.x() + a * t_.y()) / n, theta_};
  }

  /// d(T * p) / d(right perturbation of T) = R [I, J p].  2 x 3
  PointJacobian act_jacobian(const Point& p) const {
    PointJacobian H;
    const Eigen::Matrix2d R = rotation();
    H.leftCols<2>() = R;
    H.col(2) = R * Point(-p.y(), p.x());
    return H;
  }

  /// Inverse of the right Jacobian at d: Log(Exp(d) Exp(e)) = d + Jr_inv(d) e + O(e^2).
  static Adjoint right_jacobian_inverse(const Tangent& d) {
    // Jr(d) of SE(2) in closed form: [[sin(w)/w, (1-cos w)/w, *], [-(1-cos w)/w, sin(w)/w, *], [0, 0, 1]].
    const double w = d[2];
    const auto [a, b] = arc_coefficients(w);
    double p, q;  // p = (w - sin w) / w^2, q = (1 - cos w) / w^2
    if (std::abs(w) < 1e-3) {
      p = w / 6.0 - w * w * w / 120.0;
      q = 0.5 - w * w / 24.0;
    } else {
      p = (w - std::sin(w)) / (w * w);
      q = b / w;
    }
    Eigen::Matrix3d J;
    J << a, b, p * d[0] - q * d[1], -b, a, q * d[0] + p * d[1], 0, 0, 1;
    return J.inverse();
  }

 private:
  struct ArcCoefficients {
    double a, b;
  };
  /// sin(w)/w and (1 - cos w)/w, by series near zero.
  static ArcCoefficients arc_coefficients(double w) {
    if (std::abs(w) < 1e-5) return {1.0 - w * w / 6.0, 0.5 * w - w * w * w / 24.0};
    const double half = std::sin(0.5 * w);  // 1 - cos w without cancellation
    return {std::sin(w) / w, 2.0 * half * half / w};
  }

  Point t_ = Point::Zero();
  double theta_ = 0.0;
};

}  // namespace convoy
