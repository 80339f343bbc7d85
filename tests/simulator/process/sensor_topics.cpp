#include "sensor_topics.hpp"

#include "local_domain.hpp"
#include "sensor_samples.hpp"
#include "sim_error.hpp"

#include <convoy/idl/sensorsPubSubTypes.h>
#include <fastdds/dds/subscriber/SampleInfo.hpp>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <map>
#include <mutex>

namespace convoy::simulator {
namespace {

using eprosima::fastrtps::types::ReturnCode_t;

/// An exception of the generated code would end the process, and a `false` hide the samples behind: what cannot be read
/// becomes a sample of vehicle 0.
template <class PubSubType>
class Guarded final : public PubSubType {
 public:
  bool deserialize(eprosima::fastrtps::rtps::SerializedPayload_t* payload, void* data) override {
    try {
      if (PubSubType::deserialize(payload, data)) return true;
    } catch (...) {
    }
    *static_cast<typename PubSubType::type*>(data) = {};
    return true;
  }
};

/// What the vehicles have said last.
class Answers final : public edds::DataReaderListener {
 public:
  void on_data_available(edds::DataReader* reader) override {
    wire::StepDone done;
    edds::SampleInfo info;
    const std::lock_guard lock(mutex_);
    while (reader->take_next_sample(&done, &info) == ReturnCode_t::RETCODE_OK) {
      if (!info.valid_data) continue;
      if (done.vehicle() == 0) ++undecodable_;
      else last_[done.vehicle()] = {done.run(), done.step()};
    }
    changed_.notify_all();
  }

  /// Those that have not said it when the time is over.
  std::vector<std::uint32_t> wait(const std::vector<std::uint32_t>& vehicles, std::uint64_t run, std::uint32_t step,
                                  std::chrono::steady_clock::time_point until) {
    std::vector<std::uint32_t> missing = vehicles;
    std::unique_lock lock(mutex_);
    changed_.wait_until(lock, until, [&] {
      std::erase_if(missing, [&](std::uint32_t vehicle) {
        const auto at = last_.find(vehicle);
        return at != last_.end() && at->second == std::pair{run, step};
      });
      return missing.empty();
    });
    return missing;
  }

  std::uint64_t undecodable() {
    const std::lock_guard lock(mutex_);
    return undecodable_;
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::map<std::uint32_t, std::pair<std::uint64_t, std::uint32_t>> last_;
  std::uint64_t undecodable_ = 0;
};

std::string text_of(double seconds) {
  char text[32];
  std::snprintf(text, sizeof text, "%g s", seconds);
  return text;
}

std::string listed(const std::vector<std::uint32_t>& vehicles) {
  std::string text = vehicles.size() == 1 ? "vehicle " : "vehicles ";
  for (std::size_t i = 0; i < vehicles.size(); ++i) text += (i > 0 ? ", " : "") + std::to_string(vehicles[i]);
  return text;
}

}  // namespace

struct SensorTopics::Impl {
  Impl(const TopicOptions& topic_options, std::uint64_t run_number)
      : options(topic_options),
        run(run_number),
        sensors(options.sensor_domain, "convoy simulator: sensors"),
        truths(options.truth_domain, "convoy simulator: truth") {}

  template <class PubSubType>
  edds::DataWriter* writer(LocalDomain& domain, const std::string& type, int samples) {
    const LocalDomain::Keeping keeping{samples, options.lock_step, options.lock_step ? options.deadline_s : 0.1};
    return domain.writer(edds::TypeSupport(new PubSubType), "convoy/sensors/v1/" + type, keeping);
  }

  template <class Sample>
  void write(edds::DataWriter* to, Sample sample) {
    if (to->write(&sample)) return;
    ++unsent;
    if (options.lock_step)
      throw DeadlineError("a subscriber of " + to->get_topic()->get_name() + " has not taken what was sent for " +
                          text_of(options.deadline_s));
  }

  /// Of two that send the same vehicles, the later gives up.
  void expect_no_other(std::uint32_t step) const {
    edds::SubscriptionMatchedStatus status;
    others->get_subscription_matched_status(status);
    if (step <= 3 && status.current_count > 1)
      throw SetUpError("another simulator speaks on domain " + std::to_string(options.sensor_domain) +
                       "; end it, or take another domain by --domain-sensors");
  }

