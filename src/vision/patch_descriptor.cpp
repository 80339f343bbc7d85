#include <convoy/vision/patch_descriptor.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace convoy {
namespace {

using Status = DescriptorResult::Status;

constexpr int side = 8;
constexpr double blur = 0.6;          // standard deviation, in pieces of the footprint
constexpr double cut = 2.0 * blur;    // where the Gaussian ends
constexpr double min_contrast = 3.0;  // standard deviation [grey values]
constexpr double steps_per_sigma = 1.0 / 0.35;

/// Weights of the pixels along one axis for the piece whose middle is there: they add up to 1.
struct Weights {
  int first = 0;
  std::vector<double> of;
};

Weights weights_about(double middle, double piece_px) {
  // Where a piece is smaller than a pixel, the pixel itself is the blur.
  const double sigma = std::max(blur * piece_px, 0.5), reach = std::max(cut * piece_px, 1.0);
  Weights w;
  w.first = static_cast<int>(std::ceil(middle - reach));
  double sum = 0.0;
  for (int x = w.first; x <= middle + reach; ++x) {
    const double d = (x - middle) / sigma;
    w.of.push_back(std::exp(-0.5 * d * d));
    sum += w.of.back();
  }
  for (double& weight : w.of) weight /= sum;
  return w;
}

double mean(const cv::Mat& image, const Weights& along_x, const Weights& along_y) {
  double sum = 0.0;
  for (std::size_t v = 0; v < along_y.of.size(); ++v) {
    const std::uint8_t* row = image.ptr(along_y.first + static_cast<int>(v)) + along_x.first;
    double of_row = 0.0;
    for (std::size_t u = 0; u < along_x.of.size(); ++u) of_row += along_x.of[u] * row[u];
    sum += along_y.of[v] * of_row;
  }
  return sum;
}

using Grey = std::array<double, side * side>;

Grey sample(const cv::Mat& image, const Eigen::Vector2d& pixel, double piece_px) {
  std::array<Weights, side> x, y;
  for (std::size_t i = 0; i < side; ++i) {
    const double offset = (static_cast<double>(i) - 0.5 * (side - 1)) * piece_px;
    x[i] = weights_about(pixel.x() + offset, piece_px);
    y[i] = weights_about(pixel.y() + offset, piece_px);
  }
  Grey grey;
  for (std::size_t row = 0; row < side; ++row)
    for (std::size_t column = 0; column < side; ++column) grey[row * side + column] = mean(image, x[column], y[row]);
  return grey;
}

Descriptor quantised(const Grey& grey, double middle, double sigma) {
  Descriptor descriptor;
  descriptor.kind = Descriptor::Kind::patch_8x8_4bit;
  for (std::size_t i = 0; i < grey.size(); ++i) {
    const double step = std::floor(8.0 + steps_per_sigma * (grey[i] - middle) / sigma);
    const auto value = static_cast<unsigned>(std::clamp(step, 0.0, 15.0));
    descriptor.bytes[i / 2] = static_cast<std::uint8_t>(descriptor.bytes[i / 2] | value << (4 * (i % 2)));
  }
  return descriptor;
}

}  // namespace

DescriptorResult describe(const ImagePyramid& image, const Eigen::Vector2d& pixel, double depth_m, double focal_px) {
  constexpr double least_px = 6.0, most_px = 128.0;
  const double footprint_px = descriptor_footprint_m * focal_px / depth_m;
  const bool usable =
      image.valid() && pixel.allFinite() && depth_m > 0.0 && focal_px > 0.0 && std::isfinite(footprint_px);
  if (!usable) return {Status::bad_input, {}};
  if (footprint_px < least_px) return {Status::too_small, {}};
  if (footprint_px > most_px) return {Status::too_large, {}};
  const double piece_px = footprint_px / side;
  const double reach = 0.5 * (side - 1) * piece_px + std::max(cut * piece_px, 1.0);
  if (!(pixel.x() >= reach && pixel.x() <= image.width() - 1 - reach && pixel.y() >= reach &&
        pixel.y() <= image.height() - 1 - reach))
    return {Status::out_of_image, {}};
  const Grey grey = sample(image.level(0), pixel, piece_px);
  double middle = 0.0, squares = 0.0;
  for (const double value : grey) middle += value / grey.size();
  for (const double value : grey) squares += (value - middle) * (value - middle) / grey.size();
  const double sigma = std::sqrt(squares);
  if (!(sigma >= min_contrast)) return {Status::blank, {}};
  return {Status::made, quantised(grey, middle, sigma)};
}

}  // namespace convoy
