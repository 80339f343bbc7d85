#include "chaos_testing.hpp"

#include <gtest/gtest.h>
#include <net/if.h>
#include <sched.h>
#include <signal.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstring>
#include <fstream>
#include <iostream>
#include <sstream>
#include <stdexcept>

namespace convoy::chaos {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> command(const Garage& garage, const std::vector<std::string>& options) {
  std::vector<std::string> words{CONVOY_CHAOS_VEHICLE,      garage.profile,          std::to_string(garage.domain),
                                 std::to_string(garage.id), garage.state().string(), garage.stated().string()};
  words.insert(words.end(), options.begin(), options.end());
  return words;
}

bool raise_loopback() {
  const int control = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  ifreq request{};
  std::strcpy(request.ifr_name, "lo");
  request.ifr_flags = IFF_UP;
  const bool up = control >= 0 && ioctl(control, SIOCSIFFLAGS, &request) == 0;
  if (control >= 0) close(control);
  return up;
}

/// So that fleets of two checkouts, which have the same domains and vehicles, do not meet. Only root can have it.
class NetworkOfItsOwn : public testing::Environment {
 public:
  void SetUp() override {
    if (unshare(CLONE_NEWNET) != 0) std::cout << "On the network of the host: do not run this twice at a time.\n";
    else ASSERT_TRUE(raise_loopback());
  }
};
const testing::Environment* const network_of_its_own = testing::AddGlobalTestEnvironment(new NetworkOfItsOwn);

}  // namespace

TestFolder::TestFolder() : path_(testing::TempDir() + "convoy_chaos_" + std::to_string(getpid())) {
  signal(SIGPIPE, SIG_IGN);  // a vehicle that has died is to be told by what it does not answer
  fs::remove_all(path_);
  fs::create_directories(path_);
}

TestFolder::~TestFolder() {
  std::error_code error;
  fs::remove_all(path_, error);
}

Life::Life(const Garage& garage, const std::vector<std::string>& options)
    : name_("vehicle " + std::to_string(garage.id)),
      dump_(garage.folder / ("dump_" + std::to_string(garage.id))),
      child_(command(garage, options)) {
  epoch_ = std::stoull(hear("ready"));
}

std::string Life::hear(const std::string& expected) {
  const std::string line = child_.hear();
  if (!line.starts_with(expected))
    throw std::runtime_error(name_ + " says '" + line + "' where '" + expected + "' was due");
  return line.substr(expected.size());
}

std::string Life::ask(const std::string& command, const std::string& expected) {
  child_.tell(command);
  return hear(expected);
}

std::uint64_t Life::segment() { return std::stoull(ask("segment", "stated")); }

Status Life::status() {
  std::istringstream words(ask("status", "status"));
  Status s;
  for (std::uint64_t* figure : {&s.epoch, &s.holdings, &s.digest, &s.known, &s.missing, &s.lost, &s.refused,
                                &s.conflicts, &s.unfit, &s.disagreements, &s.requests, &s.relayed, &s.reopened,
                                &s.dropped, &s.restored, &s.cut_bytes, &s.failed_writes, &s.waiting, &s.quarantines})
    if (!(words >> *figure)) throw std::runtime_error(name_ + ": a figure is missing in its status");
  return s;
}

double Life::ahead_of(VehicleId vehicle) {
  std::istringstream words(ask("ahead " + std::to_string(vehicle), "ahead"));
  double seconds = 0.0;
  words >> seconds;
  return seconds;
}

Facts Life::facts() {
  const std::uint64_t count = std::stoull(ask("dump " + dump_.string(), "dumped"));
  Facts facts = read_facts(dump_);
  if (facts.size() != count) throw std::runtime_error(name_ + ": its facts cannot be read back");
  return facts;
}

Facts read_facts(const fs::path& file) {
  Facts facts;
  std::ifstream in(file);
  for (std::string line; std::getline(in, line);) {
    if (line.empty() || line.back() != '.') continue;  // its writer was killed meanwhile
    std::istringstream words(line);
    int kind = 0;
    Key key;
    Hash hash = 0;
    if (!(words >> kind >> key.chain.vehicle >> key.chain.epoch >> key.index >> hash))
      throw std::runtime_error(file.string() + ": not a fact: " + line);
    if (!facts.insert({{static_cast<FactKind>(kind), key}, hash}).second)
      throw std::runtime_error(file.string() + ": a key twice: " + line);
  }
  return facts;
}

bool tear(const fs::path& file, std::uintmax_t bytes) {
  const std::uintmax_t size = fs::file_size(file);
  if (size < bytes) return false;
  fs::resize_file(file, size - bytes);
  return true;
}

}  // namespace convoy::chaos
