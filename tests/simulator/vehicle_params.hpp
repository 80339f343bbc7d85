// What a vehicle is like.
#pragma once

#include <string>

namespace convoy::simulator {

enum class VehicleKind {
  Car,   ///< two steered wheels in front, brakes and drive on all four
  Robot  ///< two driven wheels at the rear, two castors in front: turns on the spot
};

/// Defaults are those of a small car; see robot_params() for the other kind. Each field's range is checked.
struct VehicleParams {
  VehicleKind kind = VehicleKind::Car;

  double mass_kg = 1200.0;        ///< 1 to 40000
  double wheelbase_m = 2.6;       ///< rear axle to front axle, 0.1 to 10
  double track_m = 1.5;           ///< left to right wheel, 0.1 to 4
  double wheel_radius_m = 0.3;    ///< of the rolling wheel under load, 0.02 to 1
  double centre_ahead_m = 1.3;    ///< centre of mass ahead of the rear axle, more than 0, less than the wheelbase
  double centre_height_m = 0.55;  ///< centre of mass above the ground, 0.02 to 3
  double length_m = 4.2;          ///< of the body, the wheelbase to 15
  double width_m = 1.75;          ///< of the body, 0.1 to 4
  double height_m = 1.45;         ///< top of the body above the ground, more than the clearance, to 5
  double clearance_m = 0.16;      ///< bottom of the body above the ground, 0.01 to 1

  double deflection_m = 0.08;         ///< of the springs under the resting body, 0.002 to 0.3: 0.08 swings at 1.8 Hz
  double damping_ratio = 0.35;        ///< of one wheel's share of the body, 0.05 to 1.5
  double travel_m = 0.09;             ///< from rest to the bump stop, 0.002 to 0.4
  double anti_roll_npm = 12000.0;     ///< per axle: force for a difference in height of its wheels [N/m], 0 to 1e6
  double friction = 0.9;              ///< of tyre on road, 0.05 to 2
  double cornering_stiffness = 14;    ///< lateral force / load, per radian of slip angle, 1 to 100
  double rolling_resistance = 0.012;  ///< force / load, 0 to 0.2

  double max_drive_mps2 = 3.0;  ///< 0.05 to 15
  double max_brake_mps2 =
      12.0;  ///< more than friction allows is to be had from the brakes, not from the road; 0.1 to 30
  double max_steering_rad = 0.6;         ///< of the single-track model's wheel, 0.05 to 1.2; cars only
  double steering_rate_radps = 0.8;      ///< 0.05 to 20; cars only
  double steering_lag_s = 0.1;           ///< first-order, 0 to 2; cars only
  double max_yaw_rate_radps = 1.5;       ///< 0.05 to 10; robots only
  double yaw_acceleration_radps2 = 3.0;  ///< 0.05 to 100; robots only

  /// Throws std::invalid_argument that names the field, its value and its range.
  void validate(const std::string& where = "VehicleParams") const;
};

/// A delivery robot of 40 kg, 0.6 m long.
VehicleParams robot_params();

}  // namespace convoy::simulator
