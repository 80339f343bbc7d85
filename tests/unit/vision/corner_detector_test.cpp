#include <convoy/config_error.hpp>
#include <convoy/vision/corner_detector.hpp>

#include "drawn_scene.hpp"

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include <limits>
#include <numeric>

namespace convoy {
namespace {

constexpr int width = 640, height = 480;

std::vector<int> all_cells(const CornerDetector& detector) {
  std::vector<int> cells(static_cast<std::size_t>(detector.cells()));
  std::iota(cells.begin(), cells.end(), 0);
  return cells;
}

ImagePyramid pyramid_of(const cv::Mat& image) {
  ImagePyramid pyramid(image.cols, image.rows);
  EXPECT_EQ(pyramid.set(image), ImagePyramid::Status::ok);
  return pyramid;
}

cv::Mat textured() {
  return test::draw(test::random_texture(700, 560, 3), width, height,
                    [](const Eigen::Vector2d& p) -> Eigen::Vector2d { return p + Eigen::Vector2d(20, 30); });
}

TEST(CornerDetector, FindsTheCornersOfARectangleBetweenPixels) {
  // Its corners are at (200.3, 140.6) and so on: drawn four times as fine, and averaged.
  const Eigen::Vector2d low(200.3, 140.6), high(330.8, 260.2);
  cv::Mat large(1400, 2000, CV_32FC1, cv::Scalar(60));
  constexpr int fine = 4;
  const auto in_large = [](double x) { return static_cast<int>(std::lround((x + 0.5) * fine)); };
  large(cv::Rect(cv::Point(in_large(low.x()), in_large(low.y())), cv::Point(in_large(high.x()), in_large(high.y()))))
      .setTo(180);
  const cv::Mat image = test::draw(large, 400, 320, [&](const Eigen::Vector2d& p) -> Eigen::Vector2d {
    return ((p.array() + 0.5) * fine - 0.5).matrix();
  });
  CornerDetector detector(400, 320);
  const auto corners = detector.detect(pyramid_of(image), all_cells(detector), {});
  ASSERT_EQ(corners.size(), 4U);
  for (const Corner& corner : corners) {
    // The window lies inside of the corner, so all are displaced alike, towards the middle of the rectangle.
    const Eigen::Vector2d nearest(std::abs(corner.pixel.x() - low.x()) < 20 ? low.x() : high.x(),
                                  std::abs(corner.pixel.y() - low.y()) < 20 ? low.y() : high.y());
    const Eigen::Vector2d inwards = (corner.pixel - nearest).cwiseProduct((0.5 * (low + high) - nearest).cwiseSign());
    EXPECT_NEAR(inwards.x(), inwards.y(), 0.5);
    EXPECT_LT(inwards.norm(), 4.0);
    EXPECT_EQ(corner.cell, detector.cell_of(corner.pixel));
  }
}

TEST(CornerDetector, IsTheSmallerEigenvalueOfOpenCv) {
  const cv::Mat image = textured();
  cv::Mat gradient_x, gradient_y, strength;
  image.convertTo(strength, CV_32FC1);
  const cv::Mat kernel = (cv::Mat_<float>(1, 3) << -0.5F, 0.0F, 0.5F);
  cv::filter2D(strength, gradient_x, CV_32F, kernel);
  cv::filter2D(strength, gradient_y, CV_32F, kernel.t());
  const auto mean = [](const cv::Mat& a, const cv::Mat& b) {
    cv::Mat product = a.mul(b), smooth;
    cv::boxFilter(product, smooth, CV_32F, {7, 7});
    return smooth;
  };
  const cv::Mat a = mean(gradient_x, gradient_x), b = mean(gradient_x, gradient_y), c = mean(gradient_y, gradient_y);
  CornerDetector detector(width, height);
  const auto corners = detector.detect(pyramid_of(image), all_cells(detector), {});
  EXPECT_GE(corners.size(), 75U);
  for (const Corner& corner : corners) {
    const int x = static_cast<int>(std::lround(corner.pixel.x())), y = static_cast<int>(std::lround(corner.pixel.y()));
    const double p = a.at<float>(y, x), q = b.at<float>(y, x), r = c.at<float>(y, x);
    EXPECT_NEAR(corner.strength, 0.5 * (p + r - std::sqrt((p - r) * (p - r) + 4.0 * q * q)), 0.01 * corner.strength);
  }
}

TEST(CornerDetector, KeepsAwayFromFeaturesEdgesAndOtherCells) {
  CornerParams params;
  params.margin_px = 25.0;
  params.min_distance_px = 30.0;
  CornerDetector detector(width, height, params);
  const ImagePyramid image = pyramid_of(textured());
  const std::vector<int> asked = {0, 9, 33, 44, 79};
  const auto first = detector.detect(image, asked, {});
  ASSERT_EQ(first.size(), asked.size());
  std::vector<Eigen::Vector2d> taken;
  for (const Corner& corner : first) taken.push_back(corner.pixel);
  const auto second = detector.detect(image, all_cells(detector), taken);
  std::vector<Eigen::Vector2d> all = taken;
  for (std::size_t i = 0; i < asked.size(); ++i) EXPECT_EQ(first[i].cell, asked[i]);
  for (const Corner& corner : second) {
    for (const Eigen::Vector2d& other : all) EXPECT_GE((corner.pixel - other).norm(), 30.0 - 1.0);
    all.push_back(corner.pixel);
    EXPECT_GE(corner.pixel.minCoeff(), 24.5);
    EXPECT_LE(corner.pixel.x(), width - 25.5);
    EXPECT_LE(corner.pixel.y(), height - 25.5);
  }
}

TEST(CornerDetector, CellsPartTheImage) {
  for (const auto& [w, h] : {std::pair(640, 480), std::pair(1226, 370), std::pair(333, 251)}) {
    CornerDetector detector(w, h);
    std::vector<int> count(static_cast<std::size_t>(detector.cells()), 0);
    for (int y = 0; y < h; ++y)
      for (int x = 0; x < w; ++x) ++count.at(static_cast<std::size_t>(detector.cell_of({x, y})));
    EXPECT_GE(*std::min_element(count.begin(), count.end()), (w / 10) * (h / 8));
    EXPECT_EQ(detector.cell_of({-0.6, 10.0}), -1);
    EXPECT_EQ(detector.cell_of({10.0, h - 0.4}), -1);
    EXPECT_EQ(detector.cell_of({std::numeric_limits<double>::quiet_NaN(), 1.0}), -1);
    for (const Corner& corner : detector.detect(
             pyramid_of(textured()(cv::Rect(0, 0, std::min(w, 640), std::min(h, 370)))), all_cells(detector), {}))
      EXPECT_EQ(corner.cell, detector.cell_of(corner.pixel));
  }
}

TEST(CornerDetector, FindsNothingWhereThereIsNothing) {
  CornerDetector detector(width, height);
  const auto cells = all_cells(detector);
  for (const int grey : {0, 128, 255})
    EXPECT_TRUE(detector.detect(pyramid_of(cv::Mat(height, width, CV_8UC1, cv::Scalar(grey))), cells, {}).empty());
  const cv::Mat noisy = test::exposed(cv::Mat(height, width, CV_8UC1, cv::Scalar(128)), 1.0, 1.0, 2.0, 1);
  EXPECT_TRUE(detector.detect(pyramid_of(noisy), cells, {}).empty());
  cv::Mat edge(height, width, CV_8UC1, cv::Scalar(40));
  edge.colRange(0, width / 2).setTo(200);
  EXPECT_TRUE(detector.detect(pyramid_of(edge), cells, {}).empty());
  EXPECT_TRUE(detector.detect(ImagePyramid(width, height), cells, {}).empty());
  EXPECT_TRUE(detector.detect(pyramid_of(textured()(cv::Rect(0, 0, 320, 240))), cells, {}).empty());
  const std::vector<int> foreign = {-1, 80, 1 << 30};
  EXPECT_TRUE(detector.detect(pyramid_of(textured()), foreign, {}).empty());
}

TEST(CornerDetector, ParametersOutOfRangeAreRefused) {
  const auto refused = [](auto spoil) {
    CornerParams params;
    spoil(params);
    EXPECT_THROW(CornerDetector(width, height, params), ConfigError);
  };
  refused([](auto& p) { p.columns = 0; });
  refused([](auto& p) { p.rows = 65; });
  refused([](auto& p) { p.columns = 41; });  // cells of 15 px
  refused([](auto& p) { p.margin_px = 4.0; });
  refused([](auto& p) { p.min_distance_px = std::numeric_limits<double>::quiet_NaN(); });
  refused([](auto& p) { p.min_strength = 0.0; });
}

}  // namespace
}  // namespace convoy
