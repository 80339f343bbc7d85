#include "vehicle_process.hpp"

#include <convoy/config_error.hpp>
#include <convoy/dds/dds_exchange.hpp>

#include <spdlog/spdlog.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <utility>

#include "run_time.hpp"
#include "vehicle_output.hpp"
#include "vehicle_status.hpp"
#include "vehicle_warnings.hpp"

namespace convoy::cli {
namespace {

volatile std::sig_atomic_t stop_requested = 0;

template <class G>
void print_status(double t_s, bool exhausted, const VehicleSnapshot<G>& snapshot) {
  nlohmann::json line = vehicle_status(t_s, snapshot);
  line["exhausted"] = exhausted;
  std::printf("%s\n", line.dump().c_str());
  std::fflush(stdout);
}

void log(const Notice& notice) {
  using Level = Notice::Level;
  spdlog::log(notice.level == Level::error     ? spdlog::level::err
              : notice.level == Level::warning ? spdlog::level::warn
                                               : spdlog::level::info,
              "{}", notice.text);
}

// What must be there before anything is opened.
template <class G>
void expect_whole(const VehicleConfig<G>& config) {
  if (config.sensors.file.empty() && !config.camera.given())
    throw ConfigError(config.file.string() +
                      ":1: no <sensors file=\"...\"/>; name the sensor log that the vehicle is to replay" +
                      (G::Dim == 3 ? ", or give it a <camera domain=\"10\"/>" : ""));
  if (config.dds.profile_file.empty())
    throw ConfigError(config.file.string() +
                      ":1: no <dds profile=\"...\"/>; name how the vehicle is to speak, such as " +
                      "qos_profiles/lan.xml");
}

template <class G>
VehicleConfig<G> with_options(VehicleConfig<G> config, const VehicleRunOptions& options) {
  if (options.now) config.sensors.start_unix_s = 0.0;
  if (!options.impair.empty()) config.impairment = Impairments::parse(options.impair);
  if (!options.out.empty()) config.output_folder = options.out;
  return config;
}

/// One vehicle from its first reading to its last.
template <class G>
class VehicleRun {
 public:
  VehicleRun(const VehicleConfig<G>& config, const VehicleRunOptions& options, SensorSource<G>& source)
      : config_(config),
        options_(options),
        source_(source),
        output_(config.output_folder),
        vehicle_(
            config.vehicle, source.slam(), [this] { return open_network(); }, [&source] { return source.now_s(); }),
        warnings_(config, source.clock_is_real()) {
    vehicle_.on_export([this](std::uint32_t index, std::uint64_t track) { output_.write_label(epoch_, index, track); });
  }

  int drive() {
    vehicle_.configure();
    const auto begun = vehicle_.snapshot();
    epoch_ = begun.self.epoch;
    spdlog::info("{}; {}", start_line(config_, epoch_), source_.name());
    if (const auto notice = journal_notice(config_, begun.journal)) log(*notice);
    if (const auto notice = start_notice(config_, begun.restarted)) log(*notice);
    for (const Notice& notice : budget_notices(config_, keeps_history_)) log(notice);
    vehicle_.activate();
    next_row_s_ = std::max(0.0, source_.now_s());
    while (!stop_requested && !refused_ && !at_the_end()) {
      source_.feed(vehicle_);
      if (source_.lost()) begin_epoch();
      write_row();
      tell_status();
    }
    return end();
  }

 private:
  std::unique_ptr<SubmapExchange<G>> open_network() {
    auto network = open_exchange(config_);
    if (const auto* dds = dynamic_cast<dds::DdsExchange<G>*>(network.get())) keeps_history_ = dds->keeps_history();
    return network;
  }

  bool at_the_end() {
    if (!options_.until_end || !source_.exhausted()) return false;
    const auto snapshot = vehicle_.snapshot();
    return fleet_end_.reached(snapshot.settled, snapshot.peers_agree, unix_time_());
  }

  // The SLAM was lost. What it stated before stays right; where it goes on, nobody knows.
  void begin_epoch() {
    vehicle_.deactivate();
    vehicle_.shutdown();
    source_.restart_slam();
    vehicle_.configure();
    epoch_ = vehicle_.snapshot().self.epoch;
    spdlog::warn("the SLAM was lost; it goes on in epoch {}, {}", epoch_,
                 config_.vehicle.journal ? "with all facts" : "and takes the facts of before from its peers");
    vehicle_.activate();
  }

