#include "route_follower.hpp"

#include "parameter_check.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace convoy::simulator {
namespace {

constexpr double corner_rad = 0.5;      // robots turn on the spot where the line turns by more
constexpr double speed_gain_ps = 3.0;   // acceleration per error of speed
constexpr double halt_within_m = 0.03;  // of where it has to stand
constexpr double standing_mps = 0.02;
constexpr double plan_spacing_m = 0.5;

}  // namespace

void RouteFollowerParams::validate(const std::string& where) const {
  check_range(where + ".speed_mps", speed_mps, 0.1, 10.0, "m/s");
  check_range(where + ".offset_m", offset_m, -20.0, 20.0, "m");
  check_range(where + ".lateral_acceleration_mps2", lateral_acceleration_mps2, 0.1, 6.0, "m/s^2");
  check_range(where + ".acceleration_mps2", acceleration_mps2, 0.1, 5.0, "m/s^2");
  check_range(where + ".deceleration_mps2", deceleration_mps2, 0.1, 6.0, "m/s^2");
  check_range(where + ".lookahead_m", lookahead_m, 0.2, 20.0, "m");
  check_range(where + ".lookahead_s", lookahead_s, 0.0, 3.0, "s");
  check_that(laps >= 0, where + ".laps", "less than none; 0 is for ever");
  for (std::size_t i = 0; i < stops.size(); ++i) {
    const std::string stop = where + ".stops[" + std::to_string(i) + "]";
    check_range(stop + ".at_m", stops[i].at_m, i > 0 ? stops[i - 1].at_m : 0.0, 1e9, "m, in order");
    check_range(stop + ".wait_s", stops[i].wait_s, 0.0, 1e6, "s");
  }
}

RouteFollower::RouteFollower(const Route& route, const RouteFollowerParams& params, const VehicleParams& vehicle)
    : line_(route, params.offset_m), params_(params), vehicle_(vehicle) {
  params.validate();
  vehicle.validate();
  if (vehicle.kind == VehicleKind::Robot) corners_m_ = line_.corners_m(corner_rad);
  plan_speeds();
}

RouteFollower::Start RouteFollower::start(double abscissa_m) const {
  const double way = line_.way_of_abscissa_m(abscissa_m);
  return {line_.point(way).x(), line_.point(way).y(), line_.heading_rad(way + 0.01)};
}

// As fast as bends allow, and slowed down for them in time.
void RouteFollower::plan_speeds() {
  const auto count = static_cast<std::size_t>(line_.length_m() / plan_spacing_m) + 1;
  for (std::size_t i = 0; i < count; ++i) {
    const double way = static_cast<double>(i) * plan_spacing_m;
    double bend = std::abs(line_.curvature_pm(way));
    if (std::ranges::any_of(corners_m_, [&](double corner) { return std::abs(corner - way) < 1.5; })) bend = 0.0;
    speeds_mps_.push_back(std::min(params_.speed_mps, std::sqrt(params_.lateral_acceleration_mps2 / (bend + 1e-9))));
  }
  for (std::size_t i = line_.closed() ? 2 * count : count; i-- > 1;) {
    double& here = speeds_mps_[(i - 1) % count];
    const double next = speeds_mps_[i % count];
    if (i < count || line_.closed())
      here = std::min(here, std::sqrt(next * next + 2.0 * params_.deceleration_mps2 * plan_spacing_m));
  }
}

double RouteFollower::planned_mps(double way_m) const {
  const double lap = line_.length_m();
  const double way = line_.closed() ? way_m - lap * std::floor(way_m / lap) : std::clamp(way_m, 0.0, lap);
  const auto i = std::min(static_cast<std::size_t>(way / plan_spacing_m), speeds_mps_.size() - 1);
  const std::size_t next = i + 1 < speeds_mps_.size() ? i + 1 : (line_.closed() ? 0 : i);
  const double part = std::min(1.0, way / plan_spacing_m - static_cast<double>(i));
  return speeds_mps_[i] + (speeds_mps_[next] - speeds_mps_[i]) * part;
}

double RouteFollower::abscissa_m() const {
  const double abscissa = line_.abscissa_m(place_.way_m);
  return line_.closed() ? abscissa - line_.route_length_m() * std::floor(abscissa / line_.route_length_m()) : abscissa;
}

double RouteFollower::driven_m() const { return line_.abscissa_m(place_.way_m) - start_abscissa_m_; }

void RouteFollower::begin(const VehicleState& state) {
  place_ = line_.find(state.T_world_body.translation().head<2>(), state.yaw_rad());
  start_abscissa_m_ = line_.abscissa_m(place_.way_m);
  corner_done_way_m_ = place_.way_m + halt_within_m;
  begun_ = true;
}

RouteFollower::Halt RouteFollower::next_halt() const {
  Halt next;
  const auto consider = [&](HaltKind kind, double way_m) {
    if (next.kind == HaltKind::None || way_m < next.way_m) next = {kind, way_m};
  };
  if (!line_.closed()) consider(HaltKind::End, line_.length_m());
  const double lap = line_.length_m();
  if (line_.closed() && params_.laps > 0)
    consider(HaltKind::End, line_.way_of_abscissa_m(start_abscissa_m_ + params_.laps * line_.route_length_m()));
  if (stops_done_ < params_.stops.size())
    consider(HaltKind::Stop, line_.way_of_abscissa_m(start_abscissa_m_ + params_.stops[stops_done_].at_m));
  for (double corner : corners_m_) {
    if (line_.closed()) corner += lap * std::ceil((corner_done_way_m_ + 1e-6 - corner) / lap);
    if (corner > corner_done_way_m_) consider(HaltKind::TurnOnSpot, corner);
  }
  return next;
}

