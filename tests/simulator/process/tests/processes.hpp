// Processes for the tests: started, waited for with a deadline, and killed when they go out of scope.
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <string>
#include <vector>

namespace convoy::simulator::testing {

/// An empty folder of its own, removed with all it holds when it goes out of scope.
class ScratchFolder {
 public:
  ScratchFolder();
  ~ScratchFolder();
  ScratchFolder(const ScratchFolder&) = delete;
  ScratchFolder& operator=(const ScratchFolder&) = delete;
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

class Process {
 public:
  /// Its output, standard error too, goes to the file.
  Process(const std::vector<std::string>& command, std::filesystem::path output);
  ~Process();
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;
  /// Its exit status; -signal if it was ended by one, -1000 if it still runs after the deadline.
  int wait(double deadline_s = 30.0);
  void send(int signal) const;
  /// Local addresses of its UDP sockets, as /proc/net/udp writes them (127.0.0.1 is 0100007F).
  std::vector<std::string> udp_addresses() const;
  std::string output() const;

 private:
  pid_t pid_ = -1;
  bool ended_ = false;
  std::filesystem::path output_;
};

struct Outcome {
  int status = -1;
  std::string output;
};

/// A world that is quickly built, as options of convoy-sim.
inline const std::string block = " --drop 0 --camera 64x48 --world " CONVOY_SIM_TEST_MAP;

/// convoy-sim with the words of `arguments`, to its end.
Outcome run_sim(const std::string& arguments);
/// It can write no file beyond so many bytes: as if the disk were full there.
Outcome run_sim_on_full_disk(int bytes, const std::string& arguments);
std::vector<std::string> sim_command(const std::string& arguments);
std::vector<std::string> vehicle_command(const std::string& arguments);

std::string read_text(const std::filesystem::path& file);
void write_text(const std::filesystem::path& file, const std::string& text);
std::vector<std::string> lines_of(const std::string& text);

/// Two domains for the running test: of sensors, and the next one of truth.
std::uint32_t domain_of_this_test();
std::string domains_of_this_test();  ///< as options of convoy-sim

}  // namespace convoy::simulator::testing
