#include <convoy/geometry/covariance.hpp>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <limits>

namespace convoy::decomposed {

template <int N>
bool is_covariance(const Square<N>& P, double at_least) {
  if (!P.allFinite()) return false;
  const double scale = std::max(at_least, P.cwiseAbs().maxCoeff());
  if (scale == 0.0) return true;
  if ((P - P.transpose()).cwiseAbs().maxCoeff() > 1e-9 * scale) return false;
  if (Eigen::LLT<Square<N>>(P).info() == Eigen::Success) return true;  // the usual case
  const Eigen::SelfAdjointEigenSolver<Square<N>> eigen(P, Eigen::EigenvaluesOnly);
  return eigen.info() == Eigen::Success && eigen.eigenvalues().minCoeff() >= -1e-9 * scale;
}

template <int N>
Eigen::Matrix<double, N, 1> eigenvalues(const Square<N>& symmetric) {
  return Eigen::SelfAdjointEigenSolver<Square<N>>(symmetric, Eigen::EigenvaluesOnly).eigenvalues();
}

template <int N>
Square<N> positive_part(const Square<N>& symmetric) {
  if (Eigen::LLT<Square<N>>(symmetric).info() == Eigen::Success)
    return symmetric;  // the usual case, and a tenth of the time
  const Eigen::SelfAdjointEigenSolver<Square<N>> eigen(symmetric);
  if (eigen.eigenvalues().minCoeff() >= 0.0) return symmetric;
  const Square<N> V = eigen.eigenvectors();
  return symmetrised(Square<N>(V * eigen.eigenvalues().cwiseMax(0.0).asDiagonal() * V.transpose()));
}

template <int N>
double squared_mahalanobis(const Eigen::Matrix<double, N, 1>& r, const Square<N>& P) {
  const Eigen::LLT<Square<N>> llt(P);
  if (llt.info() != Eigen::Success) return std::numeric_limits<double>::infinity();
  return llt.matrixL().solve(r).squaredNorm();
}

#define CONVOY_INSTANTIATE(N)                                            \
  template bool is_covariance<N>(const Square<N>&, double);              \
  template Eigen::Matrix<double, N, 1> eigenvalues<N>(const Square<N>&); \
  template Square<N> positive_part<N>(const Square<N>&);                 \
  template double squared_mahalanobis<N>(const Eigen::Matrix<double, N, 1>&, const Square<N>&);
CONVOY_INSTANTIATE(1)
CONVOY_INSTANTIATE(2)
CONVOY_INSTANTIATE(3)
CONVOY_INSTANTIATE(6)
CONVOY_INSTANTIATE(Eigen::Dynamic)

}  // namespace convoy::decomposed
