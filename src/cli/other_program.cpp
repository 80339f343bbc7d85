#include "other_program.hpp"

#include <convoy/config_error.hpp>

#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <vector>

#include "child_process.hpp"

namespace convoy::cli {

std::filesystem::path simulator_program() {
  const std::filesystem::path folder = this_program().parent_path();
  std::filesystem::path program = folder / "convoy-sim";
  if (const auto built = folder / "../../tests/simulator/convoy-sim";  // this is src/cli of a build tree
      !std::filesystem::exists(program) && std::filesystem::exists(built))
    program = built;
  return program;
}

std::filesystem::path replay_program() { return this_program().parent_path() / "convoy-replay"; }
std::filesystem::path camera_program() { return this_program().parent_path() / "convoy-camera"; }

void become(const std::filesystem::path& program, const std::string& option, int argc, char** argv) {
  std::vector<char*> words(argv + 1, argv + argc);
  std::string name = program.string();
  words.front() = name.data();
  words.push_back(nullptr);
  execv(name.c_str(), words.data());
  if (errno == ENOENT)
    throw ConfigError(program.filename().string() + " is not beside " + this_program().string() +
                      "; build convoy with " + option + "=ON, or install both");
  throw ConfigError("cannot run " + name + ": " + std::strerror(errno));
}

}  // namespace convoy::cli
