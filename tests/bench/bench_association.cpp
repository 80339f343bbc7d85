// The search of the association against the paper's Fig. 5 as written, and the whole of the association.
// Recorded problems: what each way to search finds, how long it takes, and what it accepts where nothing is in common;
// problems made like them: the same of several batches joined.
// Fig. 5 is quick where few pairs agree by chance; the graph asks for every pair of pairs once, whatever they are.
// Planted problems: m new landmarks, half of them among the 2 m of the map, seen with 0.05 m of noise, no prior.
#include <convoy/association/associate.hpp>
#include <convoy/association/baselines.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <cmath>
#include <random>

#include "association_problems.hpp"
#include "quantile.hpp"
#include "ratio.hpp"
#include "street_problems.hpp"

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
  literal_params.method = SearchMethod::fig5;
  AssociationResult<SE2> result, literal;
  convoy::bench::against(
      state, "associate() with gcbb_literal", [&] { result = associate<SE2>(planted.map, planted.fresh, {}, params); },
      [&] { literal = associate<SE2>(planted.map, planted.fresh, {}, literal_params); });
  if (result.decision != Decision::accepted) state.SkipWithError(to_string(result.rejection));
  state.counters["pairings"] = result.support;
  state.counters["baseline_cut_off"] = literal.rejection == Rejection::search_cut_off;
}
BENCHMARK(BM_associate)->Arg(12)->Arg(25)->Unit(benchmark::kMicrosecond);

// ---- recorded problems

AssociationParams params_of(SearchMethod method, double confidence) {
  AssociationParams params;
  params.method = method;
  params.constraints.compatibility = confidence;
  params.max_nodes = 20'000'000;
  return params;
}

/// True if there are none: the bench is skipped then.
bool skipped(benchmark::State& state) {
  if (!convoy::bench::recorded_problems().empty()) return false;
  state.SetLabel("skipped: no association/dev; set CONVOY_DATA_DIR");
  for (auto _ : state) {
  }
  return true;
}

struct Tally {
  int overlapping = 0, not_right = 0, placed = 0, accepted_right = 0, accepted_wrong = 0, false_accepts = 0;
  std::vector<double> ms, distances_m;
};

template <class Solve>
void tally_one(const convoy::bench::KnownProblem& known, const Solve& solve, Tally& t) {
  std::visit(
      [&](const auto& problem) {
        const double start_s = convoy::bench::cpu_s();
        const auto result = solve(problem);
        t.ms.push_back(1e3 * (convoy::bench::cpu_s() - start_s));
        const bool accepted = result.decision == Decision::accepted;
        if (known.kind != "match") {
          t.false_accepts += accepted;
          return;
        }
        const auto score = convoy::bench::score(known, problem, result.pairings);
        ++t.overlapping;
        t.not_right += !score.right;
        t.placed += score.placed;
        t.accepted_right += accepted && score.right;
        t.accepted_wrong += accepted && !score.right;
        if (score.right) t.distances_m.push_back(score.distance_m);
      },
      known.problem);
}

template <class Solve>
Tally tallied(const std::vector<convoy::bench::KnownProblem>& problems, const Solve& solve) {
  Tally tally;
  for (const auto& known : problems) tally_one(known, solve, tally);
  return tally;
}

Tally by_method(const std::vector<convoy::bench::KnownProblem>& problems, SearchMethod method, bool signatures) {
  return tallied(problems, [&]<class G>(const AssociationProblem<G>& p) {
    return associate(p.map, p.fresh, p.prior, params_of(method, p.confidence),
                     signatures ? p.looks_alike : LooksAlike<G>());
  });
}

void report(benchmark::State& state, const Tally& t) {
  state.counters["overlapping"] = t.overlapping;
  state.counters["right"] = t.overlapping - t.not_right;
  state.counters["not_right"] = t.not_right;
  state.counters["placed"] = t.placed;
  state.counters["accepted_right"] = t.accepted_right;
  state.counters["accepted_wrong"] = t.accepted_wrong;
  state.counters["false_accepts"] = t.false_accepts;
  state.counters["p50_ms"] = convoy::bench::quantile(t.ms, 0.5);
  state.counters["p90_ms"] = convoy::bench::quantile(t.ms, 0.9);
  state.counters["max_ms"] = convoy::bench::quantile(t.ms, 1.0);
  state.counters["median_m"] = convoy::bench::quantile(t.distances_m, 0.5);
}

