// The search of the association against the paper's Fig. 5 as written, and the whole of the association.
// Fig. 5 is quick where few pairs agree by chance; the graph asks for every pair of pairs once, whatever they are.
// Planted problems: m new landmarks, half of them among the 2 m of the map, seen with 0.05 m of noise, no prior.
#include <convoy/association/associate.hpp>
#include <convoy/geometry/groups.hpp>

#include <cmath>
#include <random>

#include "ratio.hpp"

namespace {

using namespace convoy;

constexpr double noise_m = 0.05;
constexpr double half_size_m = 20.0;
constexpr std::uint64_t literal_nodes = 500'000;  // where Fig. 5 is stopped; the ratio is an upper bound then
constexpr std::uint64_t bit_parallel_nodes = 10'000'000;

LandmarkFact<SE2> seen(const Key& anchor, std::uint32_t index, const SE2::Point& p, std::mt19937_64& random) {
  std::normal_distribution<double> noise(0.0, noise_m);
  LandmarkFact<SE2> landmark;
  landmark.key = {anchor.chain, index};
  landmark.anchor = anchor.index;
  landmark.position = p + SE2::Point(noise(random), noise(random));
  landmark.covariance = noise_m * noise_m * SE2::PointCovariance::Identity();
  return landmark;
}

struct Planted {
  explicit Planted(int new_landmarks) : m(new_landmarks), n(2 * new_landmarks) {
    std::mt19937_64 random(static_cast<std::uint64_t>(m));
    std::uniform_real_distribution<double> coordinate(-half_size_m, half_size_m);
    const SE2 T_b_a(7.0, -3.0, 1.2);
    const auto anywhere = [&] { return SE2::Point(coordinate(random), coordinate(random)); };
    for (int i = 0; i < n; ++i) {
      const SE2::Point p_a = anywhere();
      map.landmarks.push_back(seen(map.anchor, static_cast<std::uint32_t>(i), p_a, random));
      if (i < m)
        fresh.landmarks.push_back(
            seen(fresh.anchor, static_cast<std::uint32_t>(i), T_b_a * (i < m / 2 ? p_a : anywhere()), random));
    }
  }

  int m, n;
  Batch<SE2> map{{{1, 1}, 1}, {}}, fresh{{{2, 1}, 1}, {}};
};

void BM_gcbb(benchmark::State& state) {
  const Planted planted(static_cast<int>(state.range(0)));
  const ConstraintParams params;
  const DistanceTable of_fresh(planted.fresh), of_map(planted.map);
  const DistanceCompatibility binary(of_fresh, of_map, params);
  const IndividualCompatibility<SE2> unary({}, params.compatibility);
  const auto individually = [&](int i, int j) {
    return unary(planted.map.landmarks[static_cast<std::size_t>(j)],
                 planted.fresh.landmarks[static_cast<std::size_t>(i)]);
  };
  SearchResult found, literal;
  convoy::bench::against(
      state, "gcbb_literal (Fig. 5)",
      [&] {
        std::vector<IndexPairing> candidates;
        for (int i = 0; i < planted.m; ++i)
          for (int j = 0; j < planted.n; ++j)
            if (individually(i, j)) candidates.emplace_back(i, j);
        const CompatibilityGraph graph(std::move(candidates), [&](const IndexPairing& p, const IndexPairing& q) {
          return binary(p.first, p.second, q.first, q.second);
        });
        found = gcbb(graph, bit_parallel_nodes);
      },
      [&] { literal = gcbb_literal(planted.m, planted.n, individually, binary, literal_nodes); });
  if (found.cut_off || found.pairings.size() < literal.pairings.size() ||
      (!literal.cut_off && found.pairings.size() != literal.pairings.size()))
    state.SkipWithError("the two searches do not find sets of one size");
  state.counters["nodes"] = static_cast<double>(found.nodes);
  state.counters["baseline_nodes"] = static_cast<double>(literal.nodes);
  state.counters["baseline_cut_off"] = literal.cut_off;
}
BENCHMARK(BM_gcbb)->Arg(10)->Arg(15)->Arg(20)->Arg(30)->Unit(benchmark::kMicrosecond);

void BM_associate(benchmark::State& state) {
  const Planted planted(static_cast<int>(state.range(0)));
  AssociationParams params, literal_params;
  literal_params.literal_search = true;
  AssociationResult<SE2> result, literal;
  convoy::bench::against(
      state, "associate() with gcbb_literal", [&] { result = associate<SE2>(planted.map, planted.fresh, {}, params); },
      [&] { literal = associate<SE2>(planted.map, planted.fresh, {}, literal_params); });
  if (result.decision != Decision::accepted) state.SkipWithError(to_string(result.rejection));
  state.counters["pairings"] = result.support;
  state.counters["baseline_cut_off"] = literal.rejection == Rejection::search_cut_off;
}
BENCHMARK(BM_associate)->Arg(12)->Arg(25)->Unit(benchmark::kMicrosecond);

}  // namespace
