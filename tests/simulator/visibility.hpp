// Which polygon is seen where: a depth buffer on an ideal pinhole's image plane.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <limits>
#include <vector>

namespace convoy::simulator {

/// The part of the plane z = 1 (camera frame) that is looked at, and its pixels.
struct Window {
  double left = 0.0, top = 0.0;  ///< of the first pixel's corner
  double pixels_per_unit = 1.0;
  int width = 0, height = 0;  ///< [px]

  Eigen::Vector2d pixel_of(const Eigen::Vector2d& ray) const {
    return (ray - Eigen::Vector2d(left, top)) * pixels_per_unit;
  }
};

/// Corners are rounded to 1/16 pixel and a pixel belongs to a polygon if its middle does, middles on an edge to the one
/// to the right of it or below it: polygons that share an edge leave no gap and share no pixel.
class VisibilityBuffer {
 public:
  static constexpr std::int32_t kSubpixels = 16;
  static constexpr std::uint32_t kNothing = 0xffffffffU;
  using Corner = Eigen::Matrix<std::int32_t, 2, 1>;  ///< [1/16 px]

  explicit VisibilityBuffer(const Window& window);

  void clear();
  /// Marks, as `id`, what of a convex polygon is nearer than what is there. Corners run counter-clockwise as seen (y is
  /// down) and lie in the window. inverse_depth . (x, y, 1) is 1 / z along the ray (x, y, 1). True if anything is seen.
  bool draw(const Corner* corners, int count, const Eigen::Vector3d& inverse_depth, std::uint32_t id);

  const Window& window() const { return window_; }
  std::size_t index(int x, int y) const { return static_cast<std::size_t>(y) * stride_ + static_cast<std::size_t>(x); }
  const std::uint32_t* ids() const { return ids_.data(); }
  std::size_t stride() const { return stride_; }

 private:
  void trace(const Corner& upper, const Corner& lower, std::vector<std::int32_t>& columns) const;

  Window window_;
  std::size_t stride_;
  std::vector<float> inverse_depths_;
  std::vector<std::uint32_t> ids_;
  std::vector<std::int32_t> first_, end_;  ///< of each row of the polygon being drawn
};

}  // namespace convoy::simulator
