// The topics of idl/sensors.idl, on 127.0.0.1 and nowhere else.
#pragma once

#include "sensor_data.hpp"
#include "sensor_source.hpp"

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

namespace convoy::simulator {

struct TopicOptions {
  std::uint32_t sensor_domain = 10, truth_domain = 11;  ///< 0..232, not the same
  bool lock_step = false;  ///< nothing is lost: who does not take holds up the simulator, until the deadline
  double deadline_s = 30.0;
  bool depth = false;
};

class SensorTopics {
 public:
  /// Listens for another simulator on the domain for 1.5 s, then publishes the calibrations. `run` is a number unlike
  /// that of the run before. Throws SetUpError if there is one: of two, the one that began first goes on.
  SensorTopics(const TopicOptions& options, const std::vector<SourceVehicle>& vehicles, std::uint64_t run);
  ~SensorTopics();
  SensorTopics(const SensorTopics&) = delete;
  SensorTopics& operator=(const SensorTopics&) = delete;

  /// Throws DeadlineError in lock-step if a subscriber does not take what is sent. Returns false if `stop` says true
  /// while it waits for one.
  [[nodiscard]] bool publish(const StepData& step, const std::function<bool()>& stop);

  /// Waits until each of the vehicles has said that it is done with the step; 0: that it is there. Throws DeadlineError
  /// that names those that have not. Returns false if `stop` says true meanwhile.
  [[nodiscard]] bool wait_for(const std::vector<std::uint32_t>& vehicles, std::uint32_t step,
                              const std::function<bool()>& stop);

  /// Waits for subscribers to have what was sent, within the deadline.
  void finish(double deadline_s);

  std::uint64_t unsent() const;       ///< samples that the middleware did not take; not in lock-step
  std::uint64_t undecodable() const;  ///< answers that were none

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace convoy::simulator
