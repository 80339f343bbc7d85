#include <convoy/vision/reference_patch.hpp>

#include <algorithm>
#include <cmath>

namespace convoy {

ReferencePatch::Window ReferencePatch::window(const cv::Mat& image, const Eigen::Vector2d& at) {
  Window w;
  const int left = static_cast<int>(std::lround(at.x())) - half_px,
            top = static_cast<int>(std::lround(at.y())) - half_px;
  w.middle = at - Eigen::Vector2d(left, top);
  w.x0 = std::max(0, -left), w.x1 = std::min(size_px - 1, image.cols - 1 - left);
  w.y0 = std::max(0, -top), w.y1 = std::min(size_px - 1, image.rows - 1 - top);
  for (int y = w.y0; y <= w.y1; ++y)
    std::copy_n(image.ptr(top + y) + left + w.x0, w.x1 - w.x0 + 1,
                &w.grey[static_cast<std::size_t>(y * size_px + w.x0)]);
  return w;
}

std::optional<ReferencePatch> ReferencePatch::take(const ImagePyramid& image, const Eigen::Vector2d& pixel) {
  if (!image.valid()) return std::nullopt;
  const bool inside = pixel.x() >= margin_px && pixel.x() <= image.width() - 1 - margin_px && pixel.y() >= margin_px &&
                      pixel.y() <= image.height() - 1 - margin_px;
  if (!inside) return std::nullopt;
  ReferencePatch patch;
  patch.pixel_ = pixel;
  for (int k = 0; k < ImagePyramid::levels; ++k)
    patch.windows_[static_cast<std::size_t>(k)] = window(image.level(k), ImagePyramid::to_level(pixel, k));
  return patch;
}

}  // namespace convoy
