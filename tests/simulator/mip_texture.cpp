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

std::vector<float> stretched(const Texture& texture, int width, int height) {
  std::vector<float> grey;
  grey.reserve(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  const auto place = [](int i, int to, int from) { return (i + 0.5) * from / to - 0.5; };
  const auto at = [&texture](int x, int y) {
    const int column = (x + texture.width) % texture.width, row = (y + texture.height) % texture.height;
    return static_cast<double>(texture.grey[static_cast<std::size_t>(row * texture.width + column)]);
  };
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const double fx = place(x, width, texture.width), fy = place(y, height, texture.height);
      const int x0 = static_cast<int>(std::floor(fx)), y0 = static_cast<int>(std::floor(fy));
      const double a = fx - x0, b = fy - y0;
      grey.push_back(static_cast<float>((at(x0, y0) * (1 - a) + at(x0 + 1, y0) * a) * (1 - b) +
                                        (at(x0, y0 + 1) * (1 - a) + at(x0 + 1, y0 + 1) * a) * b));
    }
  return grey;
}

std::vector<float> halved(const std::vector<float>& grey, std::size_t width, std::size_t height, std::size_t by_x,
                          std::size_t by_y) {
  std::vector<float> half;
  half.reserve(grey.size() / (by_x * by_y));
  for (std::size_t y = 0; y < height; y += by_y)
    for (std::size_t x = 0; x < width; x += by_x) {
      float sum = 0.0F;
      for (std::size_t j = 0; j < by_y; ++j)
        for (std::size_t i = 0; i < by_x; ++i) sum += grey[(y + j) * width + x + i];
      half.push_back(sum / static_cast<float>(by_x * by_y));
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
  level.grey.reserve((width + 1) * (height + 1));
  for (std::size_t y = 0; y <= height; ++y)
    for (std::size_t x = 0; x <= width; ++x)
      level.grey.push_back(static_cast<std::uint8_t>(grey[(y % height) * width + x % width] + 0.5F));
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

}  // namespace convoy::simulator
