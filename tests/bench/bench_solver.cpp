// The factorisation against Eigen's scalar LDLT with AMD, on a street fleet of 100 vehicles with 1000 nodes each and,
// if they are on this machine, on public pose graphs.
#include <sys/resource.h>
#include <Eigen/Cholesky>
#include <convoy/solver/block_cholesky.hpp>
#include <convoy/solver/block_ordering.hpp>
#include <convoy/solver/incremental_pose_graph.hpp>

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <memory>
#include <random>

#include "fleet_system.hpp"
#include "public_graphs.hpp"
#include "ratio.hpp"
#include "street_fleet.hpp"

namespace {

using namespace convoy;
using bench::fleet, bench::g2o_residual, bench::public_graph;
using SparseMatrix = Eigen::SparseMatrix<double>;
using EigenFactor = Eigen::SimplicialLDLT<SparseMatrix, Eigen::Lower, Eigen::AMDOrdering<int>>;

std::size_t at(int i) { return static_cast<std::size_t>(i); }

/// What Eigen's factor takes: L, its diagonal and the order.
double held_MB(const EigenFactor& factor) {
  const auto& L = factor.matrixL().nestedExpression();
  const auto n = static_cast<double>(L.rows());
  return 1e-6 *
         (static_cast<double>(L.nonZeros()) * (sizeof(double) + sizeof(int)) + n * (sizeof(double) + 3 * sizeof(int)));
}

template <int D>
void BM_fleet_factor(benchmark::State& state) {
  const auto& system = fleet<D>(static_cast<int>(state.range(0)));
  BlockCholesky solver(system.pattern);
  system.fill(solver);
  EigenFactor eigen;
  eigen.analyzePattern(system.scalar);
  bool ok = true;
  bench::against(
      state, "Eigen SimplicialLDLT::factorize, scalar AMD", [&] { ok = ok && solver.factor().ok(); },
      [&] { eigen.factorize(system.scalar); });
  if (!ok || eigen.info() != Eigen::Success) state.SkipWithError("not positive definite");
  Eigen::VectorXd x = Eigen::VectorXd::Ones(solver.size());
  const Eigen::VectorXd y = eigen.solve(x);
  solver.solve(x);
  if ((x - y).norm() > 1e-6 * y.norm()) state.SkipWithError("the solutions differ");
  state.counters["held_MB"] = static_cast<double>(solver.factor_size().bytes) * 1e-6;
  state.counters["baseline_MB"] = held_MB(eigen);
  state.counters["Gflop"] = solver.factor_size().flops * 1e-9;
}
BENCHMARK_TEMPLATE(BM_fleet_factor, 3)->Arg(300)->Arg(20000)->Arg(68000)->Unit(benchmark::kMillisecond);
BENCHMARK_TEMPLATE(BM_fleet_factor, 6)->Arg(300)->Arg(20000)->Arg(68000)->Unit(benchmark::kMillisecond);

void BM_fleet_order(benchmark::State& state) {
  const auto& system = fleet<3>(static_cast<int>(state.range(0)));
  bench::against(
      state, "Eigen AMDOrdering on scalars", [&] { benchmark::DoNotOptimize(minimum_degree_order(system.pattern)); },
      [&] {
        Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> order;
        Eigen::AMDOrdering<int>()(system.scalar.selfadjointView<Eigen::Lower>(), order);
        benchmark::DoNotOptimize(order);
      });
}
BENCHMARK(BM_fleet_order)->Arg(300)->Arg(20000)->Arg(68000)->Unit(benchmark::kMillisecond);

// Ordering, supernodes and memory together.
void BM_fleet_analyse(benchmark::State& state) {
  const auto& system = fleet<3>(static_cast<int>(state.range(0)));
  bench::against(
      state, "Eigen SimplicialLDLT::analyzePattern, scalar AMD", [&] { BlockCholesky solver(system.pattern); },
      [&] { EigenFactor().analyzePattern(system.scalar); });
}
BENCHMARK(BM_fleet_analyse)->Arg(300)->Arg(20000)->Arg(68000)->Unit(benchmark::kMillisecond);

void BM_fleet_marginals(benchmark::State& state) {
  const auto& system = fleet<3>(static_cast<int>(state.range(0)));
  BlockCholesky solver(system.pattern);
  system.fill(solver);
  if (!solver.factor().ok()) state.SkipWithError("not positive definite");
  bench::against(
      state, "one factorisation", [&] { benchmark::DoNotOptimize(solver.marginals()); },
      [&] { benchmark::DoNotOptimize(solver.factor().ok()); });
}
BENCHMARK(BM_fleet_marginals)->Arg(300)->Arg(20000)->Arg(68000)->Unit(benchmark::kMillisecond);

/// What the same iteration takes with Eigen: triplets, matrix, factor, solve.
class EigenIteration {
 public:
  explicit EigenIteration(const PoseGraph<SE2>& graph) : graph_(graph) {}
  void operator()() {
    const Eigen::Index n = 3 * static_cast<Eigen::Index>(graph_.poses.size() - 1);
    triplets_.clear();
    Eigen::VectorXd b = Eigen::VectorXd::Zero(n);
    LinearPoseFactor<SE2> linear;
    for (const auto& f : graph_.factors) {
      linear.linearise(PoseResidual::g2o, f, graph_.poses[at(f.from)], graph_.poses[at(f.to)]);
      const int from = 3 * (f.from - 1), to = 3 * (f.to - 1);
      if (from >= 0) put(from, from, linear.H_from);
      if (to >= 0) put(to, to, linear.H_to);
      if (from >= 0 && to >= 0) put(to, from, linear.H_to_from);
      if (from >= 0) b.segment<3>(from) += linear.b_from;
      if (to >= 0) b.segment<3>(to) += linear.b_to;
    }
    SparseMatrix H(n, n);
    H.setFromTriplets(triplets_.begin(), triplets_.end());
    if (!analysed_) factor_.analyzePattern(H);
    analysed_ = true;
    factor_.factorize(H);
    benchmark::DoNotOptimize(factor_.solve(b).eval());
  }

