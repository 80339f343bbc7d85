#include "drawn_scene.hpp"

#include <opencv2/imgproc.hpp>

#include <cmath>

namespace convoy::test {
namespace {

float at(const cv::Mat& texture, const Eigen::Vector2d& p) {
  if (!(p.x() >= 0.0 && p.y() >= 0.0 && p.x() < texture.cols - 1 && p.y() < texture.rows - 1)) return 128.0F;
  const int x = static_cast<int>(p.x()), y = static_cast<int>(p.y());
  const float u = static_cast<float>(p.x() - x), v = static_cast<float>(p.y() - y);
  const float *upper = texture.ptr<float>(y) + x, *lower = texture.ptr<float>(y + 1) + x;
  return (1 - v) * ((1 - u) * upper[0] + u * upper[1]) + v * ((1 - u) * lower[0] + u * lower[1]);
}

}  // namespace

cv::Mat random_texture(int width, int height, std::uint64_t seed) {
  cv::RNG random(seed);
  cv::Mat sum(height, width, CV_32FC1, cv::Scalar(0));
  for (int step = 3; step <= 48; step *= 2) {
    cv::Mat coarse(height / step + 2, width / step + 2, CV_32FC1), fine;
    random.fill(coarse, cv::RNG::NORMAL, 0.0, 1.0);
    cv::resize(coarse, fine, sum.size(), 0, 0, cv::INTER_CUBIC);
    sum += fine;
  }
  cv::Scalar mean, deviation;
  cv::meanStdDev(sum, mean, deviation);
  cv::Mat texture = (sum - mean[0]) * (45.0 / deviation[0]) + 128.0;
  return cv::max(cv::min(texture, 250.0), 5.0);
}

cv::Mat draw(const cv::Mat& texture, int width, int height,
             const std::function<Eigen::Vector2d(const Eigen::Vector2d&)>& place, int points) {
  cv::Mat image(height, width, CV_8UC1);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      float sum = 0.0F;
      for (int v = 0; v < points; ++v)
        for (int u = 0; u < points; ++u)
          sum += at(texture, place({x + (u + 0.5) / points - 0.5, y + (v + 0.5) / points - 0.5}));
      image.at<std::uint8_t>(y, x) = cv::saturate_cast<std::uint8_t>(sum / static_cast<float>(points * points));
    }
  return image;
}

cv::Mat exposed(const cv::Mat& grey, double gain, double gamma, double noise, std::uint64_t seed) {
  cv::RNG random(seed);
  cv::Mat image(grey.size(), CV_8UC1);
  for (int y = 0; y < grey.rows; ++y)
    for (int x = 0; x < grey.cols; ++x) {
      const double light = gain * 255.0 * std::pow(grey.at<std::uint8_t>(y, x) / 255.0, gamma);
      image.at<std::uint8_t>(y, x) = cv::saturate_cast<std::uint8_t>(light + random.gaussian(noise));
    }
  return image;
}

}  // namespace convoy::test
