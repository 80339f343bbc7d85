#include <convoy/config_error.hpp>

#include "replay/replay.hpp"

namespace convoy::cli {

std::string replay_description() { return "Replay images (not in this build: it was made without OpenCV or yaml-cpp)"; }

int run_replay(const ReplayOptions&) {
  throw ConfigError(
      "replay: this convoy was built without cameras; install OpenCV 4.6 and yaml-cpp 0.7 (scripts/setup does), and "
      "build "
      "it again with -D CONVOY_BUILD_VISION=ON");
}

}  // namespace convoy::cli