  /// The covariance of every pose, by a solution for each of its columns.
  void marginals() const {
    const Eigen::Index n = 3 * static_cast<Eigen::Index>(graph_.poses.size() - 1);
    Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(n, 3);
    for (Eigen::Index pose = 0; pose < n; pose += 3) {
      unit.middleRows<3>(pose).setIdentity();
      benchmark::DoNotOptimize(Eigen::Matrix3d(factor_.solve(unit).middleRows<3>(pose)));
      unit.middleRows<3>(pose).setZero();
    }
  }

 private:
  void put(int i, int j, const Eigen::Matrix3d& block) {
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) {
        if (i > j || (i == j && r >= c)) triplets_.emplace_back(i + r, j + c, block(r, c));
        else if (i < j) triplets_.emplace_back(j + c, i + r, block(r, c));
      }
  }
  const PoseGraph<SE2>& graph_;
  std::vector<Eigen::Triplet<double>> triplets_;
  EigenFactor factor_;
  bool analysed_ = false;
};

// A drive in noise.
PoseGraph<SE2> noisy_fleet(int links) {
  const int vehicles = links < 1000 ? 4 : 100, nodes = links < 1000 ? 100 : 1000;
  const bench::StreetFleet streets(vehicles, nodes, links, links < 1000 ? 4 : 32);
  std::mt19937_64 random(5);
  std::normal_distribution<double> unit;
  PoseGraph<SE2> graph;
  graph.poses = streets.poses;
  const auto add = [&](const std::pair<int, int>& edge, const SE2::Tangent& sigma) {
    const SE2::Tangent noise = sigma.cwiseProduct(SE2::Tangent(unit(random), unit(random), unit(random)));
    graph.factors.push_back({edge.first, edge.second,
                             streets.poses[at(edge.first)].inverse() * streets.poses[at(edge.second)] * SE2::Exp(noise),
                             sigma.cwiseAbs2().cwiseInverse().asDiagonal()});
  };
  for (const auto& edge : streets.chain) add(edge, {0.05, 0.05, 0.002});
  for (const auto& edge : streets.links) add(edge, {0.2, 0.2, 0.01});
  graph.poses = composed_poses(graph);
  return graph;
}

