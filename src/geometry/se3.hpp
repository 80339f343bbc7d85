// SE(3), the group of poses in space, with the members of SE2. T_a_b maps points of frame b into frame a:
// p_a = R p_b + t. Tangent vectors are (rho, theta): three numbers in metres, then a rotation vector in radians.
// Perturbations are on the right (body frame): T <- T * Exp(d), d ~ N(0, P) (DESIGN: notation).
//
// The rotation is a unit quaternion in one canonical form, which survives being sent and stored to the bit: of q and -q
// the one whose first non-zero component is positive; one that is normalised already is left as it is.
#pragma once

#include <Eigen/Core>
#include <cmath>

namespace convoy {

/// [v]x, with [v]x w = v x w.
inline Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  return (Eigen::Matrix3d() << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0).finished();
}

class SE3 {
 public:
  static constexpr int Dof = 6;  ///< dimension of the tangent space
  static constexpr int Dim = 3;  ///< dimension of the points the group acts on
  using Tangent = Eigen::Matrix<double, 6, 1>;
  using Point = Eigen::Vector3d;
  using Adjoint = Eigen::Matrix<double, 6, 6>;
  using Covariance = Eigen::Matrix<double, 6, 6>;  ///< of a right perturbation, order (rho, theta)
  using PointCovariance = Eigen::Matrix3d;         ///< of a point [m^2]
  using PointJacobian = Eigen::Matrix<double, 3, 6>;
  using Quaternion = Eigen::Vector4d;  ///< (w, x, y, z)
  /// Number of error components that the landmarks of a batch share. What moves all of them together is a motion of the
  /// vehicle and a scale: four numbers in the plane, seven in space (the wire has room for eight).
  static constexpr int Shared = 7;
  using Loading = Eigen::Matrix<double, 3, Shared>;  ///< how a landmark moves with them [m]
  using SharedVector = Eigen::Matrix<double, Shared, 1>;

  SE3() = default;
  /// q of any length but zero; of zero or what is not finite, the pose is not finite.
  SE3(const Quaternion& q, const Point& t_m) : t_(t_m), q_(normalised(q)) {}

