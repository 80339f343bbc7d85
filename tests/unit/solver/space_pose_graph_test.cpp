// Pose graphs in space: the same solvers, in batch and incrementally, with both residuals.
#include <gtest/gtest.h>
#include <convoy/geometry/groups.hpp>
#include <convoy/solver/g2o.hpp>
#include <convoy/solver/incremental_pose_graph.hpp>

#include <random>

#include "pose_graph_files.hpp"

namespace convoy {
namespace {

/// A spiral up a tower of ten poses a turn, each linked to the one before it and, most of them, to the one below.
PoseGraph<SE3> tower(unsigned seed, int poses) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> unit;
  SE3::Tangent step, sigma;
  step << 1.0, 0.0, 0.05, 0.02, -0.01, 2.0 * M_PI / 10.0;
  sigma << 0.05, 0.05, 0.05, 0.02, 0.02, 0.02;
  std::vector<SE3> truth{SE3()};
  while (static_cast<int>(truth.size()) < poses) truth.push_back(truth.back() * SE3::Exp(step));
  PoseGraph<SE3> graph;
  graph.poses.assign(truth.size(), SE3());
  const auto link = [&](int a, int b) {
    const SE3::Tangent noise = sigma.cwiseProduct(SE3::Tangent::NullaryExpr([&] { return unit(random); }));
    SE3::Covariance W = sigma.cwiseAbs2().cwiseInverse().asDiagonal();
    W(0, 4) = W(4, 0) = 0.3 / (sigma[0] * sigma[4]);
    const SE3 T_a_b = truth[static_cast<std::size_t>(a)].inverse() * truth[static_cast<std::size_t>(b)];
    graph.factors.push_back({a, b, T_a_b * SE3::Exp(noise), W});
  };
  for (int k = 1; k < poses; ++k) {
    link(k - 1, k);
    if (k >= 10 && k % 7 != 0) {
      if (k % 2) link(k - 10, k);
      else link(k, k - 10);
    }
  }
  graph.poses = composed_poses(graph);
  return graph;
}

class SpaceResiduals : public testing::TestWithParam<PoseResidual> {};

TEST_P(SpaceResiduals, TheOptimumHasNoGradientAndTheIncrementalSolutionEndsThere) {
  const PoseGraph<SE3> graph = tower(3, 120);
  PoseGraphParams params;
  params.residual = GetParam();
  PoseGraphSolver<SE3> solver(graph, params);
  const PoseGraphReport report = solver.optimise();
  ASSERT_TRUE(report.converged);
  EXPECT_LT(report.final_cost, 0.5 * report.initial_cost);
  const double dof = 6.0 * static_cast<double>(graph.factors.size() - graph.poses.size() + 1);
  EXPECT_NEAR(2.0 * report.final_cost / dof, 1.0, 0.4);
  std::vector<SE3> poses = solver.poses();
  constexpr double h = 1e-5;
  for (std::size_t k = 1; k < poses.size(); k += 17)
    for (int c = 0; c < 6; ++c) {
      const SE3 kept = poses[k];
      poses[k] = kept * SE3::Exp(h * SE3::Tangent::Unit(c));
      const double up = pose_graph_cost(GetParam(), graph.factors, poses);
      poses[k] = kept * SE3::Exp(-h * SE3::Tangent::Unit(c));
      const double down = pose_graph_cost(GetParam(), graph.factors, poses);
      poses[k] = kept;
      EXPECT_NEAR((up - down) / (2.0 * h), 0.0, 2e-3) << k << " " << c;
    }

  IncrementalParams incremental;
  incremental.residual = GetParam();
  IncrementalPoseGraph<SE3> growing(graph.poses.front(), incremental);
  for (int k = 1; k < static_cast<int>(graph.poses.size()); ++k) {
    std::vector<PoseFactor<SE3>> factors;
    for (const auto& f : graph.factors)
      if (std::max(f.from, f.to) == k) factors.push_back(f);
    ASSERT_TRUE(growing.add(factors));
  }
  EXPECT_NEAR(growing.finish().final_cost / report.final_cost, 1.0, 1e-9);
}

INSTANTIATE_TEST_SUITE_P(Kinds, SpaceResiduals, testing::Values(PoseResidual::log, PoseResidual::g2o),
                         [](const auto& i) { return i.param == PoseResidual::log ? "Log" : "G2o"; });

TEST(SpacePoseGraph, IsReadBackAsItWasWritten) {
  const PoseGraph<SE3> graph = tower(4, 12);
  G2oFile file;
  file.dim = 3;
  for (std::uint64_t k = 0; k < graph.poses.size(); ++k) file.vertices.push_back({7 * k, {}});
  for (const auto& f : graph.factors) {
    const auto& t = f.measured.translation();
    const auto& q = f.measured.quaternion();
    file.edges.push_back({f.from, f.to, {t.x(), t.y(), t.z(), q[1], q[2], q[3], q[0]}, f.information});
  }
  const G2oFile again = parse_g2o(g2o_text(file, graph.poses), "again");
  const PoseGraph<SE3> read = pose_graph<SE3>(again);
  ASSERT_EQ(read.poses.size(), graph.poses.size());
  ASSERT_EQ(read.factors.size(), graph.factors.size());
  for (std::size_t k = 0; k < graph.poses.size(); ++k) {
    EXPECT_EQ(again.vertices[k].id, 7 * k);
    EXPECT_EQ(read.poses[k].translation(), graph.poses[k].translation());
    EXPECT_LT((read.poses[k].inverse() * graph.poses[k]).Log().norm(), 1e-15);
  }
  for (std::size_t k = 0; k < graph.factors.size(); ++k) {
    EXPECT_LT((read.factors[k].measured.inverse() * graph.factors[k].measured).Log().norm(), 1e-15);
    EXPECT_EQ(read.factors[k].information, graph.factors[k].information);
  }
}

class MultiRobotGraphs : public testing::TestWithParam<const char*> {};

// From the chain and from the relaxation to one and the same cost.
TEST_P(MultiRobotGraphs, ConvergeToOneCost) {
  const auto path = test::pose_graph_file("fullGraph.g2o", std::string("multi_robot/distributed_mapper/") + GetParam());
  if (!path)
    GTEST_SKIP() << "no pose_graphs/multi_robot/distributed_mapper/" << GetParam()
                 << "; set CONVOY_DATA_DIR to the folder that holds pose_graphs";
  PoseGraph<SE3> graph = pose_graph<SE3>(read_g2o(*path));
  graph.poses = composed_poses(graph);
  for (const PoseResidual kind : {PoseResidual::g2o, PoseResidual::log}) {
    PoseGraphParams params;
    params.residual = kind;
    PoseGraphSolver<SE3> composed(graph, params);
    PoseGraph<SE3> start = graph;
    start.poses = relaxed_poses(graph);
    PoseGraphSolver<SE3> relaxed(start, params);
    const PoseGraphReport a = composed.optimise(), b = relaxed.optimise();
    EXPECT_TRUE(a.converged && b.converged);
    EXPECT_NEAR(a.final_cost / b.final_cost, 1.0, 1e-9);
    RecordProperty(kind == PoseResidual::g2o ? "g2o" : "log", std::to_string(b.final_cost));
  }
}

INSTANTIATE_TEST_SUITE_P(DistributedMapper, MultiRobotGraphs, testing::Values("2robots", "4robots", "9robots"));

}  // namespace
}  // namespace convoy
