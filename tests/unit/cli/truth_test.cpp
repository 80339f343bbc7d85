#include "evaluate/truth.hpp"
#include "evaluate/truth_depth.hpp"

#include <gtest/gtest.h>

#include "scenario/counter_rng.hpp"

namespace convoy::cli {
namespace {

TEST(FitRigid, RecoversAKnownMotion) {
  const SE2 T(3.0, -2.0, 2.9);
  std::vector<Eigen::Vector2d> from, to;
  const CounterRng rng(1, 0, 0);
  for (std::uint32_t i = 0; i < 50; ++i) {
    from.emplace_back(10.0 * rng.normal(i, 0), rng.normal(i, 1));
    to.push_back(T * from.back());
  }
  const auto fit = fit_rigid<SE2>(from, to);
  ASSERT_TRUE(fit);
  EXPECT_LT((fit->T_to_from.inverse() * T).Log().norm(), 1e-12);
  EXPECT_LT(fit->rmse_m, 1e-12);
}

TEST(FitRigid, DoesNotScale) {
  const auto fit = fit_rigid<SE2>({{-1.0, 0.0}, {1.0, 0.0}}, {{-2.0, 0.0}, {2.0, 0.0}});
  ASSERT_TRUE(fit);
  EXPECT_NEAR(fit->rmse_m, 1.0, 1e-12);
}

TEST(FitRigid, IsEmptyWhenThePointsDoNotFixIt) {
  EXPECT_FALSE(fit_rigid<SE2>({}, {}));
  EXPECT_FALSE(fit_rigid<SE2>({{1.0, 2.0}}, {{3.0, 4.0}}));
  EXPECT_FALSE(fit_rigid<SE2>({{1.0, 2.0}, {2.0, 3.0}}, {{3.0, 4.0}}));
  EXPECT_FALSE(fit_rigid<SE2>({{1.0, 2.0}, {1.0, 2.0}}, {{3.0, 4.0}, {4.0, 4.0}}));
}

TEST(TruthAt, FollowsTheArcAndStopsAtGaps) {
  const SE2 quarter = SE2::Exp({0.5 * M_PI, 0.0, 0.5 * M_PI});  // a quarter of the unit circle
  const std::vector<TruthPose<SE2>> truth{{1.0, SE2()}, {1.4, quarter}, {9.0, quarter}};
  EXPECT_FALSE(truth_at(truth, 0.9));
  EXPECT_FALSE(truth_at(truth, 2.0));
  EXPECT_FALSE(truth_at(truth, 9.1));
  EXPECT_FALSE(truth_at<SE2>({}, 1.0));
  ASSERT_TRUE(truth_at(truth, 1.2));
  const SE2 middle = *truth_at(truth, 1.2);
  EXPECT_NEAR(middle.theta(), 0.25 * M_PI, 1e-12);
  EXPECT_NEAR((middle.translation() - Eigen::Vector2d(0.0, 1.0)).norm(), 1.0, 1e-12);
  EXPECT_TRUE(truth_at(truth, 9.0));
}

TEST(TruthMount, IsFoundFromTheTruthAlone) {
  const SE2 T_body_truth(0.03, 0.0, -0.015);
  std::vector<TruthPose<SE2>> truth;
  SE2 T_world_body(5.0, 3.0, 1.0);
  const CounterRng rng(2, 0, 0);
  for (std::uint32_t i = 0; i < 4000; ++i) {
    const double omega = 0.4 * std::sin(0.004 * i);
    T_world_body = T_world_body * SE2::Exp({0.15 * 0.05, 0.0, omega * 0.05});
    const SE2 jitter(2e-4 * rng.normal(i, 0), 2e-4 * rng.normal(i, 1), 1e-3 * rng.normal(i, 2));
    truth.push_back({0.05 * i, T_world_body * T_body_truth * jitter});
  }
  for (std::size_t i = 1000; i < 1010; ++i)
    truth[i].T_world_body = truth[i].T_world_body * SE2(0.0, 0.5, 0.3);  // a lost marker
  const auto mount = find_truth_mount(truth);
  ASSERT_TRUE(mount);
  EXPECT_NEAR(mount->heading_rad, -0.015, 1e-3);
  EXPECT_NEAR(mount->forward_m, 0.03, 2e-3);
}

TEST(TruthMount, IsEmptyForAVehicleThatStands) {
  std::vector<TruthPose<SE2>> truth;
  for (int i = 0; i < 1000; ++i) truth.push_back({0.05 * i, SE2(1.0, 2.0, 0.5)});
  EXPECT_FALSE(find_truth_mount(truth));
  EXPECT_FALSE(find_truth_mount({}));
}

TEST(TruthDepth, OfACornerAtASilhouetteIsThatOfWhatIsInFront) {
  constexpr int width = 12, height = 8;
  std::vector<float> depth(width * height, 15.0F);
  for (int r = 0; r < height; ++r)
    for (int c = 0; c < 6; ++c) depth[static_cast<std::size_t>(r * width + c)] = 7.0F;  // a wall on the left
  EXPECT_EQ(depth_of_corner(depth, width, height, 5.4, 4.0), 7.0);
  EXPECT_EQ(depth_of_corner(depth, width, height, 5.6, 4.0), 7.0) << "its pixel shows what is behind";
  EXPECT_EQ(depth_of_corner(depth, width, height, 9.0, 4.0), 15.0);
  for (int r = 0; r < height; ++r)  // a slope is one surface
    for (int c = 0; c < width; ++c)
      depth[static_cast<std::size_t>(r * width + c)] = 15.0F + 0.1F * static_cast<float>(c);
  EXPECT_EQ(depth_of_corner(depth, width, height, 6.0, 4.0), static_cast<double>(15.0F + 0.1F * 6.0F));
  std::fill(depth.begin(), depth.end(), 0.0F);
  EXPECT_EQ(depth_of_corner(depth, width, height, 6.0, 4.0), 0.0) << "nothing but sky";
  depth[4 * width + 7] = 20.0F;
  EXPECT_EQ(depth_of_corner(depth, width, height, 6.0, 4.0), 20.0) << "the tip of something before the sky";
  for (const double u : {-1.0, 12.0}) EXPECT_EQ(depth_of_corner(depth, width, height, u, 4.0), 0.0);
}

}  // namespace
}  // namespace convoy::cli
