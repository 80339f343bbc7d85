#include "run.hpp"

#include "digest.hpp"
#include "progress.hpp"
#include "recording.hpp"
#include "sensor_topics.hpp"
#include "sim_error.hpp"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <memory>
#include <thread>

namespace convoy::simulator {
namespace {

using Clock = std::chrono::steady_clock;

/// Of what one vehicle has sensed.
struct Sum {
  std::size_t frames = 0, odometry = 0, gps = 0;
  Digest digest;
};

class Run {
 public:
  Run(SensorSource& source, const SimOptions& options, const std::function<bool()>& stop)
      : source_(source), options_(options), stop_(stop), sums_(source.vehicles().size()) {
    TopicOptions topics;
    topics.sensor_domain = options.sensor_domain;
    topics.truth_domain = options.truth_domain;
    topics.lock_step = options.lock_step;
    topics.deadline_s = options.deadline_s;
    topics.depth = options.depth;
    find_expected();
    topics_ = std::make_unique<SensorTopics>(topics, source.vehicles(), options.run.value_or(number_of_run()));
    if (!options.record.empty())
      recorder_ = std::make_unique<Recorder>(
          options.record,
          RunNote{options.world, source.attribution(), options.seed, options.command_line, source.step_s()},
          source.vehicles());
  }

  /// False: stopped before the end.
  bool drive() {
    try {
      const bool complete = waited_for_vehicles() && send_all();
      if (recorder_) recorder_->end(complete);
      if (!complete) std::fprintf(stderr, "convoy sim: stopped at step %u\n", sent_);
      topics_->finish(std::min(options_.deadline_s, 2.0));
      return complete;
    } catch (const DeadlineError&) {
      if (recorder_) recorder_->end(false);
      throw;
    } catch (const SetUpError&) {
      std::fprintf(stderr, "convoy sim: step %u was the last\n", sent_);
      throw;
    }
  }

  void tell() const {
    for (std::size_t i = 0; i < sums_.size(); ++i)
      std::printf("vehicle %u: %zu frames, %zu odometry readings, %zu positions; digest %s\n",
                  source_.vehicles()[i].vehicle, sums_[i].frames, sums_[i].odometry, sums_[i].gps,
                  sums_[i].digest.text().c_str());
    if (topics_->unsent() > 0)
      std::fprintf(stderr, "convoy sim: %llu samples could not be sent\n",
                   static_cast<unsigned long long>(topics_->unsent()));
    if (topics_->undecodable() > 0)
      std::fprintf(stderr, "convoy sim: %llu answers could not be read\n",
                   static_cast<unsigned long long>(topics_->undecodable()));
  }

 private:
  // Of no meaning but to be another one than that of the last run. Not part of what is sensed.
  static std::uint64_t number_of_run() {
    return static_cast<std::uint64_t>(std::chrono::system_clock::now().time_since_epoch().count());
  }

  void find_expected() {
    const auto all = static_cast<int>(source_.vehicles().size());
    const int count = options_.wait_for.value_or(options_.lock_step ? all : 0);
    if (count > all)
      throw SetUpError("--wait-for " + std::to_string(count) + ": there are only " + std::to_string(all) + " vehicles");
    for (int i = 0; i < count; ++i) expected_.push_back(source_.vehicles()[static_cast<std::size_t>(i)].vehicle);
  }

  bool waited_for_vehicles() {
    if (expected_.empty()) return true;
    std::fprintf(stderr, "convoy sim: waiting for %zu vehicle%s on domain %u\n", expected_.size(),
                 expected_.size() == 1 ? "" : "s", options_.sensor_domain);
    return topics_->wait_for(expected_, 0, stop_);
  }

  bool send_all() {
    Progress progress(source_.duration_s());
    start_ = Clock::now();
    for (StepData step = source_.next(); pace(step) && !stop_();) {
      if (!send(step)) return false;
      progress.tell(step.time_s);
      const bool last = step.last;
      // While the vehicles are at this step, the next one is made: it does not depend on them.
      if (!last) step = source_.next();
      if (options_.lock_step && !topics_->wait_for(expected_, sent_, stop_)) return false;
      if (last) return true;
    }
    return false;
  }

  /// Waits until it is time for the step; false: told to stop.
  bool pace(const StepData& step) const {
    if (options_.lock_step) return true;
    const auto due = start_ + std::chrono::duration_cast<Clock::duration>(
                                  std::chrono::duration<double>(step.time_s / options_.rate));
    while (Clock::now() < due) {
      if (stop_()) return false;
      std::this_thread::sleep_until(std::min(due, Clock::now() + std::chrono::milliseconds(100)));
    }
    return true;
  }

  /// False: told to stop.
  bool send(const StepData& step) {
    if (recorder_) recorder_->write(step);
    if (!topics_->publish(step, stop_)) return false;
    sent_ = step.step;
    for (std::size_t i = 0; i < sums_.size(); ++i) {
      const VehicleStep& sensed = step.vehicles[i];
      sums_[i].frames += sensed.frames.size();
      sums_[i].odometry += sensed.odometry.size();
      sums_[i].gps += sensed.gps.size();
      sums_[i].digest.add(sensed);
    }
    return true;
  }

  SensorSource& source_;
  const SimOptions& options_;
  const std::function<bool()>& stop_;
  std::vector<std::uint32_t> expected_;
  std::vector<Sum> sums_;
  std::unique_ptr<Recorder> recorder_;
  std::unique_ptr<SensorTopics> topics_;
  Clock::time_point start_;
  std::uint32_t sent_ = 0;
};

}  // namespace

bool run(SensorSource& source, const SimOptions& options, const std::function<bool()>& stop) {
  Run run(source, options, stop);
  const bool complete = run.drive();
  run.tell();
  return complete;
}

}  // namespace convoy::simulator
