#include <convoy/frontend/front_end.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include <Eigen/Cholesky>
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

template <class G>
RelativeLandmarks<G> subset(const RelativeLandmarks<G>& landmarks, const std::vector<std::size_t>& indices) {
  RelativeLandmarks<G> some;
  std::vector<Eigen::Index> rows;
  for (const std::size_t i : indices) {
    some.tracks.push_back(landmarks.tracks[i]);
    some.positions.push_back(landmarks.positions[i]);
    for (int c = 0; c < G::Dim; ++c) rows.push_back(G::Dim * static_cast<Eigen::Index>(i) + c);
  }
  some.covariance = landmarks.covariance(rows, rows);
  return some;
}

// A is how the landmarks move when the pose does (but for the sign), least the pose that moves them least: least A = I.
template <class G>
std::optional<RigidPart<G>> rigid_part(const RelativeLandmarks<G>& landmarks) {
  constexpr double floor_m2 = 1e-4;
  const auto n = static_cast<Eigen::Index>(landmarks.positions.size());
  if (n <= G::Dim) return std::nullopt;
  Eigen::MatrixXd A(G::Dim * n, G::Dof);
  for (Eigen::Index i = 0; i < n; ++i)
    A.middleRows(G::Dim * i, G::Dim) = G().act_jacobian(landmarks.positions[static_cast<std::size_t>(i)]);
  const typename G::Covariance AtA = A.transpose() * A;
  const typename G::Tangent spread = eigenvalues(AtA);
  if (!(spread.minCoeff() > 1e-9 * spread.maxCoeff())) return std::nullopt;
  const Eigen::MatrixXd least = AtA.ldlt().solve(A.transpose());
  const Eigen::MatrixXd rest = Eigen::MatrixXd::Identity(G::Dim * n, G::Dim * n) - A * least;
  const Eigen::MatrixXd own = rest * landmarks.covariance * rest.transpose();
  RigidPart<G> part;
  typename G::Covariance by_own = G::Covariance::Zero();  // what errors of their own do to the least-squares pose
  for (Eigen::Index i = 0; i < n; ++i) {
    const typename G::PointCovariance block = own.block(G::Dim * i, G::Dim * i, G::Dim, G::Dim);
    const Eigen::Matrix<double, G::Dof, G::Dim> K = least.middleCols(G::Dim * i, G::Dim);
    by_own += K * block * K.transpose();
    const double floor = floor_m2 + 1e-6 * block.trace();  // so that rounding to single precision leaves it positive
    part.own.push_back(symmetrised(typename G::PointCovariance(block + floor * G::PointCovariance::Identity())));
  }
  part.shared = positive_part(typename G::Covariance(least * landmarks.covariance * least.transpose() - by_own));
  return part;
}

#define CONVOY_INSTANTIATE(G)                                                                         \
  template std::vector<typename G::Loading> shared_loadings<G>(const Eigen::MatrixXd&);               \
  template RelativeLandmarks<G> subset(const RelativeLandmarks<G>&, const std::vector<std::size_t>&); \
  template std::optional<RigidPart<G>> rigid_part(const RelativeLandmarks<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
