#include "polyline.hpp"

#include <gtest/gtest.h>

#include <stdexcept>

namespace convoy::simulator {
namespace {

const Polyline square{{0, 0}, {100, 0}, {100, 100}, {0, 100}};

TEST(Polyline, PointsGoRoundAClosedLine) {
  EXPECT_DOUBLE_EQ(length_m(square, true), 400.0);
  EXPECT_DOUBLE_EQ(length_m(square), 300.0);
  for (const double around : {-400.0, 0.0, 400.0, 4000.0}) {
    EXPECT_LT((point_at(square, 350.0 + around, true).at - Eigen::Vector2d(0, 50)).norm(), 1e-9);
    EXPECT_LT((point_at(square, 350.0 + around, true).ahead - Eigen::Vector2d(0, -1)).norm(), 1e-9);
  }
  EXPECT_LT((point_at(square, 1e4).at - square.back()).norm(), 1e-9);
}

TEST(Polyline, ResampledKeepsLengthAndEnds) {
  const Polyline open = resampled(square, 0.7), closed = resampled(square, 0.7, true);
  EXPECT_EQ(open.front(), square.front());
  EXPECT_EQ(open.back(), square.back());
  EXPECT_NEAR(length_m(open), 300.0, 1.0);
  EXPECT_NEAR(length_m(closed, true), 400.0, 1.0);
}

TEST(Polyline, RoundedBendsAreNotSharper) {
  for (const double radius : {2.0, 5.0, 12.0}) {
    const Polyline round = rounded(square, radius, true);
    EXPECT_GE(smallest_radius_m(round, true), radius);
    EXPECT_GE(length_m(round, true), 400.0 - 2.6 * radius);  // no more cut off than by arcs, and half as much again
    const Polyline open = rounded(square, radius, false);
    EXPECT_LT((open.front() - square.front()).norm(), 1e-6);
    EXPECT_LT((open.back() - square.back()).norm(), 1e-6);
  }
  EXPECT_EQ(smallest_radius_m({{0, 0}, {10, 0}, {0, 0.001}}, false), 0.0);
}

TEST(Polyline, RightIsRight) {
  const Polyline line{{0, 0}, {50, 0}};
  for (const auto& point : to_the_right(line, 2.0, false)) EXPECT_NEAR(point.y(), -2.0, 1e-9);
}

TEST(Polyline, Polygons) {
  EXPECT_TRUE(contains(square, {50, 50}));
  EXPECT_FALSE(contains(square, {150, 50}));
  EXPECT_FALSE(crosses_itself(square));
  EXPECT_TRUE(crosses_itself({{0, 0}, {10, 10}, {10, 0}, {0, 10}}));
  EXPECT_DOUBLE_EQ(signed_area_m2(square), 10'000.0);
}

TEST(Polyline, NearLinesKnowsTheNearestUpToItsReach) {
  NearLines lines(10.0);
  lines.add(square, true);
  EXPECT_NEAR(lines.distance_m({50, -3}), 3.0, 1e-12);
  EXPECT_NEAR(lines.distance_m({-4, 50}), 4.0, 1e-12);
  EXPECT_EQ(lines.distance_m({50, 50}), 10.0);
  EXPECT_EQ(lines.distance_m({-5000, 50}), 10.0);
}

}  // namespace
}  // namespace convoy::simulator
