// A child process with its standard input and output in pipes and its standard error in a file.
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace convoy::cli {

class ChildProcess {
 public:
  /// Throws ConfigError if it cannot be started. It is told to end (SIGTERM) if this process dies.
  ChildProcess(const std::vector<std::string>& command, const std::filesystem::path& error_file);
  ~ChildProcess();  ///< kills it if it still runs
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  pid_t pid() const { return pid_; }
  /// Writes a line to its standard input. False if it does not read any more.
  bool say(const std::string& line);
  /// Complete lines that have come in; does not block.
  std::vector<std::string> lines();
  /// How it ended ("exit status 2", "signal 9"); empty while it runs.
  const std::optional<std::string>& ended();
  bool succeeded() const { return succeeded_; }
  void terminate();  ///< SIGTERM
  void kill_hard();  ///< SIGKILL
  /// It reads the end of its input.
  void end_input();
  /// True once it has ended; waits for at most `timeout_s`.
  bool wait(double timeout_s);

 private:
  pid_t pid_ = -1;
  int pipe_ = -1;
  int input_ = -1;
  std::string partial_;
  std::optional<std::string> ended_;
  bool succeeded_ = false;
};

/// Path of the running program.
std::filesystem::path this_program();

}  // namespace convoy::cli
