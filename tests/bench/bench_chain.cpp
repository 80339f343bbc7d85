// The association in the chain: what each step of it takes while recordings are driven, and what is stated. The fleet
// of `convoy demo` on one thread, one clock (10 Hz of the recording) and a network without loss. The map is built once,
// at the end, since no association depends on it. A step counts if it searched; time is that of this thread.
#include <convoy/components/association_component.hpp>
#include <convoy/components/front_end_component.hpp>
#include <convoy/components/submap_manager.hpp>
#include <convoy/exchange/in_process.hpp>
#include <convoy/frontend/range_bearing_ekf.hpp>
#include <convoy/map/global_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include <benchmark/benchmark.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "../support/data_folder.hpp"
#include "quantile.hpp"
#include "ratio.hpp"
#include "scenario/mrclam.hpp"
#include "scenario/victoria_park.hpp"
#include "scenario_config.hpp"

namespace {

using namespace convoy;
using namespace convoy::cli;

constexpr double period_s = 0.1, settle_s = 300.0;

struct StepTimes {
  std::vector<double> searching_ms;
  double total_s = 0.0;  // of all steps
};

/// One vehicle of the demo, without its thread.
class Member {
 public:
  Member(const VehicleLog<SE2>& log, const VehicleConfig<SE2>& config, InProcessNetwork<SE2>& network)
      : log_(log),
        searches_per_step_(config.vehicle.searches_per_step),
        slam_(config.front_end),
        exchange_(network.join()),
        manager_({log.id, 1}, *exchange_, config.vehicle.submaps),
        front_end_(slam_, manager_, config.vehicle.drift, config.vehicle.live_period_s),
        association_(manager_, config.vehicle.association) {
    front_end_.on_export([this](std::uint32_t index, std::uint64_t track) { tracks_[index] = track; });
    manager_.open_chain(slam_.state().stamp_s, config.vehicle.static_bias, front_end_.persistent());
  }

  void drive(double until_s) {
    if (finished_) return;
    for (; next_ < log_.sensors.size() && log_.sensors[next_].t_s <= until_s; ++next_) {
      const SensorEvent& e = log_.sensors[next_];
      if (e.kind == SensorEvent::Kind::odometry) slam_.on_odometry(e.t_s, e.v_m_s, e.omega_rad_s);
      else if (e.kind == SensorEvent::Kind::sighting) slam_.on_sighting(e.t_s, e.track, e.polar<SE2>());
      front_end_.poll();
    }
    if (next_ < log_.sensors.size()) return;
    finished_ = true;
    slam_.finish();
    front_end_.poll();
  }

  void step(double now_s, StepTimes& times) {
    manager_.step(now_s);
    const double start_s = convoy::bench::cpu_s();
    searched_ = association_.step(searches_per_step_) > 0;
    const double took_s = convoy::bench::cpu_s() - start_s;
    times.total_s += took_s;
    if (searched_) times.searching_ms.push_back(1e3 * took_s);
  }

  bool idle() const { return finished_ && !searched_ && manager_.store().missing_count() == 0; }
  const FactStore<SE2>& store() const { return manager_.store(); }
  ChainId chain() const { return manager_.self(); }
  std::uint64_t searches() const { return association_.counters().searches; }
  std::uint64_t track(std::uint32_t landmark) const { return tracks_.at(landmark); }

 private:
  const VehicleLog<SE2>& log_;
  int searches_per_step_;
  RangeBearingEkf<SE2> slam_;
  std::unique_ptr<SubmapExchange<SE2>> exchange_;
  SubmapManager<SE2> manager_;
  FrontEndComponent<SE2> front_end_;
  AssociationComponent<SE2> association_;
  std::map<std::uint32_t, std::uint64_t> tracks_;
  std::size_t next_ = 0;
  bool finished_ = false, searched_ = false;
};

class Fleet {
 public:
  Fleet(const Scenario<SE2>& scenario, SearchMethod method) {
    for (const VehicleLog<SE2>& log : scenario.vehicles) {
      VehicleConfig<SE2> config = vehicle_config_of(scenario, log);
      config.vehicle.association.method = method;
      members_.push_back(std::make_unique<Member>(log, config, network_));
    }
  }

  /// The whole recording, and on until everybody holds the same facts and has searched them. False: that takes too
  /// long.
  bool run(double duration_s) {
    for (double now_s = 0.0; now_s < duration_s + settle_s; now_s += period_s) {
      for (auto& member : members_) {
        member->drive(now_s);
        member->step(now_s, times);
      }
      if (settled()) return true;
    }
    return false;
  }

  std::uint64_t searches() const {
    std::uint64_t sum = 0;
    for (const auto& member : members_) sum += member->searches();
    return sum;
  }