void BM_recorded(benchmark::State& state) {
  if (skipped(state)) return;
  const auto method = static_cast<SearchMethod>(state.range(0));
  Tally tally;
  for (auto _ : state) tally = by_method(convoy::bench::recorded_problems(), method, state.range(1) != 0);
  report(state, tally);
  state.SetLabel(std::string(to_string(method)) + (state.range(1) != 0 ? ", signatures" : ", geometry alone"));
}
BENCHMARK(BM_recorded)
    ->Args({static_cast<int>(SearchMethod::alignment), 0})
    ->Args({static_cast<int>(SearchMethod::alignment), 1})
    ->Args({static_cast<int>(SearchMethod::gcbb), 0})
    ->Args({static_cast<int>(SearchMethod::gcbb), 1})
    ->Iterations(1)
    ->Unit(benchmark::kMillisecond);

/// Problems on made-up streets, equivalent to the recorded ones: so many batches in a row that are searched together.
void BM_joined(benchmark::State& state) {
  constexpr std::uint64_t seed = 1;
  const bool signatures = state.range(1) != 0;
  const auto problems = convoy::bench::street_problems(static_cast<int>(state.range(0)), signatures, seed);
  Tally tally;
  for (auto _ : state) tally = by_method(problems, SearchMethod::alignment, signatures);
  report(state, tally);
  state.SetLabel("seed " + std::to_string(seed) + (signatures ? ", signatures" : ", geometry alone"));
}
BENCHMARK(BM_joined)->ArgsProduct({{1, 2, 3}, {0, 1}})->Iterations(1)->Unit(benchmark::kMillisecond);

/// The paper's references; JCBB (0) within a budget, since some problems take it minutes.
void BM_references(benchmark::State& state) {
  if (skipped(state)) return;
  const char* const names[] = {"JCBB", "closest neighbours", "Delaunay triangles"};
  const auto which = state.range(0);
  constexpr std::uint64_t nodes = 10'000;
  Tally tally;
  for (auto _ : state)
    tally = tallied(convoy::bench::recorded_problems(), [&]<class G>(const AssociationProblem<G>& p) {
      const SearchResult found = which == 0   ? jcbb(p.map, p.fresh, p.prior, p.confidence, nodes)
                                 : which == 1 ? triplets(p.map, p.fresh, p.prior, p.confidence)
                                              : delaunay(p.map, p.fresh, p.prior, p.confidence);
      AssociationResult<G> result;
      for (const auto& [i, j] : found.pairings)
        result.pairings.emplace_back(p.map.landmarks[static_cast<std::size_t>(i)].key,
                                     p.fresh.landmarks[static_cast<std::size_t>(j)].key);
      if (result.pairings.size() >= 5) result.decision = Decision::accepted;
      return result;
    });
  report(state, tally);
  state.SetLabel(names[which]);
}
BENCHMARK(BM_references)->DenseRange(0, 2)->Iterations(1)->Unit(benchmark::kMillisecond);

