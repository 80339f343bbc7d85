#include "dds_testing.hpp"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>
#include <thread>

namespace convoy::dds::testing {

namespace {

// Its place among those of this executable.
std::uint32_t number_of_this_test() {
  const auto& all = *::testing::UnitTest::GetInstance();
  const auto* current = all.current_test_info();
  std::uint32_t number = 0;
  for (int s = 0; s < all.total_test_suite_count(); ++s)
    for (int t = 0; t < all.GetTestSuite(s)->total_test_count(); ++t, ++number)
      if (all.GetTestSuite(s)->GetTestInfo(t) == current) return number;
  throw std::logic_error("no test is running");
}

// True for one process at a time, until it ends. Where there can be no lock file, for all.
bool has_to_itself(std::uint32_t domain) {
  static std::map<std::uint32_t, int> locks;
  if (locks.contains(domain)) return true;
  const std::string file =
      (std::filesystem::temp_directory_path() / ("convoy_test_domain_" + std::to_string(domain) + ".lock")).string();
  int lock = open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
  if (lock < 0) lock = open(file.c_str(), O_RDONLY | O_CLOEXEC);  // another user's
  if (lock >= 0 && flock(lock, LOCK_EX | LOCK_NB) != 0) {
    close(lock);
    return false;
  }
  locks[domain] = lock;
  return true;
}

}  // namespace

std::uint32_t domain_of_this_test() {
  constexpr std::uint32_t first = CONVOY_FIRST_TEST_DOMAIN, count = CONVOY_TEST_DOMAINS;
  static std::map<std::uint32_t, std::uint32_t> domains;  // by test
  const std::uint32_t number = number_of_this_test();
  if (const auto chosen = domains.find(number); chosen != domains.end()) return chosen->second;
  for (std::uint32_t k = 0; k < count; ++k)
    if (const std::uint32_t domain = first + (number + k) % count; has_to_itself(domain))
      return domains[number] = domain;
  throw std::runtime_error("all domains of these tests are in use by others");
}

std::string profile_named(const std::string& name) { return CONVOY_QOS_PROFILES "/" + name + ".xml"; }
std::string loopback_profile() { return profile_named("loopback_udp"); }

DdsConfig config_of_this_test() {
  DdsConfig config;
  config.domain = domain_of_this_test();
  config.profile_file = loopback_profile();
  return config;
}

ChangedProfile::ChangedProfile(const std::string& from, const std::string& to)
    : path(::testing::TempDir() + "convoy_profile_" + std::to_string(getpid()) + "_" +
           ::testing::UnitTest::GetInstance()->current_test_info()->name() + ".xml") {
  std::ostringstream all;
  all << std::ifstream(loopback_profile()).rdbuf();
  std::string text = all.str();
  const auto at = text.find(from);
  if (at == std::string::npos) throw std::logic_error("the loopback profile has no " + from);
  std::ofstream(path) << text.replace(at, from.size(), to);
}
ChangedProfile::~ChangedProfile() { std::filesystem::remove(path); }

bool eventually(const std::function<bool()>& done, double timeout_s) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::duration<double>(timeout_s);
  while (!done()) {
    if (std::chrono::steady_clock::now() > deadline) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return true;
}

std::vector<Message<SE2>> collect(DdsExchange<SE2>& exchange, std::size_t count, double timeout_s) {
  std::vector<Message<SE2>> all;
  const auto start = std::chrono::steady_clock::now();
  const auto left_s = [&] {
    return timeout_s - std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  };
  while (all.size() < count && left_s() > 0.0 && exchange.wait_for_messages(left_s()))
    for (auto& message : exchange.take(0.0)) all.push_back(std::move(message));
  return all;
}

Child::Child(const std::vector<std::string>& command) {
  int in[2], out[2];
  if (pipe2(in, O_CLOEXEC) != 0 || pipe2(out, O_CLOEXEC) != 0) throw std::runtime_error("pipe failed");
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, in[0], 0);
  posix_spawn_file_actions_adddup2(&actions, out[1], 1);
  std::vector<char*> argv;
  for (const std::string& word : command) argv.push_back(const_cast<char*>(word.c_str()));
  argv.push_back(nullptr);
  const int failed = posix_spawnp(&pid_, argv[0], &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  close(in[0]);
  close(out[1]);
  to_child_ = in[1];
  from_child_ = out[0];
  if (failed != 0) throw std::runtime_error("cannot start " + command[0] + ": " + std::strerror(failed));
}

Child::~Child() {
  kill_hard();
  close(to_child_);
  close(from_child_);
}

void Child::tell(const std::string& line) {
  const std::string text = line + "\n";
  if (write(to_child_, text.data(), text.size()) != static_cast<ssize_t>(text.size()))
    throw std::runtime_error("the child does not listen");
}

std::string Child::hear(double timeout_s) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::duration<double>(timeout_s);
  for (;;) {
    if (const auto end = heard_.find('\n'); end != std::string::npos) {
      const std::string line = heard_.substr(0, end);
      heard_.erase(0, end + 1);
      return line;
    }
    const auto left =
        std::chrono::duration_cast<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
    pollfd ready{from_child_, POLLIN, 0};
    if (left.count() <= 0 || poll(&ready, 1, static_cast<int>(left.count())) <= 0) return {};
    char buffer[4096];
    const ssize_t n = read(from_child_, buffer, sizeof buffer);
    if (n <= 0) return {};
    heard_.append(buffer, static_cast<std::size_t>(n));
  }
}

