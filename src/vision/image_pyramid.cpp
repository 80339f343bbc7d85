#include <convoy/config_error.hpp>
#include <convoy/vision/image_pyramid.hpp>

namespace convoy {
namespace {

void halve(const cv::Mat& image, cv::Mat& half) {
  half.create(image.rows / 2, image.cols / 2, CV_8UC1);
  for (int y = 0; y < half.rows; ++y) {
    const std::uint8_t *upper = image.ptr(2 * y), *lower = image.ptr(2 * y + 1);
    std::uint8_t* out = half.ptr(y);
    for (int x = 0; x < half.cols; ++x)
      out[x] = static_cast<std::uint8_t>((upper[2 * x] + upper[2 * x + 1] + lower[2 * x] + lower[2 * x + 1] + 2) >> 2);
  }
}

ImagePyramid::Status fault_of(const cv::Mat& image, int width, int height) {
  if (image.empty()) return ImagePyramid::Status::empty;
  if (image.dims != 2 || image.type() != CV_8UC1) return ImagePyramid::Status::not_grey;
  if (image.cols != width || image.rows != height) return ImagePyramid::Status::wrong_size;
  return ImagePyramid::Status::ok;
}

}  // namespace

ImagePyramid::ImagePyramid(int width, int height) : width_(width), height_(height) {
  constexpr int least = 16, most = 16384;
  if (width < least || width > most) throw RangeError("ImagePyramid", "width", width, "lie in 16..16384");
  if (height < least || height > most) throw RangeError("ImagePyramid", "height", height, "lie in 16..16384");
}

ImagePyramid::Status ImagePyramid::set(const cv::Mat& image) {
  const Status status = fault_of(image, width_, height_);
  ++counts_[static_cast<std::size_t>(status)];
  valid_ = status == Status::ok;
  if (!valid_) return status;
  levels_[0] = image;
  for (std::size_t k = 1; k < levels_.size(); ++k) halve(levels_[k - 1], levels_[k]);
  return status;
}

}  // namespace convoy
