// convoy sim: the simulator is a program of its own, so that nothing of it is linked into what vehicles run.
#pragma once

#include <filesystem>

namespace convoy::cli {

/// convoy-sim, which lies beside this program or in the same build tree; it may not be there.
std::filesystem::path simulator_program();

/// Becomes convoy-sim, which lies beside this program or in the same build tree, with the words from argv[2] on. Throws
/// ConfigError if it is not there.
[[noreturn]] void become_simulator(int argc, char** argv);

}  // namespace convoy::cli
