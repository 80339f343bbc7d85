// A sensor log, replayed on the clock.
#include <convoy/config_error.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/polar.hpp>

#include <spdlog/spdlog.h>

#include <chrono>
#include <filesystem>
#include <thread>
#include <utility>
#include <vector>

#include "run_time.hpp"
#include "scenario/scenario.hpp"
#include "sensor_source.hpp"

namespace convoy::cli {
namespace {

template <class G>
std::vector<SensorEvent> read_log(const VehicleConfig<G>& config) {
  if (!std::filesystem::exists(config.sensors.file) || std::filesystem::is_directory(config.sensors.file))
    throw ConfigError(config.sensors.origin + ": " + config.sensors.file.string() +
                      ": no such file; <sensors file> is relative to the folder of the configuration");
  std::vector<SensorEvent> events = read_sensors<G>(config.sensors.file);
  if (events.empty())
    throw ConfigError(config.sensors.file.string() + ":1: no reading below the header; the vehicle would never drive");
  return events;
}

template <class G>
class LogSource final : public SensorSource<G> {
 public:
  explicit LogSource(const VehicleConfig<G>& config)
      : events_(read_log(config)),
        file_(config.sensors.file.string()),
        rate_(config.sensors.rate),
        starts_now_(config.sensors.start_unix_s == 0.0),
        start_s_(starts_now_ ? unix_time_() : config.sensors.start_unix_s),
        antenna_(config.sensors.fix_lever),
        camera_(config.front_end),
        encounters_(config.sensors.encounters),
        slam_(config.front_end) {
    const double from_s = starts_now_ ? events_.front().t_s : now_s();
    if (from_s > events_.back().t_s)
      throw ConfigError(config.file.string() +
                        ": the sensor log ended before this start (start_unix_s lies in the past); give --now to drive "
                        "it from its beginning, and --out FOLDER to keep what an earlier run left");
    while (events_[next_].t_s < from_s) ++next_;  // a late starter missed these
    if (next_ > 0) spdlog::info("starting {:.1f} s into the sensor log: {} readings are past", from_s, next_);
  }

  FrontEnd<G>& slam() override { return slam_; }
  double now_s() const override { return (unix_time_() - start_s_) * rate_; }
  // A log that begins now, or is driven faster than it was recorded, has a time of its own.
  bool clock_is_real() const override { return !starts_now_ && rate_ == 1.0; }
  bool exhausted() const override { return next_ == events_.size(); }
  std::string name() const override { return std::to_string(events_.size()) + " sensor readings from " + file_; }

  void feed(Vehicle<G>& vehicle) override {
    for (const double t_s = now_s(); next_ < events_.size() && events_[next_].t_s <= t_s; ++next_) {
      const SensorEvent& e = events_[next_];
      if (e.kind == SensorEvent::Kind::encounter && !encounters_) continue;
      vehicle.feed([&] {
        if (e.kind == SensorEvent::Kind::odometry) slam_.on_odometry(e.t_s, e.v_m_s, e.omega_rad_s);
        else if (e.kind == SensorEvent::Kind::sighting) slam_.on_sighting(e.t_s, e.track, e.polar<G>());
        else slam_.on_time(e.t_s);
      });
      if (e.kind == SensorEvent::Kind::encounter) feed_encounter(e, vehicle);
      if (e.kind == SensorEvent::Kind::fix)  // one that is not fit to be a fact is counted there
        (void)vehicle.feed_absolute_fix(antenna_, e.place<G>(), square(e.sigma_m) * G::PointCovariance::Identity());
    }
    if (exhausted() && !std::exchange(finished_, true)) vehicle.feed([&] { slam_.finish(); });
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
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

  const std::vector<SensorEvent> events_;
  const std::string file_;
  const UnixTime<> unix_time_;
  const double rate_;
  const bool starts_now_;
  const double start_s_;
  const typename G::Point antenna_;  // body frame [m]
  const RangeBearingEkfParams camera_;
  const bool encounters_;
  RangeBearingEkf<G> slam_;
  std::size_t next_ = 0;
  bool finished_ = false;
};

}  // namespace

template <class G>
std::unique_ptr<SensorSource<G>> open_log(const VehicleConfig<G>& config, const SourceOptions&) {
  return std::make_unique<LogSource<G>>(config);
}

#define CONVOY_INSTANTIATE(G) \
  template std::unique_ptr<SensorSource<G>> open_log(const VehicleConfig<G>&, const SourceOptions&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
