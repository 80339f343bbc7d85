// `convoy vehicle CONFIG.xml`: one vehicle, one process.
#pragma once

#include <convoy/components/vehicle_config.hpp>

namespace convoy::cli {

/// Runs the vehicle until SIGTERM or SIGINT, or until its sensors end if `until_end`. Prints one JSON status line per
/// `status_period_s` of wall time on standard output. Returns the exit status. Throws ConfigError.
int run_vehicle(const VehicleConfig& config, bool until_end, double status_period_s);

}  // namespace convoy::cli
