#include <convoy/vision/correlation.hpp>

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <numbers>

namespace convoy {
namespace {

constexpr int half = PatchTemplate::half, side = PatchTemplate::side, stride = PatchTemplate::stride;
constexpr double not_yet = -2.0;  // of scores

/// On which level of the patch a step of the template is about a pixel.
int level_for(const Eigen::Matrix2d& ref_from_now) {
  const double step = std::sqrt(std::abs(ref_from_now.determinant()));
  int level = 0;
  while (level + 1 < ImagePyramid::levels && step > std::numbers::sqrt2 * (1 << level)) ++level;
  return level;
}

struct Sums {
  std::int32_t grey = 0, squares = 0, products = 0;
};

constexpr std::array<std::int16_t, stride> within = {1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};

int dot(const std::int16_t* a, const std::int16_t* b) {
  int sum = 0;
  for (int i = 0; i < stride; ++i) sum += a[i] * b[i];
  return sum;
}

// Rows of 16, of which 11 count: the compiler makes two vector products of each. All sums fit into 32 bits.
Sums sums_of(const std::int16_t* grey, int grey_stride, const std::int16_t* wanted) {
  Sums sums;
  for (int row = 0; row < side; ++row, grey += grey_stride, wanted += stride) {
    std::int16_t here[stride];
    for (std::size_t i = 0; i < stride; ++i) here[i] = static_cast<std::int16_t>(grey[i] * within[i]);
    sums.grey += dot(here, within.data());
    sums.squares += dot(here, here);
    sums.products += dot(here, wanted);
  }
  return sums;
}

}  // namespace

bool PatchTemplate::warp(const ReferencePatch& patch, const Eigen::Matrix2d& ref_from_now,
                         const Eigen::Vector2d& phase) {
  const int level = level_for(ref_from_now);
  const Eigen::Matrix2d step = ref_from_now / (1 << level);
  std::int64_t total = 0, squares = 0;
  for (int v = -half; v <= half; ++v) {
    for (int u = -half; u <= half; ++u) {
      const auto grey = patch.grey(level, step * (Eigen::Vector2d(u, v) - phase));
      if (!grey) return false;
      const auto value = static_cast<std::int16_t>(*grey * scale + 0.5F);
      values[static_cast<std::size_t>((v + half) * stride + u + half)] = value;
      total += value;
      squares += value * value;
    }
  }
  sum = static_cast<double>(total);
  scatter = static_cast<double>(pixels * squares - total * total);
  return true;
}

double PatchTemplate::contrast() const { return std::sqrt(scatter) / (pixels * scale); }

double PatchTemplate::saturated_share() const {
  constexpr int black = 2 * scale, white = 253 * scale;
  int count = 0;
  for (int v = 0; v < side; ++v)
    for (int u = 0; u < side; ++u) {
      const int value = values[static_cast<std::size_t>(v * stride + u)];
      count += value <= black || value >= white;
    }
  return static_cast<double>(count) / pixels;
}

bool CorrelationWindow::load(const cv::Mat& image, const Eigen::Vector2d& low, const Eigen::Vector2d& high) {
  // In floating point first: bounds may be far beyond what an int holds.
  const double left = std::max<double>(std::floor(low.x()), half), top = std::max<double>(std::floor(low.y()), half);
  const double right = std::min<double>(std::ceil(high.x()), image.cols - 1 - half);
  const double bottom = std::min<double>(std::ceil(high.y()), image.rows - 1 - half);
  columns_ = rows_ = 0;
  if (!(left <= right && top <= bottom)) return false;
  x0_ = static_cast<int>(left), y0_ = static_cast<int>(top);
  columns_ = static_cast<int>(right) - x0_ + 1, rows_ = static_cast<int>(bottom) - y0_ + 1;
  const int copied = columns_ + 2 * half;
  stride_ = copied + stride - side;  // a row of the template reads that much beyond its end
  grey_.assign(static_cast<std::size_t>(stride_) * static_cast<std::size_t>(rows_ + 2 * half), 0);
  for (int row = 0; row < rows_ + 2 * half; ++row) {
    const std::uint8_t* from = image.ptr(y0_ - half + row) + x0_ - half;
    std::copy_n(from, copied, grey_.begin() + static_cast<std::ptrdiff_t>(row) * stride_);
  }
  forget_scores();
  return true;
}

void CorrelationWindow::forget_scores() {
  scores_.assign(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_), not_yet);
}

double CorrelationWindow::score(const PatchTemplate& wanted, int x, int y) {
  double& known = scores_[static_cast<std::size_t>(y - y0_) * static_cast<std::size_t>(columns_) +
                          static_cast<std::size_t>(x - x0_)];
  if (known == not_yet) known = compare(wanted, x, y);
  return known;
}

double CorrelationWindow::compare(const PatchTemplate& wanted, int x, int y) const {
  constexpr double n = PatchTemplate::pixels;
  const std::ptrdiff_t corner = static_cast<std::ptrdiff_t>(y - y0_) * stride_ + (x - x0_);
  const Sums sums = sums_of(grey_.data() + corner, stride_, wanted.values.data());
  const double scatter = n * sums.squares - static_cast<double>(sums.grey) * sums.grey;
  if (scatter < n * n * min_contrast_ * min_contrast_ || wanted.scatter <= 0.0) return -1.0;
  return (n * sums.products - sums.grey * wanted.sum) / std::sqrt(scatter * wanted.scatter);
}

bool CorrelationWindow::is_peak(const PatchTemplate& wanted, int x, int y) {
  const double here = score(wanted, x, y);
  for (int v = -1; v <= 1; ++v)
    for (int u = -1; u <= 1; ++u) {
      if ((u == 0 && v == 0) || !holds(x + u, y + v)) continue;
      const double there = score(wanted, x + u, y + v);
      const bool before = v < 0 || (v == 0 && u < 0);
      if (there > here || (before && there == here)) return false;
    }
  return true;
}

Eigen::Vector2d CorrelationWindow::summit(const PatchTemplate& wanted, int x, int y) {
  const Eigen::Vector2d peak(x, y);
  if (!holds(x - 1, y - 1) || !holds(x + 1, y + 1)) return peak;
  const auto s = [&](int u, int v) { return score(wanted, x + u, y + v); };
  const Eigen::Vector2d slope(0.5 * (s(1, 0) - s(-1, 0)), 0.5 * (s(0, 1) - s(0, -1)));
  const double xx = s(1, 0) - 2.0 * s(0, 0) + s(-1, 0), yy = s(0, 1) - 2.0 * s(0, 0) + s(0, -1);
  const double xy = 0.25 * (s(1, 1) - s(1, -1) - s(-1, 1) + s(-1, -1));
  const double determinant = xx * yy - xy * xy;
  if (!(xx < 0.0 && yy < 0.0 && determinant > 0.0)) return peak;
  const Eigen::Vector2d step(xy * slope.y() - yy * slope.x(), xy * slope.x() - xx * slope.y());
  return peak + (step / determinant).cwiseMax(-1.0).cwiseMin(1.0);
}

}  // namespace convoy
