// Runs the command convoy and looks at what it leaves.
#pragma once

#include <nlohmann/json.hpp>

#include <sys/types.h>

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace convoy::testing {

struct Outcome {
  int status = -1;     ///< exit status; -1 if it was ended by a signal
  std::string output;  ///< standard output and error
};

/// `arguments` as a shell would take them, behind the path of the command.
Outcome run_convoy(const std::string& arguments);
Outcome run_shell(const std::string& command);

/// The command running by itself, in a process of its own; killed when this goes out of scope. Output goes to a file.
class Background {
 public:
  Background(const std::vector<std::string>& arguments, const std::filesystem::path& output_file);
  ~Background();
  Background(const Background&) = delete;
  Background& operator=(const Background&) = delete;
  pid_t pid() const { return pid_; }
  void send(int signal);
  /// Its exit status; -1 if a signal ended it. Waits.
  int wait();

 private:
  pid_t pid_ = -1;
  bool waited_ = false;
};

/// Waits until `condition` holds; false after half a minute.
bool eventually(const std::function<bool()>& condition);

std::string read_text(const std::filesystem::path& file);

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

/// Set 6 of MR.CLAM in the data folder; empty if it is not on this machine.
std::optional<std::filesystem::path> mrclam_folder();
/// Victoria Park in the data folder; empty if it is not on this machine.
std::optional<std::filesystem::path> victoria_park_folder();
/// 51 images of sequence 06 of KITTI's odometry benchmark; empty if they are not on this machine.
std::optional<std::filesystem::path> kitti_drive();

}  // namespace convoy::testing