// The cold solution of the whole fleet: start, analysis and iterations, against as many iterations of Eigen alone.
void BM_fleet_cold_solve(benchmark::State& state) {
  const PoseGraph<SE2> graph = noisy_fleet(static_cast<int>(state.range(0)));
  PoseGraphReport report;
  for (auto _ : state) {
    PoseGraph<SE2> start = graph;
    start.poses = relaxed_poses(graph);
    report = PoseGraphSolver<SE2>(std::move(start)).optimise();
  }
  if (!report.converged) state.SkipWithError("did not converge");
  state.counters["iterations_to_converge"] = report.iterations;
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  state.counters["process_peak_MB"] = static_cast<double>(usage.ru_maxrss) / 1024.0;
  EigenIteration eigen(graph);
  eigen();  // the analysis, which only the first needs
  state.counters["baseline_s"] = report.iterations * bench::seconds_per_call([&] { eigen(); }, 0.0);
  state.SetLabel("baseline: Eigen SimplicialLDLT, as many iterations");
}
BENCHMARK(BM_fleet_cold_solve)->Arg(300)->Arg(20000)->Arg(68000)->Iterations(1)->Unit(benchmark::kMillisecond);

// Linearise, factor, solve.
void BM_public_iteration(benchmark::State& state) {
  const auto graph = public_graph(state);
  if (!graph) return;
  PoseGraphSolver<SE2> solver(*graph, g2o_residual());
  solver.optimise();
  EigenIteration eigen(*graph);
  eigen();
  bench::against(
      state, "Eigen SimplicialLDLT iteration, " + bench::graph_name(state),
      [&] { benchmark::DoNotOptimize(solver.iterate()); }, [&] { eigen(); }, 0.1);
}
BENCHMARK(BM_public_iteration)->DenseRange(0, 4)->Unit(benchmark::kMillisecond);

void BM_public_cold_solve(benchmark::State& state) {
  const auto graph = public_graph(state);
  if (!graph) return;
  PoseGraphReport report;
  for (auto _ : state) {
    PoseGraph<SE2> start = *graph;
    start.poses = relaxed_poses(*graph);
    report = PoseGraphSolver<SE2>(std::move(start), g2o_residual()).optimise();
  }
  state.SetLabel(bench::graph_name(state));
  state.counters["iterations_to_converge"] = report.iterations;
  state.counters["final_cost"] = report.final_cost;
}
BENCHMARK(BM_public_cold_solve)->DenseRange(0, 4)->Unit(benchmark::kMillisecond);

// Linearise, factor and all pose marginals.
void BM_public_marginals(benchmark::State& state) {
  const auto graph = public_graph(state);
  if (!graph) return;
  PoseGraphSolver<SE2> solver(*graph, g2o_residual());
  solver.optimise();
  EigenIteration eigen(*graph);
  bench::against(
      state, "Eigen SimplicialLDLT, solved for every column, " + bench::graph_name(state),
      [&] {
        benchmark::DoNotOptimize(solver.iterate());
        benchmark::DoNotOptimize(solver.marginals());
      },
      [&] {
        eigen();
        eigen.marginals();
      });
}
BENCHMARK(BM_public_marginals)->DenseRange(0, 4)->Unit(benchmark::kMillisecond);

