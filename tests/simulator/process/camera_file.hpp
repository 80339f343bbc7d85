// A calibration as OpenCV reads it.
#pragma once

#include "sensor_data.hpp"

#include <filesystem>

namespace convoy::simulator {

/// Throw SetUpError that names the file and what is wrong in it.
void save_camera(const CameraData& camera, const std::filesystem::path& file);
CameraData load_camera(const std::filesystem::path& file);

/// Throws SetUpError if the file cannot be one of save_picture.
void expect_room_for_picture(const std::filesystem::path& file);

/// Grey, without loss (PNG). Throw SetUpError that names the file.
void save_picture(const std::filesystem::path& file, int width, int height, const std::vector<std::uint8_t>& grey);
std::vector<std::uint8_t> load_picture(const std::filesystem::path& file, int width, int height);

}  // namespace convoy::simulator
