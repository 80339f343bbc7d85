// The driver: keeps a vehicle on a line beside its route, at a set speed, slower in bends, with stops. Pure pursuit
// (Coulter, CMU-RI-TR-92-01), from where the vehicle is when its steering has answered.
#pragma once

#include "route_line.hpp"
#include "vehicle_physics.hpp"

#include <vector>

namespace convoy::simulator {

struct RouteStop {
  double at_m = 0.0;    ///< driven since the start, along the route, >= 0; goes on from lap to lap
  double wait_s = 5.0;  ///< 0 to 1e6
};

struct RouteFollowerParams {
  double speed_mps = 2.0;                  ///< 0.1 to 10
  double offset_m = 0.0;                   ///< to the left of the route, -20 to 20
  double lateral_acceleration_mps2 = 2.0;  ///< slower in bends than this, 0.1 to 6
  double acceleration_mps2 = 1.0;          ///< 0.1 to 5
  double deceleration_mps2 = 1.5;          ///< 0.1 to 6
  double lookahead_m = 1.2;                ///< standing, 0.2 to 20
  double lookahead_s = 0.35;               ///< more of it per speed, 0 to 3
  int laps = 0;                            ///< of a closed route, then it stops; 0: for ever
  std::vector<RouteStop> stops;            ///< at_m rising

  /// Throws std::invalid_argument that names the field, its value and its range.
  void validate(const std::string& where = "RouteFollowerParams") const;
};

/// Keeps to the line within 0.3 m where the vehicle can drive its bends. Robots turn on the spot at corners.
class RouteFollower {
 public:
  /// Throws std::invalid_argument for what is out of range, see also RouteLine.
  RouteFollower(const Route& route, const RouteFollowerParams& params, const VehicleParams& vehicle);

  struct Start {
    double x_m = 0.0, y_m = 0.0, yaw_rad = 0.0;
  };
  /// On the line, at that abscissa of the route [m].
  Start start(double abscissa_m = 0.0) const;

  /// To be called once per step of the vehicle, with its true state.
  DriveCommand step(const VehicleState& state);

  double abscissa_m() const;                                ///< along the route; of a closed one within the lap
  double driven_m() const;                                  ///< along the route since the first step
  double lateral_error_m() const { return place_.left_m; }  ///< to the left of the line
  double wanted_speed_mps() const { return wanted_mps_; }
  bool waiting() const { return waiting_; }    ///< at a stop
  bool finished() const { return finished_; }  ///< at the end of the route, standing

 private:
  enum class HaltKind { None, Stop, TurnOnSpot, End };
  struct Halt {
    HaltKind kind = HaltKind::None;
    double way_m = 0.0;
  };

  void begin(const VehicleState& state);
  void plan_speeds();
  double planned_mps(double way_m) const;
  Halt next_halt() const;
  double wanted_at_mps(double way_m, const Halt& halt) const;
  Eigen::Vector2d aim(double way_m, const Halt& halt) const;
  Eigen::Vector2d aim_in_body(const VehicleState& state, const Halt& halt) const;
  DriveCommand stand_at(const Halt& halt, const VehicleState& state);
  DriveCommand drive_to(const Halt& halt, const VehicleState& state);

  RouteLine line_;
  RouteFollowerParams params_;
  VehicleParams vehicle_;
  std::vector<double> speeds_mps_;  // at even distances along the line
  std::vector<double> corners_m_;
  RouteLine::Place place_;
  double start_abscissa_m_ = 0.0, corner_done_way_m_ = 0.0, halted_since_s_ = -1.0, wanted_mps_ = 0.0;
  std::size_t stops_done_ = 0;
  bool begun_ = false, waiting_ = false, finished_ = false, turning_ = false;
};

}  // namespace convoy::simulator
