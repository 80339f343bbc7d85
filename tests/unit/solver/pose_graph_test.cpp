#include <convoy/solver/pose_graph.hpp>

#include <gtest/gtest.h>
#include <convoy/geometry/groups.hpp>
#include <convoy/solver/g2o.hpp>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "pose_graph_files.hpp"
#include "random_pose_graph.hpp"

namespace convoy {
namespace {

using test::random_drive;

class Residuals : public testing::TestWithParam<PoseResidual> {};

TEST_P(Residuals, JacobianAgreesWithNumeric) {
  const SE2 cases[] = {{0, 0, 0}, {1, -2, 0.3}, {-3, 0.5, -2.9}, {0.1, 0.2, 1e-7}, {2, 2, 3.1}};
  for (const SE2& E : cases) {
    const Eigen::Matrix3d J = pose_residual_jacobian(GetParam(), E);
    constexpr double h = 1e-6;
    for (int c = 0; c < 3; ++c) {
      const SE2::Tangent d = h * SE2::Tangent::Unit(c);
      const SE2::Tangent numeric =
          (pose_residual(GetParam(), E * SE2::Exp(d)) - pose_residual(GetParam(), E * SE2::Exp(-d))) / (2.0 * h);
      EXPECT_LT((J.col(c) - numeric).norm(), 1e-6);
    }
  }
}

// Blocks and right-hand side of one factor against numeric derivatives of its cost and residual.
TEST_P(Residuals, FactorAgreesWithNumeric) {
  const auto drive = random_drive(3, 60);
  for (const PoseFactor<SE2>& f : drive.graph.factors) {
    const SE2 a = drive.graph.poses[static_cast<std::size_t>(f.from)],
              b = drive.graph.poses[static_cast<std::size_t>(f.to)];
    LinearPoseFactor<SE2> linear;
    linear.linearise(GetParam(), f, a, b);
    const auto residual = [&](const Eigen::Matrix<double, 6, 1>& d) {
      return pose_residual(
          GetParam(), f.measured.inverse() * ((a * SE2::Exp(d.head<3>())).inverse() * (b * SE2::Exp(d.tail<3>()))));
    };
    Eigen::Matrix<double, 3, 6> J;
    constexpr double h = 1e-6;
    for (int c = 0; c < 6; ++c) {
      const Eigen::Matrix<double, 6, 1> d = h * Eigen::Matrix<double, 6, 1>::Unit(c);
      J.col(c) = (residual(d) - residual(-d)) / (2.0 * h);
    }
    const SE2::Tangent r = residual(Eigen::Matrix<double, 6, 1>::Zero());
    const Eigen::Matrix<double, 6, 6> H = J.transpose() * f.information * J;
    const Eigen::Matrix<double, 6, 1> g = -J.transpose() * f.information * r;
    const double scale = 1.0 + H.norm();
    EXPECT_NEAR(linear.cost, 0.5 * r.dot(f.information * r), 1e-9 * (1.0 + linear.cost));
    EXPECT_LT((linear.H_from - H.topLeftCorner<3, 3>()).norm(), 1e-6 * scale);
    EXPECT_LT((linear.H_to - H.bottomRightCorner<3, 3>()).norm(), 1e-6 * scale);
    EXPECT_LT((linear.H_to_from - H.bottomLeftCorner<3, 3>()).norm(), 1e-6 * scale);
    EXPECT_LT((linear.b_from - g.head<3>()).norm(), 1e-6 * (1.0 + g.norm()));
    EXPECT_LT((linear.b_to - g.tail<3>()).norm(), 1e-6 * (1.0 + g.norm()));
  }
}

TEST_P(Residuals, OptimumHasNoGradient) {
  auto drive = random_drive(4, 300);
  PoseGraphParams params;
  params.residual = GetParam();
  PoseGraphSolver<SE2> solver(drive.graph, params);
  const PoseGraphReport report = solver.optimise();
  ASSERT_TRUE(report.converged);
  EXPECT_LT(report.final_cost, report.initial_cost);
  // About chi-square distributed with 3 (factors - poses + 1) degrees of freedom; the information has a small
  // correlation that the noise has not.
  const double dof = 3.0 * static_cast<double>(drive.graph.factors.size() - drive.graph.poses.size() + 1);
  EXPECT_NEAR(2.0 * report.final_cost / dof, 1.0, 0.4);
  std::vector<SE2> poses = solver.poses();
  constexpr double h = 1e-5;
  for (std::size_t k = 1; k < poses.size(); k += 17)
    for (int c = 0; c < 3; ++c) {
      const SE2 kept = poses[k];
      poses[k] = kept * SE2::Exp(h * SE2::Tangent::Unit(c));
      const double up = pose_graph_cost(GetParam(), drive.graph.factors, poses);
      poses[k] = kept * SE2::Exp(-h * SE2::Tangent::Unit(c));
      const double down = pose_graph_cost(GetParam(), drive.graph.factors, poses);
      poses[k] = kept;
      EXPECT_NEAR((up - down) / (2.0 * h), 0.0, 1e-3);
    }
}

INSTANTIATE_TEST_SUITE_P(Kinds, Residuals, testing::Values(PoseResidual::log, PoseResidual::g2o),
                         [](const auto& i) { return i.param == PoseResidual::log ? "Log" : "G2o"; });

TEST(PoseGraph, MarginalsAreTheInverseOfTheHessian) {
  auto drive = random_drive(5, 80);
  PoseGraphSolver<SE2> solver(drive.graph);
  ASSERT_TRUE(solver.optimise().converged);
  ASSERT_TRUE(solver.iterate());
  const auto marginals = solver.marginals();
  const Eigen::Index n = 3 * static_cast<Eigen::Index>(drive.graph.poses.size() - 1);
  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(n, n);
  LinearPoseFactor<SE2> linear;
  for (const auto& f : drive.graph.factors) {
    linear.linearise(PoseResidual::log, f, solver.poses()[static_cast<std::size_t>(f.from)],
                     solver.poses()[static_cast<std::size_t>(f.to)]);
    const Eigen::Index a = 3 * (f.from - 1), b = 3 * (f.to - 1);
    if (a >= 0) H.block<3, 3>(a, a) += linear.H_from;
    if (b >= 0) H.block<3, 3>(b, b) += linear.H_to;
    if (a >= 0 && b >= 0) {
      H.block<3, 3>(b, a) += linear.H_to_from;
      H.block<3, 3>(a, b) += linear.H_to_from.transpose();
    }
  }
  const Eigen::MatrixXd inverse = H.inverse();
  EXPECT_EQ(marginals[0], Eigen::Matrix3d::Zero());
  for (std::size_t k = 1; k < marginals.size(); ++k) {
    const Eigen::Index i = 3 * static_cast<Eigen::Index>(k - 1);
    const Eigen::Matrix3d expected = inverse.block<3, 3>(i, i);
    EXPECT_LT((marginals[k] - expected).norm(), 1e-8 * expected.norm());
  }
}

TEST(PoseGraph, EveryComponentKeepsItsFirstPose) {
  PoseGraph<SE2> graph;
  graph.poses = {{1, 2, 0.5}, {}, {-4, 0, 1}, {}, {}};
  graph.factors.push_back({0, 1, SE2(1, 0, 0)});
  graph.factors.push_back({3, 2, SE2(1, 0, 0)});
  graph.factors.push_back({4, 3, SE2(0, 1, 0)});
  EXPECT_EQ(fixed_poses(graph), (std::vector<bool>{true, false, true, false, false}));
  graph.poses = composed_poses(graph);
  EXPECT_NEAR(pose_graph_cost(PoseResidual::log, graph.factors, graph.poses), 0.0, 1e-20);
  PoseGraphSolver<SE2> solver(graph);
  EXPECT_TRUE(solver.optimise().converged);
  EXPECT_EQ(solver.poses()[0].translation(), SE2::Point(1, 2));
  EXPECT_EQ(solver.poses()[2].translation(), SE2::Point(-4, 0));
}

TEST(PoseGraph, ADegenerateFactorIsDampedAndNotFatal) {
  PoseGraph<SE2> graph;
  graph.poses = {{}, {1.1, 0.2, 0.1}};
  PoseFactor<SE2> f{0, 1, SE2(1, 0, 0)};
  f.information(2, 2) = 0.0;  // nothing about the angle
  graph.factors = {f};
  PoseGraphSolver<SE2> solver(graph);
  const PoseGraphReport report = solver.optimise();
  for (const SE2& T : solver.poses()) EXPECT_TRUE(T.translation().allFinite() && std::isfinite(T.theta()));
  EXPECT_LE(report.final_cost, report.initial_cost);
}

TEST(PoseGraph, SameGraphSameBits) {
  auto drive = random_drive(6, 400);
  PoseGraphSolver<SE2> a(drive.graph), b(drive.graph);
  a.optimise();
  b.optimise();
  for (std::size_t k = 0; k < a.poses().size(); ++k) {
    EXPECT_EQ(a.poses()[k].translation(), b.poses()[k].translation());
    EXPECT_EQ(a.poses()[k].theta(), b.poses()[k].theta());
  }
}

TEST(PoseGraph, RelaxedPosesAreExactWithoutNoise) {
  auto drive = random_drive(12, 100, 1e-9, 1e-9);
  for (std::size_t k = 1; k < drive.graph.poses.size(); ++k) drive.graph.poses[k] = SE2();
  const std::vector<SE2> relaxed = relaxed_poses(drive.graph);
  for (std::size_t k = 0; k < relaxed.size(); ++k)
    EXPECT_LT((relaxed[k].inverse() * drive.truth[k]).Log().norm(), 1e-5);
}

TEST(PoseGraph, RelaxedPosesDoNotAddUpTheErrorsOfAChain) {
  const auto drive = random_drive(13, 500, 0.05, 0.05);
  const double composed = pose_graph_cost(PoseResidual::log, drive.graph.factors, composed_poses(drive.graph));
  const double relaxed = pose_graph_cost(PoseResidual::log, drive.graph.factors, relaxed_poses(drive.graph));
  EXPECT_LT(relaxed, 0.01 * composed);
}

TEST(PoseGraph, RelaxedPosesOfASingularSystemAreThoseGiven) {
  PoseGraph<SE2> graph;
  graph.poses = {{}, {3, 2, 1}};
  PoseFactor<SE2> f{0, 1, SE2(1, 0, 0)};
  f.information(2, 2) = 0.0;
  graph.factors = {f};
  EXPECT_EQ(relaxed_poses(graph)[1].translation(), SE2::Point(3, 2));
}

// From the chain, LM ends far above (Ceres: LM 1694.6, dogleg 123.06).
TEST(PoseGraph, IntelConvergesFromTheRelaxation) {
  const auto path = test::pose_graph_file("input_INTEL_g2o.g2o");
  if (!path)
    GTEST_SKIP()
        << "no pose_graphs/single/input_INTEL_g2o.g2o; set CONVOY_DATA_DIR to the folder that holds pose_graphs";
  PoseGraph<SE2> graph = pose_graph_se2(read_g2o(*path));
  graph.poses = composed_poses(graph);
  graph.poses = relaxed_poses(graph);
  PoseGraphParams params;
  params.residual = PoseResidual::g2o;
  PoseGraphSolver<SE2> solver(graph, params);
  const PoseGraphReport report = solver.optimise();
  EXPECT_TRUE(report.converged);
  EXPECT_LT(report.final_cost, 108.0);
}

struct Published {
  const char* file;
  double g2o, log;  ///< costs at the optimum, as Ceres 2.1 finds them
};

class PublicGraphs : public testing::TestWithParam<Published> {};

TEST_P(PublicGraphs, ConvergeFromTheChainAndFromTheRelaxation) {
  const auto path = test::pose_graph_file(GetParam().file);
  if (!path)
    GTEST_SKIP() << "no pose_graphs/single/" << GetParam().file
                 << "; set CONVOY_DATA_DIR to the folder that holds pose_graphs";
  PoseGraph<SE2> graph = pose_graph_se2(read_g2o(*path));
  graph.poses = composed_poses(graph);
  for (const bool relaxed : {false, true}) {
    if (relaxed) graph.poses = relaxed_poses(graph);
    for (const PoseResidual kind : {PoseResidual::g2o, PoseResidual::log}) {
      PoseGraphParams params;
      params.residual = kind;
      PoseGraphSolver<SE2> solver(graph, params);
      const PoseGraphReport report = solver.optimise();
      EXPECT_TRUE(report.converged);
      const double expected = kind == PoseResidual::g2o ? GetParam().g2o : GetParam().log;
      EXPECT_NEAR(report.final_cost / expected, 1.0, 1e-6) << report.final_cost;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Single, PublicGraphs,
                         testing::Values(Published{"input_M3500_g2o.g2o", 68.95647547, 68.95743913},
                                         Published{"kitti_05.g2o", 78.55218254, 78.55192465},
                                         Published{"kitti_06.g2o", 12.97354256, 12.97348366},
                                         Published{"kitti_07.g2o", 6.33051813, 6.330518037},
                                         Published{"kitti_09.g2o", 17.19141398, 17.19139353}),
                         [](const auto& i) {
                           return std::string(i.param.file).substr(0, std::string(i.param.file).find('.'));
                         });

}  // namespace
}  // namespace convoy
