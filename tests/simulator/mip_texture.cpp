#include "mip_texture.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <string>
#ifdef __SSE2__
#include <emmintrin.h>
#endif

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

constexpr float kAlone = 0.2F;        // of the way between two levels, at either end
constexpr float kTapUnit = 0x1p-14F;  // weights of a tap's four texels add up to 2^14

constexpr std::array<float, 17> parts_of_one() {
  std::array<float, 17> parts{};
  for (std::size_t count = 1; count < parts.size(); ++count) parts[count] = 1.0F / static_cast<float>(count);
  return parts;
}
constexpr std::array<float, 17> kParts = parts_of_one();  // by the number of taps

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
  Level level{16U - log2_width,
              16U - log2_height,
              1U << (31U - log2_width),
              1U << (31U - log2_height),
              static_cast<std::int32_t>(width + 1),
              {}};
  level.grey.resize((width + 1) * (height + 1));
  std::uint8_t* out = level.grey.data();
  for (std::size_t y = 0; y <= height; ++y, out += width + 1) {
    const float* row = grey.data() + (y < height ? y : 0) * width;
    for (std::size_t x = 0; x < width; ++x) out[x] = static_cast<std::uint8_t>(row[x] + 0.5F);
    out[width] = out[0];
  }
  levels_.push_back(std::move(level));
}

/// Repeats in 2^-32, without the whole ones.
std::uint32_t MipTexture::fixed(float repeats) {
  return static_cast<std::uint32_t>(static_cast<std::int64_t>(repeats * 0x1p32F));
}

/// Where a row of taps on one level begins, in 2^-16 texels.
struct MipTexture::Start {
  std::uint32_t u, v;

  Start(const Level& on, std::uint32_t at_u, std::uint32_t at_v)
      : u((at_u - on.half_u) >> on.shift_u), v((at_v - on.half_v) >> on.shift_v) {}
};

/// How rows of taps go on on one level.
struct MipTexture::Row {
  std::uint32_t step_u, step_v;  // 2^-16 texels
  std::uint32_t last_u, last_v;  // the largest place: places wrap by it
  std::int32_t stride;
  const std::uint8_t* grey;

  Row(const Level& on, const Taps& taps)
      : step_u(taps.step_u >> on.shift_u),
        step_v(taps.step_v >> on.shift_v),
        last_u(~0U >> on.shift_u),
        last_v(~0U >> on.shift_v),
        stride(on.stride),
        grey(on.grey.data()) {}

  /// Grey x 2^14 between four neighbours, added up.
  std::int32_t sum(Start at, int count) const {
    std::uint32_t sum = 0;
    for (int i = 0; i < count; ++i) {
      const std::uint32_t right = at.u >> 9U & 127U, lower = at.v >> 9U & 127U;
      const std::uint8_t* above = grey + static_cast<std::int32_t>(at.v >> 16U) * stride + (at.u >> 16U);
      const std::uint8_t* below = above + stride;
      sum += (above[0] * (128U - right) + above[1] * right) * (128U - lower) +
             (below[0] * (128U - right) + below[1] * right) * lower;
      at.u = (at.u + step_u) & last_u, at.v = (at.v + step_v) & last_v;
    }
    return static_cast<std::int32_t>(sum);
  }
};

/// Two rows at once.
#ifdef __SSE2__
struct MipTexture::RowPair {
  __m128i step, last, strides;
  const std::uint8_t *grey_a, *grey_b;
  std::int32_t stride_a, stride_b;

  RowPair(const Row& a, const Row& b)
      : step(four(a.step_u, a.step_v, b.step_u, b.step_v)),
        last(four(a.last_u, a.last_v, b.last_u, b.last_v)),
        strides(four(static_cast<std::uint32_t>(a.stride) << 16U | 1U, static_cast<std::uint32_t>(b.stride) << 16U | 1U,
                     0, 0)),
        grey_a(a.grey),
        grey_b(b.grey),
        stride_a(a.stride),
        stride_b(b.stride) {}

  /// Places and weights of both are found at once, four texels are weighed by one operation.
  std::array<std::int32_t, 2> sums(Start a, Start b, int count) const {
    __m128i place = four(a.u, a.v, b.u, b.v), sum = _mm_setzero_si128();
    for (int i = 0; i < count; ++i) {
      const __m128i whole = _mm_srli_epi32(place, 16);
      const __m128i at = _mm_madd_epi16(_mm_packs_epi32(whole, whole), strides);
      const std::uint8_t* const texels_a = grey_a + _mm_cvtsi128_si32(at);
      const std::uint8_t* const texels_b = grey_b + _mm_cvtsi128_si32(_mm_shuffle_epi32(at, 1));
      // Each lane: (128 - part, part) in 16 bits each.
      const __m128i part = _mm_and_si128(_mm_srli_epi32(place, 9), _mm_set1_epi32(127));
      const __m128i parts = _mm_add_epi32(_mm_sub_epi32(_mm_slli_epi32(part, 16), part), _mm_set1_epi32(128));
      const __m128i along = _mm_shuffle_epi32(parts, 0b10100000);
      const __m128i down =
          _mm_shufflehi_epi16(_mm_shufflelo_epi16(_mm_shuffle_epi32(parts, 0b11110101), 0b01010000), 0b01010000);
      __m128i texels = _mm_cvtsi32_si128(pair(texels_a));
      texels = _mm_insert_epi16(texels, pair(texels_a + stride_a), 1);
      texels = _mm_insert_epi16(texels, pair(texels_b), 2);
      texels = _mm_insert_epi16(texels, pair(texels_b + stride_b), 3);
      texels = _mm_unpacklo_epi8(texels, _mm_setzero_si128());
      sum = _mm_add_epi32(sum, _mm_madd_epi16(texels, _mm_mullo_epi16(along, down)));
      place = _mm_and_si128(_mm_add_epi32(place, step), last);
    }
    sum = _mm_add_epi32(sum, _mm_shuffle_epi32(sum, 0b10110001));
    return {_mm_cvtsi128_si32(sum), _mm_cvtsi128_si32(_mm_shuffle_epi32(sum, 2))};
  }

