#include <convoy/vision/active_search.hpp>
#include <convoy/vision/patch_warp.hpp>

#include "drawn_scene.hpp"

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include <limits>

namespace convoy {
namespace {

CameraCalibration pinhole() {
  CameraCalibration c;
  c.width = 640, c.height = 480;
  c.fx = 400.0, c.fy = 410.0, c.cx = 321.0, c.cy = 238.0;
  return c;
}

CameraCalibration distorted() {
  CameraCalibration c = pinhole();
  c.coefficients << -0.2, 0.05, 0.001, -0.0005, 0.0;
  return c;
}

CameraCalibration fisheye() {
  CameraCalibration c = pinhole();
  c.distortion = CameraCalibration::Distortion::equidistant;
  c.fx = c.fy = 250.0;
  c.coefficients << 0.01, -0.003, 0.0, 0.0, 0.0;
  return c;
}

SE3 motion() { return SE3::Exp((SE3::Tangent() << 0.3, -0.1, -1.2, 0.05, -0.1, 0.2).finished()); }

/// Where a pixel near `of` comes to lie, by intersecting its ray with the plane.
Eigen::Vector2d by_intersection(const CameraModel& camera, const Eigen::Vector2d& of, const Eigen::Vector2d& pixel,
                                double distance_m, PatchPlane plane) {
  const Eigen::Vector3d ray = camera.ray(of), other = camera.ray(pixel);
  const Eigen::Vector3d normal = plane == PatchPlane::towards_camera ? ray : Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d point = other * (distance_m * ray.dot(normal) / other.dot(normal));
  return camera.project(motion() * point)->pixel;
}

TEST(PatchWarp, IsTheDerivativeOfTheHomography) {
  for (const CameraCalibration& calibration : {pinhole(), distorted(), fisheye()})
    for (const PatchPlane plane : {PatchPlane::towards_camera, PatchPlane::fronto_parallel})
      for (const Eigen::Vector2d& pixel : {Eigen::Vector2d(320, 240), {100.5, 80.25}, {560, 400}}) {
        const CameraModel camera(calibration);
        const double distance_m = 6.0, step = 1e-4;
        const auto warp = warp_of_plane(camera, pixel, 1.0 / distance_m, motion(), plane);
        ASSERT_TRUE(warp);
        EXPECT_LT((warp->pixel - by_intersection(camera, pixel, pixel, distance_m, plane)).norm(), 1e-6);
        for (int i = 0; i < 2; ++i) {
          const Eigen::Vector2d d = step * Eigen::Vector2d::Unit(i);
          const Eigen::Vector2d numeric = (by_intersection(camera, pixel, pixel + d, distance_m, plane) -
                                           by_intersection(camera, pixel, pixel - d, distance_m, plane)) /
                                          (2.0 * step);
          EXPECT_LT((warp->now_from_ref.col(i) - numeric).norm(), 1e-5) << pixel.transpose();
        }
      }
}

TEST(PatchWarp, OfAPointInfinitelyFarIsARotation) {
  const CameraModel camera(pinhole());
  const SE3 ahead(SE3::Quaternion(1, 0, 0, 0), {0.0, 0.0, -100.0});
  const auto warp = warp_of_plane(camera, {200, 150}, 0.0, ahead);
  ASSERT_TRUE(warp);
  EXPECT_LT((warp->pixel - Eigen::Vector2d(200, 150)).norm(), 1e-9);
  EXPECT_LT((warp->now_from_ref - Eigen::Matrix2d::Identity()).norm(), 1e-9);
}

TEST(PatchWarp, RefusesWhatCannotBeSeen) {
  constexpr double nan_value = std::numeric_limits<double>::quiet_NaN();
  const CameraModel camera(pinhole());
  const auto moved = [](double z_m) { return SE3(SE3::Quaternion(1, 0, 0, 0), {0.0, 0.0, z_m}); };
  EXPECT_FALSE(warp_of_plane(camera, {320, 240}, 0.2, moved(-6.0)));  // behind the camera
  EXPECT_FALSE(warp_of_plane(camera, {nan_value, 240}, 0.2, moved(0.0)));
  EXPECT_FALSE(warp_of_plane(camera, {320, 240}, nan_value, moved(0.0)));
  EXPECT_FALSE(warp_of_plane(camera, {320, 240}, -0.1, moved(0.0)));
  EXPECT_FALSE(warp_of_plane(camera, {320, 240}, std::numeric_limits<double>::infinity(), moved(-1.0)));
  EXPECT_FALSE(warp_of_plane(camera, {320, 240}, 0.2, moved(nan_value)));
  // From beside the plane: edgewise.
  const SE3 aside = SE3::Exp((SE3::Tangent() << 0, 0, 0, 0, M_PI / 2, 0).finished()) *
                    SE3(SE3::Quaternion(1, 0, 0, 0), {4.0, 0.0, -5.0});
  EXPECT_FALSE(warp_of_plane(camera, {320, 240}, 0.2, aside));
}

/// A textured wall 8 m ahead, seen again from 2.2 m nearer, to the right, and turned.
TEST(PatchWarp, LeadsTheSearchToTheTruePlaces) {
  const CameraModel camera(distorted());
  const cv::Mat texture = test::random_texture(1700, 1400, 21);
  constexpr double wall_m = 8.0, px_per_m = 70.0;
  const SE3 T_now_ref = SE3::Exp((SE3::Tangent() << -0.5, 0.1, -2.2, 0.02, 0.1, 0.25).finished());
  const auto view_from = [&](const SE3& T_camera_ref) {
    const SE3 T_ref_camera = T_camera_ref.inverse();
    return test::draw(
        texture, 640, 480,
        [&](const Eigen::Vector2d& p) -> Eigen::Vector2d {
          const Eigen::Vector3d from = T_ref_camera.translation(), along = T_ref_camera.rotation() * camera.ray(p);
          const Eigen::Vector3d point = from + along * ((wall_m - from.z()) / along.z());
          return px_per_m * point.head<2>() + Eigen::Vector2d(850, 700);
        },
        2);
  };
  ImagePyramid before(640, 480), now(640, 480);
  ASSERT_EQ(before.set(view_from(SE3())), ImagePyramid::Status::ok);
  ASSERT_EQ(now.set(view_from(T_now_ref)), ImagePyramid::Status::ok);
  ActiveSearch search;
  int tried = 0, right = 0;
  for (int y = 60; y <= 420; y += 40)
    for (int x = 60; x <= 580; x += 40) {
      const Eigen::Vector2d pixel(x, y);
      const Eigen::Vector3d ray = camera.ray(pixel);
      const auto warp = warp_of_plane(camera, pixel, ray.z() / wall_m, T_now_ref, PatchPlane::fronto_parallel);
      const auto patch = ReferencePatch::take(before, pixel);
      if (!warp || !patch || !camera.in_image(warp->pixel, 20.0) ||
          search.judge(*patch) != PatchSearchResult::Status::found)
        continue;
      ++tried;
      const auto result = search.find(
          now, *patch,
          {warp->pixel + Eigen::Vector2d(2.0, -1.5), 4.0 * Eigen::Matrix2d::Identity(), warp->now_from_ref});
      right += result.status == PatchSearchResult::Status::found && (result.pixel - warp->pixel).norm() < 0.5;
    }
  std::printf("%d of %d places of the wall found within 0.5 px\n", right, tried);
  EXPECT_GE(tried, 60);
  EXPECT_GE(right, 0.95 * tried);
}

}  // namespace
}  // namespace convoy
