// Residuals of the factors and their Jacobians by right perturbations of poses and by points (DESIGN B1.3).
#pragma once

#include <convoy/geometry/covariance.hpp>
#include <convoy/map/problem.hpp>

#include <map>
#include <utility>
#include <vector>

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

/// The F2 factors of one node together: one measurement, since their errors are shared.
template <class G>
struct BatchFactor {
  int node = 0;
  std::vector<const LandmarkFactor<G>*> landmarks;
  Eigen::MatrixXd information;  ///< inverse joint covariance, Dim n x Dim n, node frame
};

/// In the order of their nodes. They point into `problem`.
template <class G>
std::vector<BatchFactor<G>> batch_factors(const Problem<G>& problem) {
  std::map<int, BatchFactor<G>> by_node;
  for (const LandmarkFactor<G>& f : problem.landmarks) by_node[f.node].landmarks.push_back(&f);
  std::vector<BatchFactor<G>> factors;
  for (auto& [node, factor] : by_node) {
    const auto n = static_cast<Eigen::Index>(factor.landmarks.size());
    Eigen::MatrixXd loading(G::Dim * n, G::Shared);
    for (Eigen::Index i = 0; i < n; ++i)
      loading.template middleRows<G::Dim>(G::Dim * i) = factor.landmarks[static_cast<std::size_t>(i)]->loading;
    Eigen::MatrixXd covariance = loading * loading.transpose();
    for (Eigen::Index i = 0; i < n; ++i)
      covariance.template block<G::Dim, G::Dim>(G::Dim * i, G::Dim * i) =
          factor.landmarks[static_cast<std::size_t>(i)]->covariance;
    factor.node = node;
    factor.information =
        symmetrised(Eigen::MatrixXd(covariance.llt().solve(Eigen::MatrixXd::Identity(G::Dim * n, G::Dim * n))));
    factors.push_back(std::move(factor));
  }
  return factors;
}

}  // namespace convoy
