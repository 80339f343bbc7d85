#include <convoy/monocular/triangulation.hpp>

#include "monocular_world.hpp"

#include <gtest/gtest.h>

namespace convoy {
namespace {

struct Track {
  Track(test::Random& random, const CameraModel& camera, double sigma_px, int views = 8) {
    point = {random.uniform(-6.0, 6.0), random.uniform(-4.0, 1.0), random.uniform(12.0, 25.0)};
    for (int k = 0; k < views; ++k) {
      const SE3 T(SE3::Quaternion(1.0, 0.01 * k, -0.02 * k, 0.005 * k), {0.1 * k, -0.02 * k, 0.5 * k});
      const auto at = camera.project(T.inverse() * point);
      if (at) seen.push_back({T, at->pixel + sigma_px * random.unit_normal<2>()});
    }
  }
  Eigen::Vector3d point;
  std::vector<TrackView> seen;
};

TEST(Triangulation, FindsAPointFromItsExactPixels) {
  test::Random random(1);
  const CameraModel camera(test::street_camera());
  for (int k = 0; k < 50; ++k) {
    const Track track(random, camera, 0.0);
    if (track.seen.size() < 4) continue;
    for (const std::size_t anchor : {std::size_t{0}, track.seen.size() - 1}) {
      const auto t = triangulate(camera, track.seen, anchor, 1.0);
      ASSERT_TRUE(t);
      const Eigen::Vector3d p = track.seen[anchor].T_frame_camera * Eigen::Vector3d(t->bearing / t->inverse_depth);
      ASSERT_LT((p - track.point).norm(), 1e-4);
      ASSERT_LT(t->worst_px, 1e-4);
    }
  }
}

TEST(Triangulation, ItsInverseDepthIsAsUncertainAsItSays) {
  test::Random random(2);
  const CameraModel camera(test::street_camera());
  double nees = 0.0;
  int n = 0;
  for (int k = 0; k < 600; ++k) {
    const Track track(random, camera, 1.0);
    if (track.seen.size() < 6) continue;
    const auto t = triangulate(camera, track.seen, track.seen.size() - 1, 1.0);
    if (!t || t->sigma_inverse_depth > 0.3 * t->inverse_depth) continue;
    const double truth = 1.0 / (track.seen.back().T_frame_camera.inverse() * track.point).norm();
    nees += std::pow((t->inverse_depth - truth) / t->sigma_inverse_depth, 2);
    ++n;
  }
  ASSERT_GT(n, 200);
  EXPECT_NEAR(nees / n, 1.0, 0.25);
}

TEST(Triangulation, RefusesWhatIsBehindOrShowsNoParallax) {
  const CameraModel camera(test::street_camera());
  std::vector<TrackView> rotating, crossing;
  for (int k = 0; k < 5; ++k) {
    const SE3 T(SE3::Quaternion(1.0, 0.0, 0.01 * k, 0.0), {0.0, 0.0, 0.0});
    rotating.push_back({T, camera.project(T.inverse() * Eigen::Vector3d(1.0, 0.0, 10.0))->pixel});
    // Rays that would meet behind the camera.
    crossing.push_back({SE3(SE3::Quaternion(1.0, 0.0, 0.0, 0.0), {0.3 * k, 0.0, 0.0}), {319.5 + 20.0 * k, 239.5}});
  }
  const auto t = triangulate(camera, rotating, 4, 1.0);
  EXPECT_TRUE(!t || t->sigma_inverse_depth > t->inverse_depth);
  EXPECT_FALSE(triangulate(camera, crossing, 4, 1.0));
}

TEST(Triangulation, FindsTheViewsThatFitAmongOutliers) {
  test::Random random(3);
  const CameraModel camera(test::street_camera());
  int tracks = 0, whole = 0;
  for (int k = 0; k < 60; ++k) {
    Track track(random, camera, 0.5, 10);
    if (track.seen.size() < 9) continue;
    ++tracks;
    for (const std::size_t i : {1, 4, 6}) track.seen[i].pixel += Eigen::Vector2d(15.0, -20.0);
    const auto views = consistent_views(camera, track.seen, 3.0);
    const bool clean = std::none_of(views.begin(), views.end(), [](auto i) { return i == 1 || i == 4 || i == 6; });
    whole += clean && views.size() + 4 >= track.seen.size() ? 1 : 0;
  }
  ASSERT_GT(tracks, 20);
  EXPECT_GE(whole, tracks * 9 / 10);
}

}  // namespace
}  // namespace convoy
