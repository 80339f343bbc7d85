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

std::filesystem::path given_profile(const std::string& name_or_file) {
  const std::filesystem::path file(name_or_file);
  if (std::filesystem::is_regular_file(file)) return file;
  if (file.has_parent_path()) throw ConfigError(name_or_file + ": no such QoS profile file");
  return qos_profile(file.has_extension() ? name_or_file : name_or_file + ".xml");
}

}  // namespace convoy::cli
