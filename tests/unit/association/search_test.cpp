#include <convoy/association/search.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <set>

namespace convoy {
namespace {

/// A problem with both constraints drawn at random; binary() is symmetric and pairs each landmark once.
struct RandomProblem {
  RandomProblem(std::uint64_t seed, int m_, int n_, double unary_share, double binary_share) : m(m_), n(n_) {
    test::Random random(seed);
    const auto size = static_cast<std::size_t>(m * n);
    for (std::size_t k = 0; k < size; ++k) unary_table.push_back(random.uniform(0.0, 1.0) < unary_share);
    binary_table.assign(size * size, false);
    for (std::size_t p = 0; p < size; ++p)
      for (std::size_t q = p + 1; q < size; ++q)
        binary_table[p * size + q] = binary_table[q * size + p] = random.uniform(0.0, 1.0) < binary_share;
  }
  std::size_t at(int i, int j) const { return static_cast<std::size_t>(i * n + j); }
  bool unary(int i, int j) const { return unary_table[at(i, j)]; }
  bool binary(int i1, int j1, int i2, int j2) const {
    return i1 != i2 && j1 != j2 && binary_table[at(i1, j1) * unary_table.size() + at(i2, j2)];
  }
  CompatibilityGraph graph() const {
    std::vector<IndexPairing> candidates;
    for (int i = 0; i < m; ++i)
      for (int j = 0; j < n; ++j)
        if (unary(i, j)) candidates.emplace_back(i, j);
    return {candidates, [this](const auto& p, const auto& q) { return binary(p.first, p.second, q.first, q.second); }};
  }
  SearchResult literal(std::uint64_t max_nodes = 10'000'000) const {
    return gcbb_literal(
        m, n, [this](int i, int j) { return unary(i, j); },
        [this](int i1, int j1, int i2, int j2) { return binary(i1, j1, i2, j2); }, max_nodes);
  }
  bool satisfies(const std::vector<IndexPairing>& pairings) const {
    for (const auto& [i, j] : pairings) {
      if (!unary(i, j)) return false;
      for (const auto& [k, l] : pairings)
        if (std::pair(i, j) != std::pair(k, l) && !binary(i, j, k, l)) return false;
    }
    return true;
  }

  int m, n;
  std::vector<bool> unary_table, binary_table;
};

/// The size of a largest set, by trying all sets of candidates.
std::size_t brute_force(const CompatibilityGraph& graph) {
  std::size_t best = 0;
  for (std::uint32_t set = 0; set < (1U << graph.size()); ++set) {
    bool clique = true;
    for (std::size_t v = 0; v < graph.size() && clique; ++v)
      for (std::size_t w = v + 1; w < graph.size() && clique; ++w)
        if ((set >> v & 1U) && (set >> w & 1U)) clique = graph.adjacent(v, w);
    if (clique) best = std::max(best, static_cast<std::size_t>(std::popcount(set)));
  }
  return best;
}

TEST(Gcbb, FindsAsLargeASetAsFigure5AndAsBruteForce) {
  int forced = 0;
  std::set<std::size_t> sizes;
  for (std::uint64_t seed = 1; seed <= 200; ++seed) {
    test::Random random(seed);
    const RandomProblem problem(1000 + seed, random.integer(1, 7), random.integer(1, 7), random.uniform(0.2, 1.0),
                                random.uniform(0.1, 0.95));
    const CompatibilityGraph graph = problem.graph();
    const SearchResult found = gcbb(graph, 1'000'000), literal = problem.literal();
    ASSERT_FALSE(found.cut_off || literal.cut_off) << seed;
    ASSERT_EQ(found.pairings.size(), literal.pairings.size()) << seed;
    ASSERT_TRUE(problem.satisfies(found.pairings)) << seed;
    ASSERT_TRUE(problem.satisfies(literal.pairings)) << seed;
    ASSERT_TRUE(std::is_sorted(found.pairings.begin(), found.pairings.end())) << seed;
    sizes.insert(found.pairings.size());
    if (graph.size() > 16) continue;
    ++forced;
    ASSERT_EQ(found.pairings.size(), brute_force(graph)) << seed;
  }
  EXPECT_GE(forced, 80);
  EXPECT_GE(sizes.size(), 5U);
}

TEST(Gcbb, FindsAPlantedSetInALargeProblem) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    RandomProblem problem(seed, 30, 30, 0.3, 0.2);
    test::Random random(seed);
    std::vector<int> partner(30);
    for (int j = 0; j < 30; ++j) partner[static_cast<std::size_t>(j)] = j;
    std::shuffle(partner.begin(), partner.end(), random.engine());
    std::vector<IndexPairing> planted;
    for (int i = 0; i < 24; i += 2) planted.emplace_back(i, partner[static_cast<std::size_t>(i)]);
    for (const auto& [i, j] : planted) {
      problem.unary_table[problem.at(i, j)] = true;
      for (const auto& [k, l] : planted)
        problem.binary_table[problem.at(i, j) * problem.unary_table.size() + problem.at(k, l)] = true;
    }
    const SearchResult found = gcbb(problem.graph(), 1'000'000);
    ASSERT_FALSE(found.cut_off);
    EXPECT_EQ(found.pairings, planted) << seed;
  }
}

