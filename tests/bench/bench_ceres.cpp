// A baseline: Ceres on the public pose graphs of bench_solver, with the same residual and derivatives by hand, one
// thread. The quickest of its trust regions and of the sparse libraries it was built with stands for it. Built where
// Ceres is.
#include <ceres/ceres.h>
#include <ceres/version.h>

#include <array>
#include <cmath>
#include <limits>
#include <optional>

#include "blas.hpp"
#include "public_graphs.hpp"
#include "ratio.hpp"

namespace {

using namespace convoy;
using Pose = std::array<double, 3>;  // x [m], y [m], angle [rad]

/// PoseResidual::g2o, whitened.
class WhitenedError : public ceres::SizedCostFunction<3, 3, 3> {
 public:
  explicit WhitenedError(const PoseFactor<SE2>& factor)
      : measured_(factor.measured), whitening_(factor.information.llt().matrixU()) {}

  bool Evaluate(const double* const* poses, double* residuals, double** jacobians) const override {
    const Eigen::Map<const Eigen::Vector3d> from(poses[0]), to(poses[1]);
    const Eigen::Rotation2Dd to_from(-from.z());
    const Eigen::Vector2d offset = to_from * (to.head<2>() - from.head<2>());
    const Eigen::Matrix2d to_measured = measured_.rotation().transpose();
    Eigen::Vector3d error;
    error << to_measured * (offset - measured_.translation()),
        std::remainder(to.z() - from.z() - measured_.theta(), 2.0 * M_PI);
    Eigen::Map<Eigen::Vector3d>(residuals).noalias() = whitening_ * error;
    if (!jacobians) return true;

    Eigen::Matrix3d J_to = Eigen::Matrix3d::Identity();
    J_to.topLeftCorner<2, 2>() = to_measured * to_from.toRotationMatrix();
    Eigen::Matrix3d J_from = -J_to;
    J_from.topRightCorner<2, 1>() = to_measured * Eigen::Vector2d(offset.y(), -offset.x());
    using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    if (jacobians[0]) Eigen::Map<RowMajor>(jacobians[0]).noalias() = whitening_ * J_from;
    if (jacobians[1]) Eigen::Map<RowMajor>(jacobians[1]).noalias() = whitening_ * J_to;
    return true;
  }

 private:
  SE2 measured_;
  Eigen::Matrix3d whitening_;
};

struct Way {
  ceres::TrustRegionStrategyType region = ceres::LEVENBERG_MARQUARDT;
  ceres::SparseLinearAlgebraLibraryType library = ceres::EIGEN_SPARSE;
};

std::string name_of(const Way& way) {
  return std::string(ceres::TrustRegionStrategyTypeToString(way.region)) + ", " +
         ceres::SparseLinearAlgebraLibraryTypeToString(way.library);
}

std::vector<Way> available_ways() {
  std::vector<Way> ways;
  for (const auto region : {ceres::LEVENBERG_MARQUARDT, ceres::DOGLEG})
    for (const auto library : {ceres::SUITE_SPARSE, ceres::CX_SPARSE, ceres::EIGEN_SPARSE})
      if (ceres::IsSparseLinearAlgebraLibraryTypeAvailable(library)) ways.push_back({region, library});
  return ways;
}

/// CPU time between the first and the last of the iterations that it hears of.
class IterationClock : public ceres::IterationCallback {
 public:
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override {
    if (iteration.iteration == 0) first_s_ = bench::cpu_s();
    last_s_ = bench::cpu_s();
    iterations_ = iteration.iteration;
    return ceres::SOLVER_CONTINUE;
  }
  int iterations() const { return iterations_; }
  double ms_per_iteration() const { return 1e3 * (last_s_ - first_s_) / iterations_; }

 private:
  double first_s_ = 0.0, last_s_ = 0.0;
  int iterations_ = 0;
};

struct Solution {
  bool converged = false;
  double final_cost = 0.0, total_s = 0.0, ms_per_iteration = 0.0;
  int iterations = 0;
};

ceres::Solver::Options options_of(const Way& way, ceres::IterationCallback& callback) {
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.trust_region_strategy_type = way.region;
  options.sparse_linear_algebra_library_type = way.library;
  options.num_threads = 1;
  options.max_num_iterations = 200;
  options.function_tolerance = 1e-10;  // of the cost, relative; costs are compared to 1e-6
  options.logging_type = ceres::SILENT;
  options.callbacks.push_back(&callback);
  return options;
}

/// From the poses that the odometry gives; the problem is built within the time.
Solution solve(const PoseGraph<SE2>& graph, const Way& way) {
  const double start_s = bench::cpu_s();
  std::vector<Pose> poses;
  for (const SE2& T : graph.poses) poses.push_back({T.translation().x(), T.translation().y(), T.theta()});
  ceres::Problem problem;
  for (const auto& f : graph.factors)
    problem.AddResidualBlock(new WhitenedError(f), nullptr, poses[static_cast<std::size_t>(f.from)].data(),
                             poses[static_cast<std::size_t>(f.to)].data());
  problem.SetParameterBlockConstant(poses[0].data());
  IterationClock clock;
  ceres::Solver::Summary summary;
  ceres::Solve(options_of(way, clock), &problem, &summary);
  return {summary.termination_type == ceres::CONVERGENCE, summary.final_cost, bench::cpu_s() - start_s,
          clock.ms_per_iteration(), clock.iterations()};
}

/// The final cost is the yardstick of ours: from the same file, the two must be the same.
double our_final_cost(const PoseGraph<SE2>& graph) {
  PoseGraph<SE2> start = graph;
  start.poses = relaxed_poses(graph);
  return PoseGraphSolver<SE2>(std::move(start), bench::g2o_residual()).optimise().final_cost;
}

struct Quickest {
  std::optional<Way> way;
  double ms_per_iteration = std::numeric_limits<double>::infinity();  ///< of any way
};

Quickest quickest_way(const PoseGraph<SE2>& graph, double final_cost) {
  Quickest quickest;
  double least_s = std::numeric_limits<double>::infinity();
  for (const Way& way : available_ways()) {
    const Solution tried = solve(graph, way);
    if (!tried.converged || std::abs(tried.final_cost / final_cost - 1.0) > 1e-6) continue;
    quickest.ms_per_iteration = std::min(quickest.ms_per_iteration, tried.ms_per_iteration);
    if (tried.total_s >= least_s) continue;
    least_s = tried.total_s;
    quickest.way = way;
  }
  return quickest;
}

void BM_ceres_cold_solve(benchmark::State& state) {
  const std::string blas = bench::one_thread_of_blas();
  if (!bench::one_thread_of_openmp()) {
    state.SkipWithError(bench::several_threads);
    return;
  }
  const auto graph = bench::public_graph(state);
  if (!graph) return;
  const Quickest quickest = quickest_way(*graph, our_final_cost(*graph));
  if (!quickest.way) {
    state.SkipWithError("Ceres comes to our cost (to 1e-6) in no way");
    return;
  }
  Solution solution;
  for (auto _ : state) solution = solve(*graph, *quickest.way);
  state.counters["final_cost"] = solution.final_cost;
  state.counters["iterations_to_converge"] = solution.iterations;
  state.counters["ms_per_iteration"] = quickest.ms_per_iteration;
  state.SetLabel(bench::graph_name(state) + ", Ceres " CERES_VERSION_STRING ", " + name_of(*quickest.way) + ", " +
                 blas);
}
BENCHMARK(BM_ceres_cold_solve)->DenseRange(0, 4)->Unit(benchmark::kMillisecond);

}  // namespace
