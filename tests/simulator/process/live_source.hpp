// A world with vehicles that drive in it.
#pragma once

#include "sensor_source.hpp"
#include "sim_options.hpp"

#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace convoy::simulator {

struct RouteNote {
  std::string name;
  double length_m = 0.0;
  bool closed = false;
};

struct WorldNote {
  std::string attribution;
  std::vector<RouteNote> routes;
};

/// Of the world that is asked for, which is not built for it; says on standard error what is left out of a map. Throws
/// SetUpError.
WorldNote describe_world(const SimOptions& options);

class LiveSource final : public SensorSource {
 public:
  /// Builds the world, and says so on standard error. Throws SetUpError for what is wrong with it or with the options.
  explicit LiveSource(const SimOptions& options);
  ~LiveSource() override;
  const std::vector<SourceVehicle>& vehicles() const override;
  StepData next() override;
  double duration_s() const override;
  double step_s() const override;
  std::string attribution() const override;

  /// Drives to the end of the duration or distance (neither asked for: one step) and tells what vehicle 1 sees there.
  /// Not to be asked of cameras that drop frames. Tells each step's time.
  FrameData snapshot(const std::function<void(double time_s)>& tell);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace convoy::simulator
