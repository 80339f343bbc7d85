#include "gps.hpp"

#include "parameter_check.hpp"

#include <cmath>

namespace convoy::simulator {
namespace {

constexpr std::uint32_t white_stream = 0x67707301, drift_stream = 0x67707302, lost_stream = 0x67707303,
                        outage_stream = 0x67707304;

void check_error(const GpsError& error, const std::string& where) {
  check_range(where + ".white_m", error.white_m, 0.0, 100.0, "m");
  check_range(where + ".white_up_m", error.white_up_m, 0.0, 100.0, "m");
  check_range(where + ".drift_m", error.drift_m, 0.0, 100.0, "m");
  check_range(where + ".drift_up_m", error.drift_up_m, 0.0, 100.0, "m");
}

Eigen::Vector3d gaussian3(Stream& stream) {
  const double x = stream.gaussian(), y = stream.gaussian(), z = stream.gaussian();
  return {x, y, z};
}

}  // namespace

void GpsParams::validate(const std::string& where) const {
  check_range(where + ".rate_hz", rate_hz, 0.1, 240.0, "Hz");
  check_that(std::abs(240.0 / rate_hz - std::round(240.0 / rate_hz)) < 1e-9, where + ".rate_hz",
             "240 / rate_hz is not whole; take 1, 5, 10 or the like");
  check_that(antenna_body_m.allFinite() && antenna_body_m.norm() < 20.0, where + ".antenna_body_m",
             "not finite or farther than 20 m from the body's origin; say where the antenna is");
  check_error(error, where + ".error");
  check_range(where + ".correlation_s", correlation_s, 0.1, 1e5, "s");
  check_error(lost_error, where + ".lost_error");
  check_range(where + ".lost_per_hour", lost_per_hour, 0.0, 3600.0, "1/h");
  check_range(where + ".lost_s", lost_s, 0.1, 3600.0, "s");
  check_range(where + ".outages_per_hour", outages_per_hour, 0.0, 3600.0, "1/h");
  check_range(where + ".outage_s", outage_s, 0.1, 3600.0, "s");
}

GpsParams standard_gps() { return {}; }

GpsParams rtk_gps() {
  GpsParams params;
  params.rate_hz = 10.0;
  params.error = {0.008, 0.015, 0.008, 0.015};
  params.lost_error = {0.05, 0.1, 0.3, 0.6};
  params.lost_per_hour = 6.0;
  return params;
}

Gps::Gps(const GpsParams& params, std::uint32_t seed, std::uint32_t vehicle_number)
    : params_(params), seed_(seed), number_(vehicle_number) {
  params.validate();
}

void Gps::interrupt(Interruption& what, std::uint32_t stream_number, std::uint32_t frame, double per_hour,
                    double mean_s) const {
  const double time_s = frame / params_.rate_hz;
  if (what.lasts(time_s)) return;
  Stream stream({seed_, number_, stream_number, frame});
  if (stream.chance(1.0 - std::exp(-per_hour / 3600.0 / params_.rate_hz)))
    what.until_s = time_s - mean_s * std::log(1.0 - stream.uniform(0.0, 1.0));
}

void Gps::advance(std::uint32_t frame) {
  Stream stream({seed_, number_, drift_stream, frame});
  const double kept = frame == 0 ? 0.0 : std::exp(-1.0 / (params_.rate_hz * params_.correlation_s));
  drift_ = kept * drift_ + std::sqrt(1.0 - kept * kept) * gaussian3(stream);
  interrupt(lost_, lost_stream, frame, params_.lost_per_hour, params_.lost_s);
  interrupt(outage_, outage_stream, frame, params_.outages_per_hour, params_.outage_s);
}

std::optional<GpsReading> Gps::step(const VehicleState& state) {
  const auto interval = static_cast<std::uint64_t>(std::lround(240.0 / params_.rate_hz));
  if (state.step % interval != 0) return std::nullopt;
  const auto frame = static_cast<std::uint32_t>(state.step / interval);
  check_that(frame >= next_frame_, "Gps::step", "the vehicle's steps do not rise; hand them over in order");
  for (; next_frame_ <= frame; ++next_frame_) advance(next_frame_);
  if (outage_.lasts(frame / params_.rate_hz)) return std::nullopt;

  GpsReading reading;
  reading.frame = frame;
  reading.stamp_s = state.time_s;
  reading.correlation_s = params_.correlation_s;
  reading.fix = !lost_.lasts(frame / params_.rate_hz);
  const GpsError& error = reading.fix ? params_.error : params_.lost_error;
  const Eigen::Vector3d white(error.white_m, error.white_m, error.white_up_m);
  const Eigen::Vector3d drift(error.drift_m, error.drift_m, error.drift_up_m);
  Stream stream({seed_, number_, white_stream, frame});
  reading.antenna_world_m =
      state.T_world_body * params_.antenna_body_m + white.cwiseProduct(gaussian3(stream)) + drift.cwiseProduct(drift_);
  reading.drift_covariance_m2 = drift.cwiseAbs2().asDiagonal();
  reading.covariance_m2 = reading.drift_covariance_m2;
  reading.covariance_m2.diagonal() += white.cwiseAbs2();
  return reading;
}

}  // namespace convoy::simulator
