// Checks and small algebra on covariance matrices, shared by every stage. What decomposes a matrix is compiled once,
// for the sizes that this library has: 1, 2, 3, 6, and whatever is known at run time.
#pragma once

#include <Eigen/Core>

namespace convoy {

namespace decomposed {

template <int N>
using Square = Eigen::Matrix<double, N, N>;

template <int N>
bool is_covariance(const Square<N>& P, double at_least);
template <int N>
Eigen::Matrix<double, N, 1> eigenvalues(const Square<N>& symmetric);
template <int N>
Square<N> positive_part(const Square<N>& symmetric);
template <int N>
double squared_mahalanobis(const Eigen::Matrix<double, N, 1>& r, const Square<N>& P);

}  // namespace decomposed

/// True if every entry is finite, the matrix is symmetric to 1e-9 of its largest entry, and it is positive
/// semidefinite to the same tolerance. Zero is allowed: it says "exactly known". A difference of covariances is judged
/// by `at_least`, the size of what it was made from.
template <class Derived>
[[nodiscard]] bool is_covariance(const Eigen::MatrixBase<Derived>& P, double at_least = 0.0) {
  return decomposed::is_covariance<Derived::RowsAtCompileTime>(P, at_least);
}

template <class Derived>
typename Derived::PlainObject symmetrised(const Eigen::MatrixBase<Derived>& P) {
  return 0.5 * (P + P.transpose());
}

/// Of a symmetric matrix, ascending.
template <class Derived>
Eigen::Matrix<double, Derived::RowsAtCompileTime, 1> eigenvalues(const Eigen::MatrixBase<Derived>& P) {
  return decomposed::eigenvalues<Derived::RowsAtCompileTime>(P);
}

/// The nearest positive semidefinite matrix: negative eigenvalues become zero. Unchanged, to the bit, if there are
/// none.
template <class Derived>
typename Derived::PlainObject positive_part(const Eigen::MatrixBase<Derived>& P) {
  return decomposed::positive_part<Derived::RowsAtCompileTime>(symmetrised(P));
}

/// r^T P^-1 r, the squared Mahalanobis distance; infinite if P is not positive definite.
template <class Vector, class Matrix>
double squared_mahalanobis(const Eigen::MatrixBase<Vector>& r, const Eigen::MatrixBase<Matrix>& P) {
  return decomposed::squared_mahalanobis<Matrix::RowsAtCompileTime>(r, P);
}

}  // namespace convoy
