#include <convoy/config_error.hpp>
#include <convoy/vision/corner_detector.hpp>

#include <algorithm>
#include <cmath>

namespace convoy {
namespace {

constexpr int window = 7, reach = window / 2;
constexpr int least_margin = reach + 2;  // of the window, of a gradient, and of a neighbour

void check(bool holds, const char* name, double value, const char* range) {
  if (!holds) throw RangeError("corners", name, value, range);
}

/// Of seven neighbours each. Sums of whole numbers that a float holds: exact, in whatever order.
void sums_along_row(const std::vector<float>& columns, int count, float* sums) {
  const float* c = columns.data();
  for (int x = 0; x < count; ++x) sums[x] = c[x] + c[x + 1] + c[x + 2] + c[x + 3] + c[x + 4] + c[x + 5] + c[x + 6];
}

/// Where a parabola through three values is highest, within half a step of the middle one.
double parabola(float before, float here, float after) {
  const double curvature = static_cast<double>(before) - 2.0 * static_cast<double>(here) + static_cast<double>(after);
  if (!(curvature < 0.0)) return 0.0;
  return std::clamp(0.5 * static_cast<double>(before - after) / curvature, -0.5, 0.5);
}

}  // namespace

void validate(const CornerParams& p, int width, int height) {
  constexpr int least_cell = 16;
  check(p.columns >= 1 && p.columns <= 64, "columns", p.columns, "lie in 1..64");
  check(p.rows >= 1 && p.rows <= 64, "rows", p.rows, "lie in 1..64");
  check(width / p.columns >= least_cell, "columns", p.columns, "leave cells of 16 px or more");
  check(height / p.rows >= least_cell, "rows", p.rows, "leave cells of 16 px or more");
  check(p.margin_px >= least_margin && p.margin_px <= 1e4, "margin_px", p.margin_px, "lie in [5, 10000]");
  check(p.min_distance_px >= 0.0 && p.min_distance_px <= 1e4, "min_distance_px", p.min_distance_px,
        "lie in [0, 10000]");
  check(p.min_strength > 0.0, "min_strength", p.min_strength, "be > 0");
}

CornerDetector::CornerDetector(int width, int height, const CornerParams& params)
    : width_(width), height_(height), params_(params) {
  validate(params, width, height);
}

int CornerDetector::cell_of(const Eigen::Vector2d& pixel) const {
  const double x = pixel.x() + 0.5, y = pixel.y() + 0.5;
  if (!(x >= 0.0 && x < width_ && y >= 0.0 && y < height_)) return -1;
  // The inverse of part_of(), also where the sides are no multiples.
  const int column = (static_cast<int>(x) * params_.columns + params_.columns - 1) / width_;
  const int row = (static_cast<int>(y) * params_.rows + params_.rows - 1) / height_;
  return row * params_.columns + column;
}

CornerDetector::Part CornerDetector::part_of(int cell) const {
  const int column = cell % params_.columns, row = cell / params_.columns;
  const int margin = static_cast<int>(std::ceil(params_.margin_px));
  return {std::max(margin, column * width_ / params_.columns), std::max(margin, row * height_ / params_.rows),
          std::min(width_ - margin, (column + 1) * width_ / params_.columns),
          std::min(height_ - margin, (row + 1) * height_ / params_.rows)};
}

/// Moves the sums of columns down to the window that ends with row y: what was a window before leaves them.
void CornerDetector::advance(const cv::Mat& image, int y, int x0, int width) {
  const std::uint8_t *above = image.ptr(y - 1) + x0, *here = image.ptr(y) + x0, *below = image.ptr(y + 1) + x0;
  float *xx = xx_.data(), *xy = xy_.data(), *yy = yy_.data();
  float* old_xx = products_.data() + static_cast<std::ptrdiff_t>(y % window) * 3 * width;
  float *old_xy = old_xx + width, *old_yy = old_xy + width;
  for (int x = 0; x < width; ++x) {
    const auto gx = static_cast<float>(here[x + 1] - here[x - 1]), gy = static_cast<float>(below[x] - above[x]);
    xx[x] += gx * gx - old_xx[x];
    old_xx[x] = gx * gx;
    xy[x] += gx * gy - old_xy[x];
    old_xy[x] = gx * gy;
    yy[x] += gy * gy - old_yy[x];
    old_yy[x] = gy * gy;
  }
}

void CornerDetector::strengths(const cv::Mat& image, const Part& part) {
  const int width = part.width() + 2, height = part.height() + 2, columns = width + 2 * reach;
  const int x0 = part.x0 - 1 - reach, y0 = part.y0 - 1;
  stride_ = width;
  strength_.resize(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  products_.assign(static_cast<std::size_t>(3 * window * columns), 0.0F);
  for (auto* sums : {&xx_, &xy_, &yy_}) sums->assign(static_cast<std::size_t>(columns), 0.0F);
  for (auto* row : {&row_xx_, &row_xy_, &row_yy_}) row->resize(static_cast<std::size_t>(width));
  for (int y = y0 - reach; y < y0 + reach; ++y) advance(image, y, x0, columns);
  // Gradients are over two pixels, so their squares four times too large; the smaller eigenvalue is half of what
  // follows.
  constexpr float scale = 1.0F / (2.0F * 4.0F * window * window);
  for (int row = 0; row < height; ++row) {
    advance(image, y0 + row + reach, x0, columns);
    sums_along_row(xx_, width, row_xx_.data());
    sums_along_row(xy_, width, row_xy_.data());
    sums_along_row(yy_, width, row_yy_.data());
    float* out = strength_.data() + static_cast<std::ptrdiff_t>(row) * stride_;
    const float *xx = row_xx_.data(), *xy = row_xy_.data(), *yy = row_yy_.data();
    for (int x = 0; x < width; ++x) {
      const float difference = xx[x] - yy[x];
      out[x] = scale * (xx[x] + yy[x] - std::sqrt(difference * difference + 4.0F * (xy[x] * xy[x])));
    }
  }
}

bool CornerDetector::is_peak(int column, int row) const {
  const float* p = strength_.data() + static_cast<std::ptrdiff_t>(row) * stride_ + column;
  for (int v = -1; v <= 1; ++v)
    for (int u = -1; u <= 1; ++u)
      if (p[v * stride_ + u] > *p) return false;
  return true;
}

bool CornerDetector::best_of(const Part& part, const std::vector<Eigen::Vector2d>& taken, Corner& corner) const {
  const double distance2 = params_.min_distance_px * params_.min_distance_px;
  const auto is_free = [&](const Eigen::Vector2d& pixel) {
    return std::none_of(taken.begin(), taken.end(),
                        [&](const Eigen::Vector2d& t) { return (t - pixel).squaredNorm() < distance2; });
  };
  auto best = static_cast<float>(params_.min_strength);
  bool any = false;
  for (int row = 1; row <= part.height(); ++row) {
    const float* p = strength_.data() + static_cast<std::ptrdiff_t>(row) * stride_;
    for (int column = 1; column <= part.width(); ++column) {
      if (!(p[column] > best) || !is_peak(column, row)) continue;
      const Eigen::Vector2d pixel(part.x0 + column - 1, part.y0 + row - 1);
      if (!is_free(pixel)) continue;
      best = p[column];
      any = true;
      corner.pixel = pixel + Eigen::Vector2d(parabola(p[column - 1], p[column], p[column + 1]),
                                             parabola(p[column - stride_], p[column], p[column + stride_]));
      corner.strength = static_cast<double>(best);
    }
  }
  return any;
}

std::vector<Corner> CornerDetector::detect(const ImagePyramid& image, std::span<const int> cells,
                                           std::span<const Eigen::Vector2d> features) {
  std::vector<Corner> corners;
  if (!image.valid() || image.width() != width_ || image.height() != height_) return corners;
  std::vector<Eigen::Vector2d> taken(features.begin(), features.end());
  for (const int cell : cells) {
    if (cell < 0 || cell >= this->cells()) continue;
    const Part part = part_of(cell);
    if (part.width() <= 0 || part.height() <= 0) continue;
    strengths(image.level(0), part);
    Corner corner;
    corner.cell = cell;
    if (!best_of(part, taken, corner)) continue;
    taken.push_back(corner.pixel);
    corners.push_back(corner);
  }
  return corners;
}

}  // namespace convoy
