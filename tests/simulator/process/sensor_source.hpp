// Where steps come from: the world, or a recording of it.
#pragma once

#include "sensor_data.hpp"

#include <string>
#include <vector>

namespace convoy::simulator {

struct SourceVehicle {
  std::uint32_t vehicle = 0;
  CameraData camera;
};

class SensorSource {
 public:
  virtual ~SensorSource() = default;
  virtual const std::vector<SourceVehicle>& vehicles() const = 0;  ///< by number
  /// The next step. Not to be called after the last one. Throws std::runtime_error for what cannot be read.
  virtual StepData next() = 0;
  virtual double duration_s() const = 0;        ///< about; for whoever waits
  virtual double step_s() const = 0;            ///< simulated time of one step
  virtual std::string attribution() const = 0;  ///< whose map it is; empty where nobody needs to be named
};

}  // namespace convoy::simulator