  // Once a second.
  void write_row() {
    const double now_s = source_.now_s();
    if (now_s < next_row_s_ || source_.exhausted()) return;
    const auto snapshot = vehicle_.snapshot();
    vehicle_.inspect([&](auto& manager, auto&) { output_.write_live(now_s, snapshot, manager); });
    next_row_s_ += std::max(1.0, std::ceil(now_s - next_row_s_));
  }

  void tell_status() {
    const double wall_s = unix_time_();
    if (wall_s < next_status_s_) return;
    const auto snapshot = vehicle_.snapshot();
    print_status(source_.now_s(), source_.exhausted(), snapshot);
    warn(snapshot, wall_s);
    next_status_s_ = wall_s + options_.status_period_s;
  }

  void warn(const VehicleSnapshot<G>& snapshot, double wall_s) {
    for (const Notice& notice : warnings_.look(snapshot, wall_s)) log(notice);
    refused_ = snapshot.refused;
    for (const auto& state : snapshot.vehicles) {
      if (warned_ || state.chain != snapshot.self || (state.reasons & reason_impersonated) == 0) continue;
      warned_ = true;
      spdlog::warn(
          "somebody else speaks under id {} on domain {}: stop one of the two, or give it another id or domain",
          snapshot.self.vehicle, config_.dds.domain);
    }
  }

  int end() {
    vehicle_.deactivate();
    const double end_s = source_.now_s();
    vehicle_.inspect([&](SubmapManager<G>& manager, auto&) { manager.rebuild(end_s, true); });
    const auto snapshot = vehicle_.snapshot();
    vehicle_.inspect([&](SubmapManager<G>& manager, FrontEndComponent<G>& front_end) {
      output_.write_end(end_s, snapshot, manager, front_end);
    });
    print_status(end_s, source_.exhausted(), snapshot);
    vehicle_.shutdown();
    if (snapshot.facts_lost > 0)
      spdlog::warn("{} facts are declared missing (facts_lost): nobody who is left has them", snapshot.facts_lost);
    if (snapshot.facts_missing > 0)
      spdlog::warn("{} facts are not here (facts_missing): they were still on their way", snapshot.facts_missing);
    if (refused_)
      throw ConfigError(
          config_.file.string() + ": vehicle " + std::to_string(config_.vehicle.id) +
          " runs already in another process on domain " + std::to_string(config_.dds.domain) +
          ", which began earlier (its epoch is lower, or the same); this one was refused, and nothing it stated "
          "is lost here. Stop the other one, or give this one an id or a domain of its own");
    spdlog::info("stopped; map {} with {} landmarks known", hex(snapshot.map_digest), snapshot.landmarks_known);
    return 0;
  }

  const VehicleConfig<G>& config_;
  const VehicleRunOptions& options_;
  SensorSource<G>& source_;
  VehicleOutput<G> output_;
  std::atomic<bool> keeps_history_ = false;
  Vehicle<G> vehicle_;
  VehicleWarnings<G> warnings_;
  const UnixTime<> unix_time_;
  FleetEnd fleet_end_;
  Epoch epoch_ = 0;
  double next_row_s_ = 0.0, next_status_s_ = 0.0;
  bool warned_ = false, refused_ = false;
};

}  // namespace

template <class G>
int run_vehicle(VehicleConfig<G> given, const VehicleRunOptions& options, OpenSensors<G> open_sensors) {
  std::signal(SIGTERM, [](int) { stop_requested = 1; });
  std::signal(SIGINT, [](int) { stop_requested = 1; });
  std::signal(SIGPIPE, SIG_IGN);
  expect_whole(given);
  const VehicleConfig<G> config = with_options(std::move(given), options);
  SourceOptions sensors;
  sensors.stop = [] { return stop_requested != 0; };
  if (options.sightings) sensors.sightings = config.output_folder / "sightings.csv";
  const auto source = open_sensors(config, sensors);
  return source ? VehicleRun<G>(config, options, *source).drive() : 0;
}

#define CONVOY_INSTANTIATE(G) template int run_vehicle(VehicleConfig<G>, const VehicleRunOptions&, OpenSensors<G>);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
