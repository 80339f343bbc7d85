// Where the QoS profiles are that come with the command.
#pragma once

#include <filesystem>
#include <string>

namespace convoy::cli {

/// "lan.xml", ...: installed beside the program, or in the checkout it was built from. Throws ConfigError.
std::filesystem::path qos_profile(const std::string& name);

/// A file of the user's own, or one of those above, with or without ".xml". Throws ConfigError.
std::filesystem::path given_profile(const std::string& name_or_file);

}  // namespace convoy::cli
