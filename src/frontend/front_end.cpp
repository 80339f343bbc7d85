#include <convoy/frontend/front_end.hpp>
#include <convoy/geometry/groups.hpp>

#include <Eigen/Eigenvalues>

#include <algorithm>
#include <cmath>

namespace convoy {

template <class G>
std::vector<typename G::Loading> shared_loadings(const Eigen::MatrixXd& joint) {
  const Eigen::Index n = joint.rows() / G::Dim;
  std::vector<typename G::Loading> loadings(static_cast<std::size_t>(n), G::Loading::Zero());
  if (n < 2) return loadings;
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(joint);
  const Eigen::Index rank = std::min<Eigen::Index>(G::Shared, joint.rows());
  for (Eigen::Index i = 0; i < n; ++i) {
    typename G::Loading& L = loadings[static_cast<std::size_t>(i)];
    for (Eigen::Index k = 0; k < rank; ++k) {
      const Eigen::Index column = joint.rows() - 1 - k;
      L.col(k) = std::sqrt(std::max(0.0, eigen.eigenvalues()[column])) *
                 eigen.eigenvectors().template block<G::Dim, 1>(G::Dim * i, column);
    }
    L *= 1.0 - 1e-6;  // so that rounding leaves the landmark's own part positive
  }
  return loadings;
}

#define CONVOY_INSTANTIATE(G) template std::vector<typename G::Loading> shared_loadings<G>(const Eigen::MatrixXd&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
