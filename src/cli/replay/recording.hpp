// A recording of one vehicle with a camera and an odometer, as `convoy replay` takes it.
//
// images   DIR/camera.yaml     calibration (vision/calibration_file.hpp), with T_body_camera. Body: x ahead, y left, z
//                              up; its origin is where the odometer measures, the middle of the rear axle
//          DIR/images/         pictures, by name (vision/image_source.hpp)
//          DIR/frames.csv      their stamps, column stamp_s; or DIR/times.txt, a stamp per line [s]; or --rate
//          DIR/odometry.csv    columns stamp_s [s], distance_m [m], and gyro_yaw_rate_radps, wheels_yaw_rate_radps or
//                              yaw_rate_radps [rad/s] (the first of them that is there): of the time since the reading
//                              before. Column names are those of `convoy sim --record`; others may be there, too
//          DIR/truth.csv       if it is known: time_s, x_m, y_m, z_m, qw, qx, qy, qz of the body, in any frame
//          A folder without odometry.csv is images alone: tracks are followed from one to the next, and there is no
//          path. Then DIR needs no camera.yaml, and may itself be the folder of pictures.
// kitti    a drive of KITTI (vision/kitti_sequence.hpp) with DIR/poses.txt, a 3 x 4 matrix per image: camera to first
//          camera. There is no odometer: its readings are made from these poses, with noise. The body is the camera,
//          turned so that x is where it moves on straight road.
#pragma once

#include <convoy/monocular/camera_model.hpp>
#include <convoy/vision/image_source.hpp>
#include <convoy/vision/monocular_slam.hpp>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "scenario/scenario.hpp"

namespace convoy::cli {

struct OdometerReading {
  double stamp_s = 0.0;  ///< of its end; it tells of the time since the reading before
  double distance_m = 0.0;
  double yaw_rate_radps = 0.0;  ///< mean, left positive
};

struct Recording {
  std::string source;                   ///< in words, for reports
  std::string notice;                   ///< what must be said of it aloud; empty: nothing
  std::uint64_t seed = 0;               ///< of what was made up; 0: nothing was
  double start_stamp_s = 0.0;           ///< a whole second; times below, and of next_image(), count from it
  std::unique_ptr<ImageSource> images;  ///< with the stamps of the recording
  CameraCalibration calibration;        ///< of no meaning without an odometer
  SE3 T_body_camera;
  std::vector<OdometerReading> odometry;  ///< by time; empty: images alone
  std::vector<TruthPose<SE3>> truth;      ///< of the body, by time; empty: not known
  MonocularSlamParams params;             ///< for this kind of recording

  SourceImage next_image();
};

/// rate_hz: of the images, if neither frames.csv nor times.txt is there; 0: not told. Throws ConfigError.
Recording open_images(const std::filesystem::path& folder, double rate_hz);
Recording open_kitti_drive(const std::filesystem::path& folder);

/// Distance and yaw rate between neighbouring poses of the body, each with a relative error of that sigma.
std::vector<OdometerReading> odometer_from_truth(const std::vector<TruthPose<SE3>>& truth, double sigma,
                                                 std::uint64_t seed);

}  // namespace convoy::cli
