// From a source to topics and a recording, step by step.
#pragma once

#include "sensor_source.hpp"
#include "sim_options.hpp"

#include <functional>

namespace convoy::simulator {

/// Until the last step, or until `stop` says true: then it returns false. Tells of its progress on standard error and
/// of what was sensed on standard output. Throws SetUpError and DeadlineError.
[[nodiscard]] bool run(SensorSource& source, const SimOptions& options, const std::function<bool()>& stop);

}  // namespace convoy::simulator