void Child::kill_hard() {
  if (pid_ <= 0) return;
  kill(pid_, SIGKILL);
  waitpid(pid_, nullptr, 0);
  pid_ = -1;
}

int Child::finish() {
  close(to_child_);
  to_child_ = -1;
  int status = 0;
  waitpid(pid_, &status, 0);
  pid_ = -1;
  return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

std::vector<std::string> peer_command(VehicleId vehicle, const std::string& profile) {
  return {CONVOY_DDS_PEER, profile, std::to_string(domain_of_this_test()), std::to_string(vehicle)};
}

DiscoveryServer::DiscoveryServer(
    const std::string& address, std::uint16_t port, int place,
    const std::function<std::vector<std::string>(const std::vector<std::string>&)>& wrapped)
    : file_(::testing::TempDir() + "convoy_server_" + std::to_string(getpid()) + "_" + std::to_string(port) + ".xml"),
      address_(address + ":" + std::to_string(port)),
      command_({"fast-discovery-server", "-x", file_}) {
  std::ostringstream text;
  text << std::ifstream(profile_named("discovery_server")).rdbuf();
  std::string profile = text.str();
  const auto put = [&](const std::string& from, const std::string& to) {
    auto at = profile.find(from);
    if (at == std::string::npos) throw std::logic_error("discovery_server.xml has no " + from);
    for (; at != std::string::npos; at = profile.find(from, at + to.size())) profile.replace(at, from.size(), to);
  };
  put("<address>127.0.0.1<", "<address>" + address + "<");
  put("<port>11811<", "<port>" + std::to_string(port) + "<");
  put("<prefix>44.53.00.", "<prefix>44.53.0" + std::to_string(place) + ".");
  std::ofstream(file_) << profile;
  if (wrapped) command_ = wrapped(command_);
  start();
}

DiscoveryServer::~DiscoveryServer() { std::filesystem::remove(file_); }

void DiscoveryServer::start() {
  server_ = std::make_unique<Child>(command_);
  if (server_->hear().find("Server is running") == std::string::npos)
    throw std::runtime_error("the Discovery Server does not start");
}

bool DiscoveryServer::installed() {
  return Child({"sh", "-c", "command -v fast-discovery-server >/dev/null"}).finish() == 0;
}

Sent sent_by(Child& peer) {
  peer.tell("bytes");
  std::istringstream words(peer.hear());
  std::string word;
  Sent sent;
  words >> word >> sent.rtps >> sent.headers >> sent.datagrams;
  return sent;
}

std::string refusal(const DdsConfig& config) {
  try {
    DdsExchange<SE2> exchange(config);
  } catch (const ConfigError& error) {
    return error.what();
  }
  return "accepted";
}

}  // namespace convoy::dds::testing