 private:
  static __m128i four(std::uint32_t i, std::uint32_t j, std::uint32_t k, std::uint32_t l) {
    return _mm_setr_epi32(static_cast<int>(i), static_cast<int>(j), static_cast<int>(k), static_cast<int>(l));
  }
  static std::uint16_t pair(const std::uint8_t* texels) {
    std::uint16_t both;
    std::memcpy(&both, texels, sizeof both);
    return both;
  }
};
#else
struct MipTexture::RowPair {
  Row one, other;

  RowPair(const Row& a, const Row& b) : one(a), other(b) {}
  std::array<std::int32_t, 2> sums(Start a, Start b, int count) const {
    return {one.sum(a, count), other.sum(b, count)};
  }
};
#endif

void MipTexture::sample(const float* u, const float* v, std::size_t count, const Taps& taps, float* grey) {
  const auto start = [&](const Level& level, std::size_t i) {
    return Start(level, fixed(u[i] + taps.first_u), fixed(v[i] + taps.first_v));
  };
  const Row fine(*taps.fine, taps);
  if (taps.coarse != taps.fine) {
    const RowPair both(fine, Row(*taps.coarse, taps));
    for (std::size_t i = 0; i < count; ++i) {
      const auto [sharp, blurred] = both.sums(start(*taps.fine, i), start(*taps.coarse, i), taps.count);
      grey[i] = static_cast<float>(sharp) * taps.fine_scale + static_cast<float>(blurred) * taps.coarse_scale;
    }
    return;
  }
  const RowPair both(fine, fine);
  std::size_t i = 0;
  for (; i + 2 <= count; i += 2) {
    const auto [one, next] = both.sums(start(*taps.fine, i), start(*taps.fine, i + 1), taps.count);
    grey[i] = static_cast<float>(one) * taps.fine_scale, grey[i + 1] = static_cast<float>(next) * taps.fine_scale;
  }
  if (i < count) grey[i] = static_cast<float>(fine.sum(start(*taps.fine, i), taps.count)) * taps.fine_scale;
}

float MipTexture::at_level(float u, float v, int level) const {
  const Level& on = levels_[static_cast<std::size_t>(std::clamp(level, 0, levels() - 1))];
  const Taps one{&on, &on, kTapUnit, 0.0F, 1, 0.0F, 0.0F, 0, 0};
  return static_cast<float>(Row(on, one).sum(Start(on, fixed(u), fixed(v)), 1)) * kTapUnit;
}

MipTexture::Taps MipTexture::taps(const Footprint& footprint, const Filter& filter) const {
  const auto texels2 = [this](float u, float v) { return u * u * texels_per_u2_ + v * v * texels_per_v2_; };
  float along_u = footprint.u_x, along_v = footprint.v_x;
  float longer = texels2(along_u, along_v), shorter = texels2(footprint.u_y, footprint.v_y);
  if (!filter.mipmaps || !(std::max(longer, shorter) > 1.0F))
    return {levels_.data(), levels_.data(), kTapUnit, 0.0F, 1, 0.0F, 0.0F, 0, 0};
  if (longer < shorter) {
    std::swap(longer, shorter);
    along_u = footprint.u_y, along_v = footprint.v_y;
  }
  // Taps are no closer than texels of the finest level are.
  const float ratio = std::sqrt(longer / std::max(shorter, 1.0F));
  const int count = std::clamp(static_cast<int>(std::min(ratio, 16.0F) + 0.9F), 1, filter.most_taps);
  const float part = kParts[static_cast<std::size_t>(count)], first = 0.5F * part - 0.5F;
  const float spacing = longer * part * part;
  const float lod = std::min(0.5F * log2_roughly(std::max(spacing, 1.0F)), last_level_);
  const auto index = static_cast<std::size_t>(lod);
  // Near a level that one alone serves, at half the work.
  const float coarser =
      std::clamp((lod - static_cast<float>(index) - kAlone) * (1.0F / (1.0F - 2.0F * kAlone)), 0.0F, 1.0F);
  const Level *fine = levels_.data() + index + (coarser < 1.0F ? 0 : 1),
              *coarse = levels_.data() + index + (coarser > 0.0F ? 1 : 0);
  return {fine,
          coarse,
          part * kTapUnit * (fine == coarse ? 1.0F : 1.0F - coarser),
          part * kTapUnit * coarser,
          count,
          along_u * first,
          along_v * first,
          fixed(along_u * part),
          fixed(along_v * part)};
}

std::shared_ptr<const std::vector<MipTexture>> mip_textures(const Scene& scene) {
  auto all = std::make_shared<std::vector<MipTexture>>();
  all->reserve(scene.textures.size());
  for (const Texture& texture : scene.textures) all->emplace_back(texture);
  return all;
}

}  // namespace convoy::simulator
