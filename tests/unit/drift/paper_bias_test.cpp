#include <convoy/drift/paper_bias.hpp>

#include <gtest/gtest.h>

namespace convoy::paper {
namespace {

TEST(PaperBias, Equation1TurnsAboutTheOriginOfTheSlamThenShifts) {
  const Bias bias{{10.0, -5.0, M_PI / 2.0}, {}};
  const Eigen::Vector3d v_u = unbiased_pose(bias, {3.0, 4.0, 0.25});
  EXPECT_TRUE(v_u.isApprox(Eigen::Vector3d(10.0 - 4.0, -5.0 + 3.0, 0.25 + M_PI / 2.0), 1e-14)) << v_u.transpose();
}

TEST(PaperBias, Equation2TreatsALandmarkLikeThePositionOfAPose) {
  const Bias bias{{1.0, 2.0, 0.3}, {}};
  const Eigen::Vector3d v_u = unbiased_pose(bias, {-7.0, 3.0, 0.0});
  EXPECT_TRUE(unbiased_landmark(bias, {-7.0, 3.0}).isApprox(v_u.head<2>(), 1e-14));
  EXPECT_TRUE(unbiased_landmark(bias, {0.0, 0.0}).isApprox(Eigen::Vector2d(1.0, 2.0), 1e-14));
}

TEST(PaperBias, Equations3And4AreARandomWalkInTheDistance) {
  const Eigen::Matrix3d P_eps = Eigen::Vector3d(2e-4, 3e-4, 4e-6).asDiagonal();
  Bias bias{{1.0, 2.0, 0.3}, Eigen::Matrix3d::Identity()};
  for (int step = 0; step < 100; ++step) bias = propagated(bias, 2.5, P_eps);
  EXPECT_EQ(bias.b, Eigen::Vector3d(1.0, 2.0, 0.3));
  EXPECT_TRUE(bias.P_b.isApprox(Eigen::Matrix3d::Identity() + 250.0 * P_eps, 1e-12));
}

TEST(PaperBias, TheBiasOfAnAnchorTakesItsSlamPoseToTheCommonFrame) {
  const SE2 T_common_body(30.0, -4.0, 1.2), T_slam_body(28.0, 1.0, 0.9);
  const Bias bias{bias_of(T_common_body, T_slam_body), {}};
  const Eigen::Vector3d v_u = unbiased_pose(bias, {28.0, 1.0, 0.9});
  EXPECT_TRUE(v_u.isApprox(Eigen::Vector3d(30.0, -4.0, 1.2), 1e-12)) << v_u.transpose();
}

}  // namespace
}  // namespace convoy::paper
