// Built without OpenCV.
#include <convoy/config_error.hpp>

#include "replay/camera_replay.hpp"

namespace convoy::cli {

void replay_camera(const ReplayOptions& options) {
  throw ConfigError("replay: " + options.dataset +
                    " are recordings with a camera, and convoy was built without OpenCV or yaml-cpp; build it with "
                    "CONVOY_BUILD_VISION=ON");
}

}  // namespace convoy::cli
