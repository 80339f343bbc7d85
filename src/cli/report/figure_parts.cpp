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

template <class G>
bool has_truth(const RunRecord<G>& run) {
  return std::any_of(run.vehicles.begin(), run.vehicles.end(), [](const auto& v) { return !v.truth.empty(); });
}

template <class G>
std::string without_judgement(const RunRecord<G>& run, const std::string& of_what) {
  const std::string why = run.pose_tolerance ? " The truth of poses is itself a measurement, too coarse to judge "
                                             : " There is no pose truth to judge ";
  return why + of_what + " by.";
}

template <class G>
std::vector<Point> truth_path(const VehicleRecord<G>& vehicle, const G& T_frame_world) {
  std::vector<Point> path;
  double last_s = -std::numeric_limits<double>::infinity();
  for (const TruthPose<G>& pose : vehicle.truth) {
    if (pose.t_s - last_s < truth_period_s) continue;
    if (!path.empty() && pose.t_s - last_s > 5.0) path.emplace_back(NAN, NAN);
    path.push_back(from_above(T_frame_world * pose.T_world_body.translation()));
    last_s = pose.t_s;
  }
  return path;
}

template <class G>
const std::vector<PoseRow<G>>& own_rows(const VehicleRecord<G>& vehicle) {
  return vehicle.trajectory.empty() ? vehicle.live : vehicle.trajectory;
}

template <class G>
std::vector<Point> slam_path(const VehicleRecord<G>& vehicle, const G& T_frame_slam) {
  std::vector<Point> path;
  for (const PoseRow<G>& row : own_rows(vehicle))
    if (row.vehicle == vehicle.id && row.slam) path.push_back(from_above(T_frame_slam * row.slam->T.translation()));
  return path;
}

template <class G>
std::vector<Point> common_path(const VehicleRecord<G>& vehicle) {
  std::vector<Point> path;
  for (const PoseRow<G>& row : own_rows(vehicle))
    if (row.vehicle == vehicle.id && row.common) path.push_back(from_above(row.common->T.translation()));
  return path;
}

template <class G>
typename G::PointCovariance position_covariance(const PoseEstimate<G>& estimate) {
  const typename G::PointCovariance R = estimate.T.rotation();
  return R * estimate.P.template topLeftCorner<G::Dim, G::Dim>() * R.transpose();
}

template <class G>
Placement<G> placement_of(const RunRecord<G>& run, const Evaluation<G>& evaluation, const VehicleRecord<G>& vehicle) {
  Placement<G> placement;
  if (vehicle.prior && evaluation.T_world_common) {
    placement.by_prior = true;
    placement.T_frame_slam = vehicle.prior->mean;
    placement.prior = vehicle.prior->sigma.cwiseAbs2().asDiagonal();
    placement.T_frame_world = evaluation.T_world_common->inverse();
    return placement;
  }
  const auto first = run.first_event_s.find(vehicle.id);
  if (first == run.first_event_s.end()) return placement;
  if (const auto start = truth_at(vehicle.truth, first->second)) placement.T_frame_world = start->inverse();
  return placement;
}

template <class G>
typename G::PointCovariance drift_covariance(const MapAnchor<G>& anchor, const Placement<G>& placement) {
  const typename G::PointJacobian J = placement.T_frame_slam.act_jacobian(anchor.T_slam_body->translation());
  return J * (anchor.drift + placement.prior) * J.transpose();
}

template <class G>
std::vector<const MapAnchor<G>*> anchors_of(const RunRecord<G>& run, VehicleId id) {
  std::vector<const MapAnchor<G>*> anchors;
  if (const VehicleRecord<G>* survivor = run.first_survivor())
    for (const MapAnchor<G>& anchor : survivor->map->anchors)
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

template <class G>
bool crowded(const RunRecord<G>& run) {
  return run.vehicles.size() > 2;
}

#define CONVOY_INSTANTIATE(G)                                                                             \
  template bool has_truth(const RunRecord<G>&);                                                           \
  template std::string without_judgement(const RunRecord<G>&, const std::string&);                        \
  template std::vector<Point> truth_path(const VehicleRecord<G>&, const G&);                              \
  template const std::vector<PoseRow<G>>& own_rows(const VehicleRecord<G>&);                              \
  template std::vector<Point> slam_path(const VehicleRecord<G>&, const G&);                               \
  template std::vector<Point> common_path(const VehicleRecord<G>&);                                       \
  template G::PointCovariance position_covariance(const PoseEstimate<G>&);                                \
  template Placement<G> placement_of(const RunRecord<G>&, const Evaluation<G>&, const VehicleRecord<G>&); \
  template G::PointCovariance drift_covariance(const MapAnchor<G>&, const Placement<G>&);                 \
  template std::vector<const MapAnchor<G>*> anchors_of(const RunRecord<G>&, VehicleId);                   \
  template bool crowded(const RunRecord<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli::figures
