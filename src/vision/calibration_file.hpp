// A camera's calibration from the YAML that calibration tools write. By its keys a file is one of
//   OpenCV, ROS camera_info   image_width, image_height, camera_matrix, distortion_coefficients; with distortion_model
//                             plumb_bob or equidistant, or OpenCV's fisheye_model: 1; without: plumb_bob
//   Kalibr, EuRoC             camera_model: pinhole, intrinsics, distortion_model: radtan, equidistant or none,
//                             distortion_coeffs, resolution; in Kalibr under cam0, cam1, ...
// Where the camera sits on the vehicle: T_body_camera (4 x 4; `convoy sim --record` writes it), Kalibr's T_cam_imu (the
// inertial sensor is then the body; T_cn_cnm1 leads to it from one camera to the next), EuRoC's T_BS.
#pragma once

#include <convoy/geometry/se3.hpp>
#include <convoy/monocular/camera_model.hpp>

#include <filesystem>
#include <optional>
#include <string>

namespace convoy {

struct CameraFile {
  CameraCalibration calibration;  ///< fit for a CameraModel
  std::optional<SE3> T_body_camera;
};

/// `camera`: which of the cameras of a Kalibr file. Throws ConfigError with file:line, what is wrong and how to mend
/// it.
CameraFile load_calibration(const std::filesystem::path& path, const std::string& camera = "cam0");

/// Throws ConfigError if images of that size [px] are not what was calibrated. `source`: where they come from, for the
/// error.
void expect_image_size(const CameraCalibration& calibration, int width, int height, const std::string& source);

}  // namespace convoy
