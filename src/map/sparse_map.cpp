#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/factors.hpp>
#include <convoy/map/sparse_map.hpp>
#include <convoy/solver/block_cholesky.hpp>

#include <algorithm>
#include <map>
#include <utility>

namespace convoy {
namespace {

// H^-1 by blocks. The first question pays for every block where H is not zero; what lies elsewhere takes a right-hand
// side each and is kept. A question has the same answer, to the bit, whatever was asked before it.
template <class G>
class SparseCovariance final : public CovarianceSource<G> {
 public:
  SparseCovariance(BlockCholesky solver, int nodes) : solver_(std::move(solver)), nodes_(nodes) {}

  typename G::Covariance nodes(int a, int b) override {
    if (solver_.in_pattern(a, b)) return BlockCholesky::in_slot<G::Dof, G::Dof>(selected(), solver_.slot(a, b));
    auto [it, fresh] = elsewhere_.try_emplace(std::minmax(a, b));
    if (fresh) it->second = solver_.covariance(std::min(a, b), std::max(a, b));
    return a < b ? it->second : typename G::Covariance(it->second.transpose());
  }

  typename G::PointCovariance point(int p) override {
    const int block = nodes_ + p;
    return symmetrised(BlockCholesky::in_slot<G::Dim, G::Dim>(selected(), solver_.slot(block, block)));
  }

  Eigen::MatrixXd joint(const std::vector<int>& nodes, const std::vector<int>& points) override {
    std::vector<int> blocks = nodes;
    for (const int p : points) blocks.push_back(nodes_ + p);
    return solver_.joint_covariance(blocks);
  }

 private:
  const std::vector<double>& selected() {
    if (selected_.empty()) selected_ = solver_.selected_inverse();
    return selected_;
  }

  BlockCholesky solver_;
  int nodes_;
  std::vector<double> selected_;
  std::map<std::pair<int, int>, typename G::Covariance> elsewhere_;
};

// The normal equations of a problem at an estimate: blocks of nodes, then of points, each where the pattern, which is
// analysed once, has it.
template <class G>
class NormalEquations {
 public:
  explicit NormalEquations(const Problem<G>& problem)
      : problem_(problem), nodes_(static_cast<int>(problem.nodes.size())), batches_(batch_factors(problem)) {
    for (const auto& f : problem.priors) prior_information_.push_back(f.covariance.inverse());
    for (const auto& f : problem.drifts) drift_information_.push_back(f.covariance.inverse());
    for (const auto& f : problem.fixes) fix_information_.push_back(f.covariance.inverse());
    for (const BatchFactor<G>& f : batches_) shared_.push_back(shared_errors(f));
    std::vector<int> sizes(problem.nodes.size(), G::Dof);
    sizes.resize(sizes.size() + problem.points.size(), G::Dim);
    BlockPattern pattern(std::move(sizes));
    each_pair([&](int i, int j) { pattern.add(i, j); });
    solver_ = BlockCholesky(pattern);
    solver_.set_pivot_tolerance(0.0);  // known to 0.1 mm beside known to 1 km is no rounding
    each_pair([&](int i, int j) { slots_.push_back(solver_.slot(i, j)); });
    gradient_.setZero(solver_.size());
  }

  BlockCholesky& solver() { return solver_; }
  const Eigen::VectorXd& gradient() const { return gradient_; }
  int node_row(int n) const { return solver_.offset(n); }
  int point_row(int p) const { return solver_.offset(nodes_ + p); }

  /// H = J^T W J and g = -J^T W r; returns r^T W r, summed over all factors.
  double linearise(const std::vector<G>& poses, const std::vector<typename G::Point>& points) {
    solver_.set_zero();
    gradient_.setZero();
    slot_ = slots_.data();
    double chi2 = 0.0;
    for (std::size_t k = 0; k < problem_.priors.size(); ++k) chi2 += prior(k, poses);
    for (std::size_t k = 0; k < problem_.drifts.size(); ++k) chi2 += drift(k, poses);
    for (std::size_t k = 0; k < problem_.fixes.size(); ++k) chi2 += absolute_fix(k, poses);
    for (std::size_t k = 0; k < batches_.size(); ++k) chi2 += landmarks(k, poses, points);
    return chi2;
  }

  int residuals() const {
    return G::Dof * static_cast<int>(problem_.priors.size() + problem_.drifts.size()) +
           G::Dim * static_cast<int>(problem_.landmarks.size() + problem_.fixes.size());
  }

 private:
  using Dof = typename G::Covariance;

