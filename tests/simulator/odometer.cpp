#include "odometer.hpp"

#include "parameter_check.hpp"

#include <algorithm>
#include <cmath>

namespace convoy::simulator {
namespace {

constexpr std::uint32_t run_stream = 0x6f646f01, reading_stream = 0x6f646f02, slip_stream = 0x6f646f03;
constexpr double cell_m = 1.0;  // of the way, in each of which a slip event may begin

double square(double x) { return x * x; }

std::uint64_t interval_steps(double rate_hz) { return static_cast<std::uint64_t>(std::lround(240.0 / rate_hz)); }

}  // namespace

void OdometerParams::validate(const std::string& where) const {
  check_range(where + ".rate_hz", rate_hz, 1.0, 240.0, "Hz");
  check_that(std::abs(240.0 / rate_hz - std::round(240.0 / rate_hz)) < 1e-9, where + ".rate_hz",
             "240 / rate_hz is not whole; take 10, 12, 20, 24 or the like");
  check_range(where + ".wheel_radius_sigma", wheel_radius_sigma, 0.0, 0.1, "");
  check_range(where + ".track_sigma", track_sigma, 0.0, 0.2, "");
  check_range(where + ".slip_per_force", slip_per_force, 0.0, 1.0, "");
  check_range(where + ".slip_per_lateral_force", slip_per_lateral_force, 0.0, 1.0, "");
  check_range(where + ".slip_events_per_km", slip_events_per_km, 0.0, 100.0, "1/km");
  check_range(where + ".slip_event_share", slip_event_share, 0.0, 0.6, "");
  check_range(where + ".slip_event_s", slip_event_s, 0.01, 10.0, "s");
  check_range(where + ".ticks_per_turn", ticks_per_turn, 0.0, 1e6, "");
  check_range(where + ".gyro_noise_radps", gyro_noise_radps, 0.0, 1.0, "rad/s");
  check_range(where + ".gyro_bias_radps", gyro_bias_radps, 0.0, 1.0, "rad/s");
  check_range(where + ".gyro_bias_walk_radps_sqrts", gyro_bias_walk_radps_sqrts, 0.0, 0.1, "rad/s/sqrt(s)");
  check_range(where + ".gyro_scale_sigma", gyro_scale_sigma, 0.0, 0.1, "");
  check_range(where + ".time_jitter_s", time_jitter_s, 0.0, 0.1, "s");
}

Odometer::Odometer(const OdometerParams& params, const VehicleParams& vehicle, std::uint32_t seed,
                   std::uint32_t vehicle_number)
    : params_(params), vehicle_(vehicle), seed_(seed), number_(vehicle_number) {
  params.validate();
  vehicle.validate();
  Stream run({seed_, number_, run_stream, 0});
  const auto within = [&](double sigma) { return std::clamp(sigma * run.gaussian(), -5.0 * sigma, 5.0 * sigma); };
  for (double& error : truth_.wheel_radius_error) error = within(params.wheel_radius_sigma);
  truth_.track_error = within(params.track_sigma);
  truth_.gyro_scale_error = within(params.gyro_scale_sigma);
  truth_.gyro_bias_radps = params.gyro_bias_radps * run.gaussian();
  for (std::size_t i = 0; i < 2; ++i) {
    truth_.tick_phase[i] = run.uniform(0.0, 1.0);
    if (params.ticks_per_turn > 0) angle_rad_[i] = truth_.tick_phase[i] * 2.0 * M_PI / params.ticks_per_turn;
    read_angle_rad_[i] = angle_rad_[i];
  }
}

std::optional<OdometerReading> Odometer::step(const VehicleState& state) {
  if (!last_step_) {
    last_step_ = state.step;
    for (std::size_t i = 0; i < 2; ++i) true_angle_rad_[i] = state.wheels[RearLeft + i].angle_rad;
    return std::nullopt;
  }
  check_that(state.step > *last_step_, "Odometer::step", "the vehicle's steps do not rise; hand them over in order");
  turned_rad_ += state.turn_body_radps.z() * static_cast<double>(state.step - *last_step_) / 240.0;
  last_step_ = state.step;
  begin_slip_events(state);
  turn_wheels(state);
  if (state.step % interval_steps(params_.rate_hz) != 0) return std::nullopt;
  return read(state);
}

void Odometer::begin_slip_events(const VehicleState& state) {
  truth_.slipping = state.time_s < event_.until_s;
  for (; (cell_ + 1) * cell_m <= way_m_; ++cell_) {
    Stream stream({seed_, number_, slip_stream, cell_});
    if (!stream.chance(params_.slip_events_per_km * cell_m / 1000.0)) continue;
    ++truth_.slip_events;
    truth_.slipping = true;
    event_.share = params_.slip_event_share * stream.uniform(0.5, 1.5);
    event_.until_s = state.time_s + params_.slip_event_s * stream.uniform(0.5, 1.5);
    const std::uint32_t which = stream.below(3);  // left, right, both
    event_.wheels = {which != 1, which != 0};
  }
}

void Odometer::turn_wheels(const VehicleState& state) {
  double way = 0.0;
  for (std::size_t i = 0; i < 2; ++i) {
    const WheelState& wheel = state.wheels[RearLeft + i];
    const double turn = wheel.angle_rad - true_angle_rad_[i];
    true_angle_rad_[i] = wheel.angle_rad;
    way += 0.5 * turn * vehicle_.wheel_radius_m;
    double slip = 0.0;  // turned ahead more than rolled, per turn
    if (wheel.normal_n > 0.0) {
      slip = params_.slip_per_force * wheel.longitudinal_n / wheel.normal_n;
      slip += std::copysign(params_.slip_per_lateral_force * square(wheel.lateral_n / wheel.normal_n), turn);
    }
    const double driven = wheel.longitudinal_n * turn < 0.0 ? -1.0 : 1.0;
    if (truth_.slipping && event_.wheels[i]) slip += std::copysign(event_.share, driven * turn);
    angle_rad_[i] += (turn + slip * std::abs(turn)) / (1.0 + truth_.wheel_radius_error[i]);
  }
  way_m_ += std::abs(way);
}

OdometerReading Odometer::read(const VehicleState& state) {
  OdometerReading reading;
  reading.frame = ++frame_;
  const double period_s = 1.0 / params_.rate_hz;
  Stream stream({seed_, number_, reading_stream, frame_});
  const double cut_s = 0.45 * period_s;
  reading.stamp_s = state.time_s + std::clamp(params_.time_jitter_s * stream.gaussian(), -cut_s, cut_s);

  std::array<double, 2> ways_m{};
  std::array<std::int64_t, 2> ticks{};
  for (std::size_t i = 0; i < 2; ++i) {
    double turn = angle_rad_[i] - read_angle_rad_[i];
    read_angle_rad_[i] = angle_rad_[i];
    if (params_.ticks_per_turn > 0) {
      const double tick_rad = 2.0 * M_PI / params_.ticks_per_turn;
      const auto count = static_cast<std::int64_t>(std::floor(angle_rad_[i] / tick_rad));
      ticks[i] = count - read_ticks_[i];
      read_ticks_[i] = count;
      turn = static_cast<double>(ticks[i]) * tick_rad;
    }
    ways_m[i] = turn * vehicle_.wheel_radius_m;
  }
  reading.left_ticks = ticks[0];
  reading.right_ticks = ticks[1];
  reading.distance_m = 0.5 * (ways_m[0] + ways_m[1]);
  reading.speed_mps = reading.distance_m / period_s;
  reading.wheels_yaw_rate_radps = (ways_m[1] - ways_m[0]) / (vehicle_.track_m * (1.0 + truth_.track_error)) / period_s;

  truth_.gyro_bias_radps += params_.gyro_bias_walk_radps_sqrts * std::sqrt(period_s) * stream.gaussian();
  reading.gyro_yaw_rate_radps = (1.0 + truth_.gyro_scale_error) * turned_rad_ / period_s + truth_.gyro_bias_radps +
                                params_.gyro_noise_radps * stream.gaussian();
  turned_rad_ = 0.0;
  state_sigmas(reading, period_s * frame_, ways_m[0], ways_m[1]);
  return reading;
}

// A difference of two counts of ticks has the variance of two roundings, tick^2 / 6.
void Odometer::state_sigmas(OdometerReading& reading, double time_s, double left_m, double right_m) const {
  const double tick_m =
      params_.ticks_per_turn > 0 ? 2.0 * M_PI * vehicle_.wheel_radius_m / params_.ticks_per_turn : 0.0;
  const double of_wheels =
      square(params_.wheel_radius_sigma) * (square(left_m) + square(right_m)) + square(tick_m) / 3.0;
  reading.sigma_distance_m = 0.5 * std::sqrt(of_wheels);
  reading.sigma_wheels_yaw_rate_radps = std::sqrt(of_wheels * square(params_.rate_hz / vehicle_.track_m) +
                                                  square(params_.track_sigma * reading.wheels_yaw_rate_radps));
  reading.sigma_gyro_yaw_rate_radps = std::sqrt(square(params_.gyro_noise_radps) + square(params_.gyro_bias_radps) +
                                                square(params_.gyro_bias_walk_radps_sqrts) * time_s +
                                                square(params_.gyro_scale_sigma * reading.gyro_yaw_rate_radps));
}

}  // namespace convoy::simulator
