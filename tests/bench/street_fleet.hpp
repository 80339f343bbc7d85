// A fleet on a street grid, as a graph: every vehicle drives straight and turns at random at intersections; where it
// passes a place that somebody was at before, it is linked to the last one there, now and then.
#pragma once

#include <convoy/geometry/se2.hpp>

#include <Eigen/Core>
#include <cstdint>
#include <random>
#include <utility>
#include <vector>

namespace convoy::bench {

struct StreetFleet {
  /// Nodes of vehicle v: v * nodes .. (v + 1) * nodes - 1, 10 m apart; a city block is 100 m; `intersections` along
  /// each side.
  StreetFleet(int vehicles, int nodes, int link_count, int intersections = 32, std::uint64_t seed = 1) {
    std::mt19937_64 random(seed);
    const auto below = [&](int n) { return static_cast<int>(random() % static_cast<std::uint64_t>(n)); };
    constexpr int kPerBlock = 10;
    const int side = (intersections - 1) * kPerBlock + 1;
    std::vector<std::vector<int>> visitors(static_cast<std::size_t>(side) * static_cast<std::size_t>(side));
    std::vector<std::pair<int, int>> meetings;
    for (int v = 0; v < vehicles; ++v) {
      int x = kPerBlock * below(intersections), y = kPerBlock * below(intersections), heading = below(4);
      for (int k = 0; k < nodes; ++k) {
        const int node = v * nodes + k;
        if (k > 0) chain.emplace_back(node - 1, node);
        poses.emplace_back(10.0 * x, 10.0 * y, M_PI / 2.0 * heading);
        auto& here = visitors[static_cast<std::size_t>(y * side + x)];
        for (const int other : here)
          if (other < node - 2) meetings.emplace_back(other, node);
        here.push_back(node);
        const auto leaves = [&](int h) {
          const int nx = x + (h == 0) - (h == 2), ny = y + (h == 1) - (h == 3);
          return nx < 0 || ny < 0 || nx >= side || ny >= side;
        };
        if (x % kPerBlock == 0 && y % kPerBlock == 0) {
          const int back = (heading + 2) % 4;
          int next = below(4);
          while (next == back || leaves(next)) next = below(4);
          heading = next;
        }
        x += (heading == 0) - (heading == 2);
        y += (heading == 1) - (heading == 3);
      }
    }
    // `link_count` of the meetings, each with the same chance.
    for (std::size_t k = 0; k < static_cast<std::size_t>(link_count) && k < meetings.size(); ++k) {
      std::swap(meetings[k], meetings[k + random() % (meetings.size() - k)]);
      links.push_back(meetings[k]);
    }
  }

  std::vector<SE2> poses;
  std::vector<std::pair<int, int>> chain, links;
};

}  // namespace convoy::bench
