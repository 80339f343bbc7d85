// A texture in all sizes, and what a pixel's footprint on it averages to.
#pragma once

#include "scene.hpp"

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

namespace convoy::simulator {

/// How far a pixel's two sides go on a texture, in repeats of it.
struct Footprint {
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

  /// Where to look for the average over a footprint, relative to its middle; neighbouring pixels may share it.
  struct Taps;
  /// Trilinear taps along the longer side of the footprint (as EXT_texture_filter_anisotropic has it).
  Taps taps(const Footprint& footprint, const Filter& filter) const;
  /// Grey about each of `count` places, 0 to 255.
  static void sample(const float* u, const float* v, std::size_t count, const Taps& taps, float* grey);
  /// Grey at (u, v), 0 to 255, between its neighbours of one level, which is held within what there is.
  float at_level(float u, float v, int level) const;
  int levels() const { return static_cast<int>(levels_.size()); }
  int width() const { return width_; }
  int height() const { return height_; }

 private:
  struct Level;
  struct Start;
  struct Row;
  struct RowPair;
  static std::uint32_t fixed(float repeats);
  void add_level(const std::vector<float>& grey, unsigned log2_width, unsigned log2_height);

  int width_ = 0, height_ = 0;
  float texels_per_u2_ = 0.0F, texels_per_v2_ = 0.0F;  ///< squared
  float last_level_ = 0.0F;
  std::vector<Level> levels_;
};

struct MipTexture::Level {
  unsigned shift_u = 0, shift_v = 0;     ///< from 2^-32 repeats to 2^-16 texels
  std::uint32_t half_u = 0, half_v = 0;  ///< texels, in 2^-32 repeats
  std::int32_t stride = 0;
  std::vector<std::uint8_t> grey;  ///< the first row and column once more at the end: neighbours need no wrapping
};

struct MipTexture::Taps {
  const Level* fine;
  const Level* coarse;
  float fine_scale, coarse_scale;  ///< from the sum of a level's taps to grey
  int count;                       ///< 1 to 16
  float first_u, first_v;          ///< repeats
  std::uint32_t step_u, step_v;    ///< 2^-32 repeats
};

/// All textures of a scene, to be shared by the cameras in it.
std::shared_ptr<const std::vector<MipTexture>> mip_textures(const Scene& scene);

}  // namespace convoy::simulator
