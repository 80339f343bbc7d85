// What is sensed in one step, without middleware: from a source (the world, a recording) to whoever takes it (topics, a
// recording). Meanings, frames and units are those of idl/sensors.idl.
#pragma once

#include <Eigen/Geometry>

#include <array>
#include <cstdint>
#include <vector>

namespace convoy::simulator {

struct CameraData {
  int width = 0, height = 0;  ///< pixels
  double rate_hz = 10.0;
  double fx = 0.0, fy = 0.0, cx = 0.0, cy = 0.0;
  std::array<double, 5> distortion{};  ///< k1, k2, p1, p2, k3
  Eigen::Isometry3d T_body_camera = Eigen::Isometry3d::Identity();
};

struct FrameData {
  std::uint32_t frame = 0;
  double stamp_s = 0.0;
  int width = 0, height = 0;
  std::vector<std::uint8_t> grey;
  std::vector<float> depth_m;  ///< truth; empty where it was not asked for
};

struct OdometryData {
  std::uint32_t reading = 0;
  double stamp_s = 0.0;
  std::int64_t left_ticks = 0, right_ticks = 0;
  double distance_m = 0.0, speed_mps = 0.0, wheels_yaw_rate_radps = 0.0, gyro_yaw_rate_radps = 0.0;
  double sigma_distance_m = 0.0, sigma_wheels_yaw_rate_radps = 0.0, sigma_gyro_yaw_rate_radps = 0.0;
};

enum class GpsKind { standard, rtk };

struct GpsData {
  std::uint32_t reading = 0;
  double stamp_s = 0.0;
  GpsKind kind = GpsKind::standard;
  bool fix = true;
  std::array<double, 3> antenna_body{}, position{};
  std::array<double, 6> covariance{}, drift_covariance{};
  double correlation_s = 0.0;
};

struct TruthData {
  std::array<double, 7> T_world_body{0, 0, 0, 1, 0, 0, 0};
  std::array<double, 3> velocity_world{}, turn_body{};
};

struct VehicleStep {
  std::uint32_t vehicle = 0;
  std::vector<FrameData> frames;
  std::vector<OdometryData> odometry;
  std::vector<GpsData> gps;
  TruthData truth;
};

struct StepData {
  std::uint32_t step = 0;  ///< 1, 2, ...
  double time_s = 0.0;     ///< at its end
  bool last = false;
  std::vector<VehicleStep> vehicles;  ///< by number
};

}  // namespace convoy::simulator
