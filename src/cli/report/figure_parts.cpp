#include "report/figure_parts.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace convoy::cli::figures {

std::string cell(const std::string& svg, const char* width_class) {
  return std::string("<div class=\"") + width_class + "\">" + svg + "</div>\n";
}

std::string row_of(const std::string& cells) { return "<div class=\"row\">\n" + cells + "</div>\n"; }

std::string key_of(const std::vector<std::pair<Style, std::string>>& entries) {
  std::string out = "<p class=\"key\">";
  for (const auto& [style, text] : entries)
    out +=
        "<span><svg viewBox=\"0 0 26 10\" width=\"26\" height=\"10\"><line x1=\"1\" y1=\"5\" x2=\"25\" y2=\"5\" "
        "stroke=\"" +
        style.color + "\" stroke-width=\"" + fixed(style.width, 1) + "\" stroke-opacity=\"" + fixed(style.opacity, 2) +
        "\"/></svg> " + xml_escaped(text) + "</span>";
  return out + "</p>\n";
}

std::string metres_text(double value) { return fixed(value, value < 1.0 ? 2 : 1) + " m"; }

bool has_truth(const RunRecord& run) {
  return std::any_of(run.vehicles.begin(), run.vehicles.end(), [](const auto& v) { return !v.truth.empty(); });
}

std::vector<Point> truth_path(const VehicleRecord& vehicle, const SE2& T_frame_world) {
  std::vector<Point> path;
  double last_s = -std::numeric_limits<double>::infinity();
  for (const TruthPose& pose : vehicle.truth) {
    if (pose.t_s - last_s < truth_period_s) continue;
    if (!path.empty() && pose.t_s - last_s > 5.0) path.emplace_back(NAN, NAN);
    path.push_back(T_frame_world * pose.T_world_body.translation());
    last_s = pose.t_s;
  }
  return path;
}

const std::vector<PoseRow>& own_rows(const VehicleRecord& vehicle) {
  return vehicle.trajectory.empty() ? vehicle.live : vehicle.trajectory;
}

std::vector<Point> slam_path(const VehicleRecord& vehicle, const SE2& T_frame_slam) {
  std::vector<Point> path;
  for (const PoseRow& row : own_rows(vehicle))
    if (row.vehicle == vehicle.id && row.slam) path.push_back(T_frame_slam * row.slam->T.translation());
  return path;
}

std::vector<Point> common_path(const VehicleRecord& vehicle) {
  std::vector<Point> path;
  for (const PoseRow& row : own_rows(vehicle))
    if (row.vehicle == vehicle.id && row.common) path.push_back(row.common->T.translation());
  return path;
}

Eigen::Matrix2d position_covariance(const PoseEstimate& estimate) {
  const Eigen::Matrix2d R = estimate.T.rotation();
  return R * estimate.P.topLeftCorner<2, 2>() * R.transpose();
}

Eigen::Matrix<double, 2, 3> frame_jacobian(const Point& p_frame) {
  Eigen::Matrix<double, 2, 3> G;
  G << 1.0, 0.0, -p_frame.y(), 0.0, 1.0, p_frame.x();
  return G;
}

Placement placement_of(const RunRecord& run, const Evaluation& evaluation, const VehicleRecord& vehicle) {
  Placement placement;
  if (vehicle.prior && evaluation.T_world_common) {
    placement.by_prior = true;
    placement.T_frame_slam = vehicle.prior->mean;
    const Eigen::Vector3d sigma(vehicle.prior->sigma_x_m, vehicle.prior->sigma_y_m, vehicle.prior->sigma_theta_rad);
    placement.prior = sigma.cwiseAbs2().asDiagonal();
    placement.T_frame_world = evaluation.T_world_common->inverse();
    return placement;
  }
  const auto first = run.first_event_s.find(vehicle.id);
  if (first == run.first_event_s.end()) return placement;
  if (const auto start = truth_at(vehicle.truth, first->second)) placement.T_frame_world = start->inverse();
  return placement;
}

Eigen::Matrix2d drift_covariance(const MapAnchor& anchor, const Placement& placement) {
  const auto G = frame_jacobian(anchor.T_slam_body->translation());
  const Eigen::Matrix2d R = placement.T_frame_slam.rotation();
  return R * G * (anchor.drift + placement.prior) * G.transpose() * R.transpose();
}

std::vector<const MapAnchor*> anchors_of(const RunRecord& run, VehicleId id) {
  std::vector<const MapAnchor*> anchors;
  if (const VehicleRecord* survivor = run.first_survivor())
    for (const MapAnchor& anchor : survivor->map->anchors)
      if (anchor.key.chain.vehicle == id && anchor.T_slam_body) anchors.push_back(&anchor);
  return anchors;
}

Window window_around(const Point& centre, double half_m) {
  return {centre - Point(half_m, half_m), centre + Point(half_m, half_m)};
}

void metres(SvgPlot& plot) {
  plot.x_label("x [m]");
  plot.y_label("y [m]");
}

bool crowded(const RunRecord& run) { return run.vehicles.size() > 2; }

}  // namespace convoy::cli::figures
