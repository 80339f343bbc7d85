// convoy replay of a fleet: all vehicles of a scenario in one thread and on one clock, that of the recording, with a
// network that loses nothing. They leave what vehicles leave (vehicle_output.hpp), and what their front ends did.
#pragma once

#include <filesystem>

#include "scenario/scenario.hpp"

namespace convoy::cli {

/// Drives it, writes the run folder `out`, and judges it. True if all vehicles came to hold the same map. Throws
/// ConfigError.
bool replay_fleet(const Scenario<SE2>& scenario, const std::filesystem::path& out);

}  // namespace convoy::cli
