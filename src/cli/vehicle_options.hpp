// The command line of `convoy vehicle`, which two programs read: see other_program.hpp.
#pragma once

#include <CLI/CLI.hpp>

#include <string>

#include "vehicle_process.hpp"

namespace convoy::cli {

/// What --impair takes.
std::string impairment_help();

/// `config` and `options` must outlive `command`.
void add_vehicle_options(CLI::App& command, std::string& config, VehicleRunOptions& options);

}  // namespace convoy::cli
