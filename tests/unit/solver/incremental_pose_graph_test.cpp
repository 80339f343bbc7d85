#include <convoy/solver/incremental_pose_graph.hpp>

#include <gtest/gtest.h>
#include <convoy/geometry/groups.hpp>
#include <convoy/solver/g2o.hpp>

#include <algorithm>

#include "pose_graph_files.hpp"
#include "random_pose_graph.hpp"

namespace convoy {
namespace {

using test::random_drive;

std::vector<std::vector<PoseFactor<SE2>>> by_newest(const PoseGraph<SE2>& graph) {
  std::vector<std::vector<PoseFactor<SE2>>> result(graph.poses.size());
  for (const auto& f : graph.factors) result[static_cast<std::size_t>(std::max(f.from, f.to))].push_back(f);
  return result;
}

double largest_difference(const std::vector<SE2>& a, const std::vector<SE2>& b) {
  double largest = 0.0;
  for (std::size_t k = 0; k < a.size(); ++k)
    largest = std::max(largest, (a[k].inverse() * b[k]).Log().cwiseAbs().maxCoeff());
  return largest;
}

/// Relinearises and hands down whatever moves at all: the estimate is then the exact one as soon as it stands still.
IncrementalParams exact() {
  IncrementalParams params;
  params.relinearise_m = params.relinearise_rad = 1e-9;
  params.propagate = 0.0;
  params.again_factor = 1.0;
  return params;
}

class Drives : public testing::TestWithParam<unsigned> {};

// The tree of fronts, taken apart and rebuilt at every loop, gives at every moment what a batch solution gives.
TEST_P(Drives, EveryMomentEqualsBatch) {
  const auto drive = random_drive(GetParam(), 150);
  const auto factors = by_newest(drive.graph);
  IncrementalPoseGraph<SE2> incremental(drive.graph.poses[0], exact());
  PoseGraph<SE2> so_far;
  so_far.poses.push_back(drive.graph.poses[0]);
  int loops = 0;
  for (std::size_t k = 1; k < factors.size(); ++k) {
    ASSERT_TRUE(incremental.add(factors[k]));
    ASSERT_FALSE(incremental.last_update().failed);
    loops += factors[k].size() > 1;
    so_far.factors.insert(so_far.factors.end(), factors[k].begin(), factors[k].end());
    so_far.poses.emplace_back();
    if (k % 10) continue;
    for (int again = 0; again < 6; ++again) ASSERT_TRUE(incremental.add_factors({}));
    PoseGraph<SE2> batch_graph{incremental.poses(), so_far.factors};
    PoseGraphSolver<SE2> batch(batch_graph);
    ASSERT_TRUE(batch.optimise().converged);
    EXPECT_LT(largest_difference(incremental.poses(), batch.poses()), 1e-6) << "pose " << k;
  }
  EXPECT_GT(loops, 5);
}

TEST_P(Drives, FinishIsTheBatchSolution) {
  const auto drive = random_drive(GetParam(), 400);
  const auto factors = by_newest(drive.graph);
  IncrementalPoseGraph<SE2> incremental(drive.graph.poses[0]);
  for (std::size_t k = 1; k < factors.size(); ++k) ASSERT_TRUE(incremental.add(factors[k]));
  PoseGraphSolver<SE2> batch(drive.graph);
  const PoseGraphReport expected = batch.optimise();
  ASSERT_TRUE(expected.converged);
  // Even before, the estimate is nearly optimal.
  EXPECT_LT(pose_graph_cost(PoseResidual::log, incremental.factors(), incremental.poses()), 1.02 * expected.final_cost);
  const PoseGraphReport report = incremental.finish();
  EXPECT_TRUE(report.converged);
  EXPECT_NEAR(report.final_cost / expected.final_cost, 1.0, 1e-9);
  EXPECT_LT(largest_difference(incremental.poses(), batch.poses()), 1e-6);
}

TEST_P(Drives, GoesOnAfterFinish) {
  const auto drive = random_drive(GetParam(), 300);
  const auto factors = by_newest(drive.graph);
  IncrementalPoseGraph<SE2> incremental(drive.graph.poses[0]);
  for (std::size_t k = 1; k < factors.size(); ++k) {
    ASSERT_TRUE(incremental.add(factors[k]));
    if (k == 150) incremental.finish();
  }
  PoseGraphSolver<SE2> batch(drive.graph);
  batch.optimise();
  incremental.finish();
  EXPECT_LT(largest_difference(incremental.poses(), batch.poses()), 1e-6);
}

INSTANTIATE_TEST_SUITE_P(Seeds, Drives, testing::Values(1U, 2U, 3U, 4U, 5U));

// Whatever is asked for, at any moment, against the inverse of the whole system: poses in the tree and behind it.
TEST(IncrementalPoseGraph, CovariancesAreThoseOfTheWholeSystem) {
  auto drive = random_drive(2, 120);
  for (std::size_t k = 1; k < drive.graph.factors.size(); k += 3) {  // some the other way round
    PoseFactor<SE2>& f = drive.graph.factors[k];
    const SE2::Adjoint A = f.measured.inverse().adjoint();
    f = {f.to, f.from, f.measured.inverse(), A.transpose() * f.information * A};
  }
  const auto factors = by_newest(drive.graph);
  IncrementalPoseGraph<SE2> incremental(drive.graph.poses[0], exact());
  int behind = 0;
  for (std::size_t k = 1; k < factors.size(); ++k) {
    ASSERT_TRUE(incremental.add(factors[k]));
    behind += incremental.last_update().fronts == 0;
    if (k < 100) continue;
    for (int again = 0; again < 6; ++again) ASSERT_TRUE(incremental.add_factors({}));
    PoseGraphSolver<SE2> batch({incremental.poses(), incremental.factors()});
    ASSERT_TRUE(batch.iterate());
    const auto marginals = batch.marginals();
    const int n = incremental.size();
    for (const int i : {0, 1, n / 2, n - 2, n - 1}) {
      EXPECT_LT((incremental.covariance(i, i) - marginals[static_cast<std::size_t>(i)]).norm(),
                1e-5 * (1e-9 + marginals[static_cast<std::size_t>(i)].norm()))
          << i << " of " << n;
      for (const int j : {1, n / 3, n - 1}) {
        const SE2::Adjoint expected =
            i == 0 ? SE2::Adjoint::Zero() : SE2::Adjoint(batch.cholesky().covariance(i - 1, j - 1));
        EXPECT_LT((incremental.covariance(i, j) - expected).norm(), 1e-5 * (1e-9 + expected.norm()))
            << i << ", " << j << " of " << n;
      }
    }
  }
  EXPECT_GT(behind, 10);
}

TEST(IncrementalPoseGraph, OdometryAloneFactorsNothing) {
  const auto drive = random_drive(7, 30);
  IncrementalPoseGraph<SE2> incremental(drive.graph.poses[0]);
  const auto factors = by_newest(drive.graph);
  for (std::size_t k = 1; k < 5; ++k) {
    ASSERT_EQ(factors[k].size(), 1U);
    ASSERT_TRUE(incremental.add(factors[k]));
    EXPECT_EQ(incremental.last_update().fronts, 0);
    EXPECT_LT(largest_difference({incremental.pose(static_cast<int>(k))}, {drive.graph.poses[k]}), 1e-12);
  }
}

TEST(IncrementalPoseGraph, LateFactorsBetweenOldPoses) {
  auto drive = random_drive(8, 200);
  const auto factors = by_newest(drive.graph);
  IncrementalPoseGraph<SE2> incremental(drive.graph.poses[0]);
  std::vector<PoseFactor<SE2>> late;
  for (std::size_t k = 1; k < factors.size(); ++k) {
    ASSERT_TRUE(incremental.add(std::span(factors[k]).first(1)));
    late.insert(late.end(), factors[k].begin() + 1, factors[k].end());
  }
  ASSERT_GT(late.size(), 10U);
  for (const auto& f : late) ASSERT_TRUE(incremental.add_factors(std::span(&f, 1)));
  PoseGraphSolver<SE2> batch(drive.graph);
  batch.optimise();
  EXPECT_NEAR(incremental.finish().final_cost / batch.optimise().final_cost, 1.0, 1e-9);
}

TEST(IncrementalPoseGraph, RefusesWhatItCannotPlace) {
  IncrementalPoseGraph<SE2> incremental{SE2()};
  const PoseFactor<SE2> odometry{0, 1, SE2(1, 0, 0)};
  EXPECT_FALSE(incremental.add({}));
  for (const auto& [a, b] : {std::pair{0, 2}, {1, 1}, {-1, 1}, {0, 0}, {5, 1}}) {
    const PoseFactor<SE2> wrong{a, b, SE2()};
    EXPECT_FALSE(incremental.add(std::span(&wrong, 1))) << a << ", " << b;
  }
  EXPECT_EQ(incremental.size(), 1);
  ASSERT_TRUE(incremental.add(std::span(&odometry, 1)));
  const PoseFactor<SE2> beyond{0, 2, SE2()};
  EXPECT_FALSE(incremental.add_factors(std::span(&beyond, 1)));
  EXPECT_EQ(incremental.factors().size(), 1U);
  EXPECT_EQ(incremental.size(), 2);
}

TEST(IncrementalPoseGraph, RecoversFromAFactorThatIsNone) {
  auto drive = random_drive(9, 120);
  const auto factors = by_newest(drive.graph);
  IncrementalPoseGraph<SE2> incremental(drive.graph.poses[0]);
  PoseGraph<SE2> whole;
  whole.poses = {drive.graph.poses[0]};
  bool failed = false;
  for (std::size_t k = 1; k < factors.size(); ++k) {
    auto now = factors[k];
    if (k == 60) {  // a pose of which nothing says its angle, and a loop so that it enters the tree
      for (auto& f : now)
        f.information(2, 2) = f.information(0, 2) = f.information(2, 0) = f.information(1, 2) = f.information(2, 1) =
            0.0;
      PoseFactor<SE2> again = now[0];
      now.push_back(again);
    }
    ASSERT_TRUE(incremental.add(now));
    failed |= incremental.last_update().failed;
    for (const SE2& T : incremental.poses()) ASSERT_TRUE(T.translation().allFinite());
    whole.factors.insert(whole.factors.end(), now.begin(), now.end());
    whole.poses.emplace_back();
  }
  EXPECT_TRUE(failed);
  EXPECT_FALSE(incremental.last_update().failed);
  whole.poses = composed_poses(whole);
  PoseGraphSolver<SE2> batch(whole);
  EXPECT_NEAR(incremental.finish().final_cost / batch.optimise().final_cost, 1.0, 1e-8);
}

TEST(IncrementalPoseGraph, SameOrderSameBits) {
  const auto drive = random_drive(10, 300);
  const auto factors = by_newest(drive.graph);
  const auto run = [&] {
    IncrementalPoseGraph<SE2> incremental(drive.graph.poses[0]);
    for (std::size_t k = 1; k < factors.size(); ++k) EXPECT_TRUE(incremental.add(factors[k]));
    return incremental.poses();
  };
  const std::vector<SE2> a = run(), b = run();
  for (std::size_t k = 0; k < a.size(); ++k) {
    EXPECT_EQ(a[k].translation(), b[k].translation());
    EXPECT_EQ(a[k].theta(), b[k].theta());
  }
}

TEST(IncrementalPoseGraph, M3500EndsAtTheExactCost) {
  const auto path = test::pose_graph_file("input_M3500_g2o.g2o");
  if (!path)
    GTEST_SKIP()
        << "no pose_graphs/single/input_M3500_g2o.g2o; set CONVOY_DATA_DIR to the folder that holds pose_graphs";
  const PoseGraph<SE2> graph = pose_graph_se2(read_g2o(*path));
  const auto factors = by_newest(graph);
  IncrementalParams params;
  params.residual = PoseResidual::g2o;
  IncrementalPoseGraph<SE2> incremental(graph.poses[0], params);
  for (std::size_t k = 1; k < factors.size(); ++k) {
    ASSERT_TRUE(incremental.add(factors[k]));
    ASSERT_FALSE(incremental.last_update().failed);
  }
  EXPECT_LT(pose_graph_cost(PoseResidual::g2o, incremental.factors(), incremental.poses()), 69.012);
  EXPECT_NEAR(incremental.finish().final_cost / 68.95647547, 1.0, 1e-6);
}

}  // namespace
}  // namespace convoy
