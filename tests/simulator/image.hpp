// Images, and a number that tells two of them apart.
#pragma once

#include <cstdint>
#include <vector>

namespace convoy::simulator {

/// width x height values, row by row from the top. The middle of the first pixel is (0, 0), as in OpenCV.
template <typename Value>
struct Image {
  int width = 0, height = 0;
  std::vector<Value> values;

  Image() = default;
  Image(int width_px, int height_px)
      : width(width_px),
        height(height_px),
        values(static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px)) {}
  Value* row(int y) { return values.data() + static_cast<std::ptrdiff_t>(y) * width; }
  const Value* row(int y) const { return values.data() + static_cast<std::ptrdiff_t>(y) * width; }
  Value& at(int x, int y) { return row(y)[x]; }
  Value at(int x, int y) const { return row(y)[x]; }
};

using GreyImage = Image<std::uint8_t>;
using LightImage = Image<float>;  ///< 0 is dark, 255 white paper in the sun

/// FNV-1a, 64 bits, of the size and all pixels.
std::uint64_t frame_hash(const GreyImage& image);

}  // namespace convoy::simulator
