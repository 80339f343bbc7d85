// How similar a patch, as it should look now, is to places of an image.
#pragma once

#include <convoy/vision/reference_patch.hpp>

#include <array>
#include <cstdint>
#include <vector>

namespace convoy {

/// 11 x 11 grey values, in sixteenths, by rows of 16 of which the last five are zero.
struct PatchTemplate {
  static constexpr int half = 5, side = 2 * half + 1, pixels = side * side, stride = 16, scale = 16;
  alignas(16) std::array<std::int16_t, side * stride> values{};
  double sum = 0.0;
  double scatter = 0.0;  ///< pixels * (sum of squares) - sum^2; 0: no contrast

  /// Of the pixels around a feature, warped: `ref_from_now` takes offsets of the template into offsets of the image the
  /// patch was taken from [px of the image / px of the template]. The feature comes to lie `phase` [px] beside the
  /// middle pixel. False if the patch ends before it.
  bool warp(const ReferencePatch& patch, const Eigen::Matrix2d& ref_from_now, const Eigen::Vector2d& phase);
  double contrast() const;         ///< standard deviation [grey values of 0..255]
  double saturated_share() const;  ///< of pixels that are black or white
};

/// A part of an image that a template is compared with, place by place and each once.
class CorrelationWindow {
 public:
  /// `min_contrast`: standard deviation of grey values [0..255] below which a place is like nothing. > 0
  explicit CorrelationWindow(double min_contrast) : min_contrast_(min_contrast) {}

  /// Takes in all places [px] of `image` (CV_8UC1) within these bounds and at least half a template from its edges.
  /// False: there are none.
  bool load(const cv::Mat& image, const Eigen::Vector2d& low, const Eigen::Vector2d& high);
  /// Before another template is compared with the same part.
  void forget_scores();

  int left() const { return x0_; }
  int top() const { return y0_; }
  int right() const { return x0_ + columns_ - 1; }  ///< the last one
  int bottom() const { return y0_ + rows_ - 1; }
  bool holds(int x, int y) const { return x >= left() && x <= right() && y >= top() && y <= bottom(); }

  /// Zero-mean normalised cross-correlation with the template's middle there, [-1, 1]; -1 where there is no contrast.
  double score(const PatchTemplate& wanted, int x, int y);
  /// No neighbour is more similar. Of two that are equal, the one to the left or above is the peak.
  bool is_peak(const PatchTemplate& wanted, int x, int y);
  /// Where a paraboloid through a peak and its eight neighbours is highest, each coordinate within 1 px of it; the peak
  /// itself at the rim.
  Eigen::Vector2d summit(const PatchTemplate& wanted, int x, int y);

 private:
  double compare(const PatchTemplate& wanted, int x, int y) const;

  double min_contrast_;
  int x0_ = 0, y0_ = 0, columns_ = 0, rows_ = 0, stride_ = 0;
  std::vector<std::int16_t> grey_;
  std::vector<double> scores_;
};

}  // namespace convoy
