#include "command.hpp"

#include <sys/wait.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <stdexcept>

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

std::optional<fs::path> data_folder() {
  const char* named = std::getenv("CONVOY_DATA_DIR");
  const fs::path folder = named != nullptr ? fs::path(named) : fs::path(CONVOY_SOURCE_FOLDER) / "../shared/data";
  if (fs::exists(folder / "utias_mrclam")) return folder;
  return std::nullopt;
}

}  // namespace convoy::testing
