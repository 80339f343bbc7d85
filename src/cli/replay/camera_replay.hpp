// convoy replay of recordings with a camera (recording.hpp): the part that needs OpenCV.
#pragma once

#include "replay/replay.hpp"

namespace convoy::cli {

/// `options.dataset` is "images" or "kitti"; the folder to make is new. Throws ConfigError, always if this program was
/// built without OpenCV.
void replay_camera(const ReplayOptions& options);

}  // namespace convoy::cli
