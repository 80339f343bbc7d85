// A grey image and its halves, made once for each frame.
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>

#include <array>
#include <cstdint>

namespace convoy {

class ImagePyramid {
 public:
  static constexpr int levels = 3;

  enum class Status : std::uint8_t {
    ok,
    empty,       ///< no image
    not_grey,    ///< not of one channel of 8 bits
    wrong_size,  ///< not of the size of the calibration
  };
  static constexpr int statuses = 4;

  /// For images of that size [px], each 16..16384. Throws RangeError.
  ImagePyramid(int width, int height);

  /// The pixels are shared and must not be written to as long as this one is in use. What is refused is counted, and
  /// leaves valid() false.
  [[nodiscard]] Status set(const cv::Mat& image);
  bool valid() const { return valid_; }
  std::uint64_t count(Status status) const { return counts_[static_cast<std::size_t>(status)]; }

  int width() const { return width_; }
  int height() const { return height_; }
  /// Level 0 is the image. A pixel of level k is the mean of 2^k x 2^k of its pixels; what is left over at the right
  /// and at the bottom is in none. CV_8UC1.
  const cv::Mat& level(int k) const { return levels_[static_cast<std::size_t>(k)]; }

  /// Where a pixel of the image (middles at whole numbers) is on level k, and back.
  static Eigen::Vector2d to_level(const Eigen::Vector2d& pixel, int k) {
    return ((pixel.array() + 0.5) / (1 << k) - 0.5).matrix();
  }
  static Eigen::Vector2d from_level(const Eigen::Vector2d& pixel, int k) {
    return ((pixel.array() + 0.5) * (1 << k) - 0.5).matrix();
  }

 private:
  int width_, height_;
  bool valid_ = false;
  std::array<cv::Mat, levels> levels_;
  std::array<std::uint64_t, statuses> counts_{};
};

}  // namespace convoy
