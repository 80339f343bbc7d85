// Which ray of light meets which pixel.
#pragma once

#include <Eigen/Core>

#include <array>
#include <optional>

namespace convoy::simulator {

enum class Distortion {
  kRadialTangential,  ///< coefficients k1, k2, p1, p2 (OpenCV's order)
  kEquidistant,       ///< coefficients k1, k2, k3, k4 of the angle's odd powers (OpenCV's fisheye)
};

struct LensParams {
  int width = 640, height = 480;  ///< [px], 16 to 4096
  double fx = 370.0, fy = 370.0;  ///< [px], > 0. 370: 82 degrees from side to side
  double cx = 319.5, cy = 239.5;  ///< [px], the middle of the first pixel is 0; within the frame
  Distortion distortion = Distortion::kRadialTangential;
  std::array<double, 4> coefficients{-0.06, 0.01, 0.0005, -0.0005};  ///< one to one between frame and rays

  /// Throws std::invalid_argument that says what is wrong and how to mend it.
  void validate() const;
  static LensParams pinhole(int width_px, int height_px, double focal_px);
  static LensParams small();  ///< 512 x 384, same field of view
};

/// Frame and rays of a lens. Camera frame: x to the right, y down, z ahead.
class Lens {
 public:
  explicit Lens(const LensParams& params);

  const LensParams& params() const { return params_; }
  /// Where light of p_camera [m] meets the image plane [px], in the frame or beyond its border. None behind the camera
  /// and where the model of the distortion no longer holds.
  std::optional<Eigen::Vector2d> pixel_of(const Eigen::Vector3d& p_camera) const;
  /// (x, y) of the ray (x, y, 1) that meets a pixel of the frame or near it.
  Eigen::Vector2d ray_of(const Eigen::Vector2d& pixel) const;
  bool in_frame(const Eigen::Vector2d& pixel) const;

 private:
  LensParams params_;
  double largest_slope_ = 0.0;  ///< of rays that the model is good for
};

}  // namespace convoy::simulator
