#include <convoy/config_error.hpp>
#include <convoy/vision/calibration_file.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include <fstream>

namespace convoy {
namespace {

using testing::HasSubstr;
using Distortion = CameraCalibration::Distortion;

class CalibrationFile : public testing::Test {
 protected:
  CalibrationFile()
      : file_(testing::TempDir() + "convoy_" + testing::UnitTest::GetInstance()->current_test_info()->name() +
              ".yaml") {}
  ~CalibrationFile() override { std::filesystem::remove(file_); }

  CameraFile load(const std::string& text, const std::string& camera = "cam0") {
    std::ofstream(file_, std::ios::binary) << text;
    return load_calibration(file_, camera);
  }
  /// What a refusal says; empty if there is none.
  std::string refusal(const std::string& text, const std::string& camera = "cam0") {
    try {
      load(text, camera);
    } catch (const ConfigError& error) {
      return error.what();
    }
    return {};
  }
  void expect_refusal(const std::string& text, int line, const std::string& what, const std::string& camera = "cam0") {
    const std::string said = refusal(text, camera);
    EXPECT_THAT(said, HasSubstr(what));
    EXPECT_THAT(said, HasSubstr(file_.string() + (line > 0 ? ":" + std::to_string(line) + ": " : ":"))) << text;
  }
  std::filesystem::path file_;
};

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

const std::string ros = R"(image_width: 640
image_height: 480
camera_name: front
camera_matrix:
  rows: 3
  cols: 3
  data: [438.5, 0.0, 318.25, 0.0, 439.5, 242.0, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.2, 0.05, 0.001, -0.002, 0.003]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
)";

const std::string kalibr = R"(cam0:
  T_cam_imu:
  - [0.0, -1.0, 0.0, 0.1]
  - [0.0, 0.0, -1.0, 0.2]
  - [1.0, 0.0, 0.0, 0.3]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.01, -0.002, 0.003, -0.0004]
  distortion_model: equidistant
  intrinsics: [250.0, 251.0, 320.0, 240.0]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.5]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.2, 0.04, 0.001, 0.002]
  distortion_model: radtan
  intrinsics: [450.0, 451.0, 321.0, 241.0]
  resolution: [640, 480]
)";

TEST_F(CalibrationFile, OfRos) {
  const CameraFile camera = load(ros);
  const CameraCalibration& c = camera.calibration;
  EXPECT_EQ(c.width, 640);
  EXPECT_EQ(c.height, 480);
  EXPECT_EQ(c.fx, 438.5);
  EXPECT_EQ(c.fy, 439.5);
  EXPECT_EQ(c.cx, 318.25);
  EXPECT_EQ(c.cy, 242.0);
  EXPECT_EQ(c.distortion, Distortion::radial_tangential);
  EXPECT_EQ(c.coefficients, (Eigen::Matrix<double, 5, 1>() << -0.2, 0.05, 0.001, -0.002, 0.003).finished());
  EXPECT_FALSE(camera.T_body_camera);
}

TEST_F(CalibrationFile, OfRosEquidistantOrWithoutDistortion) {
  const std::string fisheye =
      replaced(replaced(ros, "plumb_bob", "equidistant"), "cols: 5\n  data: [-0.2, 0.05, 0.001, -0.002, 0.003]",
               "cols: 4\n  data: [0.02, 0.01, 0.0, 0.0]");
  EXPECT_EQ(load(fisheye).calibration.distortion, Distortion::equidistant);
  const std::string none = replaced(ros, "cols: 5\n  data: [-0.2, 0.05, 0.001, -0.002, 0.003]", "cols: 0\n  data: []");
  EXPECT_TRUE(load(none).calibration.coefficients.isZero());
}

TEST_F(CalibrationFile, OfOpenCvAsItsFileStorageWritesIt) {
  {
    cv::FileStorage out(file_.string(), cv::FileStorage::WRITE);
    const cv::Mat K = (cv::Mat_<double>(3, 3) << 400, 0, 319.5, 0, 400, 239.5, 0, 0, 1);
    const cv::Mat D = (cv::Mat_<double>(1, 5) << -0.1, 0.02, 0.0, 1e-3, 0.0);
    const cv::Mat T = (cv::Mat_<double>(4, 4) << 0, 0, 1, 1.5, -1, 0, 0, 0.1, 0, -1, 0, 1.2, 0, 0, 0, 1);
    out << "image_width" << 640 << "image_height" << 480 << "rate_hz" << 10.0 << "camera_matrix" << K
        << "distortion_coefficients" << D << "T_body_camera" << T;
  }
  const CameraFile camera = load_calibration(file_);
  EXPECT_EQ(camera.calibration.cx, 319.5);
  EXPECT_EQ(camera.calibration.coefficients[3], 1e-3);
  ASSERT_TRUE(camera.T_body_camera);
  EXPECT_LT((*camera.T_body_camera * Eigen::Vector3d(0, 0, 1) - Eigen::Vector3d(2.5, 0.1, 1.2)).norm(), 1e-12);
}

TEST_F(CalibrationFile, OfKalibr) {
  const CameraFile camera = load(kalibr);
  EXPECT_EQ(camera.calibration.distortion, Distortion::equidistant);
  EXPECT_EQ(camera.calibration.fy, 251.0);
  EXPECT_EQ(camera.calibration.coefficients[2], 0.003);
  ASSERT_TRUE(camera.T_body_camera);
  // A point 1 m ahead of the inertial sensor (its x) is 1 m ahead of the camera (its z), shifted.
  EXPECT_LT((camera.T_body_camera->inverse() * Eigen::Vector3d(1, 0, 0) - Eigen::Vector3d(0.1, 0.2, 1.3)).norm(),
            1e-12);
}

