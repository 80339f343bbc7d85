#include "sensor_samples.hpp"

namespace convoy::simulator {

wire::Header header_of(std::uint64_t run, std::uint32_t step, double stamp_s) {
  wire::Header header;
  header.run(run);
  header.step(step);
  header.stamp_s(stamp_s);
  return header;
}

std::array<double, 7> numbers_of(const Eigen::Isometry3d& pose) {
  const Eigen::Quaterniond q(pose.linear());
  const Eigen::Vector3d& p = pose.translation();
  return {p.x(), p.y(), p.z(), q.w(), q.x(), q.y(), q.z()};
}

wire::CameraCalibration calibration_sample(std::uint64_t run, std::uint32_t vehicle, const CameraData& camera) {
  wire::CameraCalibration sample;
  sample.vehicle(vehicle);
  sample.header(header_of(run, 0, 0.0));
  sample.width(static_cast<std::uint32_t>(camera.width));
  sample.height(static_cast<std::uint32_t>(camera.height));
  sample.rate_hz(camera.rate_hz);
  sample.fx(camera.fx);
  sample.fy(camera.fy);
  sample.cx(camera.cx);
  sample.cy(camera.cy);
  sample.distortion(camera.distortion);
  sample.T_body_camera(numbers_of(camera.T_body_camera));
  return sample;
}

wire::CameraFrame frame_sample(std::uint64_t run, std::uint32_t step, std::uint32_t vehicle, const FrameData& frame) {
  wire::CameraFrame sample;
  sample.vehicle(vehicle);
  sample.header(header_of(run, step, frame.stamp_s));
  sample.frame(frame.frame);
  sample.width(static_cast<std::uint32_t>(frame.width));
  sample.height(static_cast<std::uint32_t>(frame.height));
  sample.grey(frame.grey);
  return sample;
}

wire::TruthDepth depth_sample(std::uint64_t run, std::uint32_t step, std::uint32_t vehicle, const FrameData& frame) {
  wire::TruthDepth sample;
  sample.vehicle(vehicle);
  sample.header(header_of(run, step, frame.stamp_s));
  sample.frame(frame.frame);
  sample.width(static_cast<std::uint32_t>(frame.width));
  sample.height(static_cast<std::uint32_t>(frame.height));
  sample.depth(frame.depth_m);
  return sample;
}

wire::Odometry odometry_sample(std::uint64_t run, std::uint32_t step, std::uint32_t vehicle, const OdometryData& data) {
  wire::Odometry sample;
  sample.vehicle(vehicle);
  sample.header(header_of(run, step, data.stamp_s));
  sample.reading(data.reading);
  sample.left_ticks(data.left_ticks);
  sample.right_ticks(data.right_ticks);
  sample.distance_m(data.distance_m);
  sample.speed_mps(data.speed_mps);
  sample.wheels_yaw_rate_radps(data.wheels_yaw_rate_radps);
  sample.gyro_yaw_rate_radps(data.gyro_yaw_rate_radps);
  sample.sigma_distance_m(data.sigma_distance_m);
  sample.sigma_wheels_yaw_rate_radps(data.sigma_wheels_yaw_rate_radps);
  sample.sigma_gyro_yaw_rate_radps(data.sigma_gyro_yaw_rate_radps);
  return sample;
}

wire::Gps gps_sample(std::uint64_t run, std::uint32_t step, std::uint32_t vehicle, const GpsData& data) {
  wire::Gps sample;
  sample.vehicle(vehicle);
  sample.header(header_of(run, step, data.stamp_s));
  sample.reading(data.reading);
  sample.kind(data.kind == GpsKind::rtk ? wire::GPS_RTK : wire::GPS_STANDARD);
  sample.fix(data.fix);
  sample.antenna_body(data.antenna_body);
  sample.position(data.position);
  sample.covariance(data.covariance);
  sample.drift_covariance(data.drift_covariance);
  sample.correlation_s(data.correlation_s);
  return sample;
}

wire::Step step_sample(std::uint64_t run, const StepData& step, const VehicleStep& of_vehicle) {
  wire::Step sample;
  sample.vehicle(of_vehicle.vehicle);
  sample.header(header_of(run, step.step, step.time_s));
  sample.frames(static_cast<std::uint32_t>(of_vehicle.frames.size()));
  sample.odometry(static_cast<std::uint32_t>(of_vehicle.odometry.size()));
  sample.gps(static_cast<std::uint32_t>(of_vehicle.gps.size()));
  sample.last(step.last);
  return sample;
}

wire::Truth truth_sample(std::uint64_t run, const StepData& step, const VehicleStep& of_vehicle) {
  wire::Truth sample;
  sample.vehicle(of_vehicle.vehicle);
  sample.header(header_of(run, step.step, step.time_s));
  sample.T_world_body(of_vehicle.truth.T_world_body);
  sample.velocity_world(of_vehicle.truth.velocity_world);
  sample.turn_body(of_vehicle.truth.turn_body);
  return sample;
}

}  // namespace convoy::simulator
