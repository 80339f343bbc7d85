#include "processes.hpp"

#include <gtest/gtest.h>

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <set>
#include <sstream>
#include <stdexcept>
#include <thread>

namespace convoy::simulator::testing {
namespace {

std::vector<std::string> words_of(const std::string& program, const std::string& arguments) {
  std::vector<std::string> words{program};
  std::istringstream in(arguments);
  for (std::string word; in >> word;) words.push_back(word);
  return words;
}

}  // namespace

ScratchFolder::ScratchFolder() {
  std::string name = (std::filesystem::temp_directory_path() / "convoy-sim-XXXXXX").string();
  if (mkdtemp(name.data()) == nullptr) throw std::runtime_error("no folder for the test");
  path_ = name;
}

ScratchFolder::~ScratchFolder() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}

Process::Process(const std::vector<std::string>& command, std::filesystem::path output) : output_(std::move(output)) {
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, 1, output_.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
  posix_spawn_file_actions_adddup2(&actions, 1, 2);
  std::vector<char*> argv;
  for (const std::string& word : command) argv.push_back(const_cast<char*>(word.c_str()));
  argv.push_back(nullptr);
  const int failed = posix_spawn(&pid_, argv[0], &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (failed != 0) throw std::runtime_error("cannot start " + command[0]);
}

Process::~Process() {
  if (ended_) return;
  kill(pid_, SIGKILL);
  waitpid(pid_, nullptr, 0);
}

int Process::wait(double deadline_s) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::duration<double>(deadline_s);
  int status = 0;
  while (waitpid(pid_, &status, WNOHANG) != pid_) {
    if (std::chrono::steady_clock::now() > deadline) return -1000;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  ended_ = true;
  return WIFSIGNALED(status) ? -WTERMSIG(status) : WEXITSTATUS(status);
}

void Process::send(int signal) const { kill(pid_, signal); }

std::vector<std::string> Process::udp_addresses() const {
  const std::string of_process = "/proc/" + std::to_string(pid_);
  std::set<std::string> sockets;
  for (const auto& entry : std::filesystem::directory_iterator(of_process + "/fd")) {
    std::error_code gone;
    const std::string target = std::filesystem::read_symlink(entry.path(), gone).string();
    if (target.starts_with("socket:[")) sockets.insert(target.substr(8, target.size() - 9));
  }
  std::vector<std::string> addresses;
  for (const std::string& line : lines_of(read_text(of_process + "/net/udp"))) {
    std::istringstream words(line);
    std::string word[10];
    for (std::string& w : word) words >> w;
    if (sockets.contains(word[9])) addresses.push_back(word[1].substr(0, 8));
  }
  return addresses;
}

std::string Process::output() const { return read_text(output_); }

std::vector<std::string> sim_command(const std::string& arguments) { return words_of(CONVOY_SIM, arguments); }
std::vector<std::string> vehicle_command(const std::string& arguments) {
  return words_of(CONVOY_SIM_TEST_VEHICLE, arguments);
}

Outcome run_sim(const std::string& arguments) {
  const ScratchFolder scratch;
  Process process(sim_command(arguments), scratch / "output");
  const int status = process.wait();
  return {status, process.output()};
}

Outcome run_sim_on_full_disk(int bytes, const std::string& arguments) {
  const std::string limits = "trap '' XFSZ; exec prlimit --fsize=" + std::to_string(bytes);  // so that a write fails
  FILE* pipe = popen((limits + " '" CONVOY_SIM "' " + arguments + " 2>&1").c_str(), "r");
  if (pipe == nullptr) throw std::runtime_error("no shell for the test");
  Outcome outcome;
  char part[4096];
  while (const std::size_t size = std::fread(part, 1, sizeof part, pipe)) outcome.output.append(part, size);
  outcome.status = WEXITSTATUS(pclose(pipe));
  return outcome;
}

std::string read_text(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

void write_text(const std::filesystem::path& file, const std::string& text) { std::ofstream(file) << text; }

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

std::uint32_t domain_of_this_test() {
  constexpr std::uint32_t first = CONVOY_FIRST_TEST_DOMAIN, count = CONVOY_TEST_DOMAINS;
  const auto& all = *::testing::UnitTest::GetInstance();
  std::uint32_t number = 0;
  for (int s = 0; s < all.total_test_suite_count(); ++s)
    for (int t = 0; t < all.GetTestSuite(s)->total_test_count(); ++t, ++number)
      if (all.GetTestSuite(s)->GetTestInfo(t) == all.current_test_info()) return first + 2 * (number % (count / 2));
  throw std::logic_error("no test is running");
}

std::string domains_of_this_test() {
  const std::uint32_t domain = domain_of_this_test();
  return " --domain-sensors " + std::to_string(domain) + " --domain-truth " + std::to_string(domain + 1);
}

}  // namespace convoy::simulator::testing