TEST_F(CalibrationFile, OfKalibrsSecondCameraByWayOfTheFirst) {
  const CameraFile camera = load(kalibr, "cam1");
  EXPECT_EQ(camera.calibration.distortion, Distortion::radial_tangential);
  EXPECT_EQ(camera.calibration.fx, 450.0);
  ASSERT_TRUE(camera.T_body_camera);
  EXPECT_LT((camera.T_body_camera->inverse() * Eigen::Vector3d(1, 0, 0) - Eigen::Vector3d(-0.4, 0.2, 1.3)).norm(),
            1e-12);
}

TEST_F(CalibrationFile, OfEuroc) {
  const CameraFile camera = load(R"(sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0.0, -1.0, 0.0, -0.02, 1.0, 0.0, 0.0, -0.06, 0.0, 0.0, 1.0, 0.01, 0.0, 0.0, 0.0, 1.0]
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
)");
  EXPECT_EQ(camera.calibration.width, 752);
  EXPECT_EQ(camera.calibration.coefficients[0], -0.28340811);
  ASSERT_TRUE(camera.T_body_camera);
  EXPECT_EQ(camera.T_body_camera->translation().y(), -0.06);
}

TEST_F(CalibrationFile, SaysWhereItIsWrong) {
  expect_refusal(replaced(ros, "image_width: 640\n", ""), 1, "'image_width' is missing; give the width");
  expect_refusal(replaced(ros, "image_height: 480", "image_height: tall"), 2, "image_height is 'tall'");
  expect_refusal(replaced(ros, "438.5", ".nan"), 7, "must be a finite number");
  expect_refusal(replaced(ros, "438.5, 0.0", "438.5, 0.1"), 5, "without skew");
  expect_refusal(replaced(ros, "438.5, 0.0", "438.5"), 7, "has 8 numbers, rows and cols say 3 x 3");
  expect_refusal(replaced(ros, "plumb_bob", "rational_polynomial"), 8,
                 "calibrate with plumb_bob (radtan) or equidistant");
  expect_refusal(replaced(ros, "plumb_bob", "equidistant"), 10, "has 5 numbers, the model 4");
  expect_refusal(replaced(ros, "cols: 5\n  data: [-0.2, 0.05, 0.001, -0.002, 0.003]", "cols: 2\n  data: [0.1, 0.1]"),
                 10, "k1, k2, p1, p2");
  expect_refusal(ros + "image_width: 320\n", 17, "'image_width' is there twice");
  expect_refusal(replaced(ros, "distortion_coefficients", "distortion"), 1, "'distortion_coefficients' is missing");
  expect_refusal(replaced(kalibr, "camera_model: pinhole", "camera_model: omni"), 7, "pinhole-radtan or pinhole-equi");
  expect_refusal(replaced(kalibr, "[250.0, 251.0, 320.0, 240.0]", "[250.0, 251.0, 320.0]"), 10, "it must have 4");
  expect_refusal(replaced(kalibr, "resolution: [640, 480]", "resolution: [640.5, 480]"), 11, "whole number");
  expect_refusal(replaced(kalibr, "[1.0, 0.0, 0.0, 0.3]", "[0.5, 0.0, 0.0, 0.3]"), 3, "must be a rotation");
  expect_refusal(replaced(kalibr, "[1.0, 0.0, 0.0, 0.3]", "[-1.0, 0.0, 0.0, 0.3]"), 3, "must be a rotation");
  expect_refusal(replaced(kalibr, "[0.0, 0.0, 0.0, 1.0]", "[0.0, 0.0, 0.1, 1.0]"), 3, "last row must be 0 0 0 1");
  expect_refusal(kalibr, 1, "'cam7' is missing", "cam7");
}

TEST_F(CalibrationFile, SaysThatItIsNone) {
  expect_refusal("focal_length: 3\n", 1,
                 "none of the keys camera_matrix (OpenCV, ROS), 'cam0' (Kalibr) and intrinsics");
  expect_refusal("a: [1, 2\nb: 3\n", 0, "no YAML");
  expect_refusal("", 0, "has no keys");
  expect_refusal("- 1\n- 2\n", 0, "has no keys");
  expect_refusal(std::string("a\0b", 3), 0, "a binary file");
  expect_refusal(std::string(1 << 21, '#'), 0, "longer than a megabyte");
  expect_refusal("camera_matrix: " + std::string(100000, '['), 0, "no YAML");
  expect_refusal("camera_matrix: &a {b: *a}\n", 1, "nested too deeply");  // it is part of itself
  EXPECT_THROW(load_calibration("/no/such/file.yaml"), ConfigError);
  EXPECT_THROW(load_calibration(testing::TempDir()), ConfigError);
}

TEST_F(CalibrationFile, ThatCannotBeIsRefused) {
  expect_refusal(replaced(ros, "318.25", "900.0"), 0, "cx");  // beyond the image
  expect_refusal(replaced(ros, "438.5", "-438.5"), 0, "fx");
  expect_refusal(replaced(ros, "image_width: 640", "image_width: 2"), 0, "width");
  expect_refusal(replaced(ros, "-0.2, 0.05", "-5.0, 0.05"), 0, "");  // a lens that folds back
}

TEST_F(CalibrationFile, ThatBelongsToOtherImagesIsRefused) {
  const CameraCalibration c = load(ros).calibration;
  EXPECT_NO_THROW(expect_image_size(c, 640, 480, "images"));
  try {
    expect_image_size(c, 480, 640, "the folder images");
    FAIL();
  } catch (const ConfigError& error) {
    EXPECT_THAT(error.what(),
                HasSubstr("the folder images: images are 480 x 640, the camera was calibrated with 640 x 480"));
  }
}

}  // namespace
}  // namespace convoy
