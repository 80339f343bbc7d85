#include "mip_texture.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <string>

namespace convoy::simulator {
namespace {

constexpr int kLargest = 8192;

unsigned log2_at_least(int size) {
  return std::max(1U, static_cast<unsigned>(std::bit_width(static_cast<unsigned>(size - 1))));
}

/// Repeats of the texture in 2^-32, without the whole ones.
std::uint32_t fixed(float repeats) {
  return static_cast<std::uint32_t>(static_cast<std::int64_t>(static_cast<double>(repeats) * 0x1p32));
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
  std::vector<float> grey = stretched(texture, 1 << log2_width, 1 << log2_height);
  add_level(grey, log2_width, log2_height);
  while (log2_width > 1 || log2_height > 1) {
    const std::size_t by_x = log2_width > 1 ? 2 : 1, by_y = log2_height > 1 ? 2 : 1;
    grey = halved(grey, std::size_t{1} << log2_width, std::size_t{1} << log2_height, by_x, by_y);
    log2_width -= by_x > 1 ? 1 : 0, log2_height -= by_y > 1 ? 1 : 0;
    add_level(grey, log2_width, log2_height);
  }
}

void MipTexture::add_level(const std::vector<float>& grey, unsigned log2_width, unsigned log2_height) {
  const std::size_t width = std::size_t{1} << log2_width, height = std::size_t{1} << log2_height;
  Level level{log2_width, log2_height, width + 1, {}};
  level.grey.reserve((width + 1) * (height + 1));
  for (std::size_t y = 0; y <= height; ++y)
    for (std::size_t x = 0; x <= width; ++x)
      level.grey.push_back(static_cast<std::uint8_t>(grey[(y % height) * width + x % width] + 0.5F));
  levels_.push_back(std::move(level));
}

/// Grey x 256 between the four neighbours.
inline std::uint32_t MipTexture::Level::tap(std::uint32_t u, std::uint32_t v) const {
  u -= 1U << (31U - log2_width), v -= 1U << (31U - log2_height);
  const std::uint32_t x = u >> (32U - log2_width), y = v >> (32U - log2_height);
  const std::uint32_t fx = (u >> (24U - log2_width)) & 255U, fy = (v >> (24U - log2_height)) & 255U;
  const std::uint8_t* above = grey.data() + y * stride + x;
  const std::uint8_t* below = above + stride;
  const std::uint32_t left = above[0] * (256U - fy) + below[0] * fy, right = above[1] * (256U - fy) + below[1] * fy;
  return (left * (256U - fx) + right * fx) >> 8U;
}

float MipTexture::at_level(float u, float v, int level) const {
  const auto index = static_cast<std::size_t>(std::clamp(level, 0, levels() - 1));
  return static_cast<float>(levels_[index].tap(fixed(u), fixed(v))) * (1.0F / 256.0F);
}

float MipTexture::sample(const Footprint& footprint, const Filter& filter) const {
  const auto w = static_cast<float>(width()), h = static_cast<float>(height());
  const auto squared = [w, h](float u, float v) { return u * u * w * w + v * v * h * h; };
  float along_u = footprint.u_x, along_v = footprint.v_x;
  float longer = squared(along_u, along_v), shorter = squared(footprint.u_y, footprint.v_y);
  if (!filter.mipmaps || !(std::max(longer, shorter) > 1.0F)) return at_level(footprint.u, footprint.v, 0);
  if (longer < shorter) {
    std::swap(longer, shorter);
    along_u = footprint.u_y, along_v = footprint.v_y;
  }
  // Taps are no closer than texels of the finest level are.
  const float ratio = std::sqrt(longer / std::max(shorter, 1.0F));
  const int taps = std::clamp(static_cast<int>(std::ceil(std::min(ratio, 16.0F) - 0.1F)), 1, filter.most_taps);
  const float spacing = longer / static_cast<float>(taps * taps);
  const float lod = std::clamp(0.5F * log2_roughly(std::max(spacing, 1.0F)), 0.0F, static_cast<float>(levels() - 1));
  const auto index = static_cast<std::size_t>(lod);
  const auto coarser = static_cast<std::uint32_t>((lod - static_cast<float>(index)) * 256.0F);
  const Level& fine = levels_[index];
  const Level& coarse = levels_[std::min(index + 1, levels_.size() - 1)];

  const float part = 1.0F / static_cast<float>(taps);
  const std::uint32_t step_u = fixed(along_u * part), step_v = fixed(along_v * part);
  std::uint32_t u = fixed(footprint.u - along_u * (0.5F - 0.5F * part));
  std::uint32_t v = fixed(footprint.v - along_v * (0.5F - 0.5F * part));
  std::uint32_t sum = 0;
  for (int i = 0; i < taps; ++i, u += step_u, v += step_v) {
    sum += fine.tap(u, v) * (256U - coarser);
    if (coarser != 0) sum += coarse.tap(u, v) * coarser;
  }
  return static_cast<float>(sum) * (part * 0x1p-16F);
}

}  // namespace convoy::simulator
