// The sparse map against the paper's filter and against Eigen, on the same problem: two vehicles on laps beside each
// other, two landmarks per bias, each seen by both. The filter has all covariances when it is done; the sparse map
// solves for what is asked. Then the whole way from facts to the map, as a fleet grows.
#include <convoy/geometry/groups.hpp>
#include <convoy/map/ekf_map.hpp>
#include <convoy/map/global_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include <algorithm>
#include <cmath>
#include <random>

#include "eigen_map.hpp"
#include "map_fleet.hpp"
#include "ratio.hpp"

namespace {

using namespace convoy;

class Laps {
 public:
  explicit Laps(int biases) : random_(7), per_chain_(biases / 2) {
    for (const VehicleId v : {1U, 2U}) add_chain(v);
    for (int k = 0; k < per_chain_; ++k)
      for (const double ahead_m : {8.0, 12.0}) add_class(k, {ahead_m, 5.0});
  }
  const Problem<SE2>& problem() const { return problem_; }

 private:
  SE2::Tangent drawn(const SE2::Tangent& sigma) {
    std::normal_distribution<double> unit;
    SE2::Tangent d;
    for (int i = 0; i < 3; ++i) d[i] = sigma[i] * unit(random_);
    return d;
  }

  void add_chain(VehicleId v) {
    const SE2::Tangent start_sigma = v == 1 ? SE2::Tangent(0.01, 0.01, 0.001) : SE2::Tangent(1.0, 1.0, 0.05);
    const SE2::Tangent drift_sigma = (5.0 * SE2::Tangent(4e-4, 4e-4, 4e-6)).cwiseSqrt();  // of 5 m
    const int first = static_cast<int>(problem_.nodes.size());
    const ChainId chain{v, 1};
    SE2 truth(0.0, 4.0 * v, 0.0), slam;
    const SE2 start = truth * SE2::Exp(drawn(start_sigma));
    problem_.priors.push_back({first, start, start_sigma.cwiseAbs2().asDiagonal()});
    for (int k = 0; k < per_chain_; ++k) {
      if (k > 0) {
        const SE2 motion(5.0, 0.0, 2.0 * M_PI / 50.0);
        truth = truth * motion * SE2::Exp(drawn(drift_sigma));
        slam = slam * motion;
        problem_.drifts.push_back({first + k - 1, first + k, motion, drift_sigma.cwiseAbs2().asDiagonal()});
      }
      ChainState<SE2> state{2.5 * k, 5.0 * k, slam, SE2::Covariance::Zero()};
      problem_.nodes.push_back({{chain, static_cast<std::uint32_t>(k)}, state, start * slam});
      truth_.push_back(truth);
    }
    problem_.chains.push_back({chain, first, first + per_chain_, true});
  }

  // A point near the k-th bias of the first chain, seen from there and from the k-th of the other.
  void add_class(int k, const SE2::Point& p_first) {
    constexpr double sigma_m = 0.1;
    const auto index = static_cast<std::uint32_t>(problem_.points.size());
    const SE2::Point p = truth_[static_cast<std::size_t>(k)] * p_first;
    std::normal_distribution<double> noise(0.0, sigma_m);
    for (const int node : {k, per_chain_ + k}) {
      const SE2::Point error(noise(random_), noise(random_));
      const SE2::Point l = truth_[static_cast<std::size_t>(node)].inverse() * p + error;
      const Key key{problem_.nodes[static_cast<std::size_t>(node)].anchor.chain, index};
      problem_.landmarks.push_back(
          {node, static_cast<int>(index), key, l, sigma_m * sigma_m * SE2::PointCovariance::Identity()});
    }
    const LandmarkFactor<SE2>& seen = *(problem_.landmarks.end() - 2);
    problem_.points.push_back(problem_.nodes[static_cast<std::size_t>(k)].initial * seen.position);
  }

  std::mt19937_64 random_;
  int per_chain_;
  Problem<SE2> problem_;
  std::vector<SE2> truth_;
};

void BM_sparse_map(benchmark::State& state) {
  const Laps laps(static_cast<int>(state.range(0)));
  std::unique_ptr<Map<SE2>> sparse;
  convoy::bench::against(
      state, "EkfMap::solve", [&] { sparse = SparseMap<SE2>().solve(laps.problem()); },
      [&] { benchmark::DoNotOptimize(EkfMap<SE2>().solve(laps.problem())); });
  if (!sparse->report().converged) state.SkipWithError("the sparse map did not converge");
  state.counters["iterations_to_converge"] = sparse->report().iterations;
  state.counters["chi2_per_dof"] = sparse->report().chi2 / sparse->report().dof;
}
BENCHMARK(BM_sparse_map)->Arg(100)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_sparse_map)->Arg(300)->Arg(1000)->Iterations(1)->Unit(benchmark::kMillisecond);