  /// Each once, whoever stated it.
  std::set<std::vector<Pairing>> hypotheses() const {
    std::set<std::vector<Pairing>> stated;
    for (const auto& [id, chain] : members_.front()->store().chains())
      for (const auto& [index, fact] : chain.associations) stated.insert(fact.pairings);
    return stated;
  }

  /// Where tracks are names of landmarks, the same for all.
  bool is_true(const Pairing& pairing) const { return track_of(pairing.first) == track_of(pairing.second); }

  /// Classes of the map that all of this amounts to which join different things.
  int false_fusions() const {
    const SparseMap<SE2> backend;
    const auto map = build_global_map(members_.front()->store(), SelectionParams(), backend);
    int count = 0;
    for (const auto& members : map.selection.classes)
      count += std::any_of(members.begin(), members.end(),
                           [&](const Key& key) { return track_of(key) != track_of(*members.begin()); });
    return count;
  }

  StepTimes times;

 private:
  bool settled() const {
    const Hash facts = members_.front()->store().digest();
    return std::all_of(members_.begin(), members_.end(),
                       [&](const auto& m) { return m->idle() && m->store().digest() == facts; });
  }
  std::uint64_t track_of(const Key& landmark) const {
    const auto member =
        std::find_if(members_.begin(), members_.end(), [&](const auto& m) { return m->chain() == landmark.chain; });
    return (*member)->track(landmark.index);
  }

  InProcessNetwork<SE2> network_;
  std::vector<std::unique_ptr<Member>> members_;
};

/// A hypothesis is wrong if one of its pairings is, misplaced if most of them are. Pairings: each once.
void count_wrong(const Fleet& fleet, const std::string& method, benchmark::State& state) {
  int wrong = 0, misplaced = 0;
  std::set<Pairing> all, untrue;
  for (const std::vector<Pairing>& pairings : fleet.hypotheses()) {
    std::size_t count = 0;
    for (const Pairing& p : pairings) {
      all.insert(p);
      if (fleet.is_true(p)) continue;
      untrue.insert(p);
      ++count;
    }
    wrong += count > 0;
    misplaced += 2 * count > pairings.size();
  }
  state.counters[method + "false_fusions"] = fleet.false_fusions();
  state.counters[method + "wrong"] = wrong;
  state.counters[method + "misplaced"] = misplaced;
  state.counters[method + "pairings"] = static_cast<double>(all.size());
  state.counters[method + "pairings_untrue"] = static_cast<double>(untrue.size());
}

void report(const Fleet& fleet, const std::string& method, benchmark::State& state) {
  const std::vector<double>& ms = fleet.times.searching_ms;
  state.counters[method + "steps"] = static_cast<double>(ms.size());
  state.counters[method + "step_p50_ms"] = convoy::bench::quantile(ms, 0.5);
  state.counters[method + "step_p99_ms"] = convoy::bench::quantile(ms, 0.99);
  state.counters[method + "step_max_ms"] = convoy::bench::quantile(ms, 1.0);
  state.counters[method + "total_s"] = fleet.times.total_s;
  state.counters[method + "searches"] = static_cast<double>(fleet.searches());
  state.counters[method + "hypotheses"] = static_cast<double>(fleet.hypotheses().size());
}

void drive(benchmark::State& state, const Scenario<SE2>& scenario, bool tracks_are_names) {
  for (auto _ : state) {
    Fleet fleet(scenario, AssociationParams().method), baseline(scenario, SearchMethod::gcbb);
    if (!fleet.run(scenario.duration_s) || !baseline.run(scenario.duration_s))
      return state.SkipWithError("the fleet does not settle");
    for (const auto& [method, driven] : {std::pair<std::string, const Fleet*>("", &fleet), {"gcbb_", &baseline}}) {
      report(*driven, method, state);
      if (tracks_are_names) count_wrong(*driven, method, state);
    }
    state.counters["ratio_to_gcbb"] = fleet.times.total_s / baseline.times.total_s;
  }
  state.SetLabel("baseline: gcbb");
}

/// True if the recording is not there: the bench is skipped then.
bool skipped(benchmark::State& state, const std::string& recording) {
  if (std::filesystem::exists(test::data_folder() / recording)) return false;
  state.SetLabel("skipped: no " + recording + "; set CONVOY_DATA_DIR");
  for (auto _ : state) {
  }
  return true;
}

void BM_chain_mrclam(benchmark::State& state) {
  if (skipped(state, "utias_mrclam/ds6")) return;
  drive(state, load_mrclam(test::data_folder() / "utias_mrclam/ds6"), true);
}
BENCHMARK(BM_chain_mrclam)->Iterations(1)->Unit(benchmark::kMillisecond);

void BM_chain_victoria_park(benchmark::State& state) {
  if (skipped(state, "victoria_park")) return;
  drive(state, load_victoria_park(test::data_folder() / "victoria_park", 1), false);
}
BENCHMARK(BM_chain_victoria_park)->Iterations(1)->Unit(benchmark::kMillisecond);

}  // namespace
