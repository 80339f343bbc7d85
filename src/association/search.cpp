#include <convoy/association/search.hpp>

#include <algorithm>
#include <bit>
#include <numeric>

namespace convoy {
namespace {

// Fig. 5. H holds j per landmark i, or -1 for "refused".
class LiteralSearch {
 public:
  LiteralSearch(int m, int n, const std::function<bool(int, int)>& unary,
                const std::function<bool(int, int, int, int)>& binary, std::uint64_t max_nodes)
      : m_(m), n_(n), unary_(unary), binary_(binary), max_nodes_(max_nodes) {}

  SearchResult run() {
    std::vector<int> H;
    recurse(H, 0, 0);
    SearchResult result{{}, cut_off_, nodes_};
    for (int i = 0; i < static_cast<int>(best_.size()); ++i)
      if (best_[static_cast<std::size_t>(i)] >= 0) result.pairings.emplace_back(i, best_[static_cast<std::size_t>(i)]);
    return result;
  }

 private:
  void recurse(std::vector<int>& H, int i, int pairings) {  // procedure GCBB(H, i)
    if (++nodes_ > max_nodes_) cut_off_ = true;
    if (cut_off_) return;
    if (i >= m_) {
      if (pairings > best_pairings_) {  // better association found?
        best_ = H;
        best_pairings_ = pairings;
      }
      return;
    }
    for (int j = 0; j < n_; ++j) {
      if (!unary_(i, j) || !binary(i, j, H)) continue;
      H.push_back(j);  // landmarks i and j associated
      recurse(H, i + 1, pairings + 1);
      H.pop_back();
    }
    if (pairings + m_ - (i + 1) > best_pairings_) {  // can do better?
      H.push_back(-1);                               // pairing (i, j) refused
      recurse(H, i + 1, pairings);
      H.pop_back();
    }
  }

  bool binary(int i, int j, const std::vector<int>& H) const {
    for (int k = 0; k < i; ++k) {
      const int l = H[static_cast<std::size_t>(k)];
      if (l >= 0 && !binary_(k, l, i, j)) return false;
    }
    return true;
  }

  int m_, n_;
  const std::function<bool(int, int)>& unary_;
  const std::function<bool(int, int, int, int)>& binary_;
  std::uint64_t max_nodes_;
  std::vector<int> best_;
  int best_pairings_ = 0;
  std::uint64_t nodes_ = 0;
  bool cut_off_ = false;
};

using Bits = std::vector<std::uint64_t>;

// Maximum clique on vertices renumbered by a degeneracy order, so that colour classes come out small.
class CliqueSearch {
 public:
  CliqueSearch(const CompatibilityGraph& graph, std::uint64_t max_nodes) : max_nodes_(max_nodes) {
    order_ = degeneracy_order(graph);
    const std::size_t n = graph.size();
    rows_.assign(n, Bits(graph.words(), 0));
    for (std::size_t v = 0; v < n; ++v)
      for (std::size_t w = 0; w < n; ++w)
        if (graph.adjacent(order_[v], order_[w])) rows_[v][w / 64] |= std::uint64_t{1} << (w % 64);
  }

  SearchResult run(const CompatibilityGraph& graph) {
    Bits all(graph.words(), 0);
    for (std::size_t v = 0; v < order_.size(); ++v) all[v / 64] |= std::uint64_t{1} << (v % 64);
    std::vector<std::size_t> clique;
    expand(clique, all);
    SearchResult result{{}, cut_off_, nodes_};
    for (const std::size_t v : best_) result.pairings.push_back(graph.candidate(order_[v]));
    std::sort(result.pairings.begin(), result.pairings.end());
    return result;
  }

 private:
  static std::vector<std::size_t> degeneracy_order(const CompatibilityGraph& graph) {
    const std::size_t n = graph.size();
    std::vector<std::size_t> degree(n, 0), order;
    std::vector<bool> removed(n, false);
    for (std::size_t v = 0; v < n; ++v)
      for (std::size_t w = 0; w < graph.words(); ++w)
        degree[v] += static_cast<std::size_t>(std::popcount(graph.row(v)[w]));
    order.reserve(n);
    for (std::size_t step = 0; step < n; ++step) {
      std::size_t smallest = n;
      for (std::size_t v = 0; v < n; ++v)
        if (!removed[v] && (smallest == n || degree[v] < degree[smallest])) smallest = v;
      removed[smallest] = true;
      order.push_back(smallest);
      for (std::size_t v = 0; v < n; ++v)
        if (!removed[v] && graph.adjacent(smallest, v)) --degree[v];
    }
    std::reverse(order.begin(), order.end());
    return order;
  }

