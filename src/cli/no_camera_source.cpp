// In place of camera_source.cpp, where convoy is built without convoy::vision.
#include <convoy/config_error.hpp>

#include "sensor_source.hpp"

namespace convoy::cli {

std::unique_ptr<SensorSource<SE3>> open_camera(const VehicleConfig<SE3>& config, const SourceOptions&) {
  throw ConfigError(config.camera.origin +
                    ": <camera>: this convoy was built without cameras (CONVOY_BUILD_VISION=OFF, or OpenCV and "
                    "yaml-cpp were not there); build it with them, or give the vehicle a <sensors file=\"...\"/>");
}

bool has_cameras() { return false; }

}  // namespace convoy::cli
