#include <convoy/association/appearance.hpp>
#include <convoy/association/associate.hpp>
#include <convoy/geometry/groups.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace convoy {
namespace {

using Grey = std::array<double, 64>;

Descriptor patch_of(const Grey& grey) {
  Descriptor d;
  d.kind = Descriptor::Kind::patch_8x8_4bit;
  const auto level = [](double g) { return static_cast<std::uint8_t>(std::clamp(std::lround(g), 0L, 15L)); };
  for (std::size_t k = 0; k < 32; ++k)
    d.bytes[k] = static_cast<std::uint8_t>(level(grey[2 * k]) | (level(grey[2 * k + 1]) << 4));
  return d;
}

/// A few blobs, as a blurred image has them.
Grey any_patch(test::Random& random) {
  Grey grey{};
  for (int blob = 0; blob < 6; ++blob) {
    const double x = random.uniform(0, 7), y = random.uniform(0, 7), height = random.uniform(-6, 6);
    for (std::size_t k = 0; k < 64; ++k) {
      const double dx = static_cast<double>(k % 8) - x, dy = static_cast<double>(k / 8) - y;
      grey[k] += height * std::exp(-(dx * dx + dy * dy) / 5.0);
    }
  }
  for (double& g : grey) g += 8.0;
  return grey;
}

Grey seen_again(test::Random& random, Grey grey) {
  for (double& g : grey) g = 7.5 + 0.8 * (g - 8.0) + random.normal(0.7);  // other light
  return grey;
}

TEST(Appearance, IsTheCorrelationOfPatchesWhateverTheirLight) {
  test::Random random(1);
  const Grey grey = any_patch(random);
  EXPECT_NEAR(similarity(patch_of(grey), patch_of(grey)).value(), 1.0, 1e-12);
  Grey darker = grey, negative = grey;
  for (double& g : darker) g = 0.5 * g + 1.0;
  for (double& g : negative) g = 15.0 - g;
  EXPECT_GT(similarity(patch_of(grey), patch_of(darker)).value(), 0.95);
  EXPECT_LT(similarity(patch_of(grey), patch_of(negative)).value(), -0.95);
  const double there = similarity(patch_of(grey), patch_of(darker)).value();
  EXPECT_EQ(similarity(patch_of(darker), patch_of(grey)).value(), there);
}

TEST(Appearance, ComparesOnlyWhatCanBeCompared) {
  test::Random random(2);
  const Descriptor patch = patch_of(any_patch(random));
  Grey flat;
  flat.fill(8.0);
  EXPECT_EQ(similarity(patch, Descriptor{}), std::nullopt);
  EXPECT_EQ(similarity(Descriptor{}, Descriptor{}), std::nullopt);
  EXPECT_EQ(similarity(patch, patch_of(flat)), std::nullopt);
}

TEST(Appearance, TellsMostPatchesApart) {
  test::Random random(3);
  int same_kept = 0, other_kept = 0;
  constexpr int tries = 2000;
  const double least = AssociationParams().min_similarity;
  for (int k = 0; k < tries; ++k) {
    const Grey grey = any_patch(random);
    same_kept += *similarity(patch_of(grey), patch_of(seen_again(random, grey))) >= least ? 1 : 0;
    other_kept += *similarity(patch_of(grey), patch_of(any_patch(random))) >= least ? 1 : 0;
  }
  EXPECT_GE(same_kept, tries * 99 / 100);
  EXPECT_LE(other_kept, tries * 30 / 100);
}

/// a sees a pattern twice, 30 m apart; b sees it once, where the first one is.
struct TwicePattern {
  explicit TwicePattern(std::uint64_t seed) : random(seed) {
    const test::Points pattern = test::scattered(random, 12, 8.0, 2.0);
    test::Points twice = pattern;
    for (const auto& p : pattern) twice.emplace_back(p.x() + 30.0, p.y());
    a = test::frozen_batch(random, {{1, 1}, 1}, SE2(), twice, {0.08, 0.05});
    b = test::frozen_batch(random, {{2, 1}, 1}, SE2(1.0, -2.0, 0.4), pattern, {0.08, 0.05});
  }
  AssociationResult<SE2> associated(SearchMethod method) const {
    AssociationParams params;
    params.method = method;
    return associate(a, b, std::optional<RelativePrior<SE2>>{}, params);
  }
  /// The first place of b: landmark j of b is landmark j of a.
  bool right(const AssociationResult<SE2>& result) const {
    return std::all_of(result.pairings.begin(), result.pairings.end(),
                       [](const Pairing& p) { return p.first.index == p.second.index; });
  }
  test::Random random;
  Batch<SE2> a, b;
};

class AppearanceDecides : public testing::TestWithParam<SearchMethod> {};
INSTANTIATE_TEST_SUITE_P(By, AppearanceDecides, testing::Values(SearchMethod::alignment, SearchMethod::gcbb),
                         [](const auto& by) { return std::string(to_string(by.param)); });

TEST_P(AppearanceDecides, BetweenTwoPlacesOfTheSameShapeByPatches) {
  int accepted = 0;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    TwicePattern world(seed);
    EXPECT_EQ(world.associated(GetParam()).decision, Decision::ambiguous) << seed;
    for (std::size_t k = 0; k < world.a.landmarks.size(); ++k) {
      const Grey grey = any_patch(world.random);
      world.a.landmarks[k].descriptor = patch_of(grey);
      if (k < world.b.landmarks.size()) world.b.landmarks[k].descriptor = patch_of(seen_again(world.random, grey));
    }
    const auto result = world.associated(GetParam());
    if (result.decision != Decision::accepted) continue;
    ++accepted;
    EXPECT_TRUE(world.right(result)) << seed;
  }
  EXPECT_GE(accepted, 7);
}

TEST_P(AppearanceDecides, BetweenTwoPlacesOfTheSameShapeByKinds) {
  TwicePattern world(1);
  for (std::size_t k = 0; k < world.a.landmarks.size(); ++k) {
    const std::size_t half = world.b.landmarks.size();
    world.a.landmarks[k].kind = static_cast<std::uint8_t>(k < half ? 1 + k % 3 : 4);
    if (k < half) world.b.landmarks[k].kind = static_cast<std::uint8_t>(1 + k % 3);
  }
  const auto result = world.associated(GetParam());
  EXPECT_EQ(result.decision, Decision::accepted);
  EXPECT_TRUE(world.right(result));
  for (auto& l : world.b.landmarks) l.kind = 5;
  EXPECT_EQ(world.associated(GetParam()).decision, Decision::none);
  for (auto& l : world.b.landmarks) l.kind = 0;
  EXPECT_EQ(world.associated(GetParam()).decision, Decision::ambiguous) << "what says nothing may be anything";
}

}  // namespace
}  // namespace convoy