TEST(Gcbb, SaysWhenTheBudgetCutItOff) {
  const RandomProblem problem(1, 20, 20, 1.0, 0.8);
  const SearchResult found = gcbb(problem.graph(), 50);
  EXPECT_TRUE(found.cut_off);
  EXPECT_LE(found.nodes, 60U);
  EXPECT_TRUE(problem.satisfies(found.pairings));
  const SearchResult literal = problem.literal(1000);
  EXPECT_TRUE(literal.cut_off);
  EXPECT_TRUE(problem.satisfies(literal.pairings));
}

TEST(Gcbb, IsDeterministic) {
  const RandomProblem problem(3, 15, 15, 0.8, 0.6);
  const SearchResult first = gcbb(problem.graph(), 1'000'000);
  for (int round = 0; round < 5; ++round) {
    const SearchResult again = gcbb(problem.graph(), 1'000'000);
    EXPECT_EQ(again.pairings, first.pairings);
    EXPECT_EQ(again.nodes, first.nodes);
  }
}

TEST(Gcbb, OfNothingIsNothing) {
  const RandomProblem problem(1, 5, 5, 0.0, 1.0);
  EXPECT_TRUE(gcbb(problem.graph(), 1000).pairings.empty());
  EXPECT_TRUE(problem.literal().pairings.empty());
  EXPECT_TRUE(gcbb_literal(
                  0, 3, [](int, int) { return true; }, [](int, int, int, int) { return true; }, 10)
                  .pairings.empty());
}

TEST(CompatibilityGraph, AsksOncePerPairAndKeepsTheRest) {
  std::vector<IndexPairing> candidates;
  for (int k = 0; k < 100; ++k) candidates.emplace_back(k, k);
  int asked = 0;
  const auto compatible = [&](const IndexPairing& p, const IndexPairing& q) {
    ++asked;
    return (p.first + q.first) % 3 == 0;
  };
  const CompatibilityGraph graph(candidates, compatible);
  EXPECT_EQ(asked, 100 * 99 / 2);
  const auto even = [](const IndexPairing& p) { return p.first % 2 == 0; };
  const CompatibilityGraph odd = graph.without(even);
  ASSERT_EQ(odd.size(), 50U);
  std::uint64_t edges = 0;
  for (std::size_t v = 0; v < odd.size(); ++v) {
    EXPECT_EQ(odd.candidate(v).first, static_cast<int>(2 * v + 1));
    for (std::size_t w = 0; w < odd.size(); ++w) {
      const bool expected = v != w && (odd.candidate(v).first + odd.candidate(w).first) % 3 == 0;
      EXPECT_EQ(odd.adjacent(v, w), expected);
      edges += v < w && expected;
    }
  }
  EXPECT_EQ(odd.edges(), edges);
}

}  // namespace
}  // namespace convoy
