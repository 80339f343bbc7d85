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
  static SE3 from_rotation(const Eigen::Matrix3d& R, const Point& t_m);

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
  Adjoint adjoint() const;

  /// ad_d, the derivative of Ad_Exp(d) at the identity: ad_d e = [d, e].
  static Adjoint ad(const Tangent& d);

  static SE3 Exp(const Tangent& d);

  /// The rotation by at most pi; of the two by pi, the one whose first non-zero component is positive.
  Tangent Log() const;

  /// d(T * p) / d(right perturbation of T) = R [I, -[p]x].  3 x 6
  PointJacobian act_jacobian(const Point& p) const;

  /// Inverse of the right Jacobian at d: Log(Exp(d) Exp(e)) = d + Jr_inv(d) e + O(e^2), |theta| < 2 pi.
  /// Jr(d) = Jl(-d) with Jl = [[J, Q], [0, J]], J that of the rotation alone (Barfoot, State Estimation, 7.85-7.95).
  static Adjoint right_jacobian_inverse(const Tangent& d);

 private:
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

  Point t_ = Point::Zero();
  Quaternion q_ = Quaternion(1.0, 0.0, 0.0, 0.0);
};

}  // namespace convoy
