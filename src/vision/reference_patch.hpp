// What the surroundings of a feature looked like when it was first seen.
#pragma once

#include <convoy/vision/image_pyramid.hpp>

#include <array>
#include <cstdint>
#include <optional>

namespace convoy {

class ReferencePatch {
 public:
  static constexpr int half_px = 20;               ///< of the window that is kept, on each level
  static constexpr int size_px = 2 * half_px + 1;  ///< its sides
  static constexpr double margin_px = 9.0;         ///< from the edge of the image, at least; room for the template

  /// Nothing if the image is not valid, or the pixel not finite or nearer to an edge than that.
  static std::optional<ReferencePatch> take(const ImagePyramid& image, const Eigen::Vector2d& pixel);

  /// Grey value at `offset` pixels of the level from the feature, between pixels bilinear; nothing if the window, or
  /// the image, ends before it.
  std::optional<float> grey(int level, const Eigen::Vector2d& offset) const {
    const Window& w = windows_[static_cast<std::size_t>(level)];
    const double x = w.middle.x() + offset.x(), y = w.middle.y() + offset.y();
    if (!(x >= w.x0 && x < w.x1 && y >= w.y0 && y < w.y1)) return std::nullopt;
    const int column = static_cast<int>(x), row = static_cast<int>(y);
    const float u = static_cast<float>(x - column), v = static_cast<float>(y - row);
    const std::uint8_t* p = &w.grey[static_cast<std::size_t>(row * size_px + column)];
    const float upper = static_cast<float>(p[0]) + u * static_cast<float>(p[1] - p[0]);
    const float lower = static_cast<float>(p[size_px]) + u * static_cast<float>(p[size_px + 1] - p[size_px]);
    return upper + v * (lower - upper);
  }
  const Eigen::Vector2d& pixel() const { return pixel_; }

 private:
  struct Window {
    Eigen::Vector2d middle;              // the feature, in pixels of the window
    int x0 = 0, y0 = 0, x1 = 0, y1 = 0;  // its part that lies in the image: [x0, x1] x [y0, y1]
    std::array<std::uint8_t, size_px * size_px> grey{};
  };
  static Window window(const cv::Mat& image, const Eigen::Vector2d& at);

  Eigen::Vector2d pixel_ = Eigen::Vector2d::Zero();
  std::array<Window, ImagePyramid::levels> windows_;
};

}  // namespace convoy
