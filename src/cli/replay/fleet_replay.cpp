#include "replay/fleet_replay.hpp"

#include <convoy/components/vehicle.hpp>
#include <convoy/exchange/in_process.hpp>
#include <convoy/frontend/range_bearing_ekf.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <memory>
#include <set>
#include <vector>

#include <nlohmann/json.hpp>

#include "evaluate/evaluate.hpp"
#include "evaluate/front_end_record.hpp"
#include "replay/outcome.hpp"
#include "replay/progress.hpp"
#include "report/report.hpp"
#include "scenario/gps_reference.hpp"
#include "scenario/table_file.hpp"
#include "scenario_config.hpp"
#include "vehicle_output.hpp"

namespace convoy::cli {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

constexpr double period_s = 0.1;    // between two steps of a vehicle
constexpr double live_s = 1.0;      // between two rows of live.csv, and two maps
constexpr double settle_s = 120.0;  // that they get to tell each other the rest

using SteadyTime = std::chrono::steady_clock::time_point;
double ms_since(SteadyTime began) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - began).count();
}

/// A scan is what was seen at one moment, and the odometry since the scan before.
class ScanLog {
 public:
  explicit ScanLog(const VehicleLog<SE2>& log) : reckoned_(log.sensors) {}

  void note(const SensorEvent& e, bool refused, double took_ms) {
    next_.took_ms += took_ms;
    if (e.kind != SensorEvent::Kind::sighting) return;
    seen_ = true;
    next_.t_s = e.t_s;
    const bool known = !tracks_.insert(e.track).second;
    next_.sought += known;
    next_.tracked += known && !refused;
    next_.started += !known;
  }
  bool ended_before(double t_s) const { return seen_ && t_s > next_.t_s; }
  void close(const FrontEndState<SE2>& state, std::uint64_t exported) {
    if (!seen_) return;
    next_.epoch = 1;
    next_.path_m = state.abscissa_m;
    next_.T_start_body = in_space(state.pose);
    next_.T_start_odometry = in_space(reckoned_.at(next_.t_s).T_local_body);
    next_.landmarks = next_.tracked;
    next_.exported = static_cast<std::uint32_t>(exported);
    scans_.push_back(next_);
    next_ = {};
    seen_ = false;
  }
  void exported_at_end(std::uint64_t exported) {
    if (!scans_.empty()) scans_.back().exported = static_cast<std::uint32_t>(exported);
  }
  const std::vector<FrontEndFrame>& scans() const { return scans_; }

 private:
  ReckonedPath reckoned_;
  std::set<std::uint32_t> tracks_;
  FrontEndFrame next_;
  bool seen_ = false;
  std::vector<FrontEndFrame> scans_;
};

class Member {
 public:
  Member(const VehicleLog<SE2>& log, const VehicleConfig<SE2>& config, InProcessNetwork<SE2>& network,
         const fs::path& folder)
      : log_(log),
        searches_per_step_(config.vehicle.searches_per_step),
        output_(folder),
        scans_(log),
        slam_(config.front_end),
        exchange_(network.join()),
        manager_({log.id, 1}, *exchange_, config.vehicle.submaps),
        front_end_(slam_, manager_, config.vehicle.drift, config.vehicle.live_period_s),
        association_(manager_, config.vehicle.association) {
    front_end_.on_export(
        [this](std::uint32_t index, std::uint64_t track) { output_.write_label(manager_.self().epoch, index, track); });
    manager_.open_chain(slam_.state().stamp_s, config.vehicle.static_bias, front_end_.persistent());
  }

  void drive(double until_s) {
    for (; next_ < log_.sensors.size() && log_.sensors[next_].t_s <= until_s; ++next_) feed(log_.sensors[next_]);
    if (next_ < log_.sensors.size() || finished_) return;
    finished_ = true;
    close_scan();
    slam_.finish();
    front_end_.poll();
    scans_.exported_at_end(front_end_.landmarks_exported());
  }

  void step(double now_s) {
    manager_.step(now_s);
    searched_ = association_.step(searches_per_step_) > 0;
  }

  void tell(double now_s) {
    manager_.rebuild(now_s);
    if (!finished_) output_.write_live(now_s, snapshot(now_s), manager_);
  }

  void end(double now_s) {
    manager_.rebuild(now_s, true);
    output_.write_end(now_s, snapshot(now_s), manager_, front_end_);
  }

  bool idle() const { return finished_ && !searched_ && !manager_.busy() && manager_.facts_missing() == 0; }
  Hash facts() const { return manager_.store().digest(); }
  const std::vector<FrontEndFrame>& scans() const { return scans_.scans(); }

 private:
  void feed(const SensorEvent& e) {
    if (scans_.ended_before(e.t_s)) close_scan();
    const std::uint64_t refused = refusals();
    const SteadyTime began = std::chrono::steady_clock::now();
    if (e.kind == SensorEvent::Kind::odometry) slam_.on_odometry(e.t_s, e.v_m_s, e.omega_rad_s);
    else if (e.kind == SensorEvent::Kind::sighting) slam_.on_sighting(e.t_s, e.track, e.polar<SE2>());
    scans_.note(e, refusals() > refused, ms_since(began));
    front_end_.poll();
  }
  void close_scan() { scans_.close(slam_.state(), front_end_.landmarks_exported()); }
  std::uint64_t refusals() const { return slam_.counters().sightings_gated + slam_.counters().sightings_invalid; }