  // Greedy sequential colouring: vertices in order of colour with the bound each gives.
  void colour(const Bits& candidates, std::vector<std::size_t>& vertices, std::vector<int>& bounds) const {
    Bits uncoloured = candidates;
    for (int colour = 1; std::any_of(uncoloured.begin(), uncoloured.end(), [](auto w) { return w != 0; }); ++colour) {
      Bits available = uncoloured;
      for (std::size_t w = 0; w < available.size(); ++w) {
        while (available[w] != 0) {
          const std::size_t v = w * 64 + static_cast<std::size_t>(std::countr_zero(available[w]));
          available[w] &= available[w] - 1;
          uncoloured[w] &= ~(std::uint64_t{1} << (v % 64));
          for (std::size_t u = w; u < available.size(); ++u) available[u] &= ~rows_[v][u];
          vertices.push_back(v);
          bounds.push_back(colour);
        }
      }
    }
  }

  void expand(std::vector<std::size_t>& clique, Bits candidates) {
    if (++nodes_ > max_nodes_) cut_off_ = true;
    if (cut_off_) return;
    std::vector<std::size_t> vertices;
    std::vector<int> bounds;
    colour(candidates, vertices, bounds);
    if (vertices.empty() && clique.size() > best_.size()) best_ = clique;
    for (std::size_t k = vertices.size(); k-- > 0;) {
      if (clique.size() + static_cast<std::size_t>(bounds[k]) <= best_.size()) return;
      const std::size_t v = vertices[k];
      Bits next(candidates.size());
      for (std::size_t w = 0; w < next.size(); ++w) next[w] = candidates[w] & rows_[v][w];
      clique.push_back(v);
      expand(clique, std::move(next));
      clique.pop_back();
      if (cut_off_) return;
      candidates[v / 64] &= ~(std::uint64_t{1} << (v % 64));
    }
  }

  std::vector<std::size_t> order_;
  std::vector<Bits> rows_;
  std::vector<std::size_t> best_;
  std::uint64_t max_nodes_;
  std::uint64_t nodes_ = 0;
  bool cut_off_ = false;
};

}  // namespace

SearchResult gcbb_literal(int m, int n, const std::function<bool(int, int)>& unary,
                          const std::function<bool(int, int, int, int)>& binary, std::uint64_t max_nodes) {
  return LiteralSearch(m, n, unary, binary, max_nodes).run();
}

CompatibilityGraph::CompatibilityGraph(std::vector<IndexPairing> candidates)
    : candidates_(std::move(candidates)),
      words_((candidates_.size() + 63) / 64),
      bits_(candidates_.size() * words_, 0) {}

CompatibilityGraph::CompatibilityGraph(std::vector<IndexPairing> candidates,
                                       const std::function<bool(const IndexPairing&, const IndexPairing&)>& compatible)
    : CompatibilityGraph(std::move(candidates)) {
  for (std::size_t v = 0; v < size(); ++v)
    for (std::size_t w = v + 1; w < size(); ++w)
      if (compatible(candidates_[v], candidates_[w])) connect(v, w);
}

void CompatibilityGraph::connect(std::size_t v, std::size_t w) {
  bits_[v * words_ + w / 64] |= std::uint64_t{1} << (w % 64);
  bits_[w * words_ + v / 64] |= std::uint64_t{1} << (v % 64);
  ++edges_;
}

std::uint64_t CompatibilityGraph::triangles() const {
  std::uint64_t thrice = 0;
  for (std::size_t v = 0; v < size(); ++v)
    for (std::size_t w = v + 1; w < size(); ++w) {
      if (!adjacent(v, w)) continue;
      for (std::size_t k = 0; k < words_; ++k)
        thrice += static_cast<std::uint64_t>(std::popcount(row(v)[k] & row(w)[k]));
    }
  return thrice / 3;
}

CompatibilityGraph CompatibilityGraph::without(const std::function<bool(const IndexPairing&)>& removed) const {
  std::vector<IndexPairing> kept;
  std::vector<std::size_t> index;
  for (std::size_t v = 0; v < size(); ++v)
    if (!removed(candidates_[v])) {
      kept.push_back(candidates_[v]);
      index.push_back(v);
    }
  CompatibilityGraph graph(std::move(kept));
  for (std::size_t v = 0; v < graph.size(); ++v)
    for (std::size_t w = v + 1; w < graph.size(); ++w)
      if (adjacent(index[v], index[w])) graph.connect(v, w);
  return graph;
}

SearchResult gcbb(const CompatibilityGraph& graph, std::uint64_t max_nodes) {
  return CliqueSearch(graph, max_nodes).run(graph);
}

}  // namespace convoy
