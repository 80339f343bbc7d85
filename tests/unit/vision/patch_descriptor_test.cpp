#include <convoy/association/appearance.hpp>
#include <convoy/vision/corner_detector.hpp>
#include <convoy/vision/patch_descriptor.hpp>

#include "drawn_scene.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <numeric>

namespace convoy {
namespace {

using Status = DescriptorResult::Status;

constexpr int width = 640, height = 480;
constexpr double focal_px = 400.0, depth_m = 40.0 / 3.0;

ImagePyramid pyramid_of(const cv::Mat& image) {
  ImagePyramid pyramid(width, height);
  EXPECT_EQ(pyramid.set(image), ImagePyramid::Status::ok);
  return pyramid;
}

const Eigen::Vector2d middle(320, 240);

ImagePyramid scene_from(double scale, double gain, double gamma, double noise, std::uint64_t seed) {
  static const cv::Mat texture = test::random_texture(1500, 1200, 31);
  const cv::Mat drawn = test::draw(texture, width, height, [&](const Eigen::Vector2d& p) -> Eigen::Vector2d {
    return (p - middle) / scale + Eigen::Vector2d(750, 600);
  });
  return pyramid_of(test::exposed(drawn, gain, gamma, noise, seed));
}

std::vector<Corner> corners_of(const ImagePyramid& image) {
  CornerParams params;
  params.margin_px = 40.0;
  CornerDetector detector(width, height, params);
  std::vector<int> cells(static_cast<std::size_t>(detector.cells()));
  std::iota(cells.begin(), cells.end(), 0);
  return detector.detect(image, cells, {});
}

/// Share of true pairs that are more similar than all but `false_share` of the false ones.
struct Rates {
  double at_10_percent = 0.0, at_1_percent = 0.0;
  std::size_t pairs = 0;
};

Rates rates(const std::vector<Descriptor>& before, const std::vector<Descriptor>& now) {
  std::vector<double> right, wrong;
  for (std::size_t i = 0; i < before.size(); ++i)
    for (std::size_t j = 0; j < now.size(); ++j)
      (i == j ? right : wrong).push_back(similarity(before[i], now[j]).value_or(-1.0));
  std::sort(wrong.rbegin(), wrong.rend());
  const auto above = [&](double share) {
    const double threshold = wrong[static_cast<std::size_t>(share * static_cast<double>(wrong.size()))];
    const auto count = std::count_if(right.begin(), right.end(), [&](double s) { return s > threshold; });
    return static_cast<double>(count) / static_cast<double>(right.size());
  };
  return {above(0.1), above(0.01), right.size()};
}

/// `told_m`: the depth of the second view as it is said to be.
Rates across(double scale, double told_m, double offset_px) {
  const ImagePyramid before = scene_from(1.0, 1.0, 1.0, 2.0, 5), now = scene_from(scale, 0.8, 0.8, 3.0, 6);
  std::vector<Descriptor> a, b;
  for (const Corner& corner : corners_of(before)) {
    const Eigen::Vector2d there = middle + scale * (corner.pixel - middle) + Eigen::Vector2d(offset_px, -offset_px);
    const DescriptorResult first = describe(before, corner.pixel, depth_m, focal_px);
    const DescriptorResult second = describe(now, there, told_m, focal_px);
    if (first.status != Status::made || second.status != Status::made) continue;
    a.push_back(first.descriptor);
    b.push_back(second.descriptor);
  }
  const Rates r = rates(a, b);
  std::printf(
      "scale %.2f, depth told %.1f m (true: %.1f m), %.0f px beside: true pairs above 10 %% / 1 %% of the false: "
      "%.2f / %.2f of %zu\n",
      scale, told_m, depth_m / scale, offset_px, r.at_10_percent, r.at_1_percent, r.pairs);
  return r;
}

TEST(PatchDescriptor, TellsTruePairsFromFalseOnesAcrossScale) {
  for (const double scale : {0.6, 0.8, 1.0, 1.26, 1.6}) {
    const Rates r = across(scale, depth_m / scale, 0.5);
    EXPECT_GE(r.pairs, 20U);
    EXPECT_GE(r.at_10_percent, 0.97);
    EXPECT_GE(r.at_1_percent, 0.9);
  }
}

TEST(PatchDescriptor, BearsADepthThatIsTenPercentOff) {
  EXPECT_GE(across(1.26, 1.1 * depth_m / 1.26, 1.0).at_10_percent, 0.95);
  EXPECT_GE(across(0.8, 0.9 * depth_m / 0.8, 1.0).at_10_percent, 0.95);
}

TEST(PatchDescriptor, NeedsTheDepth) {
  EXPECT_LT(across(1.6, depth_m, 0.5).at_1_percent, across(1.6, depth_m / 1.6, 0.5).at_1_percent - 0.2);
}

TEST(PatchDescriptor, SpansTheFourBits) {
  const ImagePyramid image = scene_from(1.0, 1.0, 1.0, 1.0, 1);
  const auto made = describe(image, middle, depth_m, focal_px);
  ASSERT_EQ(made.status, Status::made);
  EXPECT_EQ(made.descriptor.kind, Descriptor::Kind::patch_8x8_4bit);
  double sum = 0.0, squares = 0.0;
  for (const std::uint8_t byte : made.descriptor.bytes)
    for (const int value : {byte & 15, byte >> 4}) sum += value, squares += value * value;
  EXPECT_NEAR(sum / 64, 7.5, 1.0);
  EXPECT_NEAR(std::sqrt(squares / 64 - sum * sum / 64 / 64), 1.0 / 0.35, 0.5);
}

TEST(PatchDescriptor, PixelsAreByRowsTheFirstInTheLowHalf) {
  cv::Mat image(height, width, CV_8UC1);
  for (int x = 0; x < width; ++x) image.col(x).setTo(cv::saturate_cast<std::uint8_t>(128 + 4 * (x - 320)));
  const auto made = describe(pyramid_of(image), middle, depth_m, focal_px);
  ASSERT_EQ(made.status, Status::made);
  for (std::size_t i = 0; i < 32; ++i) {
    EXPECT_EQ(made.descriptor.bytes[i], made.descriptor.bytes[i % 4]);  // rows are alike
    EXPECT_LT(made.descriptor.bytes[i] & 15, made.descriptor.bytes[i] >> 4);
  }
}

TEST(PatchDescriptor, RefusesWhatItCannotShow) {
  constexpr double nan_value = std::numeric_limits<double>::quiet_NaN(),
                   infinite = std::numeric_limits<double>::infinity();
  const ImagePyramid image = scene_from(1.0, 1.0, 1.0, 1.0, 1);
  const auto status = [&](const Eigen::Vector2d& pixel, double depth, double focal) {
    const DescriptorResult result = describe(image, pixel, depth, focal);
    EXPECT_EQ(result.descriptor.kind == Descriptor::Kind::none, result.status != Status::made);
    return result.status;
  };
  EXPECT_EQ(status(middle, depth_m, focal_px), Status::made);
  for (const double bad : {0.0, -1.0, nan_value}) {
    EXPECT_EQ(status(middle, bad, focal_px), Status::bad_input);
    EXPECT_EQ(status(middle, depth_m, bad), Status::bad_input);
  }
  EXPECT_EQ(status(middle, depth_m, infinite), Status::bad_input);
  EXPECT_EQ(status({nan_value, 100}, depth_m, focal_px), Status::bad_input);
  EXPECT_EQ(status(middle, 70.0, focal_px), Status::too_small);
  EXPECT_EQ(status(middle, 1.0, focal_px), Status::too_large);
  for (const Eigen::Vector2d& away : {Eigen::Vector2d(5, 100), {635, 100}, {100, 5}, {100, 475}, {-1e300, 1e300}})
    EXPECT_EQ(status(away, depth_m, focal_px), Status::out_of_image);
  const ImagePyramid blank = pyramid_of(cv::Mat(height, width, CV_8UC1, cv::Scalar(255)));
  EXPECT_EQ(describe(blank, middle, depth_m, focal_px).status, Status::blank);
  EXPECT_EQ(describe(ImagePyramid(width, height), middle, depth_m, focal_px).status, Status::bad_input);
}

}  // namespace
}  // namespace convoy
