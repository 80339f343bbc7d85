// Residuals of the factors and their Jacobians by right perturbations of poses and by points (DESIGN B1.3).
#pragma once

#include <convoy/map/problem.hpp>

namespace convoy {

/// F0: r = Log(M^-1 T), with J = dr / d(T).
template <class G>
struct PriorResidual {
  PriorResidual(const PriorFactor<G>& f, const G& T)
      : r((f.mean.inverse() * T).Log()), J(G::right_jacobian_inverse(r)) {}
  typename G::Tangent r;
  typename G::Covariance J;
};

/// F1: r = Log(U^-1 T_a^-1 T_b).
template <class G>
struct DriftResidual {
  DriftResidual(const DriftFactor<G>& f, const G& T_a, const G& T_b) : DriftResidual(f, T_a.inverse() * T_b) {}
  typename G::Tangent r;
  typename G::Covariance J_b, J_a;

 private:
  DriftResidual(const DriftFactor<G>& f, const G& T_a_b)
      : r((f.motion.inverse() * T_a_b).Log()),
        J_b(G::right_jacobian_inverse(r)),
        J_a(-J_b * T_a_b.inverse().adjoint()) {}
};

/// F2: r = T^-1 m - l.
template <class G>
struct LandmarkResidual {
  LandmarkResidual(const LandmarkFactor<G>& f, const G& T, const typename G::Point& m) : J_m(T.rotation().transpose()) {
    const typename G::Point q = J_m * (m - T.translation());
    r = q - f.position;
    J_T = -G().act_jacobian(q);  // d(T^-1 m) = -[I, J q] d_T
  }
  typename G::Point r;
  typename G::PointJacobian J_T;
  typename G::PointCovariance J_m;
};

}  // namespace convoy
