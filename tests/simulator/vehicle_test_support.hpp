// Ground to drive on and a driver of few thoughts, for tests of the vehicle.
#pragma once

#include "vehicle_physics.hpp"

#include <cmath>

namespace convoy::simulator {

struct Slope final : Ground {
  double east = 0.0, north = 0.0, waves_m = 0.0;
  double height_m(double x_m, double y_m) const override {
    return east * x_m + north * y_m + waves_m * std::sin(2.0 * x_m) * std::sin(1.7 * y_m);
  }
};

constexpr double g = VehiclePhysics::gravity_mps2;
constexpr int per_second = 240;

inline void run(VehiclePhysics& vehicle, const DriveCommand& command, double seconds) {
  for (int i = 0; i < static_cast<int>(seconds * per_second); ++i) vehicle.step(command);
}

/// Holds the speed about as a driver does.
inline DriveCommand at_speed(const VehiclePhysics& vehicle, double speed_mps, double steering_rad = 0.0) {
  DriveCommand command;
  command.drive_mps2 = 2.0 * (speed_mps - vehicle.state().speed_mps) + 0.012 * g;
  command.steering_rad = steering_rad;
  return command;
}

inline void hold_speed(VehiclePhysics& vehicle, double speed_mps, double seconds, double steering_rad = 0.0) {
  for (int i = 0; i < static_cast<int>(seconds * per_second); ++i)
    vehicle.step(at_speed(vehicle, speed_mps, steering_rad));
}

inline Eigen::Vector3d position(const VehiclePhysics& vehicle) { return vehicle.state().T_world_body.translation(); }

}  // namespace convoy::simulator
