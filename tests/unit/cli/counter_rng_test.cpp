#include "scenario/counter_rng.hpp"

#include <gtest/gtest.h>

namespace convoy::cli {
namespace {

// Known answers of Philox4x32-10 from the Random123 distribution.
TEST(Philox, GivesTheKnownAnswers) {
  EXPECT_EQ(philox4x32({0, 0, 0, 0}, {0, 0}),
            (std::array<std::uint32_t, 4>{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  EXPECT_EQ(philox4x32({0xffffffff, 0xffffffff, 0xffffffff, 0xffffffff}, {0xffffffff, 0xffffffff}),
            (std::array<std::uint32_t, 4>{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}));
  EXPECT_EQ(philox4x32({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, {0xa4093822, 0x299f31d0}),
            (std::array<std::uint32_t, 4>{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}));
}

TEST(CounterRng, DependsOnEveryPartOfItsKeyAndPlace) {
  const double here = CounterRng(1, 2, 3).uniform(4, 5);
  EXPECT_EQ(here, CounterRng(1, 2, 3).uniform(4, 5));
  EXPECT_NE(here, CounterRng(9, 2, 3).uniform(4, 5));
  EXPECT_NE(here, CounterRng(1 + (1ULL << 32), 2, 3).uniform(4, 5));
  EXPECT_NE(here, CounterRng(1, 9, 3).uniform(4, 5));
  EXPECT_NE(here, CounterRng(1, 2, 9).uniform(4, 5));
  EXPECT_NE(here, CounterRng(1, 2, 3).uniform(9, 5));
  EXPECT_NE(here, CounterRng(1, 2, 3).uniform(4, 9));
}

TEST(CounterRng, HasTheMomentsItPromises) {
  const CounterRng rng(7, 1, 0);
  constexpr int count = 200000;
  double uniform_sum = 0, sum = 0, squares = 0, fourth = 0, lag = 0, last = 0;
  for (std::uint32_t i = 0; i < count; ++i) {
    const double u = rng.uniform(i), z = rng.normal(i, 1);
    ASSERT_GE(u, 0.0);
    ASSERT_LT(u, 1.0);
    uniform_sum += u;
    sum += z;
    squares += z * z;
    fourth += z * z * z * z;
    lag += z * last;
    last = z;
  }
  // 4 standard deviations of each mean
  EXPECT_NEAR(uniform_sum / count, 0.5, 4 * std::sqrt(1.0 / 12 / count));
  EXPECT_NEAR(sum / count, 0.0, 4 / std::sqrt(count));
  EXPECT_NEAR(squares / count, 1.0, 4 * std::sqrt(2.0 / count));
  EXPECT_NEAR(fourth / count, 3.0, 4 * std::sqrt(96.0 / count));
  EXPECT_NEAR(lag / count, 0.0, 4 / std::sqrt(count));
}

}  // namespace
}  // namespace convoy::cli
