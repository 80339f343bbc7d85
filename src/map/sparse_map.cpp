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
  explicit SparseCovariance(BlockCholesky solver) : solver_(std::move(solver)) {}

  Eigen::MatrixXd between(int a, int b) override {
    if (solver_.in_pattern(a, b)) {
      const Eigen::MatrixXd P = solver_.in_slot(selected(), a, b);
      return a == b ? symmetrised(P) : P;
    }
    auto [it, fresh] = elsewhere_.try_emplace(std::minmax(a, b));
    if (fresh) it->second = solver_.covariance(std::min(a, b), std::max(a, b));
    return a < b ? it->second : Eigen::MatrixXd(it->second.transpose());
  }

  Eigen::MatrixXd joint(const std::vector<int>& unknowns) override { return solver_.joint_covariance(unknowns); }

 private:
  const std::vector<double>& selected() {
    if (selected_.empty()) selected_ = solver_.selected_inverse();
    return selected_;
  }

  BlockCholesky solver_;
  std::vector<double> selected_;
  std::map<std::pair<int, int>, Eigen::MatrixXd> elsewhere_;
};

// An estimate of every unknown.
template <class G>
struct State {
  std::vector<G> poses;
  std::vector<typename G::Point> points;
  std::vector<Constants<G>> constants;
  const G& pose(int n) const { return poses[static_cast<std::size_t>(n)]; }
  Constants<G> constants_of(int k) const { return k < 0 ? Constants<G>::Zero() : constants[static_cast<std::size_t>(k)]; }
};

