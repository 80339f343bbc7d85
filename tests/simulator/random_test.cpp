#include "random.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>

namespace convoy::simulator {
namespace {

// The known answers of the authors' own implementation (Random123, kat_vectors: philox4x32-10).
TEST(Random, IsPhilox) {
  Stream zero({0, 0, 0, 0});
  std::array<std::uint32_t, 4> first{};
  for (auto it = first.rbegin(); it != first.rend(); ++it) *it = zero();
  EXPECT_EQ(first, (std::array<std::uint32_t, 4>{0x6627e8d5U, 0xe169c58dU, 0xbc57ac4cU, 0x9b00dbd8U}));
}

TEST(Random, StreamsDependOnTheirKeyAlone) {
  for (int part = 0; part < 4; ++part) {
    StreamKey other{1, 2, 3, 4};
    (part == 0 ? other.seed : part == 1 ? other.vehicle : part == 2 ? other.sensor : other.frame) += 1;
    Stream a({1, 2, 3, 4}), again({1, 2, 3, 4}), b(other);
    int same = 0;
    for (int i = 0; i < 1000; ++i) {
      const std::uint32_t number = a();
      EXPECT_EQ(number, again());
      same += number == b();
    }
    EXPECT_EQ(same, 0) << part;
  }
}

TEST(Random, HasTheMomentsItSays) {
  Stream stream({7, 0, 0, 0});
  constexpr int n = 100'000;
  double sum = 0.0, squares = 0.0, fourth = 0.0, uniform = 0.0;
  for (int i = 0; i < n; ++i) {
    const double x = stream.gaussian(), u = stream.uniform(-1.0, 3.0);
    ASSERT_GE(u, -1.0);
    ASSERT_LT(u, 3.0);
    ASSERT_LT(stream.below(7), 7U);
    sum += x;
    squares += x * x;
    fourth += x * x * x * x;
    uniform += u;
  }
  EXPECT_NEAR(sum / n, 0.0, 0.02);
  EXPECT_NEAR(squares / n, 1.0, 0.03);
  EXPECT_NEAR(fourth / n, 3.0, 0.2);
  EXPECT_NEAR(uniform / n, 1.0, 0.02);
}

}  // namespace
}  // namespace convoy::simulator
