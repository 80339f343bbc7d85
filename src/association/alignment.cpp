#include <convoy/association/alignment.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <Eigen/SVD>

namespace convoy {
namespace {

// One pair at an alignment: its residual, the noise on it, and r = -J (d, u_a, u_b) + noise.
template <class G>
struct PairResidual {
  PairResidual(const Alignment<G>& at, const LandmarkFact<G>& i, const LandmarkFact<G>& j) {
    const typename G::PointCovariance R = at.T_a_b.rotation();
    const typename G::Point corrected = j.position - j.loading * at.shared_b;
    r = i.position - i.loading * at.shared_a - at.T_a_b * corrected;
    noise = i.own_covariance() + R * j.own_covariance() * R.transpose();
    J.template leftCols<G::Dof>() = at.T_a_b.act_jacobian(corrected);
    J.template middleCols<G::Shared>(G::Dof) = i.loading;
    J.template rightCols<G::Shared>() = -R * j.loading;
  }
  typename G::Point r;
  typename G::PointCovariance noise;
  Eigen::Matrix<double, G::Dim, Alignment<G>::Size> J;
};

// In space, points in a row leave the rotation about it to their noise: such a covariance is large, and wrong, since
// the truth may lie half a turn away.
template <class G>
bool fixes_rotation(const Alignment<G>& alignment) {
  constexpr double max_sigma_rad = 0.3;
  const typename G::Covariance P = alignment.covariance();
  return G::Dim < 3 || P.diagonal().template tail<G::Dof - G::Dim>().maxCoeff() < max_sigma_rad * max_sigma_rad;
}

}  // namespace

template <class G>
G closed_form_alignment(const Batch<G>& a, const Batch<G>& b, const std::vector<IndexPairing>& pairings) {
  typename G::Point mean_a = G::Point::Zero(), mean_b = G::Point::Zero();
  const double n = static_cast<double>(pairings.size());
  for (const auto& [i, j] : pairings) {
    mean_a += a.landmarks[static_cast<std::size_t>(i)].position / n;
    mean_b += b.landmarks[static_cast<std::size_t>(j)].position / n;
  }
  using Matrix = typename G::PointCovariance;
  Matrix cross = Matrix::Zero();
  for (const auto& [i, j] : pairings)
    cross += (a.landmarks[static_cast<std::size_t>(i)].position - mean_a) *
             (b.landmarks[static_cast<std::size_t>(j)].position - mean_b).transpose();
  const Eigen::JacobiSVD<Matrix> svd(cross, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Matrix proper = Matrix::Identity();  // no reflections
  proper(G::Dim - 1, G::Dim - 1) = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0 ? -1.0 : 1.0;
  const Matrix R = svd.matrixU() * proper * svd.matrixV().transpose();
  return G::from_rotation(R, mean_a - R * mean_b);
}

template <class G>
std::optional<Alignment<G>> align(const Batch<G>& a, const Batch<G>& b, const std::vector<IndexPairing>& pairings) {
  if (static_cast<int>(pairings.size()) < G::Dim) return std::nullopt;
  constexpr int Size = Alignment<G>::Size;
  using Matrix = Eigen::Matrix<double, Size, Size>;
  using Vector = Eigen::Matrix<double, Size, 1>;
  Alignment<G> result;
  result.T_a_b = closed_form_alignment(a, b, pairings);
  result.dof = G::Dim * static_cast<int>(pairings.size()) - G::Dof;
  for (int iteration = 0; iteration < 30; ++iteration) {
    Matrix information = Matrix::Zero();
    information.diagonal().template tail<2 * G::Shared>().setOnes();  // u ~ N(0, I)
    Vector gradient = Vector::Zero();
    gradient.template segment<G::Shared>(G::Dof) = -result.shared_a;
    gradient.template tail<G::Shared>() = -result.shared_b;
    result.chi2 = result.shared_a.squaredNorm() + result.shared_b.squaredNorm();
    for (const auto& [i, j] : pairings) {
      const PairResidual<G> pair(result, a.landmarks[static_cast<std::size_t>(i)],
                                 b.landmarks[static_cast<std::size_t>(j)]);
      const Eigen::LLT<typename G::PointCovariance> llt(pair.noise);
      if (llt.info() != Eigen::Success) return std::nullopt;
      const typename G::Point weighted = llt.solve(pair.r);
      information += pair.J.transpose() * llt.solve(pair.J);
      gradient += pair.J.transpose() * weighted;
      result.chi2 += pair.r.dot(weighted);
    }
    const Eigen::LDLT<Matrix> ldlt(information);
    if (ldlt.info() != Eigen::Success || !(ldlt.rcond() > 1e-14)) return std::nullopt;
    result.joint = symmetrised(Matrix(ldlt.solve(Matrix::Identity())));
    const Vector step = ldlt.solve(gradient);
    if (step.dot(information * step) < 1e-18) return fixes_rotation(result) ? std::optional(result) : std::nullopt;
    result.T_a_b = result.T_a_b * G::Exp(step.template head<G::Dof>());
    result.shared_a += step.template segment<G::Shared>(G::Dof);
    result.shared_b += step.template tail<G::Shared>();
  }
  return std::nullopt;  // no convergence: the pairs contradict each other
}

template <class G>
typename G::PointCovariance residual_covariance(const Alignment<G>& alignment, const LandmarkFact<G>& i,
                                                const LandmarkFact<G>& j) {
  const PairResidual<G> pair(alignment, i, j);
  return symmetrised(typename G::PointCovariance(pair.noise + pair.J * alignment.joint * pair.J.transpose()));
}

template <class G>
double residual_chi2(const Alignment<G>& alignment, const LandmarkFact<G>& i, const LandmarkFact<G>& j) {
  return squared_mahalanobis(PairResidual<G>(alignment, i, j).r, residual_covariance(alignment, i, j));
}

#define CONVOY_INSTANTIATE(G)                                                                                     \
  template G closed_form_alignment(const Batch<G>&, const Batch<G>&, const std::vector<IndexPairing>&);           \
  template std::optional<Alignment<G>> align(const Batch<G>&, const Batch<G>&, const std::vector<IndexPairing>&); \
  template typename G::PointCovariance residual_covariance(const Alignment<G>&, const LandmarkFact<G>&,           \
                                                           const LandmarkFact<G>&);                               \
  template double residual_chi2(const Alignment<G>&, const LandmarkFact<G>&, const LandmarkFact<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