  /// From a rotation matrix (3 x 3, orthonormal, determinant 1) and a translation [m].
  static SE3 from_rotation(const Eigen::Matrix3d& R, const Point& t_m) {
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

  const Point& translation() const { return t_; }
  const Quaternion& quaternion() const { return q_; }
  Eigen::Matrix3d rotation() const {
    const double w = q_[0], x = q_[1], y = q_[2], z = q_[3];
    Eigen::Matrix3d R;
    R << 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y), 2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x), 2.0 * (x * z - w * y), 2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y);
    return R;
  }

  SE3 operator*(const SE3& b) const {
    const Quaternion &p = q_, &q = b.q_;
    return {Quaternion(p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
                       p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
                       p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
                       p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]),
            t_ + rotation() * b.t_};
  }
  Point operator*(const Point& p) const { return t_ + rotation() * p; }
  SE3 inverse() const { return {Quaternion(q_[0], -q_[1], -q_[2], -q_[3]), -(rotation().transpose() * t_)}; }

  /// Ad_X = [[R, [t]x R], [0, R]]: X Exp(d) = Exp(Ad_X d) X.
  Adjoint adjoint() const {
    const Eigen::Matrix3d R = rotation();
    Adjoint A;
    A << R, skew(t_) * R, Eigen::Matrix3d::Zero(), R;
    return A;
  }

  /// ad_d, the derivative of Ad_Exp(d) at the identity: ad_d e = [d, e].
  static Adjoint ad(const Tangent& d) {
    const Eigen::Matrix3d turn = skew(d.tail<3>());
    Adjoint A;
    A << turn, skew(d.head<3>()), Eigen::Matrix3d::Zero(), turn;
    return A;
  }

  static SE3 Exp(const Tangent& d) {
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

  /// The rotation by at most pi; of the two by pi, the one whose first non-zero component is positive.
  Tangent Log() const {
    const Point v = q_.tail<3>();
    const double n = v.norm(), w = q_[0];
    const double scale = n < 1e-8 ? 2.0 / w : 2.0 * std::atan2(n, w) / n;
    const Point theta = scale * v;
    Tangent d;
    d << left_jacobian_inverse(theta) * t_, theta;
    return d;
  }

  /// d(T * p) / d(right perturbation of T) = R [I, -[p]x].  3 x 6
  PointJacobian act_jacobian(const Point& p) const {
    const Eigen::Matrix3d R = rotation();
    PointJacobian H;
    H << R, -R * skew(p);
    return H;
  }

  /// Inverse of the right Jacobian at d: Log(Exp(d) Exp(e)) = d + Jr_inv(d) e + O(e^2), |theta| < 2 pi.
  /// Jr(d) = Jl(-d) with Jl = [[J, Q], [0, J]], J that of the rotation alone (Barfoot, State Estimation, 7.85-7.95).
  static Adjoint right_jacobian_inverse(const Tangent& d) {
    const Point rho = -d.head<3>(), theta = -d.tail<3>();
    const Eigen::Matrix3d J_inv = left_jacobian_inverse(theta);
    Adjoint A;
    A << J_inv, -J_inv * coupling(rho, theta) * J_inv, Eigen::Matrix3d::Zero(), J_inv;
    return A;
  }

 private:
  // Below this angle [rad] the closed forms lose digits, and the series written out here have none missing.
  static constexpr double small = 0.1;

  static Quaternion normalised(const Quaternion& q) {
    const double n2 = q.squaredNorm();
    const double sign = first_positive(q) ? 1.0 : -1.0;
    if (std::abs(n2 - 1.0) < 4e-15) return sign * q;  // dividing leaves less: a second time changes nothing
    return sign * q / std::sqrt(n2);
  }
  static bool first_positive(const Quaternion& q) {
    for (int i = 0; i < 4; ++i)
      if (q[i] != 0.0) return q[i] > 0.0;
    return true;
  }

  /// (a - sin a) / a^3.
  static double third_order(double a) {
    const double a2 = a * a;
    if (a < small) return 1.0 / 6.0 - a2 / 120.0 + a2 * a2 / 5040.0 - a2 * a2 * a2 / 362880.0;
    return (a - std::sin(a)) / (a2 * a);
  }

  /// I + (1 - cos a) / a^2 W + (a - sin a) / a^3 W^2, W = [theta]x, a = |theta|.
  static Eigen::Matrix3d left_jacobian(const Point& theta) {
    const double a = theta.norm(), half = 0.5 * a;
    const double h = half < 1e-4 ? 1.0 - half * half / 6.0 : std::sin(half) / half;
    const Eigen::Matrix3d W = skew(theta);
    return Eigen::Matrix3d::Identity() + 0.5 * h * h * W + third_order(a) * W * W;
  }

  /// I - W / 2 + (1 / a^2 - cot(a / 2) / (2 a)) W^2.
  static Eigen::Matrix3d left_jacobian_inverse(const Point& theta) {
    const double a = theta.norm(), a2 = a * a;
    const double c = a < small ? 1.0 / 12.0 + a2 / 720.0 + a2 * a2 / 30240.0 + a2 * a2 * a2 / 1209600.0
                               : 1.0 / a2 - std::cos(0.5 * a) / (2.0 * a * std::sin(0.5 * a));
    const Eigen::Matrix3d W = skew(theta);
    return Eigen::Matrix3d::Identity() - 0.5 * W + c * W * W;
  }

  /// Q(rho, theta) of the left Jacobian.
  static Eigen::Matrix3d coupling(const Point& rho, const Point& theta) {
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

  Point t_ = Point::Zero();
  Quaternion q_ = Quaternion(1.0, 0.0, 0.0, 0.0);
};

}  // namespace convoy
