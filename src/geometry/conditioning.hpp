// Covariances that are to be inverted, whatever somebody has stated: exact in some direction, or kilometres beside
// microradians.
#pragma once

#include <Eigen/Core>

namespace convoy {

namespace decomposed {

template <int N>
Eigen::Matrix<double, N, N> invertible(const Eigen::Matrix<double, N, N>& P);
template <int N>
Eigen::Matrix<double, N, N> inverse_covariance(const Eigen::Matrix<double, N, N>& P);

}  // namespace decomposed

/// P safe to invert: in units of its own standard deviations, its negative part is left out and 1e-10 is added to every
/// variance, so that nothing is known to less than 1e-5 of what its components are.
template <class Derived>
typename Derived::PlainObject invertible(const Eigen::MatrixBase<Derived>& P) {
  return decomposed::invertible<Derived::RowsAtCompileTime>(P);
}

/// P^-1 of a positive definite P, positive semidefinite itself however ill-conditioned P is.
template <class Derived>
typename Derived::PlainObject inverse_covariance(const Eigen::MatrixBase<Derived>& P) {
  return decomposed::inverse_covariance<Derived::RowsAtCompileTime>(P);
}

}  // namespace convoy
