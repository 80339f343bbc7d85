#include "vehicle_process.hpp"

#include <convoy/config_error.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/polar.hpp>

#include <spdlog/spdlog.h>
#include <nlohmann/json.hpp>

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <thread>

#include "run_time.hpp"
#include "scenario/scenario.hpp"
#include "vehicle_output.hpp"
#include "vehicle_status.hpp"
#include "vehicle_warnings.hpp"

namespace convoy::cli {
namespace {

volatile std::sig_atomic_t stop_requested = 0;

// Replays a sensor log on the clock.
template <class G>
class LogReplay {
 public:
  LogReplay(const std::vector<SensorEvent>& events, const VehicleConfig<G>& config, double from_s)
      : events_(events),
        antenna_(config.sensors.fix_lever),
        camera_(config.front_end),
        encounters_(config.sensors.encounters) {
    while (next_ < events_.size() && events_[next_].t_s < from_s) ++next_;  // a late starter missed these
    if (next_ > 0) spdlog::info("starting {:.1f} s into the sensor log: {} readings are past", from_s, next_);
  }
  bool exhausted() const { return next_ == events_.size(); }

  void feed_until(double t_s, Vehicle<G>& vehicle, RangeBearingEkf<G>& slam) {
    for (; next_ < events_.size() && events_[next_].t_s <= t_s; ++next_) {
      const SensorEvent& e = events_[next_];
      if (e.kind == SensorEvent::Kind::encounter && !encounters_) continue;
      vehicle.feed([&] {
        if (e.kind == SensorEvent::Kind::odometry) slam.on_odometry(e.t_s, e.v_m_s, e.omega_rad_s);
        else if (e.kind == SensorEvent::Kind::sighting) slam.on_sighting(e.t_s, e.track, e.polar<G>());
        else slam.on_time(e.t_s);
      });
      if (e.kind == SensorEvent::Kind::encounter) feed_encounter(e, vehicle);
      if (e.kind == SensorEvent::Kind::fix)  // one that is not fit to be a fact is counted there
        (void)vehicle.feed_absolute_fix(antenna_, e.place<G>(), square(e.sigma_m) * G::PointCovariance::Identity());
    }
    if (exhausted() && !finished_) {
      finished_ = true;
      vehicle.feed([&] { slam.finish(); });
    }
  }

 private:
  static double square(double x) { return x * x; }

  // As exact as the sighting of a landmark.
  void feed_encounter(const SensorEvent& e, Vehicle<G>& vehicle) const {
    const typename G::Point polar = e.polar<G>();
    const typename G::PointCovariance J = point_jacobian(polar);
    const typename G::PointCovariance P = J * camera_.sighting_noise<G>(e.range_m) * J.transpose();
    (void)vehicle.feed_encounter(e.track, e.range_m * ray_of(polar), symmetrised(P));
  }

