// What a map from above does not show: heights along the way, in space.
#include "report/figure_parts.hpp"

#include <algorithm>
#include <cmath>
#include <convoy/geometry/chi2.hpp>

namespace convoy::cli::figures {
namespace {

/// The height of one vehicle in the common frame, over the distance that it has driven.
struct HeightProfile {
  std::vector<Point> estimate, low, high, truth;  ///< (distance [m], height [m]); low and high hold 95 %
  Share held;                                     ///< true heights between low and high
  double square_error_m2 = 0.0;                   ///< sum over the rows with truth
};

HeightProfile height_profile_of(const VehicleRecord<SE3>& vehicle, const std::optional<SE3>& T_world_common) {
  static const double reach = std::sqrt(chi2_quantile(0.95, 1.0));
  HeightProfile profile;
  for (const PoseRow<SE3>& row : own_rows(vehicle)) {
    if (row.vehicle != vehicle.id || !row.common) continue;
    const double z = row.common->T.translation().z();
    const double half = reach * std::sqrt(std::max(0.0, position_covariance(*row.common)(2, 2)));
    profile.estimate.emplace_back(row.abscissa_m, z);
    profile.low.emplace_back(row.abscissa_m, z - half);
    profile.high.emplace_back(row.abscissa_m, z + half);
    const auto T_world_body = truth_at(vehicle.truth, row.t_s);
    if (!T_world_common || !T_world_body) continue;
    const double true_z = (T_world_common->inverse() * *T_world_body).translation().z();
    profile.truth.emplace_back(row.abscissa_m, true_z);
    profile.square_error_m2 += (z - true_z) * (z - true_z);
    if (half > 0.0) profile.held.add(std::abs(z - true_z) <= half);  // the start is known exactly and cannot be judged
  }
  return profile;
}

std::string drawing_of(const RunRecord<SE3>& run, const VehicleRecord<SE3>& vehicle, const HeightProfile& profile,
                       double width) {
  SvgPlot plot(width, 260.0);
  plot.x_label("distance driven [m]");
  plot.y_label("height [m]");
  const std::string color = vehicle_color(run, vehicle.id);
  plot.ribbon(profile.low, profile.high, {color, 1.0, "", 0.22}, "95 %");
  plot.line(profile.truth, {truth_color, 1.4}, "ground truth");
  plot.line(profile.estimate, {color, 1.8}, vehicle_name(run, vehicle.id));
  return plot.svg();
}

}  // namespace

Figure height_profile(const RunRecord<SE3>& run, const Evaluation<SE3>& evaluation) {
  const bool many = crowded(run);
  Figure figure;
  figure.title = "Heights";
  figure.caption =
      "Height of each vehicle in the common frame over the distance it has driven, corrected with the final map, "
      "with the band that holds 95 %.";
  std::string cells;
  for (const VehicleRecord<SE3>& vehicle : run.vehicles) {
    const HeightProfile profile = height_profile_of(vehicle, evaluation.T_world_common);
    if (profile.estimate.empty()) continue;
    cells += cell(drawing_of(run, vehicle, profile, many ? small_width : half_width), many ? "third" : "half");
    if (profile.truth.empty()) continue;
    const double rmse_m = std::sqrt(profile.square_error_m2 / static_cast<double>(profile.truth.size()));
    figure.caption += " The height of " + the_vehicle(run, vehicle.id) + " is off by " + metres_text(rmse_m) +
                      " RMSE; " + profile.held.text() + " true heights lie within its band.";
  }
  if (cells.empty()) figure.caption = "No vehicle was in the common frame.";
  else figure.body = row_of(cells);
  return figure;
}

}  // namespace convoy::cli::figures
