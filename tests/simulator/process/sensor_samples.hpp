// Samples of idl/sensors.idl from what was sensed.
#pragma once

#include "sensor_data.hpp"

#include <convoy/idl/sensors.h>

namespace convoy::simulator {

namespace wire = convoy::sensors::v1;

wire::Header header_of(std::uint64_t run, std::uint32_t step, double stamp_s);
wire::CameraCalibration calibration_sample(std::uint64_t run, std::uint32_t vehicle, const CameraData& camera);
wire::CameraFrame frame_sample(std::uint64_t run, std::uint32_t step, std::uint32_t vehicle, const FrameData& frame);
wire::TruthDepth depth_sample(std::uint64_t run, std::uint32_t step, std::uint32_t vehicle, const FrameData& frame);
wire::Odometry odometry_sample(std::uint64_t run, std::uint32_t step, std::uint32_t vehicle, const OdometryData& data);
wire::Gps gps_sample(std::uint64_t run, std::uint32_t step, std::uint32_t vehicle, const GpsData& data);
wire::Step step_sample(std::uint64_t run, const StepData& step, const VehicleStep& of_vehicle);
wire::Truth truth_sample(std::uint64_t run, const StepData& step, const VehicleStep& of_vehicle);

/// x, y, z, qw, qx, qy, qz.
std::array<double, 7> numbers_of(const Eigen::Isometry3d& pose);

}  // namespace convoy::simulator
