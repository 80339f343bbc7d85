#include "solve.hpp"

#include <sys/resource.h>
#include <convoy/config_error.hpp>
#include <convoy/solver/g2o.hpp>
#include <convoy/solver/incremental_pose_graph.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "scenario/table_file.hpp"

namespace convoy::cli {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

/// Speaks after two seconds, then every other second.
class Progress {
 public:
  template <class... Values>
  void say(const char* format, Values... values) {
    const double now_s = seconds_since(start_);
    if (now_s < next_s_) return;
    next_s_ = now_s + 2.0;
    std::printf("%6.1f s  ", now_s);
    std::printf(format, values...);
    std::printf("\n");
    std::fflush(stdout);
  }

 private:
  Clock::time_point start_ = Clock::now();
  double next_s_ = 2.0;
};

double peak_mb() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024.0;  // Linux counts kilobytes
}

/// The p-quantile (nearest rank) of sorted values; 0 of none.
double quantile(const std::vector<double>& sorted, double p) {
  if (sorted.empty()) return 0.0;
  const double rank = std::ceil(p * static_cast<double>(sorted.size()));
  return sorted[static_cast<std::size_t>(std::max(0.0, rank - 1.0))];
}

template <class G>
struct Solution {
  std::vector<G> poses;
  PoseGraphReport report;
  std::vector<double> update_ms;  ///< sorted
};

template <class G>
Solution<G> solve_batch(PoseGraph<G> graph, const PoseGraphParams& params) {
  Progress progress;
  graph.poses = relaxed_poses(graph);
  PoseGraphSolver<G> solver(std::move(graph), params);
  Solution<G> solution;
  solution.report = solver.optimise(
      [&](const PoseGraphReport& r) { progress.say("iteration %d, cost %.6g", r.iterations, r.final_cost); });
  solution.poses = solver.poses();
  return solution;
}

template <class G>
Solution<G> solve_incrementally(const PoseGraph<G>& graph, const G2oFile& file, const SolveOptions& options,
                                const PoseGraphParams& params) {
  std::vector<std::vector<PoseFactor<G>>> factors_of(graph.poses.size());
  for (const PoseFactor<G>& f : graph.factors)
    factors_of[static_cast<std::size_t>(std::max(f.from, f.to))].push_back(f);
  IncrementalParams incremental;
  incremental.residual = params.residual;
  IncrementalPoseGraph<G> solver(graph.poses.front(), incremental);
  Progress progress;
  Solution<G> solution;
  for (std::size_t k = 1; k < graph.poses.size(); ++k) {
    const Clock::time_point start = Clock::now();
    if (!solver.add(factors_of[k]))
      throw ConfigError(options.graph.string() + ": vertex " + std::to_string(file.vertices[k].id) +
                        " has no edge to a vertex with a smaller id; number the vertices along the drive, or leave out "
                        "--incremental");
    solution.update_ms.push_back(1e3 * seconds_since(start));
    progress.say("vertex %zu of %zu", k + 1, graph.poses.size());
  }
  solution.report = solver.finish();
  solution.poses = solver.poses();
  std::sort(solution.update_ms.begin(), solution.update_ms.end());
  return solution;
}

PoseResidual residual_named(const std::string& name) {
  if (name == "g2o") return PoseResidual::g2o;
  if (name == "log") return PoseResidual::log;
  throw ConfigError("--residual " + name + " is not known; give g2o or log");
}

/// Without edges between two parts nothing says how they lie to one another.
template <class G>
void refuse_if_disconnected(const PoseGraph<G>& graph, const G2oFile& file, const SolveOptions& options) {
  const std::vector<bool> first_of_part = fixed_poses(graph);
  for (std::size_t k = 1; k < first_of_part.size(); ++k)
    if (first_of_part[k])
      throw ConfigError(options.graph.string() + ": no edges lead from vertex " + std::to_string(file.vertices[0].id) +
                        " to vertex " + std::to_string(file.vertices[k].id) +
                        "; add the edges that are missing, or solve the parts of the graph one by one");
}

/// Numbers that are finite one by one can still run over once they are multiplied.
template <class G>
void refuse_if_not_finite(const std::vector<G>& poses, const PoseGraphReport& report, const G2oFile& file,
                          const SolveOptions& options) {
  const std::string end = "; the numbers of its edges are too large or too far apart to be solved in double precision";
  for (std::size_t k = 0; k < poses.size(); ++k)
    if (!poses[k].translation().allFinite() || !poses[k].rotation().allFinite())
      throw ConfigError(options.graph.string() + ": vertex " + std::to_string(file.vertices[k].id) +
                        " gets a pose that is not finite" + end);
  if (!std::isfinite(report.initial_cost) || !std::isfinite(report.final_cost))
    throw ConfigError(options.graph.string() + ": the cost is not finite" + end);
}

template <class G>
SolveSummary solve_in(const G2oFile& file, const SolveOptions& options, const PoseGraphParams& params) {
  PoseGraph<G> graph = pose_graph<G>(file);
  refuse_if_disconnected(graph, file, options);
  const Clock::time_point start = Clock::now();
  graph.poses = composed_poses(graph);
  const Solution<G> solution =
      options.incremental ? solve_incrementally(graph, file, options, params) : solve_batch(graph, params);
  SolveSummary summary{graph.poses.size(), graph.factors.size(), solution.report, seconds_since(start)};
  summary.report.initial_cost = pose_graph_cost(params.residual, graph.factors, graph.poses);
  refuse_if_not_finite(solution.poses, summary.report, file, options);

  nlohmann::ordered_json json{{"dim", file.dim},
                              {"nodes", summary.nodes},
                              {"factors", summary.factors},
                              {"residual", options.residual},
                              {"initial_cost", summary.report.initial_cost},
                              {"final_cost", summary.report.final_cost},
                              {"iterations", summary.report.iterations},
                              {"converged", summary.report.converged},
                              {"seconds", summary.seconds}};
  const auto update = [&](const char* key, double p) {
    if (options.incremental) json[key] = quantile(solution.update_ms, p);
    else json[key] = nullptr;
  };
  update("update_ms_p50", 0.5);
  update("update_ms_p99", 0.99);
  update("update_ms_max", 1.0);
  json["peak_mb"] = peak_mb();
  write_text_file(options.out / "solved.g2o", g2o_text(file, solution.poses));
  write_text_file(options.out / "solve.json", json.dump(2) + "\n");
  return summary;
}

}  // namespace

SolveSummary solve_graph(const SolveOptions& options) {
  PoseGraphParams params;
  params.residual = residual_named(options.residual);
  expect_writable(options.out);
  const G2oFile file = read_g2o(options.graph);
  return file.dim == 2 ? solve_in<SE2>(file, options, params) : solve_in<SE3>(file, options, params);
}

int run_solve(const SolveOptions& options) {
  const SolveSummary summary = solve_graph(options);
  const int iterations = summary.report.iterations;
  std::printf("%zu nodes, %zu factors: cost (half chi-square) %.10g -> %.10g, %d iteration%s, %.3f s; %s\n",
              summary.nodes, summary.factors, summary.report.initial_cost, summary.report.final_cost, iterations,
              iterations == 1 ? "" : "s", summary.seconds, (options.out / "solve.json").c_str());
  if (summary.report.converged) return 0;
  std::printf(
      "did not converge: the start found from the edges is too far from the solution, or the edges contradict each "
      "other\n");
  return 1;
}

}  // namespace convoy::cli
