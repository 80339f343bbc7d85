#include "command.hpp"

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <stdexcept>
#include <thread>

#include "../support/data_folder.hpp"

namespace convoy::testing {

namespace fs = std::filesystem;

Outcome run_shell(const std::string& command) {
  FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  if (pipe == nullptr) throw std::runtime_error("cannot run: " + command);
  Outcome outcome;
  char buffer[4096];
  for (std::size_t n; (n = fread(buffer, 1, sizeof buffer, pipe)) > 0;) outcome.output.append(buffer, n);
  const int status = pclose(pipe);
  outcome.status = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return outcome;
}

Outcome run_convoy(const std::string& arguments) { return run_shell(std::string(CONVOY_PROGRAM) + " " + arguments); }

Background::Background(const std::vector<std::string>& arguments, const fs::path& output_file) {
  std::vector<std::string> words{CONVOY_PROGRAM};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  const int out = open(output_file.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (out < 0) throw std::runtime_error("cannot write " + output_file.string());
  pid_ = fork();
  if (pid_ == 0) {
    dup2(out, STDOUT_FILENO);
    dup2(out, STDERR_FILENO);
    execv(argv[0], argv.data());
    _exit(127);
  }
  close(out);
  if (pid_ < 0) throw std::runtime_error("cannot fork");
}

Background::~Background() {
  if (waited_) return;
  send(SIGKILL);
  wait();
}

void Background::send(int signal) { kill(pid_, signal); }

int Background::wait() {
  int status = 0;
  waited_ = waitpid(pid_, &status, 0) == pid_;
  return waited_ && WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

bool eventually(const std::function<bool()>& condition) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(30);
  while (std::chrono::steady_clock::now() < deadline) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  return false;
}

std::string read_text(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

ScratchFolder::ScratchFolder() {
  std::string name = (fs::temp_directory_path() / "convoy-test-XXXXXX").string();
  if (mkdtemp(name.data()) == nullptr) throw std::runtime_error("cannot make a folder like " + name);
  path_ = name;
}

ScratchFolder::~ScratchFolder() {
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

nlohmann::json read_json(const fs::path& file) {
  std::ifstream in(file);
  if (!in) throw std::runtime_error("no such file: " + file.string());
  return nlohmann::json::parse(in);
}

namespace {
std::optional<fs::path> recording(const char* name) {
  const fs::path folder = test::data_folder() / name;
  return fs::exists(folder) ? std::optional(folder) : std::nullopt;
}
}  // namespace

std::optional<fs::path> mrclam_folder() { return recording("utias_mrclam/ds6"); }
std::optional<fs::path> victoria_park_folder() { return recording("victoria_park"); }
std::optional<fs::path> kitti_drive() { return recording("kitti_mini/seq1"); }

}  // namespace convoy::testing
