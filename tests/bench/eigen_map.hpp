// What SparseMap is measured against: the same iterations, with Eigen's SimplicialLDLT on scalars.
#pragma once

#include <convoy/map/factors.hpp>
#include <convoy/map/map.hpp>
#include <convoy/map/sparse_map.hpp>

#include <Eigen/Sparse>
#include <Eigen/SparseCholesky>
#include <vector>

namespace convoy::bench {

using ScalarMatrix = Eigen::SparseMatrix<double>;

// The normal equations of a problem at an estimate.
template <class G>
class ScalarEquations {
 public:
  explicit ScalarEquations(const Problem<G>& problem)
      : problem_(problem),
        nodes_(static_cast<int>(problem.nodes.size())),
        size_(G::Dof * nodes_ + G::Dim * static_cast<Eigen::Index>(problem.points.size())) {
    for (const auto& f : problem.priors) prior_information_.push_back(f.covariance.inverse());
    for (const auto& f : problem.drifts) drift_information_.push_back(f.covariance.inverse());
    batches_ = batch_factors(problem);
  }

  Eigen::Index size() const { return size_; }

  /// r^T W r summed over all factors; with `assemble`, H = J^T W J (lower triangle) and g = -J^T W r too.
  double linearise(const std::vector<G>& poses, const std::vector<typename G::Point>& points, bool assemble) {
    if (assemble) {
      triplets_.clear();
      gradient_ = Eigen::VectorXd::Zero(size_);
    }
    double chi2 = 0.0;
    for (std::size_t k = 0; k < problem_.priors.size(); ++k) chi2 += prior(k, poses, assemble);
    for (std::size_t k = 0; k < problem_.drifts.size(); ++k) chi2 += drift(k, poses, assemble);
    for (const BatchFactor<G>& batch : batches_) chi2 += landmarks(batch, poses, points, assemble);
    return chi2;
  }

  ScalarMatrix hessian() const {
    ScalarMatrix H(size_, size_);
    H.setFromTriplets(triplets_.begin(), triplets_.end());
    return H;
  }
  const Eigen::VectorXd& gradient() const { return gradient_; }

  int residuals() const {
    return G::Dof * static_cast<int>(problem_.priors.size() + problem_.drifts.size()) +
           G::Dim * static_cast<int>(problem_.landmarks.size());
  }

 private:
  using Dof = typename G::Covariance;

  Eigen::Index node(int n) const { return G::Dof * n; }
  Eigen::Index point(int p) const { return G::Dof * nodes_ + G::Dim * p; }

  template <class Block>
  void add_block(Eigen::Index row, Eigen::Index col, const Block& block) {
    for (Eigen::Index c = 0; c < block.cols(); ++c)
      for (Eigen::Index r = 0; r < block.rows(); ++r)
        if (row + r >= col + c) triplets_.emplace_back(row + r, col + c, block(r, c));
  }

  double prior(std::size_t k, const std::vector<G>& poses, bool assemble) {  // F0
    const PriorFactor<G>& f = problem_.priors[k];
    const Dof& W = prior_information_[k];
    const auto [r, J] = PriorResidual<G>(f, poses[static_cast<std::size_t>(f.node)]);
    if (assemble) {
      add_block(node(f.node), node(f.node), Dof(J.transpose() * W * J));
      gradient_.segment<G::Dof>(node(f.node)) -= J.transpose() * W * r;
    }
    return r.dot(W * r);
  }

  double drift(std::size_t k, const std::vector<G>& poses, bool assemble) {  // F1
    const DriftFactor<G>& f = problem_.drifts[k];
    const Dof& W = drift_information_[k];
    const auto [r, J_b, J_a, J_c] =
        DriftResidual<G>(f, poses[static_cast<std::size_t>(f.a)], poses[static_cast<std::size_t>(f.b)]);
    if (assemble) {
      add_block(node(f.a), node(f.a), Dof(J_a.transpose() * W * J_a));
      add_block(node(f.b), node(f.a), Dof(J_b.transpose() * W * J_a));
      add_block(node(f.b), node(f.b), Dof(J_b.transpose() * W * J_b));
      gradient_.segment<G::Dof>(node(f.a)) -= J_a.transpose() * W * r;
      gradient_.segment<G::Dof>(node(f.b)) -= J_b.transpose() * W * r;
    }
    return r.dot(W * r);
  }

