// A small world for the range-bearing front end, in the plane or in space, with exactly the noise that the filter is
// told.
#pragma once

#include <convoy/frontend/range_bearing_ekf.hpp>
#include <convoy/geometry/polar.hpp>

#include "../random_world.hpp"

#include <functional>
#include <map>

namespace convoy::test {

inline RangeBearingEkfParams quiet_params() {
  RangeBearingEkfParams p;
  p.sigma_along_per_sqrt_m = 0.03;
  p.sigma_across_per_sqrt_m = 0.01;
  p.sigma_heading_per_sqrt_m = 0.005;
  p.sigma_heading_per_sqrt_rad = 0.02;
  p.sigma_vertical_per_sqrt_m = 0.01;
  p.sigma_tilt_per_sqrt_m = 0.005;
  p.sigma_range_m = 0.1;
  p.sigma_bearing_rad = 0.01;
  p.sigma_elevation_rad = 0.01;
  p.gate = 0.9999;
  p.trail_spacing_m = 0.0;
  return p;
}

/// A vehicle at 2 m/s among points, 5 odometry inputs and one round of sightings per second.
template <class G>
class RangeBearingWorld {
 public:
  RangeBearingWorld(const RangeBearingEkfParams& params, std::uint64_t seed)
      : params_(params), random_(seed), points_(scattered<G>(random_, 240, 60.0, 3.0)), filter_(params) {}

  RangeBearingEkf<G>& filter() { return filter_; }
  const G& truth() const { return truth_; }
  const PointsOf<G>& points() const { return points_; }
  double now_s() const { return stamp_s_; }
  /// Truth at every stamp passed.
  const std::map<double, G>& passed() const { return passed_; }

  /// Drives on a curve of this curvature, calling after_input() after each input to the filter.
  void drive(
      double length_m, double curvature_per_m, const std::function<void()>& after_input = [] {}) {
    const int steps = static_cast<int>(length_m / step_m);
    for (int k = 0; k < steps; ++k) {
      if (inputs_++ % 5 == 0) look(after_input);
      filter_.on_odometry(stamp_s_, step_m / dt_s, curvature_per_m * step_m / dt_s);
      after_input();
      stamp_s_ += dt_s;
      const double angle = curvature_per_m * step_m;
      const auto square = [](double x) { return x * x; };
      typename G::Tangent sigma, motion = G::Tangent::Zero();
      if constexpr (G::Dim == 3) {
        const double tilt = params_.sigma_tilt_per_sqrt_m * std::sqrt(step_m);
        sigma << 0.0, 0.0, params_.sigma_vertical_per_sqrt_m * std::sqrt(step_m), tilt, tilt, 0.0;
      }
      sigma[0] = params_.sigma_along_per_sqrt_m * std::sqrt(step_m);
      sigma[1] = params_.sigma_across_per_sqrt_m * std::sqrt(step_m);
      sigma[G::Dof - 1] = std::sqrt(square(params_.sigma_heading_per_sqrt_m) * step_m +
                                    square(params_.sigma_heading_per_sqrt_rad) * std::abs(angle));
      motion[0] = step_m;
      motion[G::Dof - 1] = angle;
      truth_ = truth_ * G::Exp(motion) * G::Exp(sigma.cwiseProduct(random_.template unit_normal<G::Dof>()));
      passed_[stamp_s_] = truth_;
      filter_.on_odometry(stamp_s_, step_m / dt_s, curvature_per_m * step_m / dt_s);
      after_input();
    }
  }

 private:
  void look(const std::function<void()>& after_input) {
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const typename G::Point y = truth_.inverse() * points_[i];
      typename G::Point polar = polar_of(y);
      polar[0] += random_.normal(params_.sigma_range_m);
      polar[1] = wrap_angle(polar[1] + random_.normal(params_.sigma_bearing_rad));
      if constexpr (G::Dim == 3) polar[2] += random_.normal(params_.sigma_elevation_rad);
      if (y.norm() > 14.0 || y.norm() < 2.0) continue;
      filter_.on_sighting(stamp_s_, i, polar);
      after_input();
    }
  }

  static constexpr double step_m = 0.4, dt_s = 0.2;
  RangeBearingEkfParams params_;
  Random random_;
  PointsOf<G> points_;
  RangeBearingEkf<G> filter_;
  G truth_;
  double stamp_s_ = 0.0;
  int inputs_ = 0;
  std::map<double, G> passed_{{0.0, G()}};
};

}  // namespace convoy::test
