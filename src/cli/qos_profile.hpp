// Where the QoS profiles are that come with the command.
#pragma once

#include <filesystem>
#include <string>

namespace convoy::cli {

/// "lan.xml", ...: installed beside the program, or in the checkout it was built from. Throws ConfigError.
std::filesystem::path qos_profile(const std::string& name);

}  // namespace convoy::cli
