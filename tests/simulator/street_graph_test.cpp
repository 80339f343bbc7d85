#include "street_graph.hpp"

#include <gtest/gtest.h>

#include <stdexcept>

namespace convoy::simulator {
namespace {

/// Two blocks of 100 x 100 m side by side: nodes 1 2 3 below, 4 5 6 above.
StreetGraph two_blocks(bool oneway_across = false) {
  const auto at = [](std::int64_t node) {
    return Eigen::Vector2d(100.0 * static_cast<double>((node - 1) % 3), 100.0 * static_cast<double>((node - 1) / 3));
  };
  std::vector<GraphEdge> edges;
  const auto add = [&](std::int64_t a, std::int64_t b, bool backward) {
    edges.push_back({a, b, {at(a), at(b)}, 100.0, backward, true, edges.size()});
  };
  add(1, 2, true), add(2, 3, true), add(4, 5, true), add(5, 6, true);
  add(1, 4, true), add(2, 5, !oneway_across), add(3, 6, true);
  return StreetGraph(std::move(edges));
}

double by_length(const Polyline& line) { return length_m(line, true); }

TEST(StreetGraph, FindsLoopsByTheirScore) {
  const auto all = two_blocks().loops(300, 700, true, 40, by_length);
  ASSERT_EQ(all.size(), 6U);  // three loops in both directions
  EXPECT_EQ(all[0].size(), 6U);
  EXPECT_EQ(all[5].size(), 4U);
  EXPECT_EQ(two_blocks().loops(300, 500, true, 40, by_length).size(), 4U);
  EXPECT_EQ(two_blocks().loops(300, 700, true, 1, by_length).size(), 1U);
  EXPECT_TRUE(two_blocks().loops(100, 300, true, 40, by_length).empty());
}

TEST(StreetGraph, KeepsToOnewayStreetsIfAsked) {
  EXPECT_EQ(two_blocks(true).loops(300, 700, true, 40, by_length).size(), 4U);
  EXPECT_EQ(two_blocks(true).loops(300, 700, false, 40, by_length).size(), 6U);
}

TEST(StreetGraph, ShortestWay) {
  const StreetGraph graph = two_blocks();
  const Polyline line = graph.line_of(graph.way_along({1, 6, 5}));
  EXPECT_DOUBLE_EQ(length_m(line), 400.0);
  EXPECT_EQ(line.front(), Eigen::Vector2d(0, 0));
  EXPECT_EQ(line.back(), Eigen::Vector2d(100, 100));
  EXPECT_THROW(graph.way_along({1, 99}), std::runtime_error);
}

}  // namespace
}  // namespace convoy::simulator
