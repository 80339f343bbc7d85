#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/incremental_map.hpp>
#include <convoy/map/linear_factors.hpp>
#include <convoy/map/sparse_map.hpp>
#include <convoy/solver/block_cholesky.hpp>

#include <algorithm>
#include <map>
#include <type_traits>
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

// The normal equations of a problem at an estimate, in a pattern that is analysed once.
template <class G>
class NormalEquations {
 public:
  explicit NormalEquations(const Problem<G>& problem) : problem_(problem), factors_(problem) {
    BlockPattern pattern(unknown_sizes(problem));
    for (int k = 0; k < factors_.size(); ++k) {
      information_.push_back(factors_.information(k));
      each_pair(k, [&](int i, int j) { pattern.add(i, j); });
    }
    solver_ = BlockCholesky(pattern);
    solver_.set_pivot_tolerance(0.0);  // known to 0.1 mm beside known to 1 km is no rounding
    for (int k = 0; k < factors_.size(); ++k) each_pair(k, [&](int i, int j) { slots_.push_back(solver_.slot(i, j)); });
    gradient_.setZero(solver_.size());
  }

  BlockCholesky& solver() { return solver_; }
  const Eigen::VectorXd& gradient() const { return gradient_; }
  int residuals() const { return factors_.residuals(); }

  /// H = J^T W J and g = -J^T W r; returns r^T W r, summed over all factors.
  double linearise(const State<G>& at) {
    solver_.set_zero();
    gradient_.setZero();
    const BlockCholesky::Slot* slot = slots_.data();
    double chi2 = 0.0;
    for (int k = 0; k < factors_.size(); ++k) {
      chi2 += factors_.linearise(k, information_[static_cast<std::size_t>(k)], at, &term_);
      Eigen::Index row = 0;
      for (const int i : factors_.unknowns(k)) {
        const Eigen::Index rows = solver_.block_size(i);
        gradient_.segment(solver_.offset(i), rows) += term_.b.segment(row, rows);
        Eigen::Index column = 0;
        for (const int j : factors_.unknowns(k)) {
          if (column > row) break;
          const Eigen::Index columns = solver_.block_size(j);
          solver_.add(*slot++, term_.H.block(row, column, rows, columns));
          column += columns;
        }
        row += rows;
      }
    }
    return chi2;
  }

  void move(const State<G>& from, const Eigen::VectorXd& step, State<G>& to) const {
    const auto of = [&]<int Size>(std::integral_constant<int, Size>, int unknown) {
      return step.segment<Size>(solver_.offset(unknown));
    };
    for (std::size_t n = 0; n < to.poses.size(); ++n)
      to.poses[n] = from.poses[n] * G::Exp(of(std::integral_constant<int, G::Dof>(), static_cast<int>(n)));
    for (std::size_t p = 0; p < to.points.size(); ++p)
      to.points[p] =
          from.points[p] + of(std::integral_constant<int, G::Dim>(), problem_.unknown_of_point(static_cast<int>(p)));
    for (std::size_t k = 0; k < to.constants.size(); ++k)
      to.constants[k] = from.constants[k] + of(std::integral_constant<int, Constants<G>::RowsAtCompileTime>(),
                                               problem_.unknown_of_constants(static_cast<int>(k)));
  }

 private:
  // Every block that factor k adds to, in the order of linearise().
  template <class Visit>
  void each_pair(int k, const Visit& visit) const {
    const std::span<const int> unknowns = factors_.unknowns(k);
    for (std::size_t i = 0; i < unknowns.size(); ++i)
      for (std::size_t j = 0; j <= i; ++j) visit(unknowns[i], unknowns[j]);
  }

  const Problem<G>& problem_;
  LinearFactors<G> factors_;
  std::vector<Eigen::MatrixXd> information_;
  BlockCholesky solver_;
  std::vector<BlockCholesky::Slot> slots_;
  LinearTerm term_;
  Eigen::VectorXd gradient_;
};

}  // namespace

template <class G>
std::unique_ptr<Map<G>> SparseMap<G>::solve(Problem<G> stated) const {
  const auto problem = std::make_shared<const Problem<G>>(std::move(stated));
  NormalEquations<G> equations(*problem);
  BlockCholesky& solver = equations.solver();
  State<G> at = start_of(*problem), moved = at;
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
  return std::make_unique<Map<G>>(problem, std::move(at), report, std::move(covariances));
}

template <class G>
std::shared_ptr<IncrementalMap<G>> SparseMap<G>::incremental() const {
  return std::make_shared<IncrementalMap<G>>();
}

#define CONVOY_INSTANTIATE(G) template class SparseMap<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
