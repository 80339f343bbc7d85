#include "sensor_topics.hpp"

#include "local_domain.hpp"
#include "progress.hpp"
#include "sensor_samples.hpp"
#include "sim_error.hpp"

#include <convoy/idl/sensorsPubSubTypes.h>
#include <fastdds/dds/subscriber/SampleInfo.hpp>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <set>

namespace convoy::simulator {
namespace {

using eprosima::fastrtps::types::ReturnCode_t;
using Clock = std::chrono::steady_clock;

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

/// What the vehicles have answered. Answers of others, of other runs, and to steps that were not sent, change
/// nothing.
class Answers final : public edds::DataReaderListener {
 public:
  Answers(const std::vector<SourceVehicle>& vehicles, std::uint64_t run) : run_(run) {
    for (const SourceVehicle& vehicle : vehicles) of_[vehicle.vehicle] = {};
  }

  void on_data_available(edds::DataReader* reader) override {
    wire::StepDone done;
    edds::SampleInfo info;
    const std::lock_guard lock(mutex_);
    while (reader->take_next_sample(&done, &info) == ReturnCode_t::RETCODE_OK)
      if (info.valid_data) add(done);
    changed_.notify_all();
  }

  void sends(std::uint32_t step) {
    const std::lock_guard lock(mutex_);
    sent_ = step;
  }

  /// All that have said that they are there.
  std::vector<std::uint32_t> there() {
    const std::lock_guard lock(mutex_);
    std::vector<std::uint32_t> vehicles;
    for (const auto& [vehicle, said] : of_)
      if (said.there) vehicles.push_back(vehicle);
    return vehicles;
  }

