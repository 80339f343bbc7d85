// What a wheel odometer's error grows with, for every front end that has one.
#pragma once

#include <cmath>

namespace convoy {

/// Variance of a right perturbation of a step, order (rho, theta), of an odometer whose parameters have the names of
/// RangeBearingEkfParams. [m, rad, s], each >= 0
template <class G, class Params>
typename G::Tangent odometry_variance(const Params& p, double length_m, double angle_rad, double dt_s) {
  const auto square = [](double x) { return x * x; };
  const double along = square(p.sigma_along_per_sqrt_m) * length_m + square(p.sigma_along_per_sqrt_rad) * angle_rad;
  const double across = square(p.sigma_across_per_sqrt_m) * length_m;
  const double heading = square(p.sigma_heading_per_sqrt_m) * length_m +
                         square(p.sigma_heading_per_sqrt_rad) * angle_rad + square(p.sigma_heading_per_sqrt_s) * dt_s;
  typename G::Tangent variance;
  if constexpr (G::Dim == 2) {
    variance << along, across, heading;
  } else {
    const double vertical = square(p.sigma_vertical_per_sqrt_m) * length_m;
    const double tilt = square(p.sigma_tilt_per_sqrt_m) * length_m;
    variance << along, across, vertical, tilt, tilt, heading;
  }
  return variance;
}

}  // namespace convoy