  const TopicOptions options;
  const std::uint64_t run;
  std::uint64_t unsent = 0;
  Answers answers;  // before the domains, so that it outlives them
  LocalDomain sensors, truths;
  edds::DataWriter* calibration = writer<wire::CameraCalibrationPubSubType>(sensors, "CameraCalibration", 1);
  edds::DataWriter* frames = writer<wire::CameraFramePubSubType>(sensors, "CameraFrame", 4);
  edds::DataWriter* odometry = writer<wire::OdometryPubSubType>(sensors, "Odometry", 400);
  edds::DataWriter* gps = writer<wire::GpsPubSubType>(sensors, "Gps", 400);
  edds::DataWriter* steps = writer<wire::StepPubSubType>(sensors, "Step", 400);
  edds::DataWriter* truth = writer<wire::TruthPubSubType>(truths, "Truth", 400);
  edds::DataWriter* depth = options.depth ? writer<wire::TruthDepthPubSubType>(truths, "TruthDepth", 2) : nullptr;
  edds::DataReader* others =  // is matched with every writer of steps, this one's too
      sensors.reader(edds::TypeSupport(new Guarded<wire::StepPubSubType>), "convoy/sensors/v1/Step", nullptr);
  edds::DataReader* done =
      sensors.reader(edds::TypeSupport(new Guarded<wire::StepDonePubSubType>), "convoy/sensors/v1/StepDone", &answers);
};

SensorTopics::SensorTopics(const TopicOptions& options, const std::vector<SourceVehicle>& vehicles, std::uint64_t run)
    : impl_(std::make_unique<Impl>(options, run)) {
  for (const SourceVehicle& vehicle : vehicles)
    impl_->write(impl_->calibration, calibration_sample(run, vehicle.vehicle, vehicle.camera));
}

SensorTopics::~SensorTopics() = default;

void SensorTopics::publish(const StepData& step) {
  const std::uint64_t run = impl_->run;
  impl_->expect_no_other(step.step);
  for (const VehicleStep& of_vehicle : step.vehicles) {
    const std::uint32_t vehicle = of_vehicle.vehicle;
    impl_->write(impl_->truth, truth_sample(run, step, of_vehicle));
    for (const FrameData& frame : of_vehicle.frames) {
      impl_->write(impl_->frames, frame_sample(run, step.step, vehicle, frame));
      if (impl_->depth != nullptr) impl_->write(impl_->depth, depth_sample(run, step.step, vehicle, frame));
    }
    for (const OdometryData& data : of_vehicle.odometry)
      impl_->write(impl_->odometry, odometry_sample(run, step.step, vehicle, data));
    for (const GpsData& data : of_vehicle.gps) impl_->write(impl_->gps, gps_sample(run, step.step, vehicle, data));
    impl_->write(impl_->steps, step_sample(run, step, of_vehicle));
  }
}

bool SensorTopics::wait_for(const std::vector<std::uint32_t>& vehicles, std::uint32_t step,
                            const std::function<bool()>& stop) {
  using Clock = std::chrono::steady_clock;
  const auto deadline = Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                           std::chrono::duration<double>(impl_->options.deadline_s));
  for (;;) {
    const auto now = Clock::now();
    const auto missing = impl_->answers.wait(vehicles, step == 0 ? 0 : impl_->run, step,
                                             std::min(deadline, now + std::chrono::milliseconds(100)));
    if (missing.empty()) return true;
    if (stop()) return false;
    if (now < deadline) continue;
    const std::string seconds = text_of(impl_->options.deadline_s);
    throw DeadlineError(step == 0
                            ? listed(missing) + " did not appear on domain " +
                                  std::to_string(impl_->options.sensor_domain) + " within " + seconds
                            : listed(missing) + " did not answer step " + std::to_string(step) + " within " + seconds);
  }
}

void SensorTopics::finish(double deadline_s) {
  const auto seconds = static_cast<std::int32_t>(deadline_s);
  const eprosima::fastrtps::Duration_t wait{
      seconds, static_cast<std::uint32_t>((deadline_s - static_cast<double>(seconds)) * 1e9)};
  for (edds::DataWriter* writer : {impl_->frames, impl_->odometry, impl_->gps, impl_->steps, impl_->truth})
    writer->wait_for_acknowledgments(wait);
}

std::uint64_t SensorTopics::unsent() const { return impl_->unsent; }
std::uint64_t SensorTopics::undecodable() const { return impl_->answers.undecodable(); }

}  // namespace convoy::simulator
