// A camera and an odometer on DDS topics, and the monocular SLAM that they go to.
#include <convoy/config_error.hpp>
#include <convoy/dds/sensor_reader.hpp>
#include <convoy/vision/monocular_slam.hpp>

#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <fstream>
#include <mutex>
#include <utility>

#include "scenario/table_file.hpp"
#include "sensor_source.hpp"

namespace convoy::cli {
namespace {

using SteadyClock = std::chrono::steady_clock;

double seconds_since(SteadyClock::time_point then) {
  return std::chrono::duration<double>(SteadyClock::now() - then).count();
}

/// The time of the last reading, and if it runs on, wall time from there.
class SensorClock {
 public:
  double now_s() const {
    const std::lock_guard lock(mutex_);
    latest_s_ = std::max(latest_s_, stamp_s_ + (runs_on_ ? seconds_since(heard_) : 0.0));
    return latest_s_;
  }
  void set(double stamp_s, bool runs_on) {
    const std::lock_guard lock(mutex_);
    stamp_s_ = stamp_s;
    heard_ = SteadyClock::now();
    runs_on_ = runs_on;
  }

 private:
  mutable std::mutex mutex_;
  mutable double latest_s_ = 0.0;
  double stamp_s_ = 0.0;
  SteadyClock::time_point heard_ = SteadyClock::now();
  bool runs_on_ = false;
};

dds::SensorReaderParams reader_params(const VehicleConfig<SE3>& config) {
  dds::SensorReaderParams params;
  params.domain = config.camera.domain;
  params.vehicle = config.vehicle.id;
  params.interfaces = config.camera.interfaces;
  params.lock_step = config.camera.lock_step;
  return params;
}

MonocularSlamParams slam_params(const CameraConfig& config) {
  MonocularSlamParams params;
  params.filter = config.slam;
  params.features = config.features;
  params.new_features = config.new_features;
  return params;
}

class CameraSource final : public SensorSource<SE3> {
 public:
  CameraSource(const VehicleConfig<SE3>& config, const SourceOptions& options)
      : config_(config.camera), vehicle_(config.vehicle.id), reader_(reader_params(config)) {
    wait_for_camera(options.stop);
    if (ready() && !options.sightings.empty()) write_sightings(options.sightings);
  }
  /// False if waiting for the camera was stopped: then nothing else may be called.
  bool ready() const { return slam_.has_value(); }

  FrontEnd<SE3>& slam() override { return *slam_; }
  double now_s() const override { return clock_.now_s(); }
  bool clock_is_real() const override { return false; }
  bool exhausted() const override { return ended_ || silent_; }
  bool lost() const override { return slam_->lost(); }
  void restart_slam() override { slam_->restart(); }
  std::string name() const override {
    const CameraCalibration& c = camera_.calibration;
    return "a camera of " + std::to_string(c.width) + "x" + std::to_string(c.height) + " px and odometry from domain " +
           std::to_string(config_.domain) + (config_.lock_step ? ", in lock-step" : "");
  }

  void feed(Vehicle<SE3>& vehicle) override {
    constexpr double patience_s = 0.005;
    const auto batch = first_ ? std::exchange(first_, std::nullopt) : reader_.next(patience_s);
    if (batch) take(*batch, vehicle);
    else note_silence(vehicle);
    if (!warned_ && reader_.counters().foreign > 0) warn_of_another_sender();
  }

 private:
  void wait_for_camera(const std::function<bool()>& stop) {
    spdlog::info("waiting for the camera of vehicle {} on DDS domain {}", vehicle_, config_.domain);
    const auto began = SteadyClock::now();
    while (!stop()) {
      if (auto batch = reader_.next(0.1)) first_ = std::move(batch);
      if (const auto camera = reader_.camera()) {
        camera_ = *camera;
        run_ = camera->run;
        if (first_ && first_->run != run_) first_.reset();
        slam_.emplace(slam_params(config_), camera_.calibration, camera_.T_body_camera);
        heard_ = SteadyClock::now();
        return;
      }
      if (seconds_since(began) >= config_.wait_s) refuse_to_wait_longer();
    }
  }

