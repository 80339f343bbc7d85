// The normal equations of a fleet on streets, for solvers by blocks and for solvers by scalars.
#pragma once

#include <convoy/solver/block_cholesky.hpp>

#include <Eigen/Sparse>
#include <algorithm>
#include <map>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "street_fleet.hpp"

namespace convoy::bench {

/// A graph whose factors are linearised once, for both solvers.
template <int D>
struct System {
  System(int nodes, std::vector<std::pair<int, int>> edges)
      : pattern(std::vector<int>(static_cast<std::size_t>(nodes), D)), edges_(std::move(edges)) {
    for (const auto& [a, b] : edges_) pattern.add(a, b);
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> unit(-0.3, 0.3);
    std::vector<Eigen::Triplet<double>> triplets;
    const auto put = [&](int i, int j, const Block& block) {
      blocks.push_back({i, j, block});
      for (int r = 0; r < D; ++r)
        for (int c = 0; c < D; ++c)
          if (D * i + r >= D * j + c) triplets.emplace_back(D * i + r, D * j + c, block(r, c));
    };
    for (int n = 0; n < nodes; ++n) put(n, n, 1e-4 * Block::Identity());
    for (const auto& [a, b] : edges_) {
      const Block J_a = Block::Identity() + Block::NullaryExpr([&] { return unit(random); });
      const Block J_b = Block::Identity() + Block::NullaryExpr([&] { return unit(random); });
      put(a, a, J_a.transpose() * J_a);
      put(b, b, J_b.transpose() * J_b);
      const int low = std::min(a, b), high = std::max(a, b);
      put(high, low, high == b ? Block(-J_b.transpose() * J_a) : Block(-J_a.transpose() * J_b));
    }
    scalar.resize(D * nodes, D * nodes);
    scalar.setFromTriplets(triplets.begin(), triplets.end());
  }

  void fill(BlockCholesky& solver) const {
    solver.set_zero();
    for (const auto& b : blocks) solver.add(solver.slot(b.row, b.column), b.values);
  }

  using Block = Eigen::Matrix<double, D, D>;
  struct Placed {
    int row, column;
    Block values;
  };
  BlockPattern pattern;
  std::vector<std::pair<int, int>> edges_;
  std::vector<Placed> blocks;
  Eigen::SparseMatrix<double> scalar;  ///< lower triangle
};

/// Links 20 k and 68 k: 100 x 1000 nodes. 300: a small one, to see it run.
template <int D>
const System<D>& fleet(int links) {
  static std::map<int, std::unique_ptr<System<D>>> systems;
  auto& system = systems[links];
  if (!system) {
    const int vehicles = links < 1000 ? 4 : 100, nodes = links < 1000 ? 100 : 1000;
    const StreetFleet streets(vehicles, nodes, links, links < 1000 ? 4 : 32);
    std::vector<std::pair<int, int>> edges = streets.chain;
    edges.insert(edges.end(), streets.links.begin(), streets.links.end());
    system = std::make_unique<System<D>>(vehicles * nodes, std::move(edges));
  }
  return *system;
}

}  // namespace convoy::bench
