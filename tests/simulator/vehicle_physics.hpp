// A vehicle that drives on the ground: springs, dampers, anti-roll bars, tyres that hold as far as friction goes, a
// steering that lags. It collides with nothing but the ground. Frames: see scene.hpp.
#pragma once

#include "ground.hpp"
#include "vehicle_params.hpp"

#include <Eigen/Geometry>

#include <array>
#include <cstdint>
#include <memory>

namespace convoy::simulator {

enum Wheel : std::size_t { FrontLeft, FrontRight, RearLeft, RearRight };

struct WheelState {
  double angle_rad = 0.0;       ///< turned since the start, forwards positive; rolls without longitudinal slip
  double speed_radps = 0.0;     ///< mean of the last step
  double steering_rad = 0.0;    ///< of this wheel, to the left positive
  double normal_n = 0.0;        ///< load [N]; 0 in the air
  double longitudinal_n = 0.0;  ///< force of the road on the tyre, ahead positive [N]
  double lateral_n = 0.0;       ///< to the left positive [N]
  double spring_m = 0.0;        ///< compression as against the resting vehicle; positive: compressed
};

struct VehicleState {
  std::uint64_t step = 0;  ///< since the start
  double time_s = 0.0;     ///< step / 240 Hz
  /// The pitched and rolled body. Its origin is on the ground under the middle of the rear axle while the springs are
  /// as at rest on level ground.
  Eigen::Isometry3d T_world_body = Eigen::Isometry3d::Identity();
  Eigen::Vector3d velocity_world_mps = Eigen::Vector3d::Zero();  ///< of the body's origin
  Eigen::Vector3d turn_body_radps = Eigen::Vector3d::Zero();     ///< angular velocity: roll, pitch, yaw rate
  double speed_mps = 0.0;     ///< of the origin along the body's x, negative in reverse
  double steering_rad = 0.0;  ///< of the single-track model's wheel: the middle of a car's front wheels
  std::array<WheelState, 4> wheels;

  double yaw_rad() const;    ///< of the body's x, (-pi, pi]
  double pitch_rad() const;  ///< nose down positive
  double roll_rad() const;   ///< right side down positive
};

/// What the driver does. What is beyond the vehicle's limits is cut to them; NaN throws std::invalid_argument.
struct DriveCommand {
  double drive_mps2 = 0.0;      ///< acceleration on level ground, negative: backwards
  double brake_mps2 = 0.0;      ///< >= 0; slows whatever moves, holds what does not
  double steering_rad = 0.0;    ///< cars: of the single-track model's wheel, tan = wheelbase / radius of the turn
  double yaw_rate_radps = 0.0;  ///< robots
};

/// Steps of 1 / 240 s. To the bit the same for the same inputs, whatever else is there. The ground has to outlive it.
class VehiclePhysics {
 public:
  static constexpr double rate_hz = 240.0;
  static constexpr double gravity_mps2 = 9.81;

  /// Stands at (x, y), settled, with the brakes on. Throws std::invalid_argument for parameters out of range and for
  /// ground that is no number or too steep to stand on.
  VehiclePhysics(const VehicleParams& params, const Ground& ground, double x_m, double y_m, double yaw_rad);
  ~VehiclePhysics();
  VehiclePhysics(VehiclePhysics&&) noexcept;
  VehiclePhysics& operator=(VehiclePhysics&&) noexcept;

  /// One step. Throws std::invalid_argument where the ground's height is no number; the vehicle is of no use then.
  void step(const DriveCommand& command);
  const VehicleState& state() const;
  const VehicleParams& params() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace convoy::simulator
