// Images drawn from a random texture, whose geometry is known.
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include <cstdint>
#include <functional>

namespace convoy::test {

/// Grey values of 0..255 about 128, with detail of all sizes from about 2 px; CV_32FC1, the same for the same seed.
cv::Mat random_texture(int width, int height, std::uint64_t seed);

/// Each pixel is the mean of points x points points of its area, which `place` takes into the texture [px]. Beyond it:
/// 128.
cv::Mat draw(const cv::Mat& texture, int width, int height,
             const std::function<Eigen::Vector2d(const Eigen::Vector2d&)>& place, int points = 4);

/// gain * 255 (grey / 255)^gamma + noise, rounded.
cv::Mat exposed(const cv::Mat& grey, double gain, double gamma, double noise, std::uint64_t seed);

}  // namespace convoy::test
