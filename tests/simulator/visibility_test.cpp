#include "visibility.hpp"

#include "random.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace convoy::simulator {
namespace {

using Corner = VisibilityBuffer::Corner;

const Eigen::Vector3d kFar(0.0, 0.0, 0.1), kNear(0.0, 0.0, 0.2);

std::size_t count(const VisibilityBuffer& buffer, std::uint32_t id) {
  const std::size_t n = static_cast<std::size_t>(buffer.window().height) * buffer.stride();
  return static_cast<std::size_t>(std::count(buffer.ids(), buffer.ids() + n, id));
}

TEST(VisibilityBuffer, NothingIsLeftOfWhatIsBesideTheWindow) {
  VisibilityBuffer buffer({0.0, 0.0, 1.0, 90, 70});
  EXPECT_FALSE(buffer.draw(nullptr, 0, kFar, 1));
  EXPECT_EQ(count(buffer, 1), 0U);
}

// A window cut into crooked quadrilaterals, each into two triangles, corners at any sixteenth of a pixel.
TEST(VisibilityBuffer, TrianglesThatShareEdgesShareNoPixelAndLeaveNone) {
  const Window window{0.0, 0.0, 1.0, 90, 70};
  constexpr int n = 12;
  for (std::uint32_t round = 0; round < 20; ++round) {
    Stream stream({3, 0, 0, round});
    std::array<std::array<Corner, n + 1>, n + 1> grid;
    for (int j = 0; j <= n; ++j)
      for (int i = 0; i <= n; ++i) {
        const auto off = [&](bool border) { return border ? 0 : static_cast<int>(stream.below(50)) - 25; };
        const bool x_border = i == 0 || i == n, y_border = j == 0 || j == n;
        grid[static_cast<std::size_t>(j)][static_cast<std::size_t>(i)] = {90 * 16 * i / n + off(x_border),
                                                                          70 * 16 * j / n + off(y_border)};
      }
    std::size_t sum = 0;
    VisibilityBuffer all(window);
    for (std::size_t j = 0; j < n; ++j)
      for (std::size_t i = 0; i < n; ++i) {
        const Corner a = grid[j][i], b = grid[j][i + 1], c = grid[j + 1][i + 1], d = grid[j + 1][i];
        for (const auto& triangle : {std::array{a, d, c}, std::array{a, c, b}}) {
          VisibilityBuffer alone(window);
          alone.draw(triangle.data(), 3, kFar, 7);
          all.draw(triangle.data(), 3, kFar, 7);
          sum += count(alone, 7);
        }
      }
    EXPECT_EQ(sum, 90U * 70U) << round;
    EXPECT_EQ(count(all, VisibilityBuffer::kNothing), 0U) << round;
  }
}

TEST(VisibilityBuffer, KeepsWhatIsNearerInEitherOrder) {
  const std::array<Corner, 4> small{Corner(64, 64), {64, 320}, {320, 320}, {320, 64}};
  const std::array<Corner, 4> large{Corner(0, 0), {0, 480}, {640, 480}, {640, 0}};
  for (const bool near_first : {false, true}) {
    VisibilityBuffer buffer({0.0, 0.0, 1.0, 40, 30});
    if (near_first) {
      EXPECT_TRUE(buffer.draw(small.data(), 4, kNear, 1));
    }
    EXPECT_TRUE(buffer.draw(large.data(), 4, kFar, 2));
    if (!near_first) {
      EXPECT_TRUE(buffer.draw(small.data(), 4, kNear, 1));
    }
    EXPECT_EQ(count(buffer, 1), 16U * 16U);
    EXPECT_EQ(count(buffer, 2), 40U * 30U - 16U * 16U);
    EXPECT_FALSE(buffer.draw(small.data(), 4, kFar, 3)) << "hidden";
  }
}

}  // namespace
}  // namespace convoy::simulator
