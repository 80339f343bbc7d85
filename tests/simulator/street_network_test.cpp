#include "street_network.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace convoy::simulator {
namespace {

Street street(std::vector<Eigen::Vector2d> line, double half_width = 4.0) {
  return {std::move(line), half_width, 2, true, 1};
}

TEST(StreetNetwork, MeasuresFromTheKerb) {
  const StreetNetwork network({street({{-50, 0}, {50, 0}})});
  EXPECT_DOUBLE_EQ(network.beyond_kerb_m({0, 0}), -4.0);
  EXPECT_DOUBLE_EQ(network.beyond_kerb_m({10, 5}), 1.0);
  EXPECT_DOUBLE_EQ(network.beyond_kerb_m({57, 0}), 3.0);
  EXPECT_DOUBLE_EQ(network.beyond_kerb_m({0, 300}), StreetNetwork::far_m);
  EXPECT_DOUBLE_EQ(network.beyond_others_m({0, 0}, 0), StreetNetwork::far_m);
}

TEST(StreetNetwork, RoundsCornersButNotStraightJoints) {
  const StreetNetwork crossing({street({{-50, 0}, {50, 0}}), street({{0, -50}, {0, 50}})});
  EXPECT_LT(crossing.beyond_kerb_m({5, 5}), 0.0);  // a car may cut here
  EXPECT_GT(crossing.beyond_kerb_m({6.5, 6.5}), 0.0);
  EXPECT_NEAR(crossing.beyond_kerb_m({20, 5}), 1.0, 1e-9);
  const StreetNetwork joint({street({{-50, 0}, {0, 0}}), street({{0, 0}, {50, 0}})});
  EXPECT_DOUBLE_EQ(joint.beyond_kerb_m({0, 4}), 0.0);
  EXPECT_LT(crossing.beyond_others_m({2, 0}, 0), 0.0);
}

TEST(Terrain, KerbsStandOutAndTheWorldGoesOnLevel) {
  const Terrain terrain(1, {-100, -100}, {100, 100}, StreetNetwork({street({{-50, 0}, {50, 0}})}));
  EXPECT_NEAR(terrain.height_m(0, 4.2) - terrain.height_m(0, 3.9), Terrain::kerb_m, 0.02);
  EXPECT_EQ(terrain.bed_m(1e7, 0), 0.0);
  EXPECT_EQ(terrain.height_m(-1e7, 1e9), Terrain::kerb_m);
  for (double x = -45; x < 45; x += 0.05) {
    EXPECT_LT(std::abs(terrain.height_m(x + 0.05, 1.0) - terrain.height_m(x, 1.0)), 0.01) << x;
  }
}

}  // namespace
}  // namespace convoy::simulator