  /// Those that have not answered the step (0: have not appeared) when the time is over.
  std::vector<std::uint32_t> wait(const std::vector<std::uint32_t>& vehicles, std::uint32_t step,
                                  std::chrono::steady_clock::time_point until) {
    std::vector<std::uint32_t> missing = vehicles;
    std::unique_lock lock(mutex_);
    changed_.wait_until(lock, until, [&] {
      std::erase_if(missing, [&](std::uint32_t vehicle) {
        const Said& said = of_.at(vehicle);
        return step == 0 ? said.there : said.done >= step;
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
  struct Said {
    bool there = false;
    std::uint32_t done = 0;  ///< the last step of this run
  };

  void add(const wire::StepDone& answer) {
    if (answer.vehicle() == 0) ++undecodable_;
    const auto at = of_.find(answer.vehicle());
    if (at == of_.end()) return;
    Said& said = at->second;
    if (answer.run() == 0 && answer.step() == 0) said.there = true;
    if (answer.run() == run_ && answer.step() <= sent_) said.done = std::max(said.done, answer.step());
  }

  const std::uint64_t run_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::map<std::uint32_t, Said> of_;
  std::uint32_t sent_ = 0;
  std::uint64_t undecodable_ = 0;
};

/// Those that write steps: this one, too, once it does.
class StepWriters final : public edds::DataReaderListener {
 public:
  void on_subscription_matched(edds::DataReader*, const edds::SubscriptionMatchedStatus& status) override {
    const auto writer = eprosima::fastrtps::rtps::iHandle2GUID(status.last_publication_handle);
    const std::lock_guard lock(mutex_);
    if (status.current_count_change > 0) writers_.insert(writer);
    else writers_.erase(writer);
    changed_.notify_all();
  }

  /// What they say does not matter; kept, it would fill the memory.
  void on_data_available(edds::DataReader* reader) override {
    wire::Step step;
    edds::SampleInfo info;
    while (reader->take_next_sample(&step, &info) == ReturnCode_t::RETCODE_OK) {
    }
  }

  /// Whether there is one, within the time, that `own` gives way to; without an own one, to any.
  bool there(std::chrono::milliseconds time, const std::optional<eprosima::fastrtps::rtps::GUID_t>& own) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, time, [&] { return !writers_.empty() && (!own || *writers_.begin() < *own); });
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::set<eprosima::fastrtps::rtps::GUID_t> writers_;
};

/// In lock-step: a subscriber has not taken what was sent, whoever it is.
struct NotTaken {
  std::string topic;
};

/// Told to end while it waited for that.
struct Stopped {};

VehicleStep without_readings(std::uint32_t vehicle) {
  VehicleStep step;
  step.vehicle = vehicle;
  return step;
}

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
  Impl(const TopicOptions& topic_options, const std::vector<SourceVehicle>& vehicles, std::uint64_t run_number)
      : options(topic_options),
        run(run_number),
        answers(vehicles, run),
        sensors(options.sensor_domain, "convoy simulator: sensors"),
        truths(options.truth_domain, "convoy simulator: truth") {
    sensors.reader(edds::TypeSupport(new Guarded<wire::StepPubSubType>), "convoy/sensors/v1/Step", &step_writers);
    claim_domain();
    calibration = writer<wire::CameraCalibrationPubSubType>(sensors, "CameraCalibration", 1);
    frames = writer<wire::CameraFramePubSubType>(sensors, "CameraFrame", 4);
    odometry = writer<wire::OdometryPubSubType>(sensors, "Odometry", 400);
    gps = writer<wire::GpsPubSubType>(sensors, "Gps", 400);
    truth = writer<wire::TruthPubSubType>(truths, "Truth", 400);
    if (options.depth) depth = writer<wire::TruthDepthPubSubType>(truths, "TruthDepth", 2);
    sensors.reader(edds::TypeSupport(new Guarded<wire::StepDonePubSubType>), "convoy/sensors/v1/StepDone", &answers);
  }

  /// Who writes steps has the domain, and need not look again: who comes later finds that writer, and makes none. Of
  /// two that began at once neither has found one, so both have made theirs: one of them gives way.
  void claim_domain() {
    const auto taken = [&] {
      return SetUpError("another simulator speaks on domain " + std::to_string(options.sensor_domain) +
                        "; end it, or take another domain by --domain-sensors");
    };
    if (step_writers.there(std::chrono::milliseconds(1000), {})) throw taken();
    steps = writer<wire::StepPubSubType>(sensors, "Step", 400);
    if (step_writers.there(std::chrono::milliseconds(500), steps->guid())) throw taken();
  }

  template <class PubSubType>
  edds::DataWriter* writer(LocalDomain& domain, const std::string& type, int samples) {
    const LocalDomain::Keeping keeping{samples, options.lock_step, 0.1};
    return domain.writer(edds::TypeSupport(new PubSubType), "convoy/sensors/v1/" + type, keeping);
  }

  /// In lock-step it waits for who does not take, and throws NotTaken in the end, or Stopped.
  template <class Sample>
  void write(edds::DataWriter* to, Sample sample) {
    const auto until = deadline();
    LongWait wait;
    while (!to->write(&sample)) {
      const std::string topic = to->get_topic()->get_name();
      if (options.lock_step && Clock::now() < until) {
        if (told_to_stop && told_to_stop()) throw Stopped{};
        wait.tell("waiting for a subscriber of " + topic + " to take what was sent",
                  " of " + text_of(options.deadline_s) + "; Ctrl-C ends the run");
        continue;
      }
      ++unsent;
      if (!options.lock_step) return;
      throw NotTaken{topic};
    }
  }
  Clock::time_point deadline() const {
    return Clock::now() +
           std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(options.deadline_s));
  }

  void publish(const StepData& step) {
    answers.sends(step.step);
    std::size_t i = 0;
    try {
      for (; i < step.vehicles.size(); ++i) publish(step, step.vehicles[i]);
    } catch (const NotTaken& not_taken) {
      find_who_is_missing(step, i, not_taken.topic);
    }
  }

  void publish(const StepData& step, const VehicleStep& of_vehicle) {
    const std::uint32_t vehicle = of_vehicle.vehicle;
    sent = step_sample(run, step, without_readings(vehicle));
    write(truth, truth_sample(run, step, of_vehicle));
    for (const FrameData& frame : of_vehicle.frames) {
      if (depth != nullptr) write(depth, depth_sample(run, step.step, vehicle, frame));
      write(frames, frame_sample(run, step.step, vehicle, frame));
      sent.frames(sent.frames() + 1);
    }
    for (const OdometryData& data : of_vehicle.odometry) {
      write(odometry, odometry_sample(run, step.step, vehicle, data));
      sent.odometry(sent.odometry() + 1);
    }
    for (const GpsData& data : of_vehicle.gps) {
      write(gps, gps_sample(run, step.step, vehicle, data));
      sent.gps(sent.gps() + 1);
    }
    write(steps, sent);
  }

  /// The middleware does not say who has not taken what was sent. But a vehicle that is alive answers a step, be it
  /// in part: that of the vehicle `unsent_from`, and those after it, have not been sent.
  [[noreturn]] void find_who_is_missing(const StepData& step, std::size_t unsent_from, const std::string& topic) {
    for (std::size_t i = unsent_from; i < step.vehicles.size(); ++i) {
      if (i > unsent_from) sent = step_sample(run, step, without_readings(step.vehicles[i].vehicle));
      if (!steps->write(&sent)) break;
    }
    if (!wait_for(answers.there(), step.step, told_to_stop)) throw Stopped{};
    throw DeadlineError("a subscriber of " + topic +
                        ", which is none of the vehicles, has not taken what was sent for " +
                        text_of(options.deadline_s) + "; end it, and start the run again");
  }

  bool wait_for(const std::vector<std::uint32_t>& vehicles, std::uint32_t step, const std::function<bool()>& stop) {
    const auto until = deadline();
    LongWait wait;
    for (;;) {
      const auto now = Clock::now();
      const auto missing = answers.wait(vehicles, step, std::min(until, now + std::chrono::milliseconds(100)));
      if (missing.empty()) return true;
      if (stop()) return false;
      if (now >= until) throw DeadlineError(fault_of(missing, step));
      wait.tell("waiting for " + listed(missing) + " to " +
                    (step == 0 ? "appear on domain " + std::to_string(options.sensor_domain)
                               : "answer step " + std::to_string(step)),
                " of " + text_of(options.deadline_s) + "; Ctrl-C ends the run");
    }
  }

  std::string fault_of(const std::vector<std::uint32_t>& missing, std::uint32_t step) const {
    const std::string within = " within " + text_of(options.deadline_s) + "; ";
    if (step == 0)
      return listed(missing) + " did not appear on domain " + std::to_string(options.sensor_domain) + within +
             "start it there, or wait for fewer by --wait-for";
    return listed(missing) + " did not answer step " + std::to_string(step) + within +
           "see how it ended, and start the run again; one that is only slow needs a longer --deadline";
  }

  const TopicOptions options;
  const std::uint64_t run;
  std::uint64_t unsent = 0;
  std::function<bool()> told_to_stop;  // of publish(); before that nothing waits
  wire::Step sent;                     // of the step and vehicle that are being sent: what of it has been
  StepWriters step_writers;            // before the domains, so that they outlive them
  Answers answers;
  LocalDomain sensors, truths;
  edds::DataWriter *steps = nullptr, *calibration = nullptr, *frames = nullptr, *odometry = nullptr, *gps = nullptr,
                   *truth = nullptr, *depth = nullptr;
};

SensorTopics::SensorTopics(const TopicOptions& options, const std::vector<SourceVehicle>& vehicles, std::uint64_t run)
    : impl_(std::make_unique<Impl>(options, vehicles, run)) {
  for (const SourceVehicle& vehicle : vehicles)
    impl_->write(impl_->calibration, calibration_sample(run, vehicle.vehicle, vehicle.camera));
}

SensorTopics::~SensorTopics() = default;

bool SensorTopics::publish(const StepData& step, const std::function<bool()>& stop) {
  impl_->told_to_stop = stop;
  try {
    impl_->publish(step);
  } catch (const Stopped&) {
    return false;
  }
  return true;
}

bool SensorTopics::wait_for(const std::vector<std::uint32_t>& vehicles, std::uint32_t step,
                            const std::function<bool()>& stop) {
  return impl_->wait_for(vehicles, step, stop);
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
