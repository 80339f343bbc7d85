// Paths and maps: the paper's Fig. 9 to 12.
#include "report/figure_parts.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <limits>
#include <set>

namespace convoy::cli::figures {
namespace {

using nlohmann::json;

/// For captions: a plane needs no such word.
template <class G>
std::string seen_from_above() {
  return G::Dim == 2 ? "" : " Seen from above.";
}

// ---- Fig. 9 ----

Style truth_style() { return {truth_color, 1.9, "", 0.75}; }

/// What the black line is in drawings of one robot each.
template <class G>
std::string truth_clause(const RunRecord<G>& run) {
  return has_truth(run) ? " The ground truth is laid on the true pose at the start, as its recorder saw it."
                        : " There is no pose truth to draw.";
}

/// How far apart two vehicles truly were when each started; that is what their SLAMs cannot know.
template <class G>
std::string started_apart(const RunRecord<G>& run) {
  if (!has_truth(run)) return " There is no pose truth to draw.";
  const std::string dots = " Dots mark where each true trajectory begins and ends.";
  if (run.vehicles.size() != 2) return dots;
  std::vector<typename G::Point> starts;
  for (const VehicleRecord<G>& vehicle : run.vehicles)
    if (const auto first = run.first_event_s.find(vehicle.id); first != run.first_event_s.end())
      if (const auto T = truth_at(vehicle.truth, first->second)) starts.push_back(T->translation());
  if (starts.size() != 2) return dots;
  return dots + " In truth they started " + metres_text((starts[1] - starts[0]).norm()) +
         " apart, which neither SLAM can know.";
}

}  // namespace

template <class G>
Figure slam_only(const RunRecord<G>& run, const Evaluation<G>& evaluation) {
  Figure figure;
  figure.title = "SLAM-only trajectories (paper, Fig. 9)";
  if (crowded(run)) {
    figure.caption =
        "Each robot's own SLAM in the frame in which it started: without an exchange nothing relates these "
        "frames to one another, and each drifts by itself." +
        truth_clause(run) + seen_from_above<G>();
    figure.body = key_of({{truth_style(), "ground truth"},
                          {{vehicle_color(run, run.vehicles.front().id), 1.6}, "SLAM, in the colour of its robot"}});
    std::string cells;
    for (const VehicleRecord<G>& vehicle : run.vehicles) {
      SvgPlot plot(small_width, small_width);
      plot.equal_aspect(small_map_height, small_map_height);
      plot.title(vehicle_name(run, vehicle.id));
      metres(plot);
      plot.no_legend();
      const Placement<G> placement = placement_of(run, evaluation, vehicle);
      if (placement.T_frame_world) plot.line(truth_path(vehicle, *placement.T_frame_world), truth_style());
      plot.line(slam_path(vehicle, placement.T_frame_slam), {vehicle_color(run, vehicle.id), 1.6});
      cells += cell(plot.svg(), "third");
    }
    figure.body += row_of(cells);
    return figure;
  }
  figure.caption = "Each vehicle's own SLAM as if it had started at the origin of the common frame." +
                   started_apart(run) + seen_from_above<G>();
  SvgPlot plot(page_width, 560.0);
  plot.equal_aspect(240.0, 560.0);
  metres(plot);
  for (const VehicleRecord<G>& vehicle : run.vehicles) {
    if (!evaluation.T_world_common || vehicle.truth.empty()) continue;
    plot.line(truth_path(vehicle, evaluation.T_world_common->inverse()), {truth_color, 1.6}, "ground truth");
  }
  for (const VehicleRecord<G>& vehicle : run.vehicles)
    plot.line(slam_path(vehicle), {vehicle_color(run, vehicle.id), 2.0}, "SLAM of " + the_vehicle(run, vehicle.id));
  for (const VehicleRecord<G>& vehicle : run.vehicles) {
    if (!evaluation.T_world_common || vehicle.truth.empty()) continue;
    const auto path = truth_path(vehicle, evaluation.T_world_common->inverse());
    plot.dots({path.front(), path.back()}, 4.5, {vehicle_color(run, vehicle.id)},
              "true begin and end, " + vehicle_name(run, vehicle.id));
  }
  figure.body = plot.svg();
  return figure;
}

namespace {

// ---- Fig. 10 and 11 ----

/// Draws one vehicle's SLAM-only path with its ellipses; the same content serves the whole view and the zoom.
template <class G>
void draw_drift(SvgPlot& plot, const RunRecord<G>& run, const VehicleRecord<G>& vehicle, const Placement<G>& placement,
                const std::vector<const MapAnchor<G>*>& anchors, bool with_slam_ellipses, double line_width) {
  const std::string color = vehicle_color(run, vehicle.id);
  if (placement.T_frame_world)
    plot.line(truth_path(vehicle, *placement.T_frame_world), {truth_color, line_width}, "ground truth");
  plot.line(slam_path(vehicle, placement.T_frame_slam), {color, line_width + 0.4}, "SLAM");
  for (const MapAnchor<G>* anchor : anchors)
    plot.ellipse(from_above(placement.T_frame_slam * anchor->T_slam_body->translation()),
                 from_above(drift_covariance(*anchor, placement)), {color, 1.0, "", 0.75}, "95 %, drift model");
  if (!with_slam_ellipses) return;
  std::vector<const PoseRow<G>*> rows;
  for (const PoseRow<G>& row : own_rows(vehicle))
    if (row.vehicle == vehicle.id && row.slam) rows.push_back(&row);
  for (const PoseRow<G>* row : spread(rows, 150)) {
    const PoseEstimate<G> placed{placement.T_frame_slam * row->slam->T, row->slam->P};
    plot.ellipse(from_above(placed.T.translation()), from_above(position_covariance(placed)), {color, 0.8, "2 2", 1.0},
                 "95 %, SLAM alone");
  }
}

/// Where the zoom looks: at three quarters of the way, wide enough for the truth and the SLAM's own ellipse.
template <class G>
std::optional<Window> zoom_window(const VehicleRecord<G>& vehicle, const Placement<G>& placement) {
  std::vector<const PoseRow<G>*> rows;
  for (const PoseRow<G>& row : own_rows(vehicle))
    if (row.vehicle == vehicle.id && row.slam) rows.push_back(&row);
  if (rows.empty()) return std::nullopt;
  const PoseRow<G>& row = *rows[rows.size() * 3 / 4];
  const Point centre = from_above(placement.T_frame_slam * row.slam->T.translation());
  double half = 6.0 * std::sqrt(std::max(1e-6, from_above(position_covariance(*row.slam)).trace()));
  if (const auto truth = truth_at(vehicle.truth, row.t_s); truth && placement.T_frame_world && !placement.by_prior)
    half = std::max(half, 1.5 * (from_above(*placement.T_frame_world * truth->translation()) - centre).norm());
  half = std::clamp(half, 0.2, 6.0);
  return window_around(centre, half);
}

template <class G>
std::string drift_drawing(const RunRecord<G>& run, const Evaluation<G>& evaluation, const VehicleRecord<G>& vehicle) {
  const Placement<G> placement = placement_of(run, evaluation, vehicle);
  const auto anchors = spread(anchors_of(run, vehicle.id), 10);
  SvgPlot whole(main_width, 460.0);
  whole.equal_aspect(250.0, 480.0);
  metres(whole);
  draw_drift(whole, run, vehicle, placement, anchors, false, 1.6);
  if (placement.by_prior && placement.prior.trace() > 0.0)
    whole.ellipse(from_above(placement.T_frame_slam.translation()), placement.prior.template topLeftCorner<2, 2>(),
                  {vehicle_color(run, vehicle.id), 1.6, "6 4"}, "95 %, static prior");
  const auto window = zoom_window(vehicle, placement);
  if (!window) return whole.svg();
  whole.box(window->first, window->second, {common_color, 1.2}, "zoom");
  const std::string zoom = zoom_drawing(*window, "zoom; dashed: 95 % by the SLAM alone", [&](SvgPlot& plot) {
    draw_drift(plot, run, vehicle, placement, anchors, true, 1.6);
  });
  return row_of(cell(whole.svg(), "two-thirds") + cell(zoom, "third"));
}

/// Whether the true position at each closing anchor lies within the drift model's 95 % ellipse.
template <class G>
Share held_by_drift(const RunRecord<G>& run, const VehicleRecord<G>& vehicle, const Placement<G>& placement) {
  static const double bound = chi2_quantile(0.95, 2.0);
  Share share;
  if (run.pose_tolerance) return share;
  for (const MapAnchor<G>* anchor : anchors_of(run, vehicle.id)) {
    const auto truth = truth_at(vehicle.truth, anchor->stamp_s);
    if (!truth || !placement.T_frame_world) continue;
    const Point error = from_above((*placement.T_frame_world * *truth).translation()) -
                        from_above(placement.T_frame_slam * anchor->T_slam_body->translation());
    const double square = squared_mahalanobis(error, from_above(drift_covariance(*anchor, placement)));
    if (std::isfinite(square)) share.add(square <= bound);  // the start is known exactly and cannot be judged
  }
  return share;
}

/// The same for the SLAM's own ellipses along the way.
template <class G>
Share held_by_slam(const RunRecord<G>& run, const VehicleRecord<G>& vehicle, const Placement<G>& placement) {
  static const double bound = chi2_quantile(0.95, 2.0);
  Share share;
  if (run.pose_tolerance) return share;
  for (const PoseRow<G>& row : own_rows(vehicle)) {
    if (row.vehicle != vehicle.id || !row.slam) continue;
    const auto truth = truth_at(vehicle.truth, row.t_s);
    if (!truth || !placement.T_frame_world) continue;
    const PoseEstimate<G> placed{placement.T_frame_slam * row.slam->T, row.slam->P};
    const Point error =
        from_above((*placement.T_frame_world * *truth).translation()) - from_above(placed.T.translation());
    const double square = squared_mahalanobis(error, from_above(position_covariance(placed)));
    if (std::isfinite(square)) share.add(square <= bound);
  }
  return share;
}

/// Half the length of the 95 % ellipse.
double reach_m(const Eigen::Matrix2d& covariance) {
  return std::sqrt(chi2_quantile(0.95, 2.0) * std::max(0.0, eigenvalues(covariance)[1]));
}

/// What the run shows of a drift drawing: which ellipses hold the truth, and how large they are in the end.
template <class G>
std::string drift_findings(const RunRecord<G>& run, const VehicleRecord<G>& vehicle, const Placement<G>& placement) {
  std::string text;
  const Share drift = held_by_drift(run, vehicle, placement), slam = held_by_slam(run, vehicle, placement);
  if (drift.judged > 0)
    text +=
        " At the ends of its segments, " + drift.text() + " true positions lie within the ellipse of the drift model.";
  if (slam.judged > 0) text += " Along the way, " + slam.text() + " lie within that of the SLAM alone.";
  const auto anchors = anchors_of(run, vehicle.id);
  const auto& rows = own_rows(vehicle);
  const auto last = std::find_if(rows.rbegin(), rows.rend(), [&](const PoseRow<G>& row) {
    return row.vehicle == vehicle.id && row.slam && !anchors.empty() && row.t_s <= anchors.back()->stamp_s;
  });
  if (last != rows.rend())
    text += " Where the last segment ends, the ellipse of the drift reaches " +
            metres_text(reach_m(from_above(drift_covariance(*anchors.back(), placement)))) +
            ", that of the SLAM alone " + metres_text(reach_m(from_above(position_covariance(*last->slam)))) + ".";
  if (drift.judged == 0 && slam.judged == 0) text += without_judgement(run, "the ellipses");
  return text;
}

}  // namespace

template <class G>
Figure drift_of_first(const RunRecord<G>& run, const Evaluation<G>& evaluation) {
  const VehicleRecord<G>& vehicle = run.vehicles.front();
  return {
      "Drift of " + the_vehicle(run, vehicle.id) + " (paper, Fig. 10)", drift_drawing(run, evaluation, vehicle),
      "SLAM-only trajectory before any fusion, with the 95 % ellipses of the position by the drift model (solid) and, "
      "in the zoom, by the SLAM alone (dashed)." +
          drift_findings(run, vehicle, placement_of(run, evaluation, vehicle)) + seen_from_above<G>()};
}

namespace {

template <class G>
std::string small_drift_drawing(const RunRecord<G>& run, const Evaluation<G>& evaluation,
                                const VehicleRecord<G>& vehicle, double width) {
  SvgPlot plot(width, small_map_height);
  plot.equal_aspect(small_map_height, small_map_height);
  plot.title(vehicle_name(run, vehicle.id));
  metres(plot);
  plot.no_legend();
  const std::string color = vehicle_color(run, vehicle.id);
  const Placement<G> placement = placement_of(run, evaluation, vehicle);
  if (placement.T_frame_world) plot.line(truth_path(vehicle, *placement.T_frame_world), truth_style());
  plot.line(slam_path(vehicle, placement.T_frame_slam), {color, 1.2, "", 0.75});
  for (const MapAnchor<G>* anchor : spread(anchors_of(run, vehicle.id), 8))
    plot.ellipse(from_above(placement.T_frame_slam * anchor->T_slam_body->translation()),
                 from_above(drift_covariance(*anchor, placement)), {color, 2.2});
  return plot.svg();
}

}  // namespace

template <class G>
Figure drift_of_others(const RunRecord<G>& run, const Evaluation<G>& evaluation) {
  Figure figure;
  if (!crowded(run)) {
    const VehicleRecord<G>& vehicle = run.vehicles.back();
    figure.title = "Drift of " + the_vehicle(run, vehicle.id) + " (paper, Fig. 11)";
    figure.body = drift_drawing(run, evaluation, vehicle);
    const Placement<G> placement = placement_of(run, evaluation, vehicle);
    figure.caption =
        (placement.by_prior ? "SLAM-only trajectory, placed in the common frame by its static prior alone; the dashed "
                              "ellipse around its start is all that is known of that (95 %)."
                            : "SLAM-only trajectory in the frame in which it started.") +
        drift_findings(run, vehicle, placement) + seen_from_above<G>();
    return figure;
  }
  figure.title = "Drift of the other robots (paper, Fig. 11)";
  Share held;
  for (std::size_t i = 1; i < run.vehicles.size(); ++i) {
    const VehicleRecord<G>& vehicle = run.vehicles[i];
    const Share own = held_by_drift(run, vehicle, placement_of(run, evaluation, vehicle));
    held.held += own.held;
    held.judged += own.judged;
  }
  figure.caption =
      "The same for the other robots, each in the frame in which it started, which lies anywhere in the common "
      "frame before the first association." +
      (held.judged > 0 ? " At the ends of their segments, " + held.text() +
                             " true positions lie within the ellipse of the drift model."
                       : without_judgement(run, "the ellipses")) +
      seen_from_above<G>();
  const std::string first_color = vehicle_color(run, run.vehicles[1].id);
  figure.body = key_of({{truth_style(), "ground truth"},
                        {{first_color, 1.2, "", 0.75}, "SLAM, in the colour of its robot"},
                        {{first_color, 2.2}, "ellipses: 95 %, drift model"}});
  const bool two_in_a_row = run.vehicles.size() == 3 || run.vehicles.size() == 5;  // no row with a single drawing
  std::string cells;
  for (std::size_t i = 1; i < run.vehicles.size(); ++i)
    cells += cell(small_drift_drawing(run, evaluation, run.vehicles[i], two_in_a_row ? half_width : small_width),
                  two_in_a_row ? "half" : "third");
  figure.body += row_of(cells);
  return figure;
}

namespace {

// ---- Fig. 12 ----

struct CommonLandmarks {
  std::set<Key> paired;
  std::vector<std::pair<Point, Point>> lines;  ///< between the members of each pairing, from above
  std::vector<double> lengths_m;
};

template <class G>
CommonLandmarks pairings_found(const MapRecord<G>& map) {
  std::map<Key, typename G::Point> place;
  for (const MapLandmark<G>& landmark : map.landmarks)
    if (landmark.p_common_m) place[landmark.key] = *landmark.p_common_m;
  CommonLandmarks result;
  for (const MapAssociation& association : map.associations) {
    if (!association.accepted) continue;
    for (const auto& [one, other] : association.pairings) {
      if (!place.contains(one) || !place.contains(other)) continue;
      result.paired.insert(one);
      result.paired.insert(other);
      result.lines.push_back({from_above(place[one]), from_above(place[other])});
      result.lengths_m.push_back((place[one] - place[other]).norm());
    }
  }
  return result;
}

template <class G>
void draw_map_landmarks(SvgPlot& plot, const RunRecord<G>& run, const MapRecord<G>& map) {
  const CommonLandmarks common = pairings_found(map);
  std::map<VehicleId, std::vector<Point>> landmarks;
  std::vector<Point> shared;
  for (const MapLandmark<G>& landmark : map.landmarks) {
    if (!landmark.p_common_m) continue;
    landmarks[landmark.key.chain.vehicle].push_back(from_above(*landmark.p_common_m));
    if (common.paired.contains(landmark.key)) shared.push_back(from_above(*landmark.p_common_m));
  }
  // Members of a pairing lie so near to one another that a line between them would hide under full dots.
  const double radius = 2.0;
  plot.segments(common.lines, {common_color, 1.4}, "pairings");
  plot.rings(shared, radius + 2.2, {common_color, 1.3}, "landmarks found common");
  for (const auto& [id, points] : landmarks)
    plot.dots(points, radius, {vehicle_color(run, id), 1.0, "", 0.9}, "landmarks of " + the_vehicle(run, id));
}

/// How many pairings are drawn, and how long their lines are.
template <class G>
std::string pairing_findings(const MapRecord<G>& map) {
  const CommonLandmarks common = pairings_found(map);
  if (common.lines.empty()) return " No landmark has been found common yet.";
  std::vector<double> lengths = common.lengths_m;
  std::sort(lengths.begin(), lengths.end());
  return " Red rings: " + std::to_string(common.paired.size()) + " landmarks in " + std::to_string(lengths.size()) +
         " pairings found between submaps, with a red line between the two members of each: " +
         metres_text(lengths[lengths.size() / 2]) + " long in the median, " + metres_text(lengths.back()) + " at most.";
}

template <class G>
std::vector<const PoseRow<G>*> aligned_rows(const VehicleRecord<G>& vehicle) {
  std::vector<const PoseRow<G>*> rows;
  for (const PoseRow<G>& row : own_rows(vehicle))
    if (row.vehicle == vehicle.id && row.common) rows.push_back(&row);
  return rows;
}

template <class G>
void draw_common_map(SvgPlot& plot, const RunRecord<G>& run, const Evaluation<G>& evaluation, const MapRecord<G>& map,
                     std::size_t ellipses) {
  const bool many = crowded(run);
  draw_map_landmarks(plot, run, map);
  for (const VehicleRecord<G>& vehicle : run.vehicles)
    plot.line(common_path(vehicle), {vehicle_color(run, vehicle.id), many ? 0.9 : 2.4, "", many ? 0.55 : 1.0},
              vehicle_name(run, vehicle.id));
  for (const VehicleRecord<G>& vehicle : run.vehicles)
    for (const PoseRow<G>* row : spread(aligned_rows(vehicle), ellipses))
      plot.ellipse(from_above(row->common->T.translation()), from_above(position_covariance(*row->common)),
                   {vehicle_color(run, vehicle.id), 1.4});
  if (!evaluation.T_world_common) return;
  const G T_common_world = evaluation.T_world_common->inverse();
  for (const VehicleRecord<G>& vehicle : run.vehicles)
    if (!vehicle.truth.empty())
      plot.line(truth_path(vehicle, T_common_world), {truth_color, many ? 0.8 : 1.0, "", many ? 0.55 : 1.0},
                "ground truth");
  if (!many || run.landmarks.empty() || run.landmarks.size() > 60) return;
  std::vector<Point> places;
  for (const TruthLandmark<G>& landmark : run.landmarks)
    places.push_back(from_above(T_common_world * landmark.p_world_m));
  plot.rings(places, 7.0, {truth_color, 1.1}, "true landmarks");
}

}  // namespace

template <class G>
Figure common_map(const RunRecord<G>& run, const Evaluation<G>& evaluation) {
  Figure figure;
  figure.title = "The common map (paper, Fig. 12)";
  const VehicleRecord<G>* survivor = run.first_survivor();
  if (!survivor) {
    figure.caption = "No vehicle left a map.";
    return figure;
  }
  figure.caption = "The map as " + the_vehicle(run, survivor->id) +
                   " holds it in the end: corrected trajectories with 95 % ellipses, and landmarks in the colour of "
                   "who mapped them." +
                   pairing_findings(*survivor->map) + seen_from_above<G>();
  const MapRecord<G>& map = *survivor->map;
  const auto rows = aligned_rows(run.vehicles.back());
  if (crowded(run) || rows.empty()) {
    SvgPlot plot(page_width, 640.0);
    plot.equal_aspect(260.0, 760.0);
    metres(plot);
    draw_common_map(plot, run, evaluation, map, 4);
    figure.body = plot.svg();
    return figure;
  }
  SvgPlot whole(main_width, 480.0);
  whole.equal_aspect(260.0, 560.0);
  metres(whole);
  draw_common_map(whole, run, evaluation, map, 10);
  const PoseEstimate<G>& pose = *rows[rows.size() * 3 / 4]->common;
  const Window window =
      window_around(from_above(pose.T.translation()),
                    std::clamp(12.0 * std::sqrt(from_above(position_covariance(pose)).trace()), 2.0, 15.0));
  whole.box(window.first, window.second, {"#52606d", 1.2}, "zoom");
  const std::string zoom = zoom_drawing(window, "zoom; ellipses: 95 %, fused",
                                        [&](SvgPlot& plot) { draw_common_map(plot, run, evaluation, map, 150); });
  figure.body = row_of(cell(whole.svg(), "two-thirds") + cell(zoom, "third"));
  return figure;
}

#define CONVOY_INSTANTIATE(G)                                                 \
  template Figure slam_only(const RunRecord<G>&, const Evaluation<G>&);       \
  template Figure drift_of_first(const RunRecord<G>&, const Evaluation<G>&);  \
  template Figure drift_of_others(const RunRecord<G>&, const Evaluation<G>&); \
  template Figure common_map(const RunRecord<G>&, const Evaluation<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli::figures
