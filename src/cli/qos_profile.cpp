#include "qos_profile.hpp"

#include <convoy/config_error.hpp>

#include "child_process.hpp"

namespace convoy::cli {

std::filesystem::path qos_profile(const std::string& name) {
  for (const std::filesystem::path& folder :
       {this_program().parent_path() / "../share/convoy/qos_profiles", std::filesystem::path(CONVOY_PROFILE_DIR)})
    if (std::filesystem::exists(folder / name)) return folder / name;
  throw ConfigError("the QoS profile " + name + " is neither installed beside the program nor in its checkout");
}

}  // namespace convoy::cli
