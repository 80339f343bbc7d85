// A grey camera on a vehicle: light through a lens onto a sensor, and what that makes of it.
#pragma once

#include "image.hpp"
#include "lens.hpp"
#include "rasteriser.hpp"

#include <Eigen/Geometry>

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

namespace convoy::simulator {

/// T_body_camera of a camera `ahead_m` of the rear axle, `left_m` of the middle and `up_m` above the ground, which
/// looks ahead and `down_rad` below the horizon.
Eigen::Isometry3d mount(double ahead_m, double left_m, double up_m, double down_rad = 0.0);

struct CameraParams {
  LensParams lens;
  RasteriserParams rendering;
  Eigen::Isometry3d T_body_camera = mount(1.7, 0.0, 1.4);

  double blur_px = 0.6;     ///< sigma of the point spread, 0 to 3
  double vignetting = 0.7;  ///< share of the cos^4 law, 0 (none) to 1
  double gain = 1.0;        ///< white paper in the sun is 255 at 1; above 0

  // Exposure and gamma are functions of the frame's number: any frame can be had without the ones before.
  double gain_drift = 0.1;         ///< of the gain's logarithm, slow, standard deviation, 0 to 1
  double drift_frames = 300.0;     ///< length of its shorter wave, >= 10
  double gain_step = 0.15;         ///< of the gain's logarithm at a step, standard deviation, 0 to 1
  int frames_between_steps = 150;  ///< >= 1
  double step_probability = 0.3;   ///< that such a stretch of frames has a gain of its own
  double gamma = 1.0;              ///< grey = 255 (light / 255)^(1 / gamma), 0.3 to 4
  double gamma_drift = 0.03;       ///< of its logarithm, standard deviation, 0 to 0.5

  double full_well_electrons = 8000.0;  ///< at 255, > 0: shot noise
  double read_noise_electrons = 12.0;   ///< standard deviation, >= 0
  double drop_probability = 0.0;        ///< that a frame is not there, 0 to 1

  std::uint32_t seed = 1;     ///< of the run
  std::uint32_t vehicle = 1;  ///< random numbers are keyed by seed, vehicle, sensor and frame
  std::uint32_t sensor = 1;   ///< below 65536

  /// Throws std::invalid_argument that says what is wrong and how to mend it.
  void validate() const;
};

struct Frame {
  std::uint32_t index = 0;
  GreyImage image;
  Eigen::Isometry3d T_world_camera = Eigen::Isometry3d::Identity();
};

/// light -> point spread -> vignetting -> gain -> shot and read noise -> gamma -> 8 bits
class Camera {
 public:
  /// The scene must outlive the camera (see Rasteriser).
  Camera(const Scene& scene, const CameraParams& params,
         std::shared_ptr<const std::vector<MipTexture>> textures = nullptr);

  const CameraParams& params() const { return params_; }
  /// The frame of that number; none if it is dropped. The same scene, pose, number and keys give the same frame.
  std::optional<Frame> take(const Eigen::Isometry3d& T_world_body, std::uint32_t index);
  bool dropped(std::uint32_t index) const;
  double gain(std::uint32_t index) const;
  double gamma(std::uint32_t index) const;
  /// World points of the last frame that was not dropped.
  const Rasteriser& truth() const { return rasteriser_; }

 private:
  double drift(std::uint32_t index, std::uint32_t which) const;
  void blur_along_rows(const LightImage& light);
  void expose(std::uint32_t index, GreyImage& image) const;

  CameraParams params_;
  Rasteriser rasteriser_;
  std::vector<float> spread_;  ///< kernel from its middle on
  LightImage falloff_;         ///< vignetting, 1 on the axis
  LightImage blurred_;         ///< along rows; with a margin of rows above and below
  std::vector<float> noise_;   ///< quantiles of N(0, 1)
};

}  // namespace convoy::simulator