  VehicleSnapshot<SE2> snapshot(double now_s) {
    VehicleSnapshot<SE2> s;
    s.self = manager_.self();
    manager_.update_live(front_end_.live());
    s.vehicles = manager_.vehicles(now_s);
    s.facts_digest = facts();
    s.map_digest = manager_.digests().map;
    s.selection_digest = manager_.digests().selection;
    s.facts_missing = manager_.facts_missing();
    s.facts_lost = manager_.facts_lost();
    s.peers_agree = manager_.peers_agree();
    s.settled = idle() && manager_.map().exact && manager_.map().facts == s.facts_digest;
    for (const auto& [id, chain] : manager_.store().chains()) s.landmarks_known += chain.landmarks.size();
    s.landmarks_exported = front_end_.landmarks_exported();
    s.submaps = manager_.counters();
    s.submaps.live_unfit += front_end_.remembered_unfit();
    s.repair = manager_.repair_counters();
    s.association = association_.counters();
    s.exchange = manager_.exchange_counters();
    s.peers = manager_.peer_counters();
    s.live_peers = exchange_->live_peers();
    s.insertions = manager_.store().insertions();
    return s;
  }

  const VehicleLog<SE2>& log_;
  int searches_per_step_;
  VehicleOutput<SE2> output_;
  ScanLog scans_;
  RangeBearingEkf<SE2> slam_;
  std::unique_ptr<SubmapExchange<SE2>> exchange_;
  SubmapManager<SE2> manager_;
  FrontEndComponent<SE2> front_end_;
  AssociationComponent<SE2> association_;
  std::size_t next_ = 0;
  bool finished_ = false, searched_ = false;
};

class Fleet {
 public:
  Fleet(const Scenario<SE2>& scenario, const fs::path& out) : scenario_(scenario), out_(out) {
    for (const VehicleLog<SE2>& log : scenario.vehicles)
      members_.push_back(
          std::make_unique<Member>(log, vehicle_config_of(scenario, log), network_, vehicle_folder(out, log.id)));
  }

  /// True if they came to hold the same facts, with nothing left to search.
  bool run() {
    Progress progress;
    bool agreed = false;
    double next_live_s = 0.0, now_s = 0.0;
    for (int k = 0; !agreed && now_s < scenario_.duration_s + settle_s; ++k) {
      now_s = k * period_s;
      for (auto& member : members_) {
        member->drive(now_s);
        member->step(now_s);
      }
      agreed = settled();
      if (now_s < next_live_s) continue;
      next_live_s += live_s;
      for (auto& member : members_) member->tell(now_s);
      progress.tell(scans(), now_s);
    }
    for (auto& member : members_) member->end(now_s);
    for (std::size_t i = 0; i < members_.size(); ++i)
      write_front_end(vehicle_folder(out_, scenario_.vehicles[i].id) / "front_end.csv", members_[i]->scans());
    return agreed;
  }

 private:
  bool settled() const {
    return std::all_of(members_.begin(), members_.end(),
                       [&](const auto& m) { return m->idle() && m->facts() == members_.front()->facts(); });
  }
  std::size_t scans() const {
    std::size_t sum = 0;
    for (const auto& member : members_) sum += member->scans().size();
    return sum;
  }

  const Scenario<SE2>& scenario_;
  fs::path out_;
  InProcessNetwork<SE2> network_;
  std::vector<std::unique_ptr<Member>> members_;
};

void write_run_info(const Scenario<SE2>& scenario, double wall_s, const fs::path& out) {
  json run = {{"scenario", scenario.name},
              {"source", scenario.source},
              {"seed", scenario.seed},
              {"dimension", 2},
              {"vehicles", json::array()},
              {"common_frame_vehicle", scenario.common_frame_vehicle},
              {"wall_s", wall_s},
              {"vehicle_s", scenario.duration_s},
              {"lost_vehicles", json::array()}};
  for (const VehicleLog<SE2>& log : scenario.vehicles) run["vehicles"].push_back(log.id);
  write_text_file(out / "run.json", run.dump(1) + "\n");
}

}  // namespace

bool replay_fleet(const Scenario<SE2>& scenario, const fs::path& out) {
  scenario.write(out);
  const SteadyTime began = std::chrono::steady_clock::now();
  const bool agreed = Fleet(scenario, out).run();
  write_run_info(scenario, 1e-3 * ms_since(began), out);
  const RunRecord<SE2> run = read_run<SE2>(out);
  const Evaluation<SE2> evaluation = evaluate(run);
  write_evaluation(run, evaluation);
  write_report(run, evaluation);
  print_front_end(evaluation.metrics.at("front_end"), "scans");
  std::printf("%s\n", headline(run, evaluation.metrics).c_str());
  return agreed && evaluation.metrics.at("map_digests_equal") == json(true);
}

}  // namespace convoy::cli