  double landmarks(const BatchFactor<G>& f, const std::vector<G>& poses, const std::vector<typename G::Point>& points,
                   bool assemble) {  // F2
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
    const Eigen::VectorXd Wr = f.information * r;
    if (!assemble) return r.dot(Wr);
    const Eigen::Matrix<double, Eigen::Dynamic, G::Dof> WJ = f.information * J_T;
    add_block(node(f.node), node(f.node), Dof(J_T.transpose() * WJ));
    gradient_.segment<G::Dof>(node(f.node)) -= J_T.transpose() * Wr;
    const auto point_of = [&](Eigen::Index i) { return point(f.landmarks[static_cast<std::size_t>(i)]->point); };
    for (Eigen::Index i = 0; i < n; ++i) {
      add_block(point_of(i), node(f.node),
                typename G::PointJacobian(J_m.transpose() * WJ.template middleRows<G::Dim>(G::Dim * i)));
      gradient_.segment<G::Dim>(point_of(i)) -= J_m.transpose() * Wr.template segment<G::Dim>(G::Dim * i);
      for (Eigen::Index j = 0; j < n; ++j) {
        if (point_of(j) > point_of(i)) continue;  // upper triangle
        const typename G::PointCovariance W = f.information.template block<G::Dim, G::Dim>(G::Dim * i, G::Dim * j);
        if (i != j && W.isZero(0.0)) continue;  // nothing shared
        add_block(point_of(i), point_of(j), typename G::PointCovariance(J_m.transpose() * W * J_m));
      }
    }
    return r.dot(Wr);
  }

  const Problem<G>& problem_;
  int nodes_;
  Eigen::Index size_;
  std::vector<Dof> prior_information_, drift_information_;
  std::vector<BatchFactor<G>> batches_;
  std::vector<Eigen::Triplet<double>> triplets_;
  Eigen::VectorXd gradient_;
};

template <class G>
SolveReport solve_with_eigen(const Problem<G>& problem, const SparseMapParams& params = {}) {
  ScalarEquations<G> equations(problem);
  std::vector<G> poses;
  for (const Node<G>& node : problem.nodes) poses.push_back(node.initial);
  std::vector<typename G::Point> points = problem.points;
  Eigen::SimplicialLDLT<ScalarMatrix, Eigen::Lower, Eigen::AMDOrdering<int>> factor;
  SolveReport report;
  double chi2 = equations.linearise(poses, points, true), damping = 0.0;
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
    std::vector<G> moved = poses;
    std::vector<typename G::Point> moved_points = points;
    for (std::size_t n = 0; n < moved.size(); ++n)
      moved[n] = moved[n] * G::Exp(step.segment<G::Dof>(G::Dof * static_cast<Eigen::Index>(n)));
    const Eigen::Index offset = G::Dof * static_cast<Eigen::Index>(moved.size());
    for (std::size_t p = 0; p < moved_points.size(); ++p)
      moved_points[p] += step.segment<G::Dim>(offset + G::Dim * static_cast<Eigen::Index>(p));
    const double moved_chi2 = equations.linearise(moved, moved_points, false);
    const bool converged = length < params.convergence;
    if (factor.info() != Eigen::Success || !(moved_chi2 <= chi2 + 1e-9 * (1.0 + chi2))) {  // uphill: damp more
      damping = damping == 0.0 ? 1e-4 : 10.0 * damping;
      if (damping > 1e12) break;
      continue;
    }
    poses = std::move(moved);
    points = std::move(moved_points);
    damping = damping < 1e-8 ? 0.0 : 0.1 * damping;
    chi2 = equations.linearise(poses, points, true);
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