void BM_sparse_map_by_blocks(benchmark::State& state) {
  const Laps laps(static_cast<int>(state.range(0)));
  std::unique_ptr<Map<SE2>> sparse;
  SolveReport scalar;
  convoy::bench::against(
      state, "Eigen SimplicialLDLT", [&] { sparse = SparseMap<SE2>().solve(laps.problem()); },
      [&] { scalar = bench::solve_with_eigen(laps.problem()); });
  if (std::abs(sparse->report().chi2 / scalar.chi2 - 1.0) > 1e-9) state.SkipWithError("the solutions differ");
}
BENCHMARK(BM_sparse_map_by_blocks)->Arg(100)->Arg(1000)->Arg(10000)->Unit(benchmark::kMillisecond);

// A fleet of range(0) vehicles with range(1) anchors each; the last batches come one by one, each with a hypothesis,
// and after each the map is made anew. Counters: milliseconds from facts to map; the baseline is the other way to come
// to one.
template <class G>
void grow(benchmark::State& state, bool incrementally) {
  const int vehicles = static_cast<int>(state.range(0)), anchors = static_cast<int>(state.range(1));
  const bench::MapFleet<G> fleet(vehicles, anchors, vehicles * anchors / (anchors < 1000 ? 1 : 5),
                                 anchors < 1000   ? 2 + vehicles / 3
                                 : vehicles < 100 ? 10
                                                  : 32);
  const std::size_t news = std::min<std::size_t>(incrementally ? 200 : 3, fleet.hypotheses.size() / 2);
  FactStore<G> store = fleet.store(fleet.hypotheses.size() - news);
  const SparseMap<G> backend;
  MapBuilder<G> builder(SelectionParams{}, backend);
  double start_s = bench::cpu_s();
  GlobalMap<G> global = builder.build(store);
  const double first_s = bench::cpu_s() - start_s;
  if (incrementally) global = builder.update(store);
  std::vector<double> ms;
  for (auto _ : state)
    for (std::size_t k = news; k > 0; --k) {
      store.insert(fleet.hypotheses[fleet.hypotheses.size() - k]);
      start_s = bench::cpu_s();
      GlobalMap<G> next = incrementally ? builder.update(store) : builder.build(store);
      ms.push_back(1e3 * (bench::cpu_s() - start_s));
      global = std::move(next);
    }
  std::sort(ms.begin(), ms.end());
  state.counters["p50_ms"] = ms[ms.size() / 2];
  state.counters["p99_ms"] = ms[ms.size() * 99 / 100];
  state.counters["max_ms"] = ms.back();
  state.counters["first_build_ms"] = 1e3 * first_s;
  state.counters["nodes"] = static_cast<double>(global.map->problem().nodes.size());
  state.counters["classes"] = static_cast<double>(global.selection.classes.size());
  state.counters["hypotheses"] = static_cast<double>(global.selection.hypotheses.size());
  state.counters["left_out"] =
      static_cast<double>(std::count_if(global.selection.hypotheses.begin(), global.selection.hypotheses.end(),
                                        [](const auto& h) { return h.state != HypothesisState::accepted; }));
  if (!global.map->report().converged) state.SkipWithError("the sparse map did not converge");
}

template <class G>
void BM_rebuild(benchmark::State& state) {
  grow<G>(state, false);
}
template <class G>
void BM_update(benchmark::State& state) {
  grow<G>(state, true);
}
#define CONVOY_FLEETS \
  ->Args({1, 200})->Args({10, 200})->Args({10, 1000})->Args({100, 1000})->Iterations(1)->Unit(benchmark::kMillisecond)
#define CONVOY_LARGE_FLEETS ->Args({10, 1000})->Args({100, 1000})->Iterations(1)->Unit(benchmark::kMillisecond)
BENCHMARK(BM_rebuild<SE2>) CONVOY_FLEETS;
BENCHMARK(BM_update<SE2>) CONVOY_FLEETS;
BENCHMARK(BM_rebuild<SE3>) CONVOY_LARGE_FLEETS;
BENCHMARK(BM_update<SE3>) CONVOY_LARGE_FLEETS;

}  // namespace
