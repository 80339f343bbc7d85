// Residuals of the factors and their Jacobians by right perturbations of poses and by points (DESIGN B1.3).
#pragma once

#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/se3.hpp>
#include <convoy/map/problem.hpp>

#include <Eigen/Geometry>

namespace convoy {

/// F0: r = Log(M^-1 T), with J = dr / d(T).
template <class G>
struct PriorResidual {
  PriorResidual(const PriorFactor<G>& f, const G& T)
      : r((f.mean.inverse() * T).Log()), J(G::right_jacobian_inverse(r)) {}
  typename G::Tangent r;
  typename G::Covariance J;
};

/// F1: r = Log((U Exp(A c))^-1 T_a^-1 T_b).
template <class G>
struct DriftResidual {
  DriftResidual(const DriftFactor<G>& f, const G& T_a, const G& T_b, const Constants<G>& c = Constants<G>::Zero()) {
    const G T_a_b = T_a.inverse() * T_b;
    const typename G::Tangent e = f.A * c;
    const G E = f.constants < 0 ? f.motion.inverse() * T_a_b : (f.motion * G::Exp(e)).inverse() * T_a_b;
    r = E.Log();
    J_b = G::right_jacobian_inverse(r);
    J_a = -J_b * T_a_b.inverse().adjoint();
    if (f.constants < 0) J_c.setZero();
    else J_c = -J_b * E.inverse().adjoint() * G::right_jacobian_inverse(e).inverse() * f.A;
  }
  typename G::Tangent r;
  typename G::Covariance J_b, J_a;
  ConstantsJacobian<G> J_c;
};

/// F6: r = e_b - phi e_a. Of one node, e = ((up^ x R^T e_z) of roll and pitch, z - h0 - height^). The vehicle is less
/// than upside down: within 60 degrees of level, say.
struct BoundedResidual {
  using Jacobian = Eigen::Matrix<double, 3, 6>;
  BoundedResidual(const BoundedFactor& f, const SE3* T_a, const SE3& T_b, double start_height_m)
      : J_a(Jacobian::Zero()) {
    r = error(f.up_b, f.height_b, T_b, start_height_m, J_b);
    J_c = Eigen::Vector3d(0.0, 0.0, -1.0);
    if (T_a == nullptr) return;
    r -= f.phi * error(f.up_a, f.height_a, *T_a, start_height_m, J_a);
    J_a *= -f.phi;
    J_c *= 1.0 - f.phi;
  }
  Eigen::Vector3d r, J_c;  ///< J_c: by the height of the start
  Jacobian J_b, J_a;

 private:
  static Eigen::Vector3d error(const Eigen::Vector3d& up, double height_m, const SE3& T, double start_height_m,
                               Jacobian& J) {
    const Eigen::Matrix3d R = T.rotation();
    const Eigen::Vector3d true_up = R.row(2).transpose();  // body frame
    J.setZero();
    J.topRightCorner<2, 3>() = (skew(up) * skew(true_up)).topRows<2>();  // d(R^T e_z) = [R^T e_z]x d_theta
    J.bottomLeftCorner<1, 3>() = R.row(2);
    Eigen::Vector3d e = up.cross(true_up);
    e.z() = T.translation().z() - start_height_m - height_m;
    return e;
  }
};

/// F2: r = T^-1 m / (1 + kappa) - l, in the SLAM's own lengths, in which its noise is: else a world that is too small
/// would fit better.
template <class G>
struct LandmarkResidual {
  LandmarkResidual(const LandmarkFactor<G>& f, const G& T, const typename G::Point& m,
                   const Constants<G>& c = Constants<G>::Zero())
      : J_m(T.rotation().transpose() / (1.0 + c[0])) {
    const typename G::Point q = J_m * (m - T.translation());
    r = q - f.position;
    J_T = -G().act_jacobian((1.0 + c[0]) * q) / (1.0 + c[0]);  // d(T^-1 m) = -[I, J q] d_T
    J_c.setZero();
    J_c.col(0) = -q / (1.0 + c[0]);
  }
  typename G::Point r;
  Eigen::Matrix<double, G::Dim, Constants<G>::RowsAtCompileTime> J_c;
  typename G::PointJacobian J_T;
  typename G::PointCovariance J_m;
};

/// F4: r = T_o^-1 T_w q - z.
template <class G>
struct EncounterResidual {
  EncounterResidual(const EncounterFactor<G>& f, const G& T_o, const G& T_w) {
    const typename G::PointCovariance R_t = T_o.rotation().transpose();
    const typename G::Point p = R_t * (T_w * f.mark - T_o.translation());
    r = p - f.position;
    J_o = -G().act_jacobian(p);
    J_w = R_t * T_w.act_jacobian(f.mark);
  }
  typename G::Point r;
  typename G::PointJacobian J_o, J_w;
};

/// F3: r = D T q - z.
template <class G>
struct AbsoluteFixResidual {
  AbsoluteFixResidual(const AbsoluteFixFactor<G>& f, const G& T, const G& D) {
    const typename G::Point p = T * f.antenna;
    r = D * p - f.position;
    J_T = D.rotation() * T.act_jacobian(f.antenna);
    J_D = D.act_jacobian(p);
  }
  typename G::Point r;
  typename G::PointJacobian J_T, J_D;
};

}  // namespace convoy
