// What is a program of its own: the simulator, so that nothing of it is linked into what vehicles run; replay, whose
// readers of image files make a process 40 MB larger; and the vehicle with a camera, for 5 MB of OpenCV that the others
// need not carry. They lie beside this program, or in its build tree.
#pragma once

#include <filesystem>
#include <string>

namespace convoy::cli {

/// Where they should be; they may not be there.
std::filesystem::path simulator_program();
std::filesystem::path replay_program();
std::filesystem::path camera_program();

/// Becomes that program, with the words from argv[2] on. Throws ConfigError if it is not there; `option`: of CMake,
/// that it is built with.
[[noreturn]] void become(const std::filesystem::path& program, const std::string& option, int argc, char** argv);

}  // namespace convoy::cli
