#include "solve.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <convoy/config_error.hpp>
#include <convoy/solver/g2o.hpp>

#include <nlohmann/json.hpp>

#include "fake_run.hpp"

namespace convoy::cli {
namespace {

using test::config_error_of;
using test::TemporaryFolder;
using testing::HasSubstr;

// A square of five poses whose last one is the first again, nearly.
constexpr const char* kSquare =
    "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0 0 0\nVERTEX_SE2 2 0 0 0\nVERTEX_SE2 3 0 0 0\nVERTEX_SE2 4 0 0 0\n"
    "EDGE_SE2 0 1 1.02 0 1.58 50 0 0 50 0 100\nEDGE_SE2 1 2 1 0.01 1.57 50 0 0 50 0 100\n"
    "EDGE_SE2 2 3 0.97 0 1.55 50 0 0 50 0 100\nEDGE_SE2 3 4 1 0 1.6 50 0 0 50 0 100\n"
    "EDGE_SE2 0 4 0 0 0 50 0 0 50 0 100\n";

nlohmann::json solved(const TemporaryFolder& folder, bool incremental) {
  test::write(folder / "square.g2o", kSquare);
  SolveOptions options;
  options.graph = folder / "square.g2o";
  options.out = folder / (incremental ? "incremental" : "batch");
  options.incremental = incremental;
  EXPECT_TRUE(solve_graph(options).report.converged);
  return nlohmann::json::parse(read_text_file(options.out / "solve.json"));
}

TEST(Solve, WritesItsVerdictAndTheGraph) {
  const TemporaryFolder folder;
  const nlohmann::json json = solved(folder, false);
  EXPECT_EQ(json.at("dim"), 2);
  EXPECT_EQ(json.at("nodes"), 5);
  EXPECT_EQ(json.at("factors"), 5);
  EXPECT_LT(json.at("final_cost"), json.at("initial_cost"));
  EXPECT_TRUE(json.at("update_ms_p50").is_null());
  EXPECT_GT(json.at("peak_mb"), 1.0);
  const G2oFile file = read_g2o(folder / "batch/solved.g2o");
  const PoseGraph<SE2> graph = pose_graph_se2(file);
  EXPECT_NEAR(pose_graph_cost(PoseResidual::g2o, graph.factors, graph.poses), json.at("final_cost").get<double>(),
              1e-12);
}

TEST(Solve, IncrementallyToTheSameCost) {
  const TemporaryFolder folder;
  const nlohmann::json batch = solved(folder, false), incremental = solved(folder, true);
  EXPECT_NEAR(incremental.at("final_cost").get<double>() / batch.at("final_cost").get<double>(), 1.0, 1e-9);
  EXPECT_EQ(incremental.at("initial_cost"), batch.at("initial_cost"));
  EXPECT_LE(incremental.at("update_ms_p50"), incremental.at("update_ms_p99"));
  EXPECT_LE(incremental.at("update_ms_p99"), incremental.at("update_ms_max"));
}

TEST(Solve, SolvesInSpaceInBatchAndIncrementally) {
  const TemporaryFolder folder;
  const auto edge = [](int from, int to, const std::string& pose) {
    std::string line = "EDGE_SE3:QUAT " + std::to_string(from) + ' ' + std::to_string(to) + ' ' + pose;
    for (int r = 0; r < 6; ++r)
      for (int c = r; c < 6; ++c) line += r == c ? " 40" : r == 0 && c == 5 ? " 3" : " 0";
    return line + '\n';
  };
  const std::string quarter = " 0.01 0 0.7071067811865476 0.7070360664349868";
  test::write(folder / "space.g2o", edge(0, 1, "1.02 0 0.1" + quarter) + edge(1, 2, "1 0.01 -0.1" + quarter) +
                                        edge(2, 3, "0.97 0 0.05" + quarter) + edge(3, 4, "1 0 0" + quarter) +
                                        edge(0, 4, "0 0 0 0 0 0 1"));
  SolveOptions options;
  options.graph = folder / "space.g2o";
  for (const char* residual : {"g2o", "log"}) {
    options.residual = residual;
    std::vector<double> costs;
    for (const bool incremental : {false, true}) {
      options.incremental = incremental;
      options.out = folder / (incremental ? "incremental" : "batch");
      const SolveSummary summary = solve_graph(options);
      EXPECT_TRUE(summary.report.converged);
      EXPECT_LT(summary.report.final_cost, summary.report.initial_cost);
      const nlohmann::json json = nlohmann::json::parse(read_text_file(options.out / "solve.json"));
      EXPECT_EQ(json.at("dim"), 3);
      EXPECT_EQ(json.at("nodes"), 5);
      const PoseGraph<SE3> graph = pose_graph_se3(read_g2o(options.out / "solved.g2o"));
      const auto kind = options.residual == "g2o" ? PoseResidual::g2o : PoseResidual::log;
      costs.push_back(pose_graph_cost(kind, graph.factors, graph.poses));
      EXPECT_NEAR(costs.back(), json.at("final_cost").get<double>(), 1e-9);
    }
    EXPECT_NEAR(costs[0] / costs[1], 1.0, 1e-9);
  }
}

TEST(Solve, AnUnusableOutIsToldBeforeTheGraphIsRead) {
  const TemporaryFolder folder;
  test::write(folder / "file", "");
  SolveOptions options;
  options.graph = folder / "nowhere.g2o";
  options.out = folder / "file/below/out";
  EXPECT_THAT(config_error_of([&] { solve_graph(options); }),
              HasSubstr("file/below/out: nothing can be written there, for " + (folder / "file").string() +
                        " is no folder; choose another one with --out"));
  options.out = folder / "new/out";
  EXPECT_THAT(config_error_of([&] { solve_graph(options); }), HasSubstr("nowhere.g2o: cannot be read"));
  EXPECT_FALSE(std::filesystem::exists(folder / "new"));
}

TEST(Solve, RefusesWhatItCannotDo) {
  const TemporaryFolder folder;
  SolveOptions options;
  options.graph = folder / "graph.g2o";
  options.out = folder / "out";
  test::write(options.graph, "EDGE_SE2 0 2 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n");
  options.incremental = true;
  EXPECT_THAT(config_error_of([&] { solve_graph(options); }),
              HasSubstr("vertex 1 has no edge to a vertex with a smaller id"));
  options.incremental = false;
  for (const bool incremental : {false, true}) {
    options.incremental = incremental;
    test::write(options.graph, "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 7 9 1 0 0 1 0 0 1 0 1\n");
    EXPECT_THAT(config_error_of([&] { solve_graph(options); }),
                HasSubstr("graph.g2o: no edges lead from vertex 0 to vertex 7; add"));
    test::write(options.graph, "EDGE_SE2 0 1 1e308 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1e308 0 0 1 0 0 1 0 1\n");
    EXPECT_THAT(config_error_of([&] { solve_graph(options); }),
                HasSubstr("not finite; the numbers of its edges are too"));
    test::write(options.graph, "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 1 0 1 0 1\n");
    EXPECT_THAT(config_error_of([&] { solve_graph(options); }), HasSubstr("graph.g2o:2: the information matrix"));
  }
  options.residual = "best";
  EXPECT_THAT(config_error_of([&] { solve_graph(options); }), HasSubstr("--residual best is not known"));
  EXPECT_FALSE(std::filesystem::exists(options.out));
}

}  // namespace
}  // namespace convoy::cli
