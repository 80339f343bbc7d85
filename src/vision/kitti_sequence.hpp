// KITTI's two layouts of a drive (Geiger, Lenz, Stiller, Urtasun: Vision meets robotics, IJRR 2013).
//   odometry   image_0/000000.png, calib.txt (rows P0 to P3), times.txt (without: 10 Hz)
//   raw        image_00/data/0000000000.png, image_00/timestamps.txt, and calib_cam_to_cam.txt there or one folder up
#pragma once

#include <convoy/monocular/camera_model.hpp>
#include <convoy/vision/image_source.hpp>

namespace convoy {

struct KittiSequence {
  std::unique_ptr<ImageSource> images;
  CameraCalibration calibration;  ///< of the rectified images: no distortion
};

/// `camera`: 0 and 1 are the grey ones, 2 and 3 those in colour. Throws ConfigError with file and line.
KittiSequence open_kitti(const std::filesystem::path& folder, int camera = 0);

}  // namespace convoy
