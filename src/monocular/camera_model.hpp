// A calibrated camera: where a point in front of it comes to lie in the image, and along which ray a pixel looks. Frame
// of a camera: x to the right of the image, y down, z ahead.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <optional>

namespace convoy {

struct CameraCalibration {
  enum class Distortion : std::uint8_t {
    radial_tangential,  ///< k1, k2, p1, p2, k3 as in OpenCV ("plumb_bob", "radtan")
    equidistant,        ///< k1 ... k4 as in cv::fisheye ("equidistant", Kannala-Brandt)
  };
  int width = 0, height = 0;  ///< of the image [px], each in 16..16384
  double fx = 0.0, fy = 0.0;  ///< focal lengths [px], > 0
  double cx = 0.0, cy = 0.0;  ///< principal point [px], inside the image; pixel centres are whole numbers
  Distortion distortion = Distortion::radial_tangential;
  Eigen::Matrix<double, 5, 1> coefficients = Eigen::Matrix<double, 5, 1>::Zero();  ///< in the order named above
};

/// Throws ConfigError that names what cannot be: a value out of range, or a lens that folds back within the image.
void validate(const CameraCalibration& calibration);

class CameraModel {
 public:
  struct Projection {
    Eigen::Vector2d pixel;
    Eigen::Matrix<double, 2, 3> jacobian;  ///< of the pixel by the point [px/m]
  };

  /// Throws ConfigError; see validate().
  explicit CameraModel(const CameraCalibration& calibration);

  /// Of a point [m] in the camera's frame. Nothing if it is behind the camera or beyond the field that the calibration
  /// holds for; it may lie outside of the image.
  std::optional<Projection> project(const Eigen::Vector3d& point) const;
  /// The unit vector along which a pixel looks.
  Eigen::Vector3d ray(const Eigen::Vector2d& pixel) const;
  /// At least `margin_px` from each edge.
  bool in_image(const Eigen::Vector2d& pixel, double margin_px = 0.0) const;
  const CameraCalibration& calibration() const { return calibration_; }

 private:
  CameraCalibration calibration_;
  double max_angle_rad_ = 0.0;  // from the axis, that the calibration holds for
};

}  // namespace convoy
