// Satellite positions: a standard receiver's (metres, the error of minutes before still in it) and an RTK one's
// (centimetres while its fix holds).
#pragma once

#include "random.hpp"
#include "vehicle_physics.hpp"

#include <Eigen/Core>

#include <cstdint>
#include <optional>
#include <string>

namespace convoy::simulator {

/// One sigma of each horizontal axis, and of the height [m]. The drift is a first-order Gauss-Markov process.
struct GpsError {
  double white_m = 0.0, white_up_m = 0.0, drift_m = 0.0, drift_up_m = 0.0;  ///< each 0 to 100
};

struct GpsParams {
  double rate_hz = 5.0;  ///< 0.1 to 240, so that 240 / rate_hz is whole
  Eigen::Vector3d antenna_body_m{0.8, 0.0, 1.5};

  GpsError error{0.4, 0.8, 1.2, 2.5};  ///< while the fix holds
  double correlation_s = 60.0;         ///< of the drift, 0.1 to 1e5

  GpsError lost_error{0.4, 0.8, 1.2, 2.5};  ///< while it is lost
  double lost_per_hour = 0.0;               ///< how often it is lost, 0 to 3600
  double lost_s = 15.0;                     ///< for how long, the mean of an exponential distribution, 0.1 to 3600

  double outages_per_hour = 0.0;  ///< no position at all; 0 to 3600
  double outage_s = 10.0;         ///< mean of an exponential distribution, 0.1 to 3600

  /// Throws std::invalid_argument that names the field, its value and its range.
  void validate(const std::string& where = "GpsParams") const;
};

GpsParams standard_gps();
GpsParams rtk_gps();  ///< 1.1 cm, 2 cm up; its fix is lost six times an hour for 15 s, 0.3 m meanwhile

struct GpsReading {
  std::uint32_t frame = 0;  ///< 0, 1, ...: outages leave gaps
  double stamp_s = 0.0;
  Eigen::Vector3d antenna_world_m = Eigen::Vector3d::Zero();
  /// Of the position's error, drift included [m^2].
  Eigen::Matrix3d covariance_m2 = Eigen::Matrix3d::Zero();
  /// The part of it that is still there correlation_s later, to 1/e.
  Eigen::Matrix3d drift_covariance_m2 = Eigen::Matrix3d::Zero();
  double correlation_s = 0.0;
  bool fix = true;  ///< false: lost, the covariance is of lost_error
};

class Gps {
 public:
  /// Throws std::invalid_argument for parameters out of range.
  Gps(const GpsParams& params, std::uint32_t seed, std::uint32_t vehicle_number);

  /// To be called with each step's state; tells a reading when one is due and there is no outage. Readings depend on
  /// the time, not on the calls before. Throws std::invalid_argument if steps do not rise.
  std::optional<GpsReading> step(const VehicleState& state);

 private:
  struct Interruption {
    double until_s = -1.0;
    bool lasts(double time_s) const { return time_s < until_s; }
  };

  void advance(std::uint32_t frame);
  void interrupt(Interruption& what, std::uint32_t stream, std::uint32_t frame, double per_hour, double mean_s) const;

  GpsParams params_;
  std::uint32_t seed_, number_, next_frame_ = 0;
  Eigen::Vector3d drift_ = Eigen::Vector3d::Zero();  // of unit variance
  Interruption lost_, outage_;
};

}  // namespace convoy::simulator
