// Vehicles in processes of their own (chaos_vehicle.cpp), and what they say of themselves.
#pragma once

#include "../dds/dds_testing.hpp"

#include <filesystem>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace convoy::chaos {

using FactId = std::pair<FactKind, Key>;
using Facts = std::map<FactId, Hash>;

/// In the order in which the vehicle prints it.
struct Status {
  Epoch epoch = 0;
  Hash holdings = 0, digest = 0;
  std::uint64_t known = 0, missing = 0, lost = 0;
  std::uint64_t refused = 0;  ///< 1: another process claims its id
  std::uint64_t conflicts = 0, unfit = 0, disagreements = 0;
  std::uint64_t requests = 0, relayed = 0, reopened = 0, dropped = 0;
  std::uint64_t restored = 0, cut_bytes = 0, failed_writes = 0, waiting = 0;  ///< of its journal
  std::uint64_t quarantines = 0;                                              ///< of peers that flood
};

/// What one vehicle needs to run. Its files are below `folder`; several runs may follow each other.
struct Garage {
  std::filesystem::path folder;
  std::string profile;
  std::uint32_t domain = 0;
  VehicleId id = 0;
  std::filesystem::path state() const { return folder / ("state_" + std::to_string(id)); }
  std::filesystem::path journal() const { return state() / "facts.journal"; }
  std::filesystem::path stated() const { return folder / ("stated_" + std::to_string(id)); }
};

/// An empty folder for the running test, in the temporary folder. It goes with this object.
class TestFolder {
 public:
  TestFolder();
  ~TestFolder();
  TestFolder(const TestFolder&) = delete;
  TestFolder& operator=(const TestFolder&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// One run of a vehicle. All throw std::runtime_error, with the vehicle's name, if it does not answer.
class Life {
 public:
  explicit Life(const Garage& garage, const std::vector<std::string>& options = {});
  Epoch epoch() const { return epoch_; }
  int pid() const { return child_.pid(); }
  void kill_hard() { child_.kill_hard(); }
  /// Tells it to, and does not wait for the answer.
  void begin_segment() { child_.tell("segment"); }
  std::uint64_t segment();
  Status status();
  Facts facts();
  /// How far its clock is ahead of that of a vehicle; 0 while it does not know.
  double ahead_of(VehicleId vehicle);
  void change(const std::string& command) { (void)ask(command, "done"); }

 private:
  std::string ask(const std::string& command, const std::string& expected);
  std::string hear(const std::string& expected);
  std::string name_;
  std::filesystem::path dump_;
  dds::testing::Child child_;
  Epoch epoch_ = 0;
};

/// Of a file that a vehicle has written; a last line that is not whole does not count.
Facts read_facts(const std::filesystem::path& file);

/// Takes `bytes` off the end. False if there are not so many.
bool tear(const std::filesystem::path& file, std::uintmax_t bytes);

}  // namespace convoy::chaos
