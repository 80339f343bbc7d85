#include "scenario/gps_reference.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "evaluate/truth.hpp"
#include "scenario/counter_rng.hpp"

namespace convoy::cli {
namespace {

constexpr double speed_m_s = 3.0, yaw_rate_rad_s = 0.03, length_s = 100.0;
const SE2 T_world_start(200.0, -50.0, 2.0);
const Eigen::Vector2d lever_m(3.78, 0.5);

SE2 true_pose(double t_s) { return T_world_start * SE2::Exp(SE2::Tangent(speed_m_s * t_s, 0.0, yaw_rate_rad_s * t_s)); }

std::vector<SensorEvent> odometry() {
  std::vector<SensorEvent> events;
  for (int i = 0; i <= 1000; ++i) events.push_back(SensorEvent::odometry(0.1 * i, speed_m_s, yaw_rate_rad_s));
  return events;
}

/// Five per second, off by 0.3 m each way; where `jump` says so by 8 m to the east besides.
template <class Jump>
std::vector<GpsFix> fixes(const Jump& jump) {
  const CounterRng rng(1, 1, 0);
  std::vector<GpsFix> result;
  for (std::uint32_t i = 0; i <= 500; ++i) {
    const double t_s = 0.2 * i;
    const Eigen::Vector2d noise(0.3 * rng.normal(i, 0), 0.3 * rng.normal(i, 1));
    result.push_back({t_s, true_pose(t_s) * lever_m + noise + Eigen::Vector2d(jump(t_s) ? 8.0 : 0.0, 0.0)});
  }
  return result;
}

GpsReference reference(const std::vector<GpsFix>& fixes) {
  GpsReferenceParams params;
  params.lever_m = lever_m;
  return gps_reference(ReckonedPath(odometry()), fixes, 0.25, params);
}

void expect_true(const GpsReference& reference) {
  for (const TruthPose<SE2>& pose : reference.poses) {
    const SE2::Tangent error = (true_pose(pose.t_s).inverse() * pose.T_world_body).Log();
    EXPECT_LT(error.head<2>().norm(), 0.3) << pose.t_s;
    EXPECT_LT(std::abs(error[2]), 0.02) << pose.t_s;
  }
}

TEST(ReckonedPath, IsThereAtAnyMoment) {
  const ReckonedPath path(odometry());
  const ReckonedPose pose = path.at(12.34);
  EXPECT_NEAR(pose.driven_m, speed_m_s * 12.34, 1e-9);
  EXPECT_LT(((T_world_start * pose.T_local_body).inverse() * true_pose(12.34)).Log().norm(), 1e-9);
  EXPECT_EQ(path.at(-1.0).driven_m, 0.0);
}

TEST(GpsReference, LiesWhereGpsSaysAndHeadsWhereTheDriveDoes) {
  const GpsReference all = reference(fixes([](double) { return false; }));
  EXPECT_EQ(all.poses.size(), 401U);
  EXPECT_EQ(all.residuals_m.size(), all.poses.size());
  expect_true(all);
}

TEST(GpsReference, StepsOverAShortJumpAndIsSilentInALongOne) {
  const GpsReference steady = reference(fixes([](double t_s) { return t_s > 50.0 && t_s < 54.0; }));
  EXPECT_EQ(steady.poses.size(), 401U);
  expect_true(steady);
  const GpsReference broken = reference(fixes([](double t_s) { return t_s > 40.0 && t_s < 60.0; }));
  for (const TruthPose<SE2>& pose : broken.poses) EXPECT_GT(std::abs(pose.t_s - 41.0), 0.5);
  EXPECT_FALSE(truth_at(broken.poses, 41.0));
  EXPECT_TRUE(truth_at(broken.poses, 20.0));
}

TEST(GpsReference, IsSilentInAGap) {
  std::vector<GpsFix> some = fixes([](double) { return false; });
  std::erase_if(some, [](const GpsFix& fix) { return fix.t_s > 40.0 && fix.t_s < 60.0; });
  const GpsReference reference_ = reference(some);
  EXPECT_FALSE(truth_at(reference_.poses, 50.0));
  EXPECT_TRUE(truth_at(reference_.poses, 43.0));
  expect_true(reference_);
  EXPECT_TRUE(reference({}).poses.empty());
}

}  // namespace
}  // namespace convoy::cli