/// gcbb against Fig. 5 as written on recorded problems of 50 new landmarks and 200 of the map, which Fig. 5 does not
/// finish: it is stopped, and the ratio an upper bound.
void BM_recorded_gcbb(benchmark::State& state) {
  if (skipped(state)) return;
  constexpr std::uint64_t fig5_nodes = 400'000;  // seconds each
  std::vector<const AssociationProblem<SE2>*> problems;
  for (const auto& recorded : convoy::bench::recorded_problems())
    if (const auto* p = std::get_if<AssociationProblem<SE2>>(&recorded.problem))
      if (p->fresh.landmarks.size() == 50 && p->map.landmarks.size() == 200) problems.push_back(p);
  double ours_s = 0.0, fig5_s = 0.0;
  int fewer = 0, cut_off = 0;
  for (auto _ : state)
    for (const auto* p : problems) {
      const DistanceTable of_fresh(p->fresh), of_map(p->map);
      const DistanceCompatibility binary(of_fresh, of_map, {});
      const IndividualCompatibility<SE2> unary(p->prior, p->confidence);
      const auto compatible = [&](int i, int j) {
        return unary(p->map.landmarks[static_cast<std::size_t>(j)], p->fresh.landmarks[static_cast<std::size_t>(i)]);
      };
      const double start_s = convoy::bench::cpu_s();
      std::vector<IndexPairing> candidates;
      for (int i = 0; i < 50; ++i)
        for (int j = 0; j < 200; ++j)
          if (compatible(i, j)) candidates.emplace_back(i, j);
      const CompatibilityGraph graph(std::move(candidates), [&](const IndexPairing& x, const IndexPairing& y) {
        return binary(x.first, x.second, y.first, y.second);
      });
      const SearchResult ours = gcbb(graph, bit_parallel_nodes);
      const double between_s = convoy::bench::cpu_s();
      const SearchResult fig5 = gcbb_literal(50, 200, compatible, binary, fig5_nodes);
      ours_s += between_s - start_s;
      fig5_s += convoy::bench::cpu_s() - between_s;
      fewer += ours.cut_off || ours.pairings.size() < fig5.pairings.size();
      cut_off += fig5.cut_off;
    }
  state.counters["problems"] = static_cast<double>(problems.size());
  state.counters["ratio_to_baseline"] = ours_s / fig5_s;
  state.counters["baseline_s"] = fig5_s;
  state.counters["fewer_pairings"] = fewer;
  state.counters["baseline_cut_off"] = cut_off;
  state.SetLabel("baseline: Fig. 5");
}
BENCHMARK(BM_recorded_gcbb)->Iterations(1)->Unit(benchmark::kMillisecond);

// ---- a large map

/// 50 new landmarks, half of them among those of a map of a town, started within 22 m and 20 degrees.
void BM_large_map(benchmark::State& state) {
  const auto n = static_cast<std::uint32_t>(state.range(0));
  std::mt19937_64 random(n);
  const double half_m = 0.5 * std::sqrt(n / 0.04);  // a landmark on every 25 m^2
  std::uniform_real_distribution<double> anywhere(-half_m, half_m), beside(-35.0, 35.0);
  Batch<SE2> map{{{1, 1}, 1}, {}}, fresh{{{2, 1}, 1}, {}};
  for (std::uint32_t i = 0; i < n; ++i)
    map.landmarks.push_back(seen(map.anchor, i, SE2::Point(anywhere(random), anywhere(random)), random));
  const SE2 T_map_fresh(12.0, -7.0, 0.8);
  std::uint32_t count = 0;
  for (const auto& l : map.landmarks)
    if (count < 25 && (l.position - T_map_fresh.translation()).cwiseAbs().maxCoeff() < 35.0)
      fresh.landmarks.push_back(seen(fresh.anchor, count++, T_map_fresh.inverse() * l.position, random));
  while (count < 50)
    fresh.landmarks.push_back(seen(fresh.anchor, count++, SE2::Point(beside(random), beside(random)), random));
  const double sigma_m = 22.0 / 2.4477, sigma_rad = 20.0 * M_PI / 180.0 / 2.4477;
  const SE2::Covariance P = Eigen::Vector3d(sigma_m * sigma_m, sigma_m * sigma_m, sigma_rad * sigma_rad).asDiagonal();
  const std::optional<RelativePrior<SE2>> prior{{T_map_fresh * SE2::Exp({6.0, 5.0, 0.1}), P}};
  AssociationResult<SE2> result;
  for (auto _ : state) result = associate(map, fresh, prior, params_of(SearchMethod::alignment, 0.95));
  if (result.decision != Decision::accepted) state.SkipWithError(to_string(result.rejection));
  state.counters["pairings"] = result.support;
}
BENCHMARK(BM_large_map)->Arg(1000)->Arg(10'000)->Arg(100'000)->Unit(benchmark::kMillisecond);

}  // namespace
