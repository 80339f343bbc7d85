// The rigid motion between two batches that paired landmarks amount to.
#pragma once

#include <convoy/association/constraints.hpp>
#include <convoy/association/search.hpp>

#include <optional>
#include <vector>

namespace convoy {

/// Posterior of (T_a_b, u_a, u_b) given pairs: u are the unit-variance errors that the landmarks of each batch share.
template <class G>
struct Alignment {
  static constexpr int Size = G::Dof + 2 * G::Shared;
  G T_a_b;
  typename G::SharedVector shared_a = G::SharedVector::Zero(), shared_b = G::SharedVector::Zero();
  Eigen::Matrix<double, Size, Size> joint = Eigen::Matrix<double, Size, Size>::Zero();  ///< of (d, u_a, u_b)
  double chi2 = 0.0;  ///< of the pairs at the optimum, shared errors included
  int dof = 0;        ///< Dim * pairs - Dof

  /// Of a right perturbation of T_a_b.
  typename G::Covariance covariance() const { return joint.template topLeftCorner<G::Dof, G::Dof>(); }
};

/// The motion T_a_b that takes the paired landmarks of b to those of a with the least sum of squares, all weighted
/// alike (Kabsch 1976). At least one pair; what the pairs leave open is arbitrary.
template <class G>
G closed_form_alignment(const Batch<G>& a, const Batch<G>& b, const std::vector<IndexPairing>& pairings);

/// Maximum a posteriori alignment of at least Dim pairs: closed-form start (Kabsch), then Gauss-Newton on
/// r = (l_i - loading_i u_a) - T_a_b (l_j - loading_j u_b) with what is each landmark's own as noise and u ~ N(0, I).
/// Empty if the geometry does not fix the motion: points in one place, in space also points in a row.
template <class G>
std::optional<Alignment<G>> align(const Batch<G>& a, const Batch<G>& b, const std::vector<IndexPairing>& pairings);

/// Covariance of l_i - T_a_b l_j as the alignment predicts it.
template <class G>
typename G::PointCovariance residual_covariance(const Alignment<G>& alignment, const LandmarkFact<G>& i,
                                                const LandmarkFact<G>& j);

/// Squared Mahalanobis distance of l_i from T_a_b l_j as the alignment predicts it.
template <class G>
double residual_chi2(const Alignment<G>& alignment, const LandmarkFact<G>& i, const LandmarkFact<G>& j);

}  // namespace convoy
