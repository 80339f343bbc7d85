// Corners to follow: the best one of a cell, in the cells that have too few features (J. Shi and C. Tomasi, Good
// features to track, CVPR 1994).
#pragma once

#include <convoy/vision/image_pyramid.hpp>

#include <span>
#include <vector>

namespace convoy {

struct CornerParams {
  int columns = 10, rows = 8;     ///< of the grid, each 1..64; cells at least 16 px wide and high
  double margin_px = 20.0;        ///< from the edge of the image, >= 5
  double min_distance_px = 15.0;  ///< from features that are there, and from each other, >= 0
  /// Of the smaller eigenvalue of the mean gradient matrix over 7 x 7 px [(grey values / px)^2], > 0. Noise of 2 grey
  /// values has about 1.
  double min_strength = 12.0;
};

/// Throws RangeError.
void validate(const CornerParams& params, int width, int height);

struct Corner {
  Eigen::Vector2d pixel;
  double strength = 0.0;  ///< see CornerParams::min_strength
  int cell = 0;
};

/// Not for several threads at once. The same input gives the same result, to the bit.
class CornerDetector {
 public:
  /// For images of that size [px].
  CornerDetector(int width, int height, const CornerParams& params = {});

  int cells() const { return params_.columns * params_.rows; }
  /// By rows from the top left; -1 outside of the image.
  int cell_of(const Eigen::Vector2d& pixel) const;

  /// At most one corner for each of `cells` (others than 0..cells()-1 are passed over), in their order, away from
  /// `features`. None if the image is not valid() or of another size.
  std::vector<Corner> detect(const ImagePyramid& image, std::span<const int> cells,
                             std::span<const Eigen::Vector2d> features);

 private:
  struct Part {  // of the image: [x0, x1) x [y0, y1)
    int x0, y0, x1, y1;
    int width() const { return x1 - x0; }
    int height() const { return y1 - y0; }
  };
  Part part_of(int cell) const;
  void strengths(const cv::Mat& image, const Part& part);
  void advance(const cv::Mat& image, int y, int x0, int width);
  bool is_peak(int column, int row) const;
  bool best_of(const Part& part, const std::vector<Eigen::Vector2d>& taken, Corner& corner) const;

  int width_, height_;
  CornerParams params_;
  // Of a part and one pixel around it, by rows.
  int stride_ = 0;
  std::vector<float> strength_;
  std::vector<float> products_;                  // of gradients: xx, xy, yy of the last rows, a window high
  std::vector<float> xx_, xy_, yy_;              // their sums, of each column
  std::vector<float> row_xx_, row_xy_, row_yy_;  // and over the window
};

}  // namespace convoy
