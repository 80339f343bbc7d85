#include "mip_texture.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <stdexcept>
#include <string>

namespace convoy::simulator {
namespace {

constexpr int kLargest = 8192;

unsigned log2_at_least(int size) {
  return std::max(1U, static_cast<unsigned>(std::bit_width(static_cast<unsigned>(size - 1))));
}

/// Straight lines between the powers of two; the error is below 0.09.
float log2_roughly(float x) {
  const auto bits = std::bit_cast<std::uint32_t>(x);
  return static_cast<float>(static_cast<std::int32_t>(bits)) * 0x1p-23F - 127.0F;
}

/// Between which two of `from` texels the i-th of `to` lies, and how far from the first.
struct Between {
  std::size_t first, second;
  double part;
};

std::vector<Between> places(int to, int from) {
  std::vector<Between> all;
  for (int i = 0; i < to; ++i) {
    const double place = (i + 0.5) * from / to - 0.5;
    const int first = static_cast<int>(std::floor(place));
    const auto wrapped = [from](int texel) { return static_cast<std::size_t>((texel + from) % from); };
    all.push_back({wrapped(first), wrapped(first + 1), place - first});
  }
  return all;
}

std::vector<float> stretched(const Texture& texture, int width, int height) {
  if (texture.width == width && texture.height == height) return {texture.grey.begin(), texture.grey.end()};
  std::vector<float> grey;
  grey.reserve(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  const std::vector<Between> columns = places(width, texture.width);
  for (const Between& y : places(height, texture.height)) {
    const std::uint8_t* row = texture.grey.data() + y.first * static_cast<std::size_t>(texture.width);
    const std::uint8_t* below = texture.grey.data() + y.second * static_cast<std::size_t>(texture.width);
    for (const Between& x : columns)
      grey.push_back(static_cast<float>((row[x.first] * (1 - x.part) + row[x.second] * x.part) * (1 - y.part) +
                                        (below[x.first] * (1 - x.part) + below[x.second] * x.part) * y.part));
  }
  return grey;
}

std::vector<float> halved(const std::vector<float>& grey, std::size_t width, std::size_t height, std::size_t by_x,
                          std::size_t by_y) {
  std::vector<float> half(grey.size() / (by_x * by_y));
  float* out = half.data();
  const float part = 1.0F / static_cast<float>(by_x * by_y);  // a power of two
  for (std::size_t y = 0; y < height; y += by_y) {
    const float *row = grey.data() + y * width, *below = row + (by_y - 1) * width;
    for (std::size_t x = 0; x < width; x += by_x, ++out)
      *out = by_y == 2
                 ? (by_x == 2 ? (row[x] + row[x + 1] + below[x] + below[x + 1]) * part : (row[x] + below[x]) * part)
                 : (row[x] + row[x + 1]) * part;
  }
  return half;
}

}  // namespace

MipTexture::MipTexture(const Texture& texture) {
  const int w = texture.width, h = texture.height;
  if (w < 1 || h < 1 || w > kLargest || h > kLargest ||
      texture.grey.size() != static_cast<std::size_t>(w) * static_cast<std::size_t>(h))
    throw std::invalid_argument("Texture: " + std::to_string(w) + " x " + std::to_string(h) + " with " +
                                std::to_string(texture.grey.size()) +
                                " texels; give sides of 1 to 8192 and width x height texels");
  unsigned log2_width = log2_at_least(w), log2_height = log2_at_least(h);
  width_ = 1 << log2_width, height_ = 1 << log2_height;
  texels_per_u2_ = static_cast<float>(width_) * static_cast<float>(width_);
  texels_per_v2_ = static_cast<float>(height_) * static_cast<float>(height_);
  std::vector<float> grey = stretched(texture, width_, height_);
  add_level(grey, log2_width, log2_height);
  while (log2_width > 1 || log2_height > 1) {
    const std::size_t by_x = log2_width > 1 ? 2 : 1, by_y = log2_height > 1 ? 2 : 1;
    grey = halved(grey, std::size_t{1} << log2_width, std::size_t{1} << log2_height, by_x, by_y);
    log2_width -= by_x > 1 ? 1 : 0, log2_height -= by_y > 1 ? 1 : 0;
    add_level(grey, log2_width, log2_height);
  }
  last_level_ = static_cast<float>(levels_.size() - 1);
}

void MipTexture::add_level(const std::vector<float>& grey, unsigned log2_width, unsigned log2_height) {
  const std::size_t width = std::size_t{1} << log2_width, height = std::size_t{1} << log2_height;
  Level level{32U - log2_width, 32U - log2_height, 1U << (31U - log2_width), 1U << (31U - log2_height), width + 1, {}};
  level.grey.resize((width + 1) * (height + 1));
  std::uint8_t* out = level.grey.data();
  for (std::size_t y = 0; y <= height; ++y, out += width + 1) {
    const float* row = grey.data() + (y < height ? y : 0) * width;
    for (std::size_t x = 0; x < width; ++x) out[x] = static_cast<std::uint8_t>(row[x] + 0.5F);
    out[width] = out[0];
  }
  levels_.push_back(std::move(level));
}

float MipTexture::at_level(float u, float v, int level) const {
  const auto index = static_cast<std::size_t>(std::clamp(level, 0, levels() - 1));
  return static_cast<float>(levels_[index].tap(fixed(u), fixed(v))) * (1.0F / 256.0F);
}

MipTexture::Taps MipTexture::taps(const Footprint& footprint, const Filter& filter) const {
  const auto texels2 = [this](float u, float v) { return u * u * texels_per_u2_ + v * v * texels_per_v2_; };
  float along_u = footprint.u_x, along_v = footprint.v_x;
  float longer = texels2(along_u, along_v), shorter = texels2(footprint.u_y, footprint.v_y);
  if (!filter.mipmaps || !(std::max(longer, shorter) > 1.0F))
    return {levels_.data(), levels_.data(), 0, 1, 0.0F, 0.0F, 0, 0, 0x1p-16F};
  if (longer < shorter) {
    std::swap(longer, shorter);
    along_u = footprint.u_y, along_v = footprint.v_y;
  }
  // Taps are no closer than texels of the finest level are.
  const float ratio = std::sqrt(longer / std::max(shorter, 1.0F));
  const int count = std::clamp(static_cast<int>(std::min(ratio, 16.0F) + 0.9F), 1, filter.most_taps);
  const float spacing = longer / static_cast<float>(count * count);
  const float lod = std::min(0.5F * log2_roughly(std::max(spacing, 1.0F)), last_level_);
  const auto index = static_cast<std::size_t>(lod);
  const auto coarser = static_cast<std::uint32_t>((lod - static_cast<float>(index)) * 256.0F);
  const float part = 1.0F / static_cast<float>(count), first = 0.5F * part - 0.5F;
  const Level* fine = levels_.data() + index;
  return {fine,
          coarser == 0 ? fine : fine + 1,
          coarser,
          count,
          along_u * first,
          along_v * first,
          fixed(along_u * part),
          fixed(along_v * part),
          part * 0x1p-16F};
}

std::shared_ptr<const std::vector<MipTexture>> mip_textures(const Scene& scene) {
  auto all = std::make_shared<std::vector<MipTexture>>();
  all->reserve(scene.textures.size());
  for (const Texture& texture : scene.textures) all->emplace_back(texture);
  return all;
}

}  // namespace convoy::simulator
