#include "mip_texture.hpp"

#include "random.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numeric>
#include <stdexcept>

namespace convoy::simulator {
namespace {

Texture noise(int width, int height) {
  Texture texture{width, height, {}};
  Stream stream({5, 0, 0, 0});
  for (int i = 0; i < width * height; ++i) texture.grey.push_back(static_cast<std::uint8_t>(stream.below(256)));
  return texture;
}

double mean(const Texture& texture) {
  return std::accumulate(texture.grey.begin(), texture.grey.end(), 0.0) / static_cast<double>(texture.grey.size());
}

TEST(MipTexture, GivesATexelInItsMiddleAndRepeats) {
  const Texture texture = noise(16, 8);
  const MipTexture mips(texture);
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 16; ++x)
      for (const float repeat : {-3.0F, 0.0F, 2.0F})
        EXPECT_NEAR(
            mips.at_level((static_cast<float>(x) + 0.5F) / 16.0F + repeat, (static_cast<float>(y) + 0.5F) / 8.0F, 0),
            texture.grey[static_cast<std::size_t>(y * 16 + x)], 0.01F);
}

TEST(MipTexture, SmallestLevelIsTheMean) {
  for (const auto& [width, height] : {std::pair{64, 64}, {256, 16}, {1, 1}, {100, 30}}) {
    const Texture texture = noise(width, height);
    const MipTexture mips(texture);
    EXPECT_NEAR(mips.at_level(0.5F, 0.5F, 99), mean(texture), 2.0) << width << " x " << height;
  }
}

// What the taps say, against the mean of the texture over the footprint's parallelogram.
TEST(MipTexture, AveragesAlongAFootprint) {
  Texture texture = noise(256, 256);
  const MipTexture mips(texture);
  Stream stream({6, 0, 0, 0});
  const auto error = [&](int most_taps, bool mipmaps) {
    double squares = 0.0;
    constexpr int n = 300;
    for (int i = 0; i < n; ++i) {
      const auto u = static_cast<float>(stream.uniform(0.0, 1.0)), v = static_cast<float>(stream.uniform(0.0, 1.0));
      const double angle = stream.uniform(0.0, 2.0 * M_PI);
      const auto c = static_cast<float>(std::cos(angle) / 256.0), s = static_cast<float>(std::sin(angle) / 256.0);
      const Footprint footprint{12.0F * c, 12.0F * s, -1.5F * s, 1.5F * c};
      double sum = 0.0;
      for (int a = 0; a < 24; ++a)
        for (int b = 0; b < 6; ++b) {
          const float x = (static_cast<float>(a) + 0.5F) / 24.0F - 0.5F,
                      y = (static_cast<float>(b) + 0.5F) / 6.0F - 0.5F;
          sum += static_cast<double>(
              mips.at_level(u + x * footprint.u_x + y * footprint.u_y, v + x * footprint.v_x + y * footprint.v_y, 0));
        }
      float got = 0.0F;
      MipTexture::sample(&u, &v, 1, mips.taps(footprint, {mipmaps, most_taps}), &got);
      squares += std::pow(static_cast<double>(got) - sum / 144.0, 2);
    }
    return std::sqrt(squares / n);
  };
  const double anisotropic = error(16, true), isotropic = error(1, true), none = error(1, false);
  EXPECT_LT(anisotropic, 10.0);
  EXPECT_LT(anisotropic, 0.75 * isotropic);
  EXPECT_LT(anisotropic, 0.3 * none);
}

// Two rows of taps at once, as they are where there is SSE2, are what each of them is alone, to the bit.
TEST(MipTexture, RowsTogetherAreWhatEachIsAlone) {
  Stream stream({7, 0, 0, 0});
  for (const auto& [width, height] : {std::pair{8192, 4}, {2, 8192}, {64, 64}}) {
    const MipTexture mips(noise(width, height));
    int on_two_levels = 0, counts = 0;
    for (int i = 0; i < 3000; ++i) {
      const auto number = [&](double most) { return static_cast<float>(stream.uniform(-most, most)); };
      const auto texels = [&](float size, double most) { return number(most) / size; };
      const auto w = static_cast<float>(width), h = static_cast<float>(height);
      const MipTexture::Taps taps =
          mips.taps({texels(w, 60.0), texels(h, 60.0), texels(w, 3.0), texels(h, 3.0)}, {true, 1 + i % 16});
      counts |= 1 << taps.count;
      std::array<float, 4> u, v, together, alone;
      for (std::size_t k = 0; k < 4; ++k) u[k] = number(3.0), v[k] = number(3.0);
      MipTexture::sample(u.data(), v.data(), 4, taps, together.data());
      const auto on_one = [&](const auto* level, float scale, std::size_t k) {
        MipTexture::Taps only = taps;
        only.fine = only.coarse = level, only.fine_scale = scale;
        float grey = 0.0F;
        MipTexture::sample(&u[k], &v[k], 1, only, &grey);  // an odd one out goes alone
        return grey;
      };
      for (std::size_t k = 0; k < 4; ++k) {
        alone[k] = on_one(taps.fine, taps.fine_scale, k);
        if (taps.coarse != taps.fine) alone[k] += on_one(taps.coarse, taps.coarse_scale, k);
      }
      on_two_levels += taps.coarse != taps.fine ? 1 : 0;
      ASSERT_EQ(together, alone) << width << " x " << height << ", " << taps.count << " taps";
    }
    EXPECT_GT(on_two_levels, 300);
    EXPECT_LT(on_two_levels, 2700);
    EXPECT_EQ(counts, (1 << 17) - 2) << "all numbers of taps";
  }
}

TEST(MipTexture, RefusesWhatIsNoTexture) {
  EXPECT_THROW(MipTexture(Texture{}), std::invalid_argument);
  EXPECT_THROW(MipTexture(Texture{2, 2, {1, 2, 3}}), std::invalid_argument);
  EXPECT_THROW(MipTexture(Texture{10'000, 1, std::vector<std::uint8_t>(10'000)}), std::invalid_argument);
}

}  // namespace
}  // namespace convoy::simulator