  // Every block that linearise() adds to, in its order.
  template <class Visit>
  void each_pair(const Visit& visit) const {
    for (const auto& f : problem_.priors) visit(f.node, f.node);
    for (const auto& f : problem_.drifts) {
      visit(f.a, f.a);
      visit(f.b, f.a);
      visit(f.b, f.b);
    }
    for (const auto& f : problem_.fixes) {
      visit(f.node, f.node);
      if (f.datum < 0) continue;
      visit(f.datum, f.node);
      visit(f.datum, f.datum);
    }
    for (std::size_t k = 0; k < batches_.size(); ++k) {
      const BatchFactor<G>& f = batches_[k];
      visit(f.node, f.node);
      for (std::size_t i = 0; i < f.landmarks.size(); ++i) visit(point_block(f, i), f.node);
      for (const auto& [i, j] : shared_[k]) visit(point_block(f, i), point_block(f, j));
    }
  }

  using Pair = std::pair<std::size_t, std::size_t>;

  // Landmarks of a batch whose errors have to do with each other, each two of them once; each with itself.
  std::vector<Pair> shared_errors(const BatchFactor<G>& f) const {
    std::vector<Pair> pairs;
    for (std::size_t i = 0; i < f.landmarks.size(); ++i)
      for (std::size_t j = 0; j < f.landmarks.size(); ++j) {
        const bool once = point_block(f, j) <= point_block(f, i);
        if (once && (i == j || !information(f, i, j).isZero(0.0))) pairs.emplace_back(i, j);
      }
    return pairs;
  }

  int point_block(const BatchFactor<G>& f, std::size_t i) const { return nodes_ + f.landmarks[i]->point; }
  static auto information(const BatchFactor<G>& f, std::size_t i, std::size_t j) {
    return f.information.template block<G::Dim, G::Dim>(G::Dim * static_cast<Eigen::Index>(i),
                                                        G::Dim * static_cast<Eigen::Index>(j));
  }

  template <class Block>
  void add(const Block& block) {
    solver_.add(*slot_++, block);
  }

  double prior(std::size_t k, const std::vector<G>& poses) {  // F0
    const PriorFactor<G>& f = problem_.priors[k];
    const Dof& W = prior_information_[k];
    const auto [r, J] = PriorResidual<G>(f, poses[static_cast<std::size_t>(f.node)]);
    add(Dof(J.transpose() * W * J));
    gradient_.segment<G::Dof>(node_row(f.node)) -= J.transpose() * W * r;
    return r.dot(W * r);
  }

  double drift(std::size_t k, const std::vector<G>& poses) {  // F1
    const DriftFactor<G>& f = problem_.drifts[k];
    const Dof& W = drift_information_[k];
    const auto [r, J_b, J_a] =
        DriftResidual<G>(f, poses[static_cast<std::size_t>(f.a)], poses[static_cast<std::size_t>(f.b)]);
    add(Dof(J_a.transpose() * W * J_a));
    add(Dof(J_b.transpose() * W * J_a));
    add(Dof(J_b.transpose() * W * J_b));
    gradient_.segment<G::Dof>(node_row(f.a)) -= J_a.transpose() * W * r;
    gradient_.segment<G::Dof>(node_row(f.b)) -= J_b.transpose() * W * r;
    return r.dot(W * r);
  }

  double absolute_fix(std::size_t k, const std::vector<G>& poses) {  // F3
    const AbsoluteFixFactor<G>& f = problem_.fixes[k];
    const typename G::PointCovariance& W = fix_information_[k];
    const G D = f.datum < 0 ? G() : poses[static_cast<std::size_t>(f.datum)];
    const AbsoluteFixResidual<G> one(f, poses[static_cast<std::size_t>(f.node)], D);
    add(Dof(one.J_T.transpose() * W * one.J_T));
    gradient_.segment<G::Dof>(node_row(f.node)) -= one.J_T.transpose() * W * one.r;
    if (f.datum >= 0) {
      add(Dof(one.J_D.transpose() * W * one.J_T));
      add(Dof(one.J_D.transpose() * W * one.J_D));
      gradient_.segment<G::Dof>(node_row(f.datum)) -= one.J_D.transpose() * W * one.r;
    }
    return one.r.dot(W * one.r);
  }

