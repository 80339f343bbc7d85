// Checks and small algebra on covariance matrices, shared by every stage.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>

namespace convoy {

/// True if every entry is finite, the matrix is symmetric to 1e-9 of its largest entry, and it is positive
/// semidefinite to the same tolerance. Zero is allowed: it says "exactly known". A difference of covariances is judged by
/// `at_least`, the size of what it was made from.
template <class Derived>
[[nodiscard]] bool is_covariance(const Eigen::MatrixBase<Derived>& P, double at_least = 0.0) {
  using Matrix = typename Derived::PlainObject;
  const Matrix M = P;
  if (!M.allFinite()) return false;
  const double scale = std::max(at_least, M.cwiseAbs().maxCoeff());
  if (scale == 0.0) return true;
  if ((M - M.transpose()).cwiseAbs().maxCoeff() > 1e-9 * scale) return false;
  const Eigen::SelfAdjointEigenSolver<Matrix> eigen(M, Eigen::EigenvaluesOnly);
  return eigen.info() == Eigen::Success && eigen.eigenvalues().minCoeff() >= -1e-9 * scale;
}

template <class Derived>
typename Derived::PlainObject symmetrised(const Eigen::MatrixBase<Derived>& P) {
  return 0.5 * (P + P.transpose());
}

/// The nearest positive semidefinite matrix: negative eigenvalues become zero. Unchanged, to the bit, if there are none.
template <class Derived>
typename Derived::PlainObject positive_part(const Eigen::MatrixBase<Derived>& P) {
  using Matrix = typename Derived::PlainObject;
  const Matrix M = symmetrised(P);
  if (Eigen::LLT<Matrix>(M).info() == Eigen::Success) return M;  // the usual case, and a tenth of the time
  const Eigen::SelfAdjointEigenSolver<Matrix> eigen(M);
  if (eigen.eigenvalues().minCoeff() >= 0.0) return M;
  const Matrix V = eigen.eigenvectors();
  return symmetrised(Matrix(V * eigen.eigenvalues().cwiseMax(0.0).asDiagonal() * V.transpose()));
}

/// r^T P^-1 r, the squared Mahalanobis distance; infinite if P is not positive definite.
template <class Vector, class Matrix>
double squared_mahalanobis(const Eigen::MatrixBase<Vector>& r, const Eigen::MatrixBase<Matrix>& P) {
  const Eigen::LLT<typename Matrix::PlainObject> llt(P);
  if (llt.info() != Eigen::Success) return std::numeric_limits<double>::infinity();
  return llt.matrixL().solve(r).squaredNorm();
}

}  // namespace convoy