// Poses in order. Counters: milliseconds of an update, and the cost before and after the final solution. A fourth
// quantile is that of updates that factored anything, because most add one pose to the end and factor nothing.
void BM_public_incremental(benchmark::State& state) {
  const auto graph = public_graph(state);
  if (!graph) return;
  std::vector<std::vector<PoseFactor<SE2>>> factors(graph->poses.size());
  for (const auto& f : graph->factors) factors[at(std::max(f.from, f.to))].push_back(f);
  for (auto _ : state) {
    IncrementalParams params;
    params.residual = PoseResidual::g2o;
    IncrementalPoseGraph<SE2> solver(graph->poses[0], params);
    std::vector<double> all_ms, working_ms;
    for (std::size_t k = 1; k < factors.size(); ++k) {
      const double start_s = bench::cpu_s();
      if (!solver.add(factors[k])) state.SkipWithError("a pose without a link to earlier ones");
      all_ms.push_back(1e3 * (bench::cpu_s() - start_s));
      if (solver.last_update().fronts > 0) working_ms.push_back(all_ms.back());
    }
    std::sort(all_ms.begin(), all_ms.end());
    std::sort(working_ms.begin(), working_ms.end());
    state.counters["p50_ms"] = all_ms[all_ms.size() / 2];
    state.counters["p99_ms"] = all_ms[all_ms.size() * 99 / 100];
    state.counters["max_ms"] = all_ms.back();
    if (!working_ms.empty()) state.counters["p50_working_ms"] = working_ms[working_ms.size() / 2];
    state.counters["cost"] = pose_graph_cost(PoseResidual::g2o, solver.factors(), solver.poses());
    const double start_s = bench::cpu_s();
    state.counters["final_cost"] = solver.finish().final_cost;
    state.counters["finish_ms"] = 1e3 * (bench::cpu_s() - start_s);
  }
  state.SetLabel(bench::graph_name(state));
}
BENCHMARK(BM_public_incremental)->DenseRange(0, 4)->Iterations(1)->Unit(benchmark::kMillisecond);

// A fleet whose poses come in turns, each with its factors. Counters: milliseconds of those updates that factored
// anything.
void BM_fleet_incremental(benchmark::State& state) {
  const int vehicles = static_cast<int>(state.range(0)), nodes = vehicles < 10 ? 100 : 1000;
  const bench::StreetFleet streets(vehicles, nodes, vehicles * nodes / 5, vehicles < 10 ? 4 : 10);
  std::mt19937_64 random(5);
  std::normal_distribution<double> unit;
  std::vector<std::vector<PoseFactor<SE2>>> factors(streets.poses.size());
  const auto add = [&](const std::pair<int, int>& edge, const SE2::Tangent& sigma) {
    const auto turn = [&](int n) { return n % nodes * vehicles + n / nodes; };
    const SE2::Tangent noise = sigma.cwiseProduct(SE2::Tangent(unit(random), unit(random), unit(random)));
    const PoseFactor<SE2> f{turn(edge.first), turn(edge.second),
                            streets.poses[at(edge.first)].inverse() * streets.poses[at(edge.second)] * SE2::Exp(noise),
                            sigma.cwiseAbs2().cwiseInverse().asDiagonal()};
    factors[at(std::max(f.from, f.to))].push_back(f);
  };
  for (int v = 1; v < vehicles; ++v) add({0, v * nodes}, {5.0, 5.0, 0.1});
  for (const auto& edge : streets.chain) add(edge, {0.05, 0.05, 0.002});
  for (const auto& edge : streets.links) add(edge, {0.2, 0.2, 0.01});
  for (auto _ : state) {
    IncrementalPoseGraph<SE2> solver(streets.poses[0]);
    std::vector<double> working_ms;
    for (std::size_t k = 1; k < factors.size(); ++k) {
      const double start_s = bench::cpu_s();
      if (!solver.add(factors[k]) || solver.last_update().failed) state.SkipWithError("an update failed");
      if (solver.last_update().fronts > 0) working_ms.push_back(1e3 * (bench::cpu_s() - start_s));
    }
    std::sort(working_ms.begin(), working_ms.end());
    state.counters["p50_working_ms"] = working_ms[working_ms.size() / 2];
    state.counters["p99_working_ms"] = working_ms[working_ms.size() * 99 / 100];
    state.counters["max_ms"] = working_ms.back();
    state.counters["cost"] = pose_graph_cost(PoseResidual::log, solver.factors(), solver.poses());
    state.counters["final_cost"] = solver.finish().final_cost;
  }
}
BENCHMARK(BM_fleet_incremental)->Arg(3)->Arg(10)->Iterations(1)->Unit(benchmark::kMillisecond);

}  // namespace
