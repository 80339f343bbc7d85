// What SparseMap is measured against: the same iterations, with Eigen's SimplicialLDLT on scalars.
#pragma once

#include <convoy/map/linear_factors.hpp>
#include <convoy/map/map.hpp>
#include <convoy/map/sparse_map.hpp>

#include <Eigen/Cholesky>
#include <Eigen/Sparse>
#include <Eigen/SparseCholesky>
#include <vector>

namespace convoy::bench {

using ScalarMatrix = Eigen::SparseMatrix<double>;

// The normal equations of a problem at an estimate.
template <class G>
class ScalarEquations {
 public:
  explicit ScalarEquations(const Problem<G>& problem) : factors_(problem), sizes_(unknown_sizes(problem)) {
    for (int k = 0; k < factors_.size(); ++k) information_.push_back(factors_.information(k));
    offsets_.push_back(0);
    for (const int size : sizes_) offsets_.push_back(offsets_.back() + size);
  }

  Eigen::Index size() const { return offsets_.back(); }
  int residuals() const { return factors_.residuals(); }
  const Eigen::VectorXd& gradient() const { return gradient_; }

  /// r^T W r summed over all factors; with `assemble`, H = J^T W J (lower triangle) and g = -J^T W r too.
  double linearise(const State<G>& state, bool assemble) {
    if (assemble) {
      triplets_.clear();
      gradient_ = Eigen::VectorXd::Zero(size());
    }
    double chi2 = 0.0;
    for (int k = 0; k < factors_.size(); ++k) {
      chi2 += factors_.linearise(k, information_[static_cast<std::size_t>(k)], state, assemble ? &term_ : nullptr);
      if (assemble) add_term(factors_.unknowns(k));
    }
    return chi2;
  }

  ScalarMatrix hessian() const {
    ScalarMatrix H(size(), size());
    H.setFromTriplets(triplets_.begin(), triplets_.end());
    return H;
  }

 private:
  void add_term(std::span<const int> unknowns) {
    rows_.clear();
    for (const int u : unknowns)
      for (int d = 0; d < sizes_[static_cast<std::size_t>(u)]; ++d)
        rows_.push_back(offsets_[static_cast<std::size_t>(u)] + d);
    for (Eigen::Index i = 0; i < term_.b.size(); ++i) {
      const Eigen::Index row = rows_[static_cast<std::size_t>(i)];
      gradient_[row] += term_.b[i];
      for (Eigen::Index j = 0; j < term_.b.size(); ++j)
        if (const Eigen::Index column = rows_[static_cast<std::size_t>(j)]; row >= column)
          triplets_.emplace_back(row, column, term_.H(i, j));
    }
  }

  LinearFactors<G> factors_;
  std::vector<int> sizes_;
  std::vector<Eigen::Index> offsets_, rows_;
  std::vector<Eigen::MatrixXd> information_;
  std::vector<Eigen::Triplet<double>> triplets_;
  LinearTerm term_;
  Eigen::VectorXd gradient_;
};

template <class G>
SolveReport solve_with_eigen(const Problem<G>& problem, const SparseMapParams& params = {}) {
  ScalarEquations<G> equations(problem);
  State<G> at = start_of(problem);
  Eigen::SimplicialLDLT<ScalarMatrix, Eigen::Lower, Eigen::AMDOrdering<int>> factor;
  SolveReport report;
  double chi2 = equations.linearise(at, true), damping = 0.0;
  bool ordered = false;
  while (equations.size() > 0 && report.iterations < params.max_iterations) {
    ++report.iterations;
    ScalarMatrix H = equations.hessian();
    if (!ordered) factor.analyzePattern(H);
    ordered = true;
    if (damping > 0.0)
      for (Eigen::Index i = 0; i < H.rows(); ++i) H.coeffRef(i, i) *= 1.0 + damping;
    factor.factorize(H);
    const Eigen::VectorXd step = factor.solve(equations.gradient());
    const double length = step.dot(equations.gradient());
    State<G> moved = at;
    for (std::size_t n = 0; n < moved.poses.size(); ++n)
      moved.poses[n] = moved.poses[n] * G::Exp(step.segment<G::Dof>(G::Dof * static_cast<Eigen::Index>(n)));
    const Eigen::Index offset = G::Dof * static_cast<Eigen::Index>(moved.poses.size());
    for (std::size_t p = 0; p < moved.points.size(); ++p)
      moved.points[p] += step.segment<G::Dim>(offset + G::Dim * static_cast<Eigen::Index>(p));
    const double moved_chi2 = equations.linearise(moved, false);
    const bool converged = length < params.convergence;
    if (factor.info() != Eigen::Success || !(moved_chi2 <= chi2 + 1e-9 * (1.0 + chi2))) {  // uphill: damp more
      damping = damping == 0.0 ? 1e-4 : 10.0 * damping;
      if (damping > 1e12) break;
      continue;
    }
    at = std::move(moved);
    damping = damping < 1e-8 ? 0.0 : 0.1 * damping;
    chi2 = equations.linearise(at, true);
    if (converged && damping == 0.0) {
      report.converged = true;
      break;
    }
  }
  if (equations.size() > 0) factor.factorize(equations.hessian());
  report.chi2 = chi2;
  report.dof = equations.residuals() - static_cast<int>(equations.size());
  return report;
}

}  // namespace convoy::bench
