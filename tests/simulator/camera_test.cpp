#include "camera.hpp"

#include "test_street.hpp"

#include <gtest/gtest.h>

#include <unistd.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <memory>
#include <stdexcept>
#include <string>

namespace convoy::simulator {
namespace {

Eigen::Isometry3d body_at(double x_m) {
  Eigen::Isometry3d T_world_body = Eigen::Isometry3d::Identity();
  T_world_body.translation().x() = x_m;
  return T_world_body;
}

std::uint64_t hash_of(std::uint32_t index, CameraParams params = {}) {
  const Scene scene = test_street();
  return frame_hash(Camera(scene, params).take(body_at(index), index)->image);
}

/// One grey all over, by a large sky.
Scene grey_world(std::uint8_t grey) {
  Scene scene;
  scene.textures = {{2, 2, {grey, grey, grey, grey}}};
  return scene;
}

CameraParams steady() {
  CameraParams params;
  params.gain_drift = params.gain_step = params.gamma_drift = params.vignetting = 0.0;
  return params;
}

TEST(Camera, AFrameDependsOnItsKeysAlone) {
  const Scene scene = test_street();
  Camera camera(scene, {});
  camera.take(body_at(3.0), 1);
  const std::uint64_t late = frame_hash(camera.take(body_at(7.0), 7)->image);
  EXPECT_EQ(late, hash_of(7));
  EXPECT_NE(late, hash_of(8));
  for (const auto change : {+[](CameraParams& p) { p.seed = 2; }, +[](CameraParams& p) { p.vehicle = 2; },
                            +[](CameraParams& p) { p.sensor = 2; }}) {
    CameraParams params;
    change(params);
    EXPECT_NE(late, hash_of(7, params));
  }
}

TEST(Camera, PrintsTheHashOfAFrame) { std::printf("hash=%016llx\n", static_cast<unsigned long long>(hash_of(5))); }

TEST(Camera, AnotherProcessMakesTheSameFrame) {
  std::array<char, 4096> self{};
  ASSERT_GT(readlink("/proc/self/exe", self.data(), self.size() - 1), 0);
  const std::string command = "'" + std::string(self.data()) + "' --gtest_filter=Camera.PrintsTheHashOfAFrame";
  const std::unique_ptr<FILE, int (*)(FILE*)> child(popen(command.c_str(), "r"), pclose);
  ASSERT_TRUE(child);
  std::string output;
  for (int c = std::fgetc(child.get()); c != EOF; c = std::fgetc(child.get())) output.push_back(static_cast<char>(c));
  std::array<char, 32> wanted{};
  std::snprintf(wanted.data(), wanted.size(), "hash=%016llx", static_cast<unsigned long long>(hash_of(5)));
  EXPECT_NE(output.find(wanted.data()), std::string::npos) << output;
}

TEST(Camera, NoiseIsOfShotAndReading) {
  for (const std::uint8_t grey : {20, 80, 160}) {
    const Scene scene = grey_world(grey);
    CameraParams params = steady();
    params.full_well_electrons = 2000.0;
    const GreyImage image = Camera(scene, params).take(body_at(0.0), 3)->image;
    double sum = 0.0, squares = 0.0, neighbours = 0.0;
    const auto n = static_cast<double>(image.values.size());
    for (std::size_t i = 0; i < image.values.size(); ++i) {
      const double value = image.values[i] - grey;
      sum += value, squares += value * value;
      if (i > 0) neighbours += value * (image.values[i - 1] - grey);
    }
    const double electrons = grey / 255.0 * 2000.0;
    const double variance = (electrons + 12.0 * 12.0) * std::pow(255.0 / 2000.0, 2) + 1.0 / 12.0;
    EXPECT_NEAR(sum / n, 0.0, 0.1);
    EXPECT_NEAR(squares / n, variance, 0.02 * variance) << static_cast<int>(grey);
    EXPECT_NEAR(neighbours / n, 0.0, 0.02 * variance);
  }
}

TEST(Camera, ABlurredEdgeIsAsWideAsThePointSpread) {
  Scene scene = test_street(48.0);
  for (Texture& texture : scene.textures) texture = {2, 2, {200, 200, 200, 200}};
  scene.textures[0] = {2, 2, {0, 0, 0, 0}};
  const auto width_of = [&scene](double blur_px) {
    CameraParams params = steady();
    params.blur_px = blur_px, params.read_noise_electrons = 0.0, params.full_well_electrons = 1e9;
    params.lens.coefficients = {};
    const GreyImage image = Camera(scene, params).take(body_at(0.0), 0)->image;
    // Second moment of the edge's slope, along the column in the middle, from the sky down onto the end wall.
    double sum = 0.0, first = 0.0, second = 0.0;
    for (int y = 0; y + 1 < 230; ++y) {
      const double slope = image.at(320, y + 1) - image.at(320, y);
      sum += slope, first += slope * y, second += slope * y * y;
    }
    EXPECT_NEAR(sum, 200.0, 1.0);
    return second / sum - std::pow(first / sum, 2);
  };
  EXPECT_NEAR(width_of(1.2) - width_of(0.0), 1.44, 0.15);
  EXPECT_NEAR(width_of(0.6) - width_of(0.0), 0.36, 0.08);
}

TEST(Camera, CornersAreDarkerByTheFourthPowerOfTheCosine) {
  const Scene scene = grey_world(200);
  CameraParams params = steady();
  params.vignetting = 1.0, params.full_well_electrons = 1e8, params.read_noise_electrons = 0.0;
  const GreyImage image = Camera(scene, params).take(body_at(0.0), 0)->image;
  const Eigen::Vector2d ray = Lens(params.lens).ray_of({0.0, 0.0});
  EXPECT_NEAR(image.at(320, 240), 200, 1);
  EXPECT_NEAR(image.at(0, 0), 200.0 / std::pow(1.0 + ray.squaredNorm(), 2), 1.0);
}

TEST(Camera, GainDriftsSlowlyAndSteps) {
  const Scene scene = grey_world(100);
  CameraParams params;
  const Camera camera(scene, params);
  int steps = 0;
  double squares = 0.0;
  constexpr std::uint32_t n = 30'000;
  for (std::uint32_t i = 1; i < n; ++i) {
    const double change = std::log(camera.gain(i) / camera.gain(i - 1));
    if (std::abs(change) > 0.005) {
      ++steps;
      EXPECT_EQ(i % 150, 0U);
    }
    squares += std::pow(std::log(camera.gain(i)), 2);
  }
  EXPECT_NEAR(steps, 2 * 200 * 0.3 * 0.85, 30);
  EXPECT_NEAR(squares / n, 0.1 * 0.1 + 0.3 * 0.15 * 0.15, 0.004);
}

TEST(Camera, DropsTheShareItSays) {
  const Scene scene = grey_world(100);
  CameraParams params;
  params.lens = LensParams::pinhole(32, 24, 20.0);
  params.drop_probability = 0.1;
  Camera camera(scene, params);
  int dropped = 0;
  for (std::uint32_t i = 0; i < 2000; ++i) {
    const bool gone = !camera.take(body_at(0.0), i).has_value();
    EXPECT_EQ(gone, camera.dropped(i));
    dropped += gone;
  }
  EXPECT_NEAR(dropped, 200, 50);
}

TEST(Camera, SaysWhatIsWrongWithItsParameters) {
  const auto refused = [](auto change) {
    CameraParams params;
    change(params);
    EXPECT_THROW(params.validate(), std::invalid_argument);
  };
  EXPECT_NO_THROW(CameraParams{}.validate());
  refused([](CameraParams& p) { p.blur_px = -1.0; });
  refused([](CameraParams& p) { p.gain = 0.0; });
  refused([](CameraParams& p) { p.gamma = NAN; });
  refused([](CameraParams& p) { p.drop_probability = 1.5; });
  refused([](CameraParams& p) { p.frames_between_steps = 0; });
  refused([](CameraParams& p) { p.sensor = 65536; });
  refused([](CameraParams& p) { p.lens.fx = 0.0; });
  refused([](CameraParams& p) { p.T_body_camera.linear() *= 2.0; });
}

}  // namespace
}  // namespace convoy::simulator
