// `convoy solve`: a pose graph from a file, solved.
#pragma once

#include <convoy/solver/pose_graph.hpp>

#include <filesystem>
#include <string>

namespace convoy::cli {

struct SolveOptions {
  std::filesystem::path graph;  ///< g2o file (solver/g2o.hpp); started cold, from its edges alone
  std::filesystem::path out;    ///< folder; gets solve.json and solved.g2o
  bool incremental =
      false;  ///< vertices one after the other, in the order of their ids, each with its edges to earlier ones
  std::string residual = "g2o";  ///< or "log"
};

struct SolveSummary {
  std::size_t nodes = 0, factors = 0;
  /// Of the batch solution, or of what exactness took after the last vertex; initial_cost is that of the poses composed
  /// from the edges (composed_poses).
  PoseGraphReport report;
  double seconds = 0.0;  ///< wall time, without reading and writing
};

/// Solves and writes; a graph of several parts, or one whose solution is not finite, is refused and nothing is written.
/// Progress goes to stdout once it takes longer than two seconds. Throws ConfigError.
SolveSummary solve_graph(const SolveOptions& options);

/// The same for the command: prints a summary. Returns 0, or 1 if the solution did not converge. Throws ConfigError.
int run_solve(const SolveOptions& options);

}  // namespace convoy::cli
