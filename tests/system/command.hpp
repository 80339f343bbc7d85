// Runs the command convoy and looks at what it leaves.
#pragma once

#include <nlohmann/json.hpp>

#include <filesystem>
#include <optional>
#include <string>

namespace convoy::testing {

struct Outcome {
  int status = -1;     ///< exit status; -1 if it was ended by a signal
  std::string output;  ///< standard output and error
};

/// `arguments` as a shell would take them, behind the path of the command.
Outcome run_convoy(const std::string& arguments);
Outcome run_shell(const std::string& command);

/// An empty folder of its own, removed with all it holds when it goes out of scope.
class ScratchFolder {
 public:
  ScratchFolder();
  ~ScratchFolder();
  const std::filesystem::path& path() const { return path_; }
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

nlohmann::json read_json(const std::filesystem::path& file);

/// The folder of the recorded data sets: CONVOY_DATA_DIR, else ../shared/data beside the source tree; empty if absent.
std::optional<std::filesystem::path> data_folder();

}  // namespace convoy::testing