double RouteFollower::wanted_at_mps(double way_m, const Halt& halt) const {
  const double planned = planned_mps(way_m);
  if (halt.kind == HaltKind::None) return planned;
  const double left_m = std::max(0.0, halt.way_m - way_m - 0.5 * halt_within_m);
  return std::min(planned, std::max(0.1, std::sqrt(2.0 * params_.deceleration_mps2 * left_m)));
}

// A robot drives straight up to a corner, and a vehicle to its end.
Eigen::Vector2d RouteFollower::aim(double way_m, const Halt& halt) const {
  const bool straight_on = halt.kind == HaltKind::TurnOnSpot || halt.kind == HaltKind::End;
  if (!straight_on || way_m < halt.way_m) return line_.point(way_m);
  const double heading = line_.heading_rad(halt.way_m - 1e-3);
  return line_.point(halt.way_m) + (way_m - halt.way_m) * Eigen::Vector2d(std::cos(heading), std::sin(heading));
}

// From where the vehicle is when its steering has answered.
Eigen::Vector2d RouteFollower::aim_in_body(const VehicleState& state, const Halt& halt) const {
  const double speed = std::max(0.0, state.speed_mps);
  const double lag_s = vehicle_.kind == VehicleKind::Car ? vehicle_.steering_lag_s : 0.0;
  const double turn = speed * std::tan(state.steering_rad) / vehicle_.wheelbase_m;
  const double yaw = state.yaw_rad();
  const Eigen::Vector2d from =
      state.T_world_body.translation().head<2>() + speed * lag_s * Eigen::Vector2d(std::cos(yaw), std::sin(yaw));
  const double scale = vehicle_.kind == VehicleKind::Car ? 1.0 : 0.5;
  const double ahead_m = scale * params_.lookahead_m + (params_.lookahead_s + lag_s) * speed;
  return Eigen::Rotation2Dd(-yaw - turn * lag_s) * (aim(place_.way_m + ahead_m, halt) - from);
}

DriveCommand RouteFollower::step(const VehicleState& state) {
  if (!begun_) begin(state);
  place_ = line_.find_near(state.T_world_body.translation().head<2>(), place_.way_m, 1.0, 2.0);
  const Halt halt = next_halt();
  const bool there = halt.kind != HaltKind::None && place_.way_m > halt.way_m - halt_within_m;
  return there ? stand_at(halt, state) : drive_to(halt, state);
}

DriveCommand RouteFollower::stand_at(const Halt& halt, const VehicleState& state) {
  DriveCommand command;
  command.brake_mps2 = std::max(2.0, params_.deceleration_mps2);
  command.steering_rad = state.steering_rad;
  wanted_mps_ = 0.0;
  if (std::abs(state.speed_mps) > standing_mps && halted_since_s_ < 0.0) return command;
  if (halted_since_s_ < 0.0) halted_since_s_ = state.time_s;
  bool done = false;
  if (halt.kind == HaltKind::Stop) {
    waiting_ = true;
    done = state.time_s - halted_since_s_ >= params_.stops[stops_done_].wait_s;
    if (done) ++stops_done_, waiting_ = false;
  } else if (halt.kind == HaltKind::TurnOnSpot) {
    const double missing = wrapped_rad(line_.heading_rad(halt.way_m + 1e-3) - state.yaw_rad());
    command.yaw_rate_radps = std::clamp(3.0 * missing, -1.0, 1.0);
    done = std::abs(missing) < 0.02;
    if (done) corner_done_way_m_ = halt.way_m + halt_within_m;
  } else {
    finished_ = true;
  }
  if (done) halted_since_s_ = -1.0;
  return command;
}

DriveCommand RouteFollower::drive_to(const Halt& halt, const VehicleState& state) {
  DriveCommand command;
  const bool car = vehicle_.kind == VehicleKind::Car;
  const Eigen::Vector2d to = aim_in_body(state, halt);
  const double bearing = std::atan2(to.y(), to.x());
  const double curvature = 2.0 * to.y() / std::max(to.squaredNorm(), 1e-6);
  turning_ = !car && std::abs(bearing) > (turning_ ? 0.1 : 0.7);
  const double speed = state.speed_mps, soon = place_.way_m + 0.1 * std::max(0.0, speed);
  wanted_mps_ = turning_ ? 0.0 : wanted_at_mps(place_.way_m, halt);
  const double change = turning_ ? 0.0 : (wanted_at_mps(soon, halt) - wanted_mps_) / 0.1;
  double wanted = speed_gain_ps * (wanted_mps_ - speed) + std::clamp(change, -params_.deceleration_mps2, 0.0);
  wanted = std::min(wanted, params_.acceleration_mps2);
  if (car) {  // what slope and tyres take
    wanted += VehiclePhysics::gravity_mps2 * state.T_world_body(2, 0);
    if (speed > standing_mps || wanted > 0.0) wanted += vehicle_.rolling_resistance * VehiclePhysics::gravity_mps2;
    command.steering_rad = std::atan(vehicle_.wheelbase_m * curvature);
  } else {
    command.yaw_rate_radps = turning_ ? std::clamp(3.0 * bearing, -1.0, 1.0) : curvature * std::max(speed, 0.05);
  }
  (wanted >= 0.0 ? command.drive_mps2 : command.brake_mps2) = std::abs(wanted);
  return command;
}

}  // namespace convoy::simulator
