// Painting grey textures by measures in metres.
#pragma once

#include "random.hpp"
#include "scene.hpp"

#include <vector>

namespace convoy::simulator {

/// Roughness of a material: a square that repeats, deviations of grey.
class NoiseTile {
 public:
  /// `finest` and `coarsest`: wavelengths [texels], powers of two up to `size`; every octave as strong as
  /// 2^(-falling * octave) of the coarsest one; all together of standard deviation `sigma`.
  NoiseTile(std::uint32_t seed, int size, int finest, int coarsest, double falling, double sigma);
  float at(int x, int y) const { return values_[static_cast<std::size_t>((y & mask_) * (mask_ + 1) + (x & mask_))]; }

 private:
  int mask_;
  std::vector<float> values_;
};

/// x to the right, y down from the upper edge [m]; what is painted over the edge is cut, or comes in on the other side.
class Canvas {
 public:
  Canvas(double width_m, double height_m, double texel_m, bool wraps = false);

  double width_m() const { return image_.width * texel_m_; }
  double height_m() const { return image_.height * texel_m_; }

  void fill(double x0, double y0, double x1, double y1, double grey, double opacity = 1.0);
  /// Grey from `top` to `bottom`.
  void shade(double x0, double y0, double x1, double y1, double top, double bottom, double opacity = 1.0);
  /// Multiplies by a factor; soft over `soft_m` inwards from the edges.
  void darken(double x0, double y0, double x1, double y1, double factor, double soft_m = 0.0);
  void line(double x0, double y0, double x1, double y1, double width_m, double grey, double opacity = 1.0);
  void disc(double x, double y, double radius_m, double grey, double opacity = 1.0);
  /// Adds noise of a tile; offsets in texels of the tile.
  void roughen(const NoiseTile& tile, double strength, int offset_x, int offset_y, int scale = 1);
  /// A crooked line that wanders from (x, y) on, by steps of 4 cm.
  void crack(Stream& random, double x, double y, double angle_rad, double length_m, double width_m, double grey);
  /// `count` signs that look like letters, of height h, in a row from (x, y) on.
  void letters(Stream& random, double x, double y, double h, int count, double grey);
  /// Outline.
  void frame(double x0, double y0, double x1, double y1, double width_m, double grey);

  Texture take() { return std::move(image_); }

 private:
  template <typename Change>
  void each(double x0, double y0, double x1, double y1, Change change);

  Texture image_;
  double texel_m_;
  bool wraps_;
};

/// One texel.
Texture plain(std::uint8_t grey);

}  // namespace convoy::simulator
