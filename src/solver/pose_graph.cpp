#include <convoy/geometry/groups.hpp>
#include <convoy/solver/index.hpp>
#include <convoy/solver/pose_graph.hpp>

#include <Eigen/LU>
#include <Eigen/SVD>
#include <numeric>
#include <queue>

namespace convoy {
namespace {

template <class G>
BlockPattern pattern_of(const PoseGraph<G>& graph, std::vector<int>& block_of, int block_size = G::Dof) {
  const std::vector<bool> fixed = fixed_poses(graph);
  int blocks = 0;
  for (const bool f : fixed) block_of.push_back(f ? -1 : blocks++);
  BlockPattern pattern(std::vector<int>(at(blocks), block_size));
  for (const PoseFactor<G>& f : graph.factors)
    if (block_of[at(f.from)] >= 0 && block_of[at(f.to)] >= 0) pattern.add(block_of[at(f.from)], block_of[at(f.to)]);
  return pattern;
}

}  // namespace

template <class G>
double pose_graph_cost(PoseResidual kind, const std::vector<PoseFactor<G>>& factors, const std::vector<G>& poses) {
  double cost = 0.0;
  for (const PoseFactor<G>& f : factors) {
    const typename G::Tangent r =
        pose_residual(kind, f.measured.inverse() * (poses[at(f.from)].inverse() * poses[at(f.to)]));
    cost += 0.5 * r.dot(f.information * r);
  }
  return cost;
}

template <class G>
std::vector<bool> fixed_poses(const PoseGraph<G>& graph) {
  std::vector<int> first(graph.poses.size());  // union-find whose root is the smallest of its set
  std::iota(first.begin(), first.end(), 0);
  const auto root = [&](int i) {
    while (first[at(i)] != i) i = first[at(i)] = first[at(first[at(i)])];
    return i;
  };
  for (const PoseFactor<G>& f : graph.factors) {
    const int a = root(f.from), b = root(f.to);
    first[at(std::max(a, b))] = std::min(a, b);
  }
  std::vector<bool> fixed(graph.poses.size());
  for (std::size_t i = 0; i < fixed.size(); ++i) fixed[i] = first[i] == static_cast<int>(i);
  return fixed;
}

template <class G>
std::vector<G> composed_poses(const PoseGraph<G>& graph) {
  const std::size_t n = graph.poses.size();
  std::vector<std::vector<std::size_t>> adjacent(n);
  for (std::size_t f = 0; f < graph.factors.size(); ++f) {
    adjacent[at(graph.factors[f].from)].push_back(f);
    adjacent[at(graph.factors[f].to)].push_back(f);
  }
  std::vector<G> poses = graph.poses;
  std::vector<bool> placed = fixed_poses(graph);
  // Poses that are linked to one that is placed, the earliest first; each is then placed by the latest of its
  // neighbours that comes before it, or else by the earliest that comes after.
  std::priority_queue<int, std::vector<int>, std::greater<>> ready;
  const auto announce = [&](int k) {
    for (const std::size_t f : adjacent[at(k)]) {
      const int other = graph.factors[f].from == k ? graph.factors[f].to : graph.factors[f].from;
      if (!placed[at(other)]) ready.push(other);
    }
  };
  for (std::size_t k = 0; k < n; ++k)
    if (placed[k]) announce(static_cast<int>(k));
  while (!ready.empty()) {
    const int k = ready.top();
    ready.pop();
    if (placed[at(k)]) continue;
    const PoseFactor<G>* best = nullptr;
    int best_other = -1;
    for (const std::size_t f : adjacent[at(k)]) {
      const PoseFactor<G>& factor = graph.factors[f];
      const int other = factor.from == k ? factor.to : factor.from;
      if (!placed[at(other)]) continue;
      const bool before = other < k, best_before = best && best_other < k;
      const bool better = !best || (before != best_before ? before : before ? other > best_other : other < best_other);
      if (better) {
        best = &factor;
        best_other = other;
      }
    }
    poses[at(k)] =
        best->to == k ? poses[at(best_other)] * best->measured : poses[at(best_other)] * best->measured.inverse();
    placed[at(k)] = true;
    announce(k);
  }
  return poses;
}

template <class G>
std::vector<G> relaxed_poses(const PoseGraph<G>& graph) {
  constexpr int N = G::Dim;
  using Matrix = Eigen::Matrix<double, N, N>;
  using Vector = Eigen::Matrix<double, N, 1>;
  std::vector<int> block_of;
  BlockCholesky solver(pattern_of(graph, block_of, N));
  const auto block = [&](int pose) { return block_of[at(pose)]; };
  std::vector<Matrix> R;
  for (const G& T : graph.poses) R.push_back(T.rotation());

  // Rows of R_to are R_measured^T times rows of R_from: the same matrix for each of the N rows.
  Eigen::MatrixXd b = Eigen::MatrixXd::Zero(solver.size(), N);
  const auto known = [&](int pose, const Matrix& toward, Eigen::Index row) {  // rows of R as columns
    b.template middleRows<N>(row) += toward * R[at(pose)].transpose();
  };
  for (const PoseFactor<G>& f : graph.factors) {
    const double weight = f.information.template bottomRightCorner<G::Dof - N, G::Dof - N>().trace();
    const Matrix wI = weight * Matrix::Identity(), wR = weight * f.measured.rotation();
    const int from = block(f.from), to = block(f.to);
    if (from >= 0) solver.add(solver.slot(from, from), wI);
    if (to >= 0) solver.add(solver.slot(to, to), wI);
    if (from >= 0 && to >= 0) solver.add(solver.slot(from, to), Matrix(-wR));
    else if (from >= 0) known(f.to, wR, N * from);
    else if (to >= 0) known(f.from, wR.transpose(), N * to);
  }
  if (!solver.factor().ok()) return graph.poses;
  for (int row = 0; row < N; ++row) solver.solve(b.col(row).data());
  for (std::size_t k = 0; k < R.size(); ++k) {
    if (block_of[k] < 0) continue;
    const Matrix M = b.template middleRows<N>(N * block_of[k]).transpose();
    const Eigen::JacobiSVD<Matrix, Eigen::NoQRPreconditioner> svd(M, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Vector sign = Vector::Ones();
    sign[N - 1] = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0 ? -1.0 : 1.0;
    R[k] = svd.matrixU() * sign.asDiagonal() * svd.matrixV().transpose();
  }

  // t_to - t_from = R_from t_measured, with the information of the position given the rotation, turned.
  solver.set_zero();
  Eigen::VectorXd x = Eigen::VectorXd::Zero(solver.size());
  for (const PoseFactor<G>& f : graph.factors) {
    const Matrix W = R[at(f.from)] * f.information.template topLeftCorner<N, N>() * R[at(f.from)].transpose();
    const Vector d = R[at(f.from)] * f.measured.translation();
    const int from = block(f.from), to = block(f.to);
    if (from >= 0) {
      solver.add(solver.slot(from, from), W);
      x.template segment<N>(N * from) -= W * (to >= 0 ? d : Vector(d - graph.poses[at(f.to)].translation()));
    }
    if (to >= 0) {
      solver.add(solver.slot(to, to), W);
      x.template segment<N>(N * to) += W * (from >= 0 ? d : Vector(d + graph.poses[at(f.from)].translation()));
    }
    if (from >= 0 && to >= 0) solver.add(solver.slot(from, to), Matrix(-W));
  }
  if (!solver.factor().ok()) return graph.poses;
  solver.solve(x);
  std::vector<G> poses = graph.poses;
  for (std::size_t k = 0; k < poses.size(); ++k)
    if (block_of[k] >= 0) poses[k] = G::from_rotation(R[k], x.template segment<N>(N * block_of[k]));
  return poses;
}

template <class G>
PoseGraphSolver<G>::PoseGraphSolver(PoseGraph<G> graph, const PoseGraphParams& params)
    : graph_(std::move(graph)), params_(params), cholesky_(pattern_of(graph_, block_of_)) {
  for (const PoseFactor<G>& f : graph_.factors) {
    const int from = block_of_[at(f.from)], to = block_of_[at(f.to)];
    Slots slots;
    if (from >= 0) slots.from = cholesky_.slot(from, from);
    if (to >= 0) slots.to = cholesky_.slot(to, to);
    if (from >= 0 && to >= 0) slots.to_from = cholesky_.slot(to, from);
    slots_.push_back(slots);
  }
  gradient_.setZero(cholesky_.size());
  step_ = gradient_;
}

template <class G>
double PoseGraphSolver<G>::linearise() {
  cholesky_.set_zero();
  gradient_.setZero();
  double cost = 0.0;
  LinearPoseFactor<G> linear;
  for (std::size_t k = 0; k < graph_.factors.size(); ++k) {
    const PoseFactor<G>& f = graph_.factors[k];
    linear.linearise(params_.residual, f, graph_.poses[at(f.from)], graph_.poses[at(f.to)]);
    cost += linear.cost;
    const int from = block_of_[at(f.from)], to = block_of_[at(f.to)];
    if (from >= 0) {
      cholesky_.add(slots_[k].from, linear.H_from);
      gradient_.template segment<G::Dof>(G::Dof * from) += linear.b_from;
    }
    if (to >= 0) {
      cholesky_.add(slots_[k].to, linear.H_to);
      gradient_.template segment<G::Dof>(G::Dof * to) += linear.b_to;
    }
    if (from >= 0 && to >= 0) cholesky_.add(slots_[k].to_from, linear.H_to_from);
  }
  return cost;
}

template <class G>
void PoseGraphSolver<G>::move(const std::vector<G>& from, std::vector<G>& to) const {
  for (std::size_t n = 0; n < from.size(); ++n)
    to[n] = block_of_[n] < 0 ? from[n] : from[n] * G::Exp(step_.template segment<G::Dof>(G::Dof * block_of_[n]));
}

template <class G>
bool PoseGraphSolver<G>::iterate() {
  linearise();
  if (!cholesky_.factor().ok()) return false;
  step_ = gradient_;
  cholesky_.solve(step_);
  return true;
}

template <class G>
PoseGraphReport PoseGraphSolver<G>::optimise(const std::function<void(const PoseGraphReport&)>& progress) {
  PoseGraphReport report;
  double cost = linearise(), damping = 0.0;
  report.initial_cost = report.final_cost = cost;
  report.converged = cholesky_.size() == 0;
  std::vector<G> before = graph_.poses;
  while (!report.converged && report.iterations < params_.max_iterations && damping < 1e12) {
    ++report.iterations;
    const bool factored = cholesky_.factor(damping).ok();
    double moved_cost = cost;
    bool small = false;
    if (factored) {
      step_ = gradient_;
      cholesky_.solve(step_);
      small = step_.dot(gradient_) < params_.convergence;
      before.swap(graph_.poses);
      move(before, graph_.poses);
      moved_cost = pose_graph_cost(params_.residual, graph_.factors, graph_.poses);
    }
    // Rounding may lift the cost of a step that is nothing but rounding.
    if (!factored || !(moved_cost <= cost + 1e-12 * (1.0 + cost))) {
      if (factored) graph_.poses.swap(before);
      damping = damping == 0.0 ? 1e-4 : 10.0 * damping;
      continue;
    }
    damping = damping < 1e-8 ? 0.0 : 0.1 * damping;
    report.converged = small && damping == 0.0;
    cost = report.converged ? moved_cost : linearise();
    report.final_cost = cost;
    if (progress) progress(report);
  }
  return report;
}

template <class G>
std::vector<typename G::Covariance> PoseGraphSolver<G>::marginals() {
  const std::vector<double> blocks = cholesky_.marginals();
  std::vector<typename G::Covariance> result(graph_.poses.size(), G::Covariance::Zero());
  for (std::size_t n = 0; n < result.size(); ++n)
    if (block_of_[n] >= 0)
      result[n] = Eigen::Map<const typename G::Covariance>(blocks.data() + cholesky_.marginal_offset(block_of_[n]));
  return result;
}

#define CONVOY_INSTANTIATE(G)                                                                                 \
  template double pose_graph_cost<G>(PoseResidual, const std::vector<PoseFactor<G>>&, const std::vector<G>&); \
  template std::vector<bool> fixed_poses<G>(const PoseGraph<G>&);                                             \
  template std::vector<G> composed_poses<G>(const PoseGraph<G>&);                                             \
  template std::vector<G> relaxed_poses<G>(const PoseGraph<G>&);                                              \
  template class PoseGraphSolver<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