// The normal equations of a problem at an estimate: blocks of nodes, then of points, then of constants, each where the
// pattern, which is analysed once, has it.
template <class G>
class NormalEquations {
 public:
  explicit NormalEquations(const Problem<G>& problem)
      : problem_(problem), batches_(batch_factors(problem)) {
    for (const auto& f : problem.priors) prior_information_.push_back(f.covariance.inverse());
    for (const auto& f : problem.drifts) drift_information_.push_back(f.covariance.inverse());
    for (const auto& f : problem.fixes) fix_information_.push_back(f.covariance.inverse());
    for (const auto& f : problem.encounters) encounter_information_.push_back(f.covariance.inverse());
    for (const BatchFactor<G>& f : batches_) shared_.push_back(shared_errors(f));
    std::vector<int> sizes(problem.nodes.size(), G::Dof);
    sizes.resize(sizes.size() + problem.points.size(), G::Dim);
    sizes.resize(sizes.size() + problem.constants.size(), Constants<G>::RowsAtCompileTime);
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
  int point_row(int p) const { return solver_.offset(problem_.unknown_of_point(p)); }
  int constants_row(int k) const { return solver_.offset(problem_.unknown_of_constants(k)); }

  /// H = J^T W J and g = -J^T W r; returns r^T W r, summed over all factors.
  double linearise(const State<G>& at) {
    solver_.set_zero();
    gradient_.setZero();
    slot_ = slots_.data();
    double chi2 = 0.0;
    for (std::size_t k = 0; k < problem_.priors.size(); ++k) chi2 += prior(k, at.poses);
    for (std::size_t k = 0; k < problem_.constants.size(); ++k) chi2 += constants(k, at);
    for (std::size_t k = 0; k < problem_.drifts.size(); ++k) chi2 += drift(k, at);
    for (std::size_t k = 0; k < problem_.bounded.size(); ++k) chi2 += bounded(k, at);
    for (std::size_t k = 0; k < problem_.fixes.size(); ++k) chi2 += absolute_fix(k, at.poses);
    for (std::size_t k = 0; k < problem_.encounters.size(); ++k) chi2 += encounter(k, at.poses);
    for (std::size_t k = 0; k < batches_.size(); ++k) chi2 += landmarks(k, at.poses, at.points);
    return chi2;
  }

  void move(const State<G>& from, const Eigen::VectorXd& step, State<G>& to) const {
    for (std::size_t n = 0; n < to.poses.size(); ++n)
      to.poses[n] = from.poses[n] * G::Exp(step.segment<G::Dof>(node_row(static_cast<int>(n))));
    for (std::size_t p = 0; p < to.points.size(); ++p)
      to.points[p] = from.points[p] + step.segment<G::Dim>(point_row(static_cast<int>(p)));
    for (std::size_t k = 0; k < to.constants.size(); ++k)
      to.constants[k] =
          from.constants[k] + step.segment<Constants<G>::RowsAtCompileTime>(constants_row(static_cast<int>(k)));
  }

  int residuals() const {
    // F6 stands for what F1 no longer says.
    return G::Dof * static_cast<int>(problem_.priors.size() + problem_.drifts.size()) +
           G::Dim * static_cast<int>(problem_.landmarks.size() + problem_.fixes.size() + problem_.encounters.size()) +
           Constants<G>::RowsAtCompileTime * static_cast<int>(problem_.constants.size());
  }

 private:
  using Dof = typename G::Covariance;
  template <class Vector>
  using Square = Eigen::Matrix<double, Vector::RowsAtCompileTime, Vector::RowsAtCompileTime>;

  // Every block that linearise() adds to, in its order.
  template <class Visit>
  void each_pair(const Visit& visit) const {
    for (const auto& f : problem_.priors) visit(f.node, f.node);
    for (std::size_t k = 0; k < problem_.constants.size(); ++k) visit(constants_block(k), constants_block(k));
    for (const auto& f : problem_.drifts) {
      visit(f.a, f.a);
      visit(f.b, f.a);
      visit(f.b, f.b);
      if (f.constants >= 0) each_of_constants(f.a, f.b, f.constants, visit);
    }
    for (const auto& f : problem_.bounded) {
      if (f.a >= 0) {
        visit(f.a, f.a);
        visit(f.b, f.a);
      }
      visit(f.b, f.b);
      each_of_constants(f.a, f.b, f.constants, visit);
    }
    for (const auto& f : problem_.fixes) {
      visit(f.node, f.node);
      if (f.datum < 0) continue;
      visit(f.datum, f.node);
      visit(f.datum, f.datum);
    }
    for (const auto& f : problem_.encounters) {
      visit(f.observer, f.observer);
      visit(f.other, f.observer);
      visit(f.other, f.other);
    }
    for (std::size_t k = 0; k < batches_.size(); ++k) {
      const BatchFactor<G>& f = batches_[k];
      visit(f.node, f.node);
      for (std::size_t i = 0; i < f.landmarks.size(); ++i) visit(point_block(f, i), f.node);
      for (const auto& [i, j] : shared_[k]) visit(point_block(f, i), point_block(f, j));
    }
  }

  template <class Visit>
  void each_of_constants(int a, int b, int constants, const Visit& visit) const {
    const int c = constants_block(static_cast<std::size_t>(constants));
    if (a >= 0) visit(c, a);
    visit(c, b);
    visit(c, c);
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

  int point_block(const BatchFactor<G>& f, std::size_t i) const { return problem_.unknown_of_point(f.landmarks[i]->point); }
  int constants_block(std::size_t k) const { return problem_.unknown_of_constants(static_cast<int>(k)); }
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

  double constants(std::size_t k, const State<G>& at) {  // F5
    const ConstantsFactor<G>& f = problem_.constants[k];
    const Constants<G> W = f.sigma.cwiseAbs2().cwiseInverse(), r = at.constants[k] - f.mean;
    add(Square<Constants<G>>(W.asDiagonal()));
    gradient_.segment<Constants<G>::RowsAtCompileTime>(constants_row(static_cast<int>(k))) -= W.cwiseProduct(r);
    return r.dot(W.cwiseProduct(r));
  }

  double drift(std::size_t k, const State<G>& at) {  // F1
    const DriftFactor<G>& f = problem_.drifts[k];
    const Dof& W = drift_information_[k];
    const auto [r, J_b, J_a, J_c] = DriftResidual<G>(f, at.pose(f.a), at.pose(f.b), at.constants_of(f.constants));
    const typename G::Tangent Wr = W * r;
    add(Dof(J_a.transpose() * W * J_a));
    add(Dof(J_b.transpose() * W * J_a));
    add(Dof(J_b.transpose() * W * J_b));
    gradient_.segment<G::Dof>(node_row(f.a)) -= J_a.transpose() * Wr;
    gradient_.segment<G::Dof>(node_row(f.b)) -= J_b.transpose() * Wr;
    if (f.constants >= 0) {
      add((J_c.transpose() * W * J_a).eval());
      add((J_c.transpose() * W * J_b).eval());
      add((J_c.transpose() * W * J_c).eval());
      gradient_.segment<Constants<G>::RowsAtCompileTime>(constants_row(f.constants)) -= J_c.transpose() * Wr;
    }
    return r.dot(Wr);
  }

  double bounded(std::size_t k, const State<G>& at) {  // F6
    if constexpr (G::Dim == 3) {
      const BoundedFactor& f = problem_.bounded[k];
      const auto W = f.information.asDiagonal();
      const BoundedResidual one(f, f.a < 0 ? nullptr : &at.pose(f.a), at.pose(f.b), at.constants_of(f.constants)[2]);
      const Eigen::Vector3d Wr = W * one.r;
      Eigen::Matrix3d J_c = Eigen::Matrix3d::Zero();
      J_c.col(2) = one.J_c;
      if (f.a >= 0) {
        add(Dof(one.J_a.transpose() * W * one.J_a));
        add(Dof(one.J_b.transpose() * W * one.J_a));
        gradient_.segment<6>(node_row(f.a)) -= one.J_a.transpose() * Wr;
      }
      add(Dof(one.J_b.transpose() * W * one.J_b));
      gradient_.segment<6>(node_row(f.b)) -= one.J_b.transpose() * Wr;
      if (f.a >= 0) add((J_c.transpose() * W * one.J_a).eval());
      add((J_c.transpose() * W * one.J_b).eval());
      add((J_c.transpose() * W * J_c).eval());
      gradient_.segment<3>(constants_row(f.constants)) -= J_c.transpose() * Wr;
      return one.r.dot(Wr);
    } else {
      (void)at;
      return 0.0 * static_cast<double>(k);
    }
  }

  double encounter(std::size_t k, const std::vector<G>& poses) {  // F4
    const EncounterFactor<G>& f = problem_.encounters[k];
    const typename G::PointCovariance& W = encounter_information_[k];
    const EncounterResidual<G> one(f, poses[static_cast<std::size_t>(f.observer)], poses[static_cast<std::size_t>(f.other)]);
    add(Dof(one.J_o.transpose() * W * one.J_o));
    add(Dof(one.J_w.transpose() * W * one.J_o));
    add(Dof(one.J_w.transpose() * W * one.J_w));
    gradient_.segment<G::Dof>(node_row(f.observer)) -= one.J_o.transpose() * W * one.r;
    gradient_.segment<G::Dof>(node_row(f.other)) -= one.J_w.transpose() * W * one.r;
    return one.r.dot(W * one.r);
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
  std::vector<BatchFactor<G>> batches_;
  std::vector<std::vector<Pair>> shared_;  // of each batch
  std::vector<Dof> prior_information_, drift_information_;
  std::vector<typename G::PointCovariance> fix_information_, encounter_information_;
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
  State<G> at;
  for (const Node<G>& node : problem.nodes) at.poses.push_back(node.initial);
  at.points = problem.points;
  for (const ConstantsFactor<G>& f : problem.constants) at.constants.push_back(f.mean);
  State<G> moved = at;
  Eigen::VectorXd step;
  SolveReport report;
  double chi2 = equations.linearise(at), damping = 0.0;
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
    equations.move(at, step, moved);
    const double moved_chi2 = equations.linearise(moved);
    if (!(moved_chi2 <= chi2 + 1e-9 * (1.0 + chi2))) {  // uphill: back
      damp_more();
      equations.linearise(at);
      continue;
    }
    std::swap(at, moved);
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
  auto covariances = std::make_unique<SparseCovariance<G>>(std::move(solver));
  return std::make_unique<Map<G>>(std::move(problem), std::move(at.poses), std::move(at.points), std::move(at.constants),
                                  report, std::move(covariances));
}

#define CONVOY_INSTANTIATE(G) template class SparseMap<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