  const std::vector<SensorEvent>& events_;
  typename G::Point antenna_;  // body frame [m]
  RangeBearingEkfParams camera_;
  bool encounters_;
  std::size_t next_ = 0;
  bool finished_ = false;
};

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

}  // namespace

template <class G>
int run_vehicle(VehicleConfig<G> config, const VehicleRunOptions& options) {
  std::signal(SIGTERM, [](int) { stop_requested = 1; });
  std::signal(SIGINT, [](int) { stop_requested = 1; });
  std::signal(SIGPIPE, SIG_IGN);

  if (config.sensors.file.empty())
    throw ConfigError(config.file.string() +
                      ":1: no <sensors file=\"...\"/>; name the sensor log that the vehicle is to replay");
  if (!std::filesystem::exists(config.sensors.file) || std::filesystem::is_directory(config.sensors.file))
    throw ConfigError(config.sensors.origin + ": " + config.sensors.file.string() +
                      ": no such file; <sensors file> is relative to the folder of the configuration");
  const std::vector<SensorEvent> events = read_sensors<G>(config.sensors.file);
  if (events.empty())
    throw ConfigError(config.sensors.file.string() + ":1: no reading below the header; the vehicle would never drive");
  if (config.dds.profile_file.empty())
    throw ConfigError(config.file.string() +
                      ":1: no <dds profile=\"...\"/>; name how the vehicle is to speak, such as " +
                      "qos_profiles/lan.xml");
  if (options.now) config.sensors.start_unix_s = 0.0;
  if (!options.impair.empty()) config.impairment = Impairments::parse(options.impair);
  if (!options.out.empty()) config.output_folder = options.out;
  const bool starts_now = config.sensors.start_unix_s == 0.0;
  const UnixTime<> unix_time;
  const double start_s = starts_now ? unix_time() : config.sensors.start_unix_s;
  const auto clock = [&] { return (unix_time() - start_s) * config.sensors.rate; };
  if (!starts_now && clock() > events.back().t_s)
    throw ConfigError(config.file.string() +
                      ": the sensor log ended before this start (start_unix_s lies in the past); " +
                      "give --now to drive it from its beginning, and --out FOLDER to keep what an earlier run left");
  VehicleOutput<G> output(config.output_folder);
  RangeBearingEkf<G> slam(config.front_end);
  std::atomic<bool> keeps_history = false;
  const auto open = [&] {
    auto network = open_exchange(config);
    if (const auto* dds = dynamic_cast<dds::DdsExchange<G>*>(network.get())) keeps_history = dds->keeps_history();
    return network;
  };
  Vehicle<G> vehicle(config.vehicle, slam, open, clock);
  Epoch epoch = 0;
  vehicle.on_export([&](std::uint32_t index, std::uint64_t track) { output.write_label(epoch, index, track); });
  vehicle.configure();
  epoch = vehicle.snapshot().self.epoch;
  spdlog::info("{}; {} sensor readings from {}", start_line(config, epoch), events.size(),
               config.sensors.file.string());
  if (const auto notice = journal_notice(config, vehicle.snapshot().journal)) log(*notice);
  if (const auto notice = start_notice(config, vehicle.snapshot().restarted)) log(*notice);
  for (const Notice& notice : budget_notices(config, keeps_history)) log(notice);
  vehicle.activate();
  bool warned = false, refused = false;
  // A log that begins now, or is driven faster than it was recorded, has a time of its own.
  VehicleWarnings<G> warnings(config, !starts_now && config.sensors.rate == 1.0);
  const auto warn_once = [&](const VehicleSnapshot<G>& snapshot, double wall_s) {
    for (const Notice& notice : warnings.look(snapshot, wall_s)) log(notice);
    refused = snapshot.refused;
    for (const auto& state : snapshot.vehicles)
      if (!warned && state.chain == snapshot.self && (state.reasons & reason_impersonated) != 0) {
        warned = true;
        spdlog::warn(
            "somebody else speaks under id {} on domain {}: stop one of the two, or give it another id or domain",
            snapshot.self.vehicle, config.dds.domain);
      }
  };

  LogReplay<G> replay(events, config, starts_now ? events.front().t_s : clock());
  double next_row_s = std::max(0.0, clock()), next_status_s = 0.0;
  FleetEnd fleet_end;
  const auto at_the_end = [&] {
    if (!options.until_end || !replay.exhausted()) return false;
    const auto snapshot = vehicle.snapshot();
    return fleet_end.reached(snapshot.settled, snapshot.peers_agree, unix_time());
  };
  while (!stop_requested && !refused && !at_the_end()) {
    const double now_s = clock();
    replay.feed_until(now_s, vehicle, slam);
    if (now_s >= next_row_s && !replay.exhausted()) {
      const auto snapshot = vehicle.snapshot();
      vehicle.inspect([&](auto& manager, auto&) { output.write_live(now_s, snapshot, manager); });
      next_row_s += 1.0 * std::max(1.0, std::ceil(now_s - next_row_s));
    }
    if (const double wall_s = unix_time(); wall_s >= next_status_s) {
      const auto snapshot = vehicle.snapshot();
      print_status(now_s, replay.exhausted(), snapshot);
      warn_once(snapshot, wall_s);
      next_status_s = wall_s + options.status_period_s;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }

  vehicle.deactivate();
  const double end_s = clock();
  vehicle.inspect([&](SubmapManager<G>& manager, auto&) { manager.rebuild(end_s, true); });
  const auto snapshot = vehicle.snapshot();
  vehicle.inspect([&](SubmapManager<G>& manager, FrontEndComponent<G>& front_end) {
    output.write_end(end_s, snapshot, manager, front_end);
  });
  print_status(end_s, replay.exhausted(), snapshot);
  vehicle.shutdown();
  if (snapshot.facts_lost > 0)
    spdlog::warn("{} facts are missing here (facts_lost): nobody who is left has them, or they were still on their way",
                 snapshot.facts_lost);
  if (refused)
    throw ConfigError(
        config.file.string() + ": vehicle " + std::to_string(config.vehicle.id) +
        " runs already in another process on domain " + std::to_string(config.dds.domain) +
        ", which began earlier (its epoch is lower, or the same); this one was refused, and nothing it stated "
        "is lost here. Stop the other one, or give this one an id or a domain of its own");
  spdlog::info("stopped; map {} with {} landmarks known", hex(snapshot.map_digest), snapshot.landmarks_known);
  return 0;
}

#define CONVOY_INSTANTIATE(G) template int run_vehicle(VehicleConfig<G>, const VehicleRunOptions&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
