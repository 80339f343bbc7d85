// The search of the association: the largest set of pairings that satisfies all constraints (paper, Fig. 5).
#pragma once

#include <cstdint>
#include <functional>
#include <utility>
#include <vector>

namespace convoy {

/// Which landmark i of the new batch is which landmark j of the map.
using IndexPairing = std::pair<int, int>;

struct SearchResult {
  std::vector<IndexPairing> pairings;  ///< ascending in i; a largest set unless `cut_off`
  bool cut_off = false;                ///< the node budget ran out; the set is the best found until then
  std::uint64_t nodes = 0;             ///< of the search tree
};

/// The paper's Fig. 5 to the letter: new landmarks one after the other, each paired with every j that satisfies both
/// constraints, or refused. Exponential: a baseline, and an oracle on small cases.
/// m: new landmarks, n: landmarks in the map; unary(i, j), binary(i1, j1, i2, j2) are called as often as Fig. 5 does.
SearchResult gcbb_literal(int m, int n, const std::function<bool(int, int)>& unary,
                          const std::function<bool(int, int, int, int)>& binary, std::uint64_t max_nodes);

/// Candidate pairings and which of them go together, as one bit row per candidate: binary constraints evaluated once.
class CompatibilityGraph {
 public:
  /// `candidates` satisfy the unary constraint, sorted. compatible(a, b) is asked once per unordered pair.
  CompatibilityGraph(std::vector<IndexPairing> candidates,
                     const std::function<bool(const IndexPairing&, const IndexPairing&)>& compatible);
  std::size_t size() const { return candidates_.size(); }
  const IndexPairing& candidate(std::size_t v) const { return candidates_[v]; }
  bool adjacent(std::size_t v, std::size_t w) const { return (row(v)[w / 64] >> (w % 64)) & 1U; }
  const std::uint64_t* row(std::size_t v) const { return bits_.data() + v * words_; }
  std::size_t words() const { return words_; }
  std::uint64_t edges() const { return edges_; }
  /// Threes of candidates that go together pairwise.
  std::uint64_t triangles() const;
  /// The graph without the candidates for which removed(candidate) holds.
  CompatibilityGraph without(const std::function<bool(const IndexPairing&)>& removed) const;

 private:
  explicit CompatibilityGraph(std::vector<IndexPairing> candidates);
  void connect(std::size_t v, std::size_t w);

  std::vector<IndexPairing> candidates_;
  std::size_t words_ = 0;
  std::vector<std::uint64_t> bits_;
  std::uint64_t edges_ = 0;
};

/// The same set as gcbb_literal (a largest one), found as a maximum clique: bit-parallel branch and bound with greedy
/// colouring bounds (San Segundo's BBMC). Ties fall to the set found first in candidate order: deterministic. The
/// budget counts nodes, not time, so that the result does not depend on the machine.
SearchResult gcbb(const CompatibilityGraph& graph, std::uint64_t max_nodes);

}  // namespace convoy
