#include "vehicle_params.hpp"

#include "parameter_check.hpp"

namespace convoy::simulator {
namespace {

void check_shape(const VehicleParams& p, const std::string& where) {
  check_range(where + ".mass_kg", p.mass_kg, 1.0, 40000.0, "kg");
  check_range(where + ".wheelbase_m", p.wheelbase_m, 0.1, 10.0, "m");
  check_range(where + ".track_m", p.track_m, 0.1, 4.0, "m");
  check_range(where + ".wheel_radius_m", p.wheel_radius_m, 0.02, 1.0, "m");
  check_range(where + ".centre_ahead_m", p.centre_ahead_m, 0.05 * p.wheelbase_m, 0.95 * p.wheelbase_m,
              "m, between the axles");
  check_range(where + ".centre_height_m", p.centre_height_m, 0.02, 3.0, "m");
  check_range(where + ".length_m", p.length_m, p.wheelbase_m, 15.0, "m, at least the wheelbase");
  check_range(where + ".width_m", p.width_m, 0.1, 4.0, "m");
  check_range(where + ".clearance_m", p.clearance_m, 0.01, 1.0, "m");
  check_range(where + ".height_m", p.height_m, p.clearance_m + 0.05, 5.0, "m, above the clearance");
}

void check_running_gear(const VehicleParams& p, const std::string& where) {
  check_range(where + ".deflection_m", p.deflection_m, 0.002, 0.3, "m");
  check_range(where + ".damping_ratio", p.damping_ratio, 0.05, 1.5, "");
  check_range(where + ".travel_m", p.travel_m, 0.002, 0.4, "m");
  check_range(where + ".anti_roll_npm", p.anti_roll_npm, 0.0, 1e6, "N/m");
  check_range(where + ".friction", p.friction, 0.05, 2.0, "");
  check_range(where + ".cornering_stiffness", p.cornering_stiffness, 1.0, 100.0, "1/rad");
  check_range(where + ".rolling_resistance", p.rolling_resistance, 0.0, 0.2, "");
}

void check_controls(const VehicleParams& p, const std::string& where) {
  check_range(where + ".max_drive_mps2", p.max_drive_mps2, 0.05, 15.0, "m/s^2");
  check_range(where + ".max_brake_mps2", p.max_brake_mps2, 0.1, 30.0, "m/s^2");
  check_range(where + ".max_steering_rad", p.max_steering_rad, 0.05, 1.2, "rad");
  check_range(where + ".steering_rate_radps", p.steering_rate_radps, 0.05, 20.0, "rad/s");
  check_range(where + ".steering_lag_s", p.steering_lag_s, 0.0, 2.0, "s");
  check_range(where + ".max_yaw_rate_radps", p.max_yaw_rate_radps, 0.05, 10.0, "rad/s");
  check_range(where + ".yaw_acceleration_radps2", p.yaw_acceleration_radps2, 0.05, 100.0, "rad/s^2");
}

}  // namespace

void VehicleParams::validate(const std::string& where) const {
  check_shape(*this, where);
  check_running_gear(*this, where);
  check_controls(*this, where);
}

VehicleParams robot_params() {
  VehicleParams p;
  p.kind = VehicleKind::Robot;
  p.mass_kg = 40.0;
  p.wheelbase_m = 0.4;
  p.track_m = 0.45;
  p.wheel_radius_m = 0.1;
  p.centre_ahead_m = 0.12;
  p.centre_height_m = 0.2;
  p.length_m = 0.6;
  p.width_m = 0.45;
  p.height_m = 0.6;
  p.clearance_m = 0.06;
  p.deflection_m = 0.012;
  p.damping_ratio = 0.5;
  p.travel_m = 0.02;
  p.anti_roll_npm = 500.0;
  p.max_drive_mps2 = 1.5;
  p.max_brake_mps2 = 3.0;
  return p;
}

}  // namespace convoy::simulator
