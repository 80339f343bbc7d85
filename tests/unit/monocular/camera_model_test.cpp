#include <convoy/config_error.hpp>
#include <convoy/monocular/camera_model.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <string>

namespace convoy {
namespace {

using Distortion = CameraCalibration::Distortion;

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

CameraCalibration pinhole() {
  CameraCalibration c;
  c.width = 640;
  c.height = 480;
  c.fx = 420.0;
  c.fy = 415.0;
  c.cx = 322.0;
  c.cy = 238.5;
  return c;
}

CameraCalibration radial_tangential() {
  CameraCalibration c = pinhole();
  c.coefficients << -0.28, 0.074, 1.9e-4, 1.8e-5, 0.002;
  return c;
}

CameraCalibration equidistant() {
  CameraCalibration c = pinhole();
  c.distortion = Distortion::equidistant;
  c.fx = c.fy = 290.0;
  c.coefficients << -0.013, 0.02, -0.013, 0.0026, 0.0;
  return c;
}

const CameraCalibration all[] = {pinhole(), radial_tangential(), equidistant()};

TEST(CameraModel, TheRayOfAPixelMeetsThatPixel) {
  for (const CameraCalibration& c : all) {
    const CameraModel model(c);
    for (int x = 0; x < c.width; x += 13)
      for (int y = 0; y < c.height; y += 13) {
        const Eigen::Vector3d ray = model.ray({x, y});
        ASSERT_NEAR(ray.norm(), 1.0, 1e-14);
        const auto at = model.project(7.0 * ray);
        ASSERT_TRUE(at) << x << " " << y;
        ASSERT_LT((at->pixel - Eigen::Vector2d(x, y)).norm(), 1e-9) << x << " " << y;
      }
  }
}

TEST(CameraModel, TheJacobianIsThatOfTheProjection) {
  test::Random random(3);
  for (const CameraCalibration& c : all) {
    const CameraModel model(c);
    for (int k = 0; k < 200; ++k) {
      const Eigen::Vector2d pixel(random.uniform(0.0, c.width - 1.0), random.uniform(0.0, c.height - 1.0));
      const Eigen::Vector3d p = random.uniform(0.5, 30.0) * model.ray(pixel);
      const auto at = model.project(p);
      ASSERT_TRUE(at);
      for (int axis = 0; axis < 3; ++axis) {
        const Eigen::Vector3d step = 1e-6 * p.norm() * Eigen::Vector3d::Unit(axis);
        const Eigen::Vector2d numeric =
            (model.project(p + step)->pixel - model.project(p - step)->pixel) / (2.0 * step.norm());
        ASSERT_LT((at->jacobian.col(axis) - numeric).norm(), 1e-6 * (1.0 + at->jacobian.norm())) << p.transpose();
      }
    }
  }
}

TEST(CameraModel, TheJacobianHoldsOnTheAxis) {
  for (const CameraCalibration& c : all) {
    const auto on = CameraModel(c).project({0.0, 0.0, 2.0}), beside = CameraModel(c).project({1e-7, -1e-7, 2.0});
    ASSERT_TRUE(on && beside);
    EXPECT_LT((on->jacobian - beside->jacobian).norm(), 1e-4);
    EXPECT_LT((on->pixel - Eigen::Vector2d(c.cx, c.cy)).norm(), 1e-12);
  }
}

// By the formulas of OpenCV's documentation, worked out by hand (decimal arithmetic, 12 digits).
TEST(CameraModel, AgreesWithReferenceValues) {
  const auto p = CameraModel(pinhole()).project({1.0, -0.5, 4.0});
  ASSERT_TRUE(p);
  EXPECT_NEAR(p->pixel.x(), 427.0, 1e-12);
  EXPECT_NEAR(p->pixel.y(), 186.625, 1e-12);

  // x = 0.25, y = -0.125, r2 = 0.078125: L = 0.9785776138...
  const double r2 = 0.078125, L = 1.0 - 0.28 * r2 + 0.074 * r2 * r2 + 0.002 * r2 * r2 * r2;
  const auto q = CameraModel(radial_tangential()).project({1.0, -0.5, 4.0});
  ASSERT_TRUE(q);
  EXPECT_NEAR(L, 0.9785776138, 1e-10);
  EXPECT_NEAR(q->pixel.x(), 322.0 + 420.0 * (0.25 * L - 2.0 * 1.9e-4 * 0.03125 + 1.8e-5 * 0.203125), 1e-10);
  EXPECT_NEAR(q->pixel.y(), 238.5 + 415.0 * (-0.125 * L + 1.9e-4 * 0.109375 - 2.0 * 1.8e-5 * 0.03125), 1e-10);

  // 45 degrees to the right: theta = pi / 4.
  const auto f = CameraModel(equidistant()).project({3.0, 0.0, 3.0});
  ASSERT_TRUE(f);
  EXPECT_NEAR(f->pixel.x(), 322.0 + 290.0 * 0.782976141, 1e-6);
  EXPECT_NEAR(f->pixel.y(), 238.5, 1e-12);
}

TEST(CameraModel, ProjectsNothingFromBehindOrBeyondTheField) {
  for (const CameraCalibration& c : all) {
    const CameraModel model(c);
    EXPECT_FALSE(model.project({0.0, 0.0, -1.0}));
    EXPECT_FALSE(model.project({1.0, 0.0, 0.0}));
    EXPECT_FALSE(model.project({0.0, 0.0, 0.0}));
    EXPECT_FALSE(model.project({nan, 0.0, 1.0}));
    EXPECT_FALSE(model.project({100.0, 0.0, 1.0}));
  }
  // Barrel distortion alone folds back at r^2 = 1 / (3 * 0.28), 47.5 degrees: past it, no pixel, though it would lie in
  // the image.
  CameraCalibration barrel = pinhole();
  barrel.coefficients[0] = -0.28;
  barrel.fx = barrel.fy = 700.0;
  EXPECT_TRUE(CameraModel(barrel).project({1.0, 0.0, 1.0}));
  EXPECT_FALSE(CameraModel(barrel).project({1.8, 0.0, 1.0}));
}

TEST(CameraModel, APointOutsideOfTheImageStillHasAPixel) {
  const CameraModel model(pinhole());
  const auto at = model.project({1.0, 0.0, 1.0});
  ASSERT_TRUE(at);
  EXPECT_FALSE(model.in_image(at->pixel));
  EXPECT_TRUE(model.in_image({0.0, 0.0}));
  EXPECT_TRUE(model.in_image({639.0, 479.0}));
  EXPECT_FALSE(model.in_image({639.0, 479.0}, 1.0));
  EXPECT_FALSE(model.in_image({nan, 3.0}));
}

TEST(CameraModel, SaysWhatIsWrongWithACalibration) {
  const auto complaint = [](const std::function<void(CameraCalibration&)>& spoil) {
    CameraCalibration c = pinhole();
    spoil(c);
    try {
      CameraModel model(c);
    } catch (const ConfigError& e) {
      return std::string(e.what());
    }
    return std::string();
  };
  EXPECT_EQ(complaint([](auto&) {}), "");
  EXPECT_NE(complaint([](auto& c) { c.width = 0; }).find("width"), std::string::npos);
  EXPECT_NE(complaint([](auto& c) { c.height = 20000; }).find("height"), std::string::npos);
  EXPECT_NE(complaint([](auto& c) { c.fx = nan; }).find("fx"), std::string::npos);
  EXPECT_NE(complaint([](auto& c) { c.fy = -1.0; }).find("fy"), std::string::npos);
  EXPECT_NE(complaint([](auto& c) { c.cx = 640.0; }).find("principal point"), std::string::npos);
  EXPECT_NE(complaint([](auto& c) { c.cy = nan; }).find("principal point"), std::string::npos);
  EXPECT_NE(complaint([](auto& c) { c.coefficients[1] = nan; }).find("coefficients"), std::string::npos);
  EXPECT_NE(complaint([](auto& c) { c.coefficients[0] = -2.0; }).find("folds"), std::string::npos);
  EXPECT_NE(complaint([](auto& c) { c.coefficients[2] = 3.0; }).find("folds"), std::string::npos);
}

}  // namespace
}  // namespace convoy
