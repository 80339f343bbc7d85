// What the wheels and a yaw gyro tell of the way gone. Errors are those of real ones: wheels of other radii than the
// stated, a track of another width, slip, ticks, a bias that walks, stamps that jitter.
#pragma once

#include "random.hpp"
#include "vehicle_physics.hpp"

#include <array>
#include <cstdint>
#include <optional>
#include <string>

namespace convoy::simulator {

struct OdometerParams {
  double rate_hz = 20.0;  ///< 1 to 240, so that 240 / rate_hz is whole

  // Drawn once per run.
  double wheel_radius_sigma = 0.005;  ///< of each wheel, relative, 0 to 0.1
  double track_sigma = 0.01;          ///< of the width stated, relative, 0 to 0.2

  // A slipping wheel turns more than the way it goes, a braked one less.
  double slip_per_force = 0.03;          ///< relative turn for longitudinal force / load, 0 to 1
  double slip_per_lateral_force = 0.01;  ///< relative turn for (lateral force / load)^2, 0 to 1
  double slip_events_per_km = 0.5;       ///< 0 to 100
  double slip_event_share = 0.15;        ///< relative turn meanwhile, times 0.5 to 1.5; 0 to 0.6
  double slip_event_s = 0.5;             ///< its duration, times 0.5 to 1.5; 0.01 to 10

  int ticks_per_turn = 2048;  ///< of each wheel's encoder, 0 (exact) to 10^6

  double gyro_noise_radps = 0.002;           ///< white, of each reading, 0 to 1
  double gyro_bias_radps = 0.001;            ///< sigma at the start, 0 to 1
  double gyro_bias_walk_radps_sqrts = 2e-5;  ///< sigma after one second, growing with the root of time, 0 to 0.1
  double gyro_scale_sigma = 0.002;           ///< relative, drawn once per run, 0 to 0.1

  double time_jitter_s = 0.001;  ///< sigma of the stamps, cut at 0.45 periods; 0 to 0.1

  /// Throws std::invalid_argument that names the field, its value and its range.
  void validate(const std::string& where = "OdometerParams") const;
};

/// Of the time since the reading before; the first one tells of the time since the start.
struct OdometerReading {
  std::uint32_t frame = 0;                       ///< 1, 2, ...
  double stamp_s = 0.0;                          ///< of its end, jitter included
  std::int64_t left_ticks = 0, right_ticks = 0;  ///< of the rear wheels; 0 where ticks_per_turn is
  double distance_m = 0.0;                       ///< of the middle of the rear axle, forwards positive
  double speed_mps = 0.0;                        ///< distance / nominal period
  double wheels_yaw_rate_radps = 0.0;            ///< from the difference of the rear wheels
  double gyro_yaw_rate_radps = 0.0;              ///< mean of the period, about the body's z

  // One sigma of the above over all runs: what is drawn once per run, ticks, bias and noise. Slip comes on top.
  double sigma_distance_m = 0.0, sigma_wheels_yaw_rate_radps = 0.0, sigma_gyro_yaw_rate_radps = 0.0;
};

class Odometer {
 public:
  /// Throws std::invalid_argument for parameters out of range.
  Odometer(const OdometerParams& params, const VehicleParams& vehicle, std::uint32_t seed,
           std::uint32_t vehicle_number);

  /// To be called with each step's state, the first (standing) one included; tells a reading when one is due. Throws
  /// std::invalid_argument if steps do not rise.
  std::optional<OdometerReading> step(const VehicleState& state);

  /// What this run's errors are, to judge by.
  struct Truth {
    std::array<double, 2> wheel_radius_error{};  ///< relative, rear left and right
    std::array<double, 2> tick_phase{};          ///< the wheels stand between two ticks, 0 to 1
    double track_error = 0.0, gyro_scale_error = 0.0, gyro_bias_radps = 0.0;
    std::uint32_t slip_events = 0;  ///< begun so far
    bool slipping = false;          ///< an event lasts
  };
  const Truth& truth() const { return truth_; }

 private:
  struct SlipEvent {
    double until_s = -1.0, share = 0.0;
    std::array<bool, 2> wheels{};
  };

  void turn_wheels(const VehicleState& state);
  void begin_slip_events(const VehicleState& state);
  OdometerReading read(const VehicleState& state);
  void state_sigmas(OdometerReading& reading, double time_s, double left_m, double right_m) const;

  OdometerParams params_;
  VehicleParams vehicle_;
  std::uint32_t seed_, number_;
  Truth truth_;
  SlipEvent event_;
  std::optional<std::uint64_t> last_step_;
  std::array<double, 2> true_angle_rad_{}, angle_rad_{}, read_angle_rad_{};
  std::array<std::int64_t, 2> read_ticks_{};
  double way_m_ = 0.0, turned_rad_ = 0.0;  // of all wheels; since the reading before
  std::uint32_t cell_ = 0, frame_ = 0;
};

}  // namespace convoy::simulator
