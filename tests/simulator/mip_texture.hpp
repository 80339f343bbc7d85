// A texture in all sizes, and what a pixel's footprint on it averages to.
#pragma once

#include "scene.hpp"

#include <cstdint>
#include <vector>

namespace convoy::simulator {

/// Footprint of a pixel: where its middle is and how far its two sides go, in repeats of the texture.
struct Footprint {
  float u = 0.0F, v = 0.0F;
  float u_x = 0.0F, v_x = 0.0F;  ///< to the next pixel of the row
  float u_y = 0.0F, v_y = 0.0F;  ///< to the next row
};

struct Filter {
  bool mipmaps = true;
  int most_taps = 16;  ///< along the footprint's longer side, 1 to 16
};

/// Sizes are powers of two from 2 x 2 up (others are stretched), each half the one before, box-filtered in linear grey.
class MipTexture {
 public:
  /// Throws std::invalid_argument if the texture's size and data do not fit or a side is above 8192.
  explicit MipTexture(const Texture& texture);

  /// Grey, 0 to 255: trilinear taps along the longer side of the footprint (as EXT_texture_filter_anisotropic has it).
  float sample(const Footprint& footprint, const Filter& filter) const;
  /// Grey at (u, v), 0 to 255, between its neighbours of one level, which is held within what there is.
  float at_level(float u, float v, int level) const;
  int levels() const { return static_cast<int>(levels_.size()); }
  int width() const { return 1 << levels_.front().log2_width; }
  int height() const { return 1 << levels_.front().log2_height; }

 private:
  struct Level {
    unsigned log2_width = 0, log2_height = 0;
    std::size_t stride = 0;
    std::vector<std::uint8_t> grey;  ///< the first row and column once more at the end: neighbours need no wrapping
    std::uint32_t tap(std::uint32_t u, std::uint32_t v) const;
  };
  void add_level(const std::vector<float>& grey, unsigned log2_width, unsigned log2_height);

  std::vector<Level> levels_;
};

}  // namespace convoy::simulator
