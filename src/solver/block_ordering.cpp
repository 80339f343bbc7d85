#include <convoy/solver/block_ordering.hpp>

#include <Eigen/OrderingMethods>
#include <Eigen/SparseCore>
#include <algorithm>
#include <numeric>

namespace convoy {

std::vector<int> minimum_degree_order(const BlockPattern& pattern) {
  const int n = pattern.blocks();
  if (n < 4) {
    std::vector<int> order(static_cast<std::size_t>(n));
    std::iota(order.begin(), order.end(), 0);
    return order;
  }
  // Both triangles, counted and scattered by hand: triplets would cost more than the ordering itself.
  Eigen::SparseMatrix<double> graph(n, n);
  std::vector<int> counts(static_cast<std::size_t>(n), 1);
  for (const auto& [i, j] : pattern.pairs()) {
    ++counts[static_cast<std::size_t>(i)];
    ++counts[static_cast<std::size_t>(j)];
  }
  int* outer = graph.outerIndexPtr();
  outer[0] = 0;
  for (int i = 0; i < n; ++i) outer[i + 1] = outer[i] + counts[static_cast<std::size_t>(i)];
  graph.resizeNonZeros(outer[n]);
  std::vector<int> next(outer, outer + n);
  for (int i = 0; i < n; ++i) graph.innerIndexPtr()[next[static_cast<std::size_t>(i)]++] = i;  // AMD wants the diagonal
  for (const auto& [i, j] : pattern.pairs()) {
    graph.innerIndexPtr()[next[static_cast<std::size_t>(i)]++] = j;
    graph.innerIndexPtr()[next[static_cast<std::size_t>(j)]++] = i;
  }
  // A pair that was given twice stands twice; sorted and once each, the result is a function of the set of pairs.
  int write = 0, begin = 0;
  for (int i = 0; i < n; ++i) {
    const int end = outer[i + 1];
    int* first = graph.innerIndexPtr() + begin;
    std::sort(first, graph.innerIndexPtr() + end);
    int* last = std::unique(first, graph.innerIndexPtr() + end);
    begin = end;
    std::copy(first, last, graph.innerIndexPtr() + write);
    write += static_cast<int>(last - first);
    outer[i + 1] = write;
  }
  graph.resizeNonZeros(write);
  std::fill(graph.valuePtr(), graph.valuePtr() + write, 1.0);
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> order;
  Eigen::internal::minimum_degree_ordering(graph, order);
  return {order.indices().data(), order.indices().data() + n};
}

}  // namespace convoy