  double landmarks(std::size_t k, const std::vector<G>& poses, const std::vector<typename G::Point>& points) {  // F2
    const BatchFactor<G>& f = batches_[k];
    const auto n = static_cast<Eigen::Index>(f.landmarks.size());
    const G& T = poses[static_cast<std::size_t>(f.node)];
    const typename G::PointCovariance J_m = T.rotation().transpose();
    Eigen::VectorXd r(G::Dim * n);
    Eigen::Matrix<double, Eigen::Dynamic, G::Dof> J_T(G::Dim * n, G::Dof);
    for (Eigen::Index i = 0; i < n; ++i) {
      const LandmarkFactor<G>& l = *f.landmarks[static_cast<std::size_t>(i)];
      const LandmarkResidual<G> one(l, T, points[static_cast<std::size_t>(l.point)]);
      r.template segment<G::Dim>(G::Dim * i) = one.r;
      J_T.template middleRows<G::Dim>(G::Dim * i) = one.J_T;
    }
    const Eigen::VectorXd Wr = f.information.lazyProduct(r);  // too small for Eigen's packed kernels
    const Eigen::Matrix<double, Eigen::Dynamic, G::Dof> WJ = f.information.lazyProduct(J_T);
    add(Dof(J_T.transpose().lazyProduct(WJ)));
    gradient_.segment<G::Dof>(node_row(f.node)) -= J_T.transpose() * Wr;
    for (std::size_t i = 0; i < f.landmarks.size(); ++i) {
      const Eigen::Index row = G::Dim * static_cast<Eigen::Index>(i);
      add(typename G::PointJacobian(J_m.transpose() * WJ.template middleRows<G::Dim>(row)));
      gradient_.segment<G::Dim>(point_row(f.landmarks[i]->point)) -= J_m.transpose() * Wr.template segment<G::Dim>(row);
    }
    for (const auto& [i, j] : shared_[k])
      add(typename G::PointCovariance(J_m.transpose() * information(f, i, j) * J_m));
    return r.dot(Wr);
  }

  const Problem<G>& problem_;
  int nodes_;
  std::vector<BatchFactor<G>> batches_;
  std::vector<std::vector<Pair>> shared_;  // of each batch
  std::vector<Dof> prior_information_, drift_information_;
  std::vector<typename G::PointCovariance> fix_information_;
  BlockCholesky solver_;
  std::vector<BlockCholesky::Slot> slots_;
  const BlockCholesky::Slot* slot_ = nullptr;  // of the next add()
  Eigen::VectorXd gradient_;
};

}  // namespace

template <class G>
std::unique_ptr<Map<G>> SparseMap<G>::solve(Problem<G> problem) const {
  NormalEquations<G> equations(problem);
  BlockCholesky& solver = equations.solver();
  std::vector<G> poses;
  for (const Node<G>& node : problem.nodes) poses.push_back(node.initial);
  std::vector<typename G::Point> points = problem.points;
  std::vector<G> moved = poses;
  std::vector<typename G::Point> moved_points = points;
  Eigen::VectorXd step;
  SolveReport report;
  double chi2 = equations.linearise(poses, points), damping = 0.0;
  const auto damp_more = [&] { damping = damping == 0.0 ? 1e-4 : 10.0 * damping; };
  while (solver.size() > 0 && report.iterations < params_.max_iterations && damping < 1e12) {
    ++report.iterations;
    if (!solver.factor(damping).ok()) {
      damp_more();
      continue;
    }
    step = equations.gradient();
    solver.solve(step);
    const bool small = step.dot(equations.gradient()) < params_.convergence;
    for (std::size_t n = 0; n < moved.size(); ++n)
      moved[n] = poses[n] * G::Exp(step.segment<G::Dof>(equations.node_row(static_cast<int>(n))));
    for (std::size_t p = 0; p < moved_points.size(); ++p)
      moved_points[p] = points[p] + step.segment<G::Dim>(equations.point_row(static_cast<int>(p)));
    const double moved_chi2 = equations.linearise(moved, moved_points);
    if (!(moved_chi2 <= chi2 + 1e-9 * (1.0 + chi2))) {  // uphill: back
      damp_more();
      equations.linearise(poses, points);
      continue;
    }
    poses.swap(moved);
    points.swap(moved_points);
    chi2 = moved_chi2;
    damping = damping < 1e-8 ? 0.0 : 0.1 * damping;
    if (small && damping == 0.0) {
      report.converged = true;
      break;
    }
  }
  // For the covariances. What is singular but for rounding is damped by as little as it takes.
  for (damping = 0.0; solver.size() > 0 && !solver.factor(damping).ok() && damping < 1.0;)
    damping = std::max(10.0 * damping, 1e-14);
  report.chi2 = chi2;
  report.dof = equations.residuals() - solver.size();
  auto covariances = std::make_unique<SparseCovariance<G>>(std::move(solver), static_cast<int>(problem.nodes.size()));
  return std::make_unique<Map<G>>(std::move(problem), std::move(poses), std::move(points), report,
                                  std::move(covariances));
}

#define CONVOY_INSTANTIATE(G) template class SparseMap<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