  // One row for each time that a landmark is seen: where its ray begins, and where it goes per metre of depth.
  void write_sightings(const std::filesystem::path& file) {
    std::error_code failed;
    std::filesystem::create_directories(file.parent_path(), failed);
    sightings_.open(file, std::ios::app);
    if (!sightings_) throw ConfigError(file.string() + ": cannot write; is the output folder writable?");
    slam_->on_report([this, model = CameraModel(camera_.calibration)](const ImageReport& report, const cv::Mat&) {
      std::string rows;
      const Eigen::Vector3d o = camera_.T_body_camera.translation();
      for (const TrackedFeature& feature : report.features) {
        if (!feature.converged) continue;
        const Eigen::Vector3d ray = model.ray(feature.pixel);
        const Eigen::Vector3d d = camera_.T_body_camera.rotation() * (ray / ray.z());
        append_csv_row(rows, feature.track, report.stamp_s, feature.pixel.x(), feature.pixel.y(), o.x(), o.y(), o.z(),
                       d.x(), d.y(), d.z());
      }
      sightings_ << rows << std::flush;
    });
  }

  [[noreturn]] void refuse_to_wait_longer() const {
    throw ConfigError(config_.origin + ": <camera>: vehicle " + std::to_string(vehicle_) + " has " +
                      (first_ ? "readings but no CameraCalibration" : "heard of no camera") + " on DDS domain " +
                      std::to_string(config_.domain) + " for " + std::to_string(static_cast<int>(config_.wait_s)) +
                      " s (wait_s); start what speaks for its sensors, such as convoy sim --domain-sensors " +
                      std::to_string(config_.domain) + ", or correct domain and interfaces");
  }

  void take(const dds::SensorBatch& batch, Vehicle<SE3>& vehicle) {
    if (ended_ || is_of_another_run(batch)) return;
    for (const dds::SensorReading& reading : batch.readings) {
      clock_.set(stamp_of(reading), !config_.lock_step);
      std::visit([&](const auto& r) { use(r, vehicle); }, reading);
    }
    heard_ = SteadyClock::now();
    silent_ = false;
    if (batch.last) {
      ended_ = true;
      finish(vehicle);
    }
    reader_.done(batch);
  }

  void use(const dds::OdometryReading& r, Vehicle<SE3>& vehicle) {
    vehicle.feed([&] { slam_->on_odometry(r.stamp_s, r.distance_m, r.gyro_yaw_rate_rad_s); });
  }
  void use(const dds::CameraFrame& r, Vehicle<SE3>& vehicle) {
    const cv::Mat shared(r.height, r.width, CV_8UC1, const_cast<std::uint8_t*>(r.grey.data()));
    vehicle.feed([&] { slam_->on_image(r.stamp_s, shared.clone()); });  // it may wait for its odometry
  }
  void use(const dds::GpsReading& r, Vehicle<SE3>& vehicle) {
    if (config_.gps) (void)vehicle.feed_absolute_fix(r.antenna, r.position, r.covariance);  // what is unfit is counted
  }

  /// Stamps begin anew there, and this drive is over.
  bool is_of_another_run(const dds::SensorBatch& batch) {
    if (batch.run == run_) return false;
    spdlog::error(
        "the sensors of vehicle {} have begun anew, and their time with them; start the vehicle again (or end who else "
        "speaks on DDS domain {})",
        vehicle_, config_.domain);
    ended_ = true;
    return true;
  }

  void warn_of_another_sender() {
    warned_ = true;
    spdlog::warn(
        "somebody else speaks for the sensors of vehicle {} on DDS domain {}, too: that is not used; end who does, or "
        "take another domain",
        vehicle_, config_.domain);
  }

  void note_silence(Vehicle<SE3>& vehicle) {
    const double patience_s = config_.lock_step ? 60.0 : 5.0;  // in lock-step others may hold up the sensors
    if (ended_ || silent_ || seconds_since(heard_) < patience_s) return;
    silent_ = true;
    spdlog::warn("the sensors of vehicle {} have been silent for {:.0f} s", vehicle_, patience_s);
    finish(vehicle);
  }

  // The fleet talks on, and wants the time for it.
  void finish(Vehicle<SE3>& vehicle) {
    vehicle.feed([&] { slam_->finish(); });
    clock_.set(clock_.now_s(), true);
  }

  const CameraConfig config_;
  const VehicleId vehicle_;
  dds::SensorReader reader_;
  dds::MountedCamera camera_;
  std::optional<MonocularSlam> slam_;
  SensorClock clock_;
  std::ofstream sightings_;
  std::optional<dds::SensorBatch> first_;  // what came before the calibration
  std::uint64_t run_ = 0;
  SteadyClock::time_point heard_;
  bool silent_ = false, ended_ = false, warned_ = false;
};

}  // namespace

std::unique_ptr<SensorSource<SE3>> open_camera(const VehicleConfig<SE3>& config, const SourceOptions& options) {
  auto source = std::make_unique<CameraSource>(config, options);
  if (!source->ready()) return nullptr;
  return source;
}

}  // namespace convoy::cli
