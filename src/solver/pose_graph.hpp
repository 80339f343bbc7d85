// Pose graphs: poses T_k and relative measurements between them, solved by Gauss-Newton with Levenberg-Marquardt
// damping where a full step goes uphill. The first pose of every connected component stays where it is.
#pragma once

#include <convoy/solver/block_cholesky.hpp>

#include <Eigen/Geometry>
#include <functional>
#include <vector>

namespace convoy {

/// A relative pose: T_from^-1 T_to = measured, up to noise with this information (inverse covariance, order of
/// G::Tangent).
template <class G>
struct PoseFactor {
  int from = 0, to = 0;
  G measured;
  typename G::Covariance information = G::Covariance::Identity();
};

template <class G>
struct PoseGraph {
  std::vector<G> poses;
  std::vector<PoseFactor<G>> factors;
};

/// What is squared, of the error E = measured^-1 T_from^-1 T_to.
enum class PoseResidual {
  log,  ///< Log(E): the group's own, as everywhere else in convoy
  g2o   ///< (translation of E, rotation): SE(2) the angle, SE(3) 2 vec(q). What most public figures refer to
};

/// Value and Jacobian with respect to a right perturbation of E.
template <class G>
typename G::Tangent pose_residual(PoseResidual kind, const G& E) {
  if (kind == PoseResidual::log) return E.Log();
  if constexpr (G::Dim == 2) {
    return {E.translation().x(), E.translation().y(), E.theta()};
  } else {
    Eigen::Quaterniond q(E.rotation());
    if (q.w() < 0.0) q.coeffs() = -q.coeffs();
    typename G::Tangent r;
    r << E.translation(), 2.0 * q.vec();
    return r;
  }
}

template <class G>
typename G::Adjoint pose_residual_jacobian(PoseResidual kind, const G& E) {
  if (kind == PoseResidual::log) return G::right_jacobian_inverse(E.Log());
  typename G::Adjoint J = G::Adjoint::Identity();
  J.template topLeftCorner<G::Dim, G::Dim>() = E.rotation();
  if constexpr (G::Dim == 3) {
    Eigen::Quaterniond q(E.rotation());
    if (q.w() < 0.0) q.coeffs() = -q.coeffs();
    J.template bottomRightCorner<3, 3>() << q.w(), -q.z(), q.y(), q.z(), q.w(), -q.x(), -q.y(), q.x(), q.w();
  }
  return J;
}

/// One factor at a pair of poses, as it enters the normal equations: cost and, if asked for, blocks of H = J^T W J and
/// of b = -J^T W r.
template <class G>
struct LinearPoseFactor {
  typename G::Adjoint H_from, H_to, H_to_from;
  typename G::Tangent b_from, b_to;
  double cost = 0.0;  ///< r^T W r / 2

  void linearise(PoseResidual kind, const PoseFactor<G>& factor, const G& T_from, const G& T_to) {
    const G T_from_to = T_from.inverse() * T_to;
    const G E = factor.measured.inverse() * T_from_to;
    const typename G::Tangent r = pose_residual(kind, E), Wr = factor.information * r;
    const typename G::Adjoint J = pose_residual_jacobian(kind, E), A = T_from_to.inverse().adjoint();
    cost = 0.5 * r.dot(Wr);
    // dr/dT_to = J, dr/dT_from = -J A.
    const typename G::Adjoint WJ = factor.information * J;
    H_to.noalias() = J.transpose() * WJ;
    H_to_from.noalias() = -(H_to * A);
    H_from.noalias() = -(A.transpose() * H_to_from);
    b_to.noalias() = -(J.transpose() * Wr);
    b_from.noalias() = -(A.transpose() * b_to);
  }
};

/// Half the sum of the squared residuals, weighted by their information.
template <class G>
double pose_graph_cost(PoseResidual kind, const std::vector<PoseFactor<G>>& factors, const std::vector<G>& poses);

/// True for the first pose of each connected component.
template <class G>
std::vector<bool> fixed_poses(const PoseGraph<G>& graph);

/// A cold start: poses in order, each placed by its factor to the latest pose before it (odometry, where there is
/// odometry), what is not linked to an earlier one as soon as it is linked to any. The first pose of each component
/// stays.
template <class G>
std::vector<G> composed_poses(const PoseGraph<G>& graph);

/// A start that does not add up the errors of a chain: rotations by linear least squares on the entries of their
/// matrices, projected onto rotations (chordal relaxation: Martinec & Pajdla, CVPR 2007), then positions by linear
/// least squares. The first pose of each component stays. Where a system is singular, the poses as they are. From here
/// Gauss-Newton converges on graphs (INTEL, for one) where it fails from composed_poses.
template <class G>
std::vector<G> relaxed_poses(const PoseGraph<G>& graph);

struct PoseGraphParams {
  PoseResidual residual = PoseResidual::log;
  int max_iterations = 200;
  double convergence = 1e-12;  ///< squared length of a step in units of its own standard deviation
};

struct PoseGraphReport {
  bool converged = false;
  int iterations = 0;         ///< factorisations
  double initial_cost = 0.0;  ///< half chi-square
  double final_cost = 0.0;
};

/// Batch solution. The analysis of the pattern is kept, so that another optimise() of the same graph does not repeat
/// it.
template <class G>
class PoseGraphSolver {
 public:
  /// Indices of the factors must be within the poses, `from` and `to` different.
  explicit PoseGraphSolver(PoseGraph<G> graph, const PoseGraphParams& params = {});

  /// From the current poses until they no longer move. `progress`, if given, hears of every iteration.
  PoseGraphReport optimise(const std::function<void(const PoseGraphReport&)>& progress = {});

  const std::vector<G>& poses() const { return graph_.poses; }
  const PoseGraph<G>& graph() const { return graph_; }
  /// Covariance of the right perturbation of every pose at the last factorisation; zero for a fixed pose.
  std::vector<typename G::Covariance> marginals();
  /// One Gauss-Newton iteration: linearise, factor, solve; the poses stay. False if H is not positive definite. For
  /// benches.
  bool iterate();
  const BlockCholesky& cholesky() const { return cholesky_; }

 private:
  double linearise();
  void move(const std::vector<G>& from, std::vector<G>& to) const;

  struct Slots {
    BlockCholesky::Slot from, to, to_from;
  };

  PoseGraph<G> graph_;
  PoseGraphParams params_;
  std::vector<int> block_of_;  ///< of each pose; -1: fixed
  BlockCholesky cholesky_;
  std::vector<Slots> slots_;
  Eigen::VectorXd gradient_, step_;
};

}  // namespace convoy
