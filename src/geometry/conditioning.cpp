#include <convoy/geometry/conditioning.hpp>
#include <convoy/geometry/covariance.hpp>

#include <Eigen/Cholesky>

namespace convoy::decomposed {

template <int N>
Eigen::Matrix<double, N, N> invertible(const Eigen::Matrix<double, N, N>& P) {
  using Matrix = Eigen::Matrix<double, N, N>;
  constexpr double smallest = 1e-150;  // its square is still a number
  const Eigen::Matrix<double, N, 1> sigma = P.diagonal().cwiseMax(smallest * smallest).cwiseSqrt();
  const Eigen::Matrix<double, N, 1> per_sigma = sigma.cwiseInverse();
  Matrix C = convoy::positive_part(Matrix(per_sigma.asDiagonal() * P * per_sigma.asDiagonal()));
  C.diagonal().array() += 1e-10;
  return symmetrised(Matrix(sigma.asDiagonal() * C * sigma.asDiagonal()));
}

template <int N>
Eigen::Matrix<double, N, N> inverse_covariance(const Eigen::Matrix<double, N, N>& P) {
  using Matrix = Eigen::Matrix<double, N, N>;
  const Eigen::Matrix<double, N, 1> per_sigma = P.diagonal().cwiseSqrt().cwiseInverse();
  const Matrix C = per_sigma.asDiagonal() * P * per_sigma.asDiagonal();
  const Matrix L_inverse = C.llt().matrixL().solve(Matrix::Identity());
  const Matrix W = L_inverse.transpose() * L_inverse;
  return symmetrised(Matrix(per_sigma.asDiagonal() * W * per_sigma.asDiagonal()));
}

#define CONVOY_INSTANTIATE(N)                                                             \
  template Eigen::Matrix<double, N, N> invertible<N>(const Eigen::Matrix<double, N, N>&); \
  template Eigen::Matrix<double, N, N> inverse_covariance<N>(const Eigen::Matrix<double, N, N>&);
CONVOY_INSTANTIATE(2)
CONVOY_INSTANTIATE(3)
CONVOY_INSTANTIATE(6)

}  // namespace convoy::decomposed
