// A texture in all sizes, and what a pixel's footprint on it averages to.
#pragma once

#include "scene.hpp"

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
  /// Grey about (u, v), 0 to 255.
  static float sample(float u, float v, const Taps& taps);
  /// Grey at (u, v), 0 to 255, between its neighbours of one level, which is held within what there is.
  float at_level(float u, float v, int level) const;
  int levels() const { return static_cast<int>(levels_.size()); }
  int width() const { return width_; }
  int height() const { return height_; }

 private:
  struct Level {
    unsigned shift_u = 0, shift_v = 0;     ///< from 2^-32 repeats to texels
    std::uint32_t half_u = 0, half_v = 0;  ///< texels, in 2^-32 repeats
    std::size_t stride = 0;
    std::vector<std::uint8_t> grey;  ///< the first row and column once more at the end: neighbours need no wrapping
    std::uint32_t tap(std::uint32_t u, std::uint32_t v) const;
  };
  static std::uint32_t fixed(float repeats);
  void add_level(const std::vector<float>& grey, unsigned log2_width, unsigned log2_height);

  int width_ = 0, height_ = 0;
  float texels_per_u2_ = 0.0F, texels_per_v2_ = 0.0F;  ///< squared
  float last_level_ = 0.0F;
  std::vector<Level> levels_;
};

struct MipTexture::Taps {
  const Level* fine;
  const Level* coarse;
  std::uint32_t coarser;         ///< weight of the coarse level, of 256
  int count;                     ///< 1 to 16
  float first_u, first_v;        ///< repeats
  std::uint32_t step_u, step_v;  ///< 2^-32 repeats
  float scale;                   ///< from the sum of taps to grey
};

/// Repeats in 2^-32, without the whole ones.
inline std::uint32_t MipTexture::fixed(float repeats) {
  return static_cast<std::uint32_t>(static_cast<std::int64_t>(static_cast<double>(repeats) * 0x1p32));
}

/// Grey x 256 between the four neighbours.
inline std::uint32_t MipTexture::Level::tap(std::uint32_t u, std::uint32_t v) const {
  u -= half_u, v -= half_v;
  const std::uint32_t fx = (u >> (shift_u - 8U)) & 255U, fy = (v >> (shift_v - 8U)) & 255U;
  const std::uint8_t* above = grey.data() + (v >> shift_v) * stride + (u >> shift_u);
  const std::uint8_t* below = above + stride;
  const std::uint32_t left = above[0] * (256U - fy) + below[0] * fy, right = above[1] * (256U - fy) + below[1] * fy;
  return (left * (256U - fx) + right * fx) >> 8U;
}

inline float MipTexture::sample(float u, float v, const Taps& taps) {
  std::uint32_t at_u = fixed(u + taps.first_u), at_v = fixed(v + taps.first_v), sum = 0;
  if (taps.coarser == 0) {
    for (int i = 0; i < taps.count; ++i, at_u += taps.step_u, at_v += taps.step_v) sum += taps.fine->tap(at_u, at_v);
    sum <<= 8U;
  } else {
    const std::uint32_t finer = 256U - taps.coarser;
    for (int i = 0; i < taps.count; ++i, at_u += taps.step_u, at_v += taps.step_v)
      sum += taps.fine->tap(at_u, at_v) * finer + taps.coarse->tap(at_u, at_v) * taps.coarser;
  }
  return static_cast<float>(sum) * taps.scale;
}

/// All textures of a scene, to be shared by the cameras in it.
std::shared_ptr<const std::vector<MipTexture>> mip_textures(const Scene& scene);

}  // namespace convoy::simulator
