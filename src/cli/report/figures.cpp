#include "report/figures.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <limits>
#include <set>

#include "report/svg_plot.hpp"

namespace convoy::cli {
namespace {

using nlohmann::json;
using Point = SvgPlot::Point;
using Style = SvgPlot::Style;

constexpr double page_width = 1060.0;  // px
constexpr double main_width = 700.0;   // main drawing with a zoom beside it
constexpr double side_width = 350.0;
constexpr double small_width = 346.0;  // three in a row
constexpr double small_map_height = 270.0;
constexpr double half_width = 525.0;    // two in a row
constexpr double truth_period_s = 0.2;  // finer truth than the eye can see makes the page heavy
const std::string truth_color = "#000000";
const std::string common_color = "#d62728";
const std::string raw_color = "#d62728";
const std::string convoy_color = "#1f5fbf";

std::string cell(const std::string& svg, const char* width_class) {
  return std::string("<div class=\"") + width_class + "\">" + svg + "</div>\n";
}

std::string row_of(const std::string& cells) { return "<div class=\"row\">\n" + cells + "</div>\n"; }

/// The legend of several drawings in a row: what each kind of line is.
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

/// How many of those that can be judged are so: "all 12", "9 of 12", "none of 12".
struct Share {
  std::size_t held = 0, judged = 0;
  void add(bool is_so) {
    ++judged;
    held += is_so;
  }
  std::string text() const {
    const std::string all = std::to_string(judged);
    return held == judged ? "all " + all : (held == 0 ? "none" : std::to_string(held)) + " of " + all;
  }
};

bool has_truth(const RunRecord& run) {
  return std::any_of(run.vehicles.begin(), run.vehicles.end(), [](const auto& v) { return !v.truth.empty(); });
}

/// The true path, seen from the frame given by T_frame_world.
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

std::vector<Point> slam_path(const VehicleRecord& vehicle, const SE2& T_frame_slam = SE2()) {
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

/// Position covariance in the frame of T, of the right perturbation of T.
Eigen::Matrix2d position_covariance(const PoseEstimate& estimate) {
  const Eigen::Matrix2d R = estimate.T.rotation();
  return R * estimate.P.topLeftCorner<2, 2>() * R.transpose();
}

/// Effect on a point at p_frame of a perturbation (rho, theta) of the frame that it hangs on.
Eigen::Matrix<double, 2, 3> frame_jacobian(const Point& p_frame) {
  Eigen::Matrix<double, 2, 3> G;
  G << 1.0, 0.0, -p_frame.y(), 0.0, 1.0, p_frame.x();
  return G;
}

/// How one vehicle's SLAM-only path is placed: by its static prior, or in its own start frame.
struct Placement {
  SE2 T_frame_slam;
  Eigen::Matrix3d prior = Eigen::Matrix3d::Zero();
  std::optional<SE2> T_frame_world;  ///< for the truth
  bool by_prior = false;
};

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

/// Position uncertainty of an anchor before any fusion: static prior and drift up to there (paper, eq. 4, and the
/// static part of the bias).
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

/// About `wanted` elements, evenly spread, the last one among them.
template <class T>
std::vector<T> spread(const std::vector<T>& all, std::size_t wanted) {
  if (all.size() <= wanted) return all;
  std::vector<T> some;
  for (std::size_t i = 1; i <= wanted; ++i) some.push_back(all[i * (all.size() - 1) / wanted]);
  return some;
}

using Window = std::pair<Point, Point>;  // low and high corner

Window window_around(const Point& centre, double half_m) {
  return {centre - Point(half_m, half_m), centre + Point(half_m, half_m)};
}

void metres(SvgPlot& plot) {
  plot.x_label("x [m]");
  plot.y_label("y [m]");
}

/// The drawing beside a main drawing that shows a small area of it; `draw` draws the same things again.
template <class Draw>
std::string zoom_drawing(const Window& window, const std::string& title, const Draw& draw) {
  SvgPlot zoom(side_width, side_width);
  zoom.equal_aspect(side_width - 100.0, side_width - 60.0);
  zoom.title(title);
  metres(zoom);
  zoom.no_legend();
  zoom.x_range(window.first.x(), window.second.x());
  zoom.y_range(window.first.y(), window.second.y());
  draw(zoom);
  return zoom.svg();
}

bool crowded(const RunRecord& run) { return run.vehicles.size() > 2; }

// ---- Fig. 9 ----

Style truth_style() { return {truth_color, 1.9, "", 0.75}; }

/// What the black line is in drawings of one robot each.
std::string truth_clause(const RunRecord& run) {
  return has_truth(run) ? " The ground truth is laid on the true pose at the start, as its recorder saw it."
                        : " There is no pose truth to draw.";
}

/// How far apart two vehicles truly were when each started; that is what their SLAMs cannot know.
std::string started_apart(const RunRecord& run) {
  if (!has_truth(run)) return " There is no pose truth to draw.";
  const std::string dots = " Dots mark where each true trajectory begins and ends.";
  if (run.vehicles.size() != 2) return dots;
  std::vector<Point> starts;
  for (const VehicleRecord& vehicle : run.vehicles)
    if (const auto first = run.first_event_s.find(vehicle.id); first != run.first_event_s.end())
      if (const auto T = truth_at(vehicle.truth, first->second)) starts.push_back(T->translation());
  if (starts.size() != 2) return dots;
  return dots + " In truth they started " + metres_text((starts[1] - starts[0]).norm()) +
         " apart, which neither SLAM can know.";
}

Figure slam_only(const RunRecord& run, const Evaluation& evaluation) {
  Figure figure;
  figure.title = "SLAM-only trajectories (paper, Fig. 9)";
  if (crowded(run)) {
    figure.caption =
        "Each robot's own SLAM in the frame in which it started: without an exchange nothing relates these "
        "frames to one another, and each drifts by itself." +
        truth_clause(run);
    figure.body = key_of({{truth_style(), "ground truth"},
                          {{vehicle_color(run, run.vehicles.front().id), 1.6}, "SLAM, in the colour of its robot"}});
    std::string cells;
    for (const VehicleRecord& vehicle : run.vehicles) {
      SvgPlot plot(small_width, small_width);
      plot.equal_aspect(small_map_height, small_map_height);
      plot.title(vehicle_name(run, vehicle.id));
      metres(plot);
      plot.no_legend();
      const Placement placement = placement_of(run, evaluation, vehicle);
      if (placement.T_frame_world) plot.line(truth_path(vehicle, *placement.T_frame_world), truth_style());
      plot.line(slam_path(vehicle, placement.T_frame_slam), {vehicle_color(run, vehicle.id), 1.6});
      cells += cell(plot.svg(), "third");
    }
    figure.body += row_of(cells);
    return figure;
  }
  figure.caption =
      "Each vehicle's own SLAM as if it had started at the origin of the common frame." + started_apart(run);
  SvgPlot plot(page_width, 560.0);
  plot.equal_aspect(240.0, 560.0);
  metres(plot);
  for (const VehicleRecord& vehicle : run.vehicles) {
    if (!evaluation.T_world_common || vehicle.truth.empty()) continue;
    plot.line(truth_path(vehicle, evaluation.T_world_common->inverse()), {truth_color, 1.6}, "ground truth");
  }
  for (const VehicleRecord& vehicle : run.vehicles)
    plot.line(slam_path(vehicle), {vehicle_color(run, vehicle.id), 2.0}, "SLAM of " + the_vehicle(run, vehicle.id));
  for (const VehicleRecord& vehicle : run.vehicles) {
    if (!evaluation.T_world_common || vehicle.truth.empty()) continue;
    const auto path = truth_path(vehicle, evaluation.T_world_common->inverse());
    plot.dots({path.front(), path.back()}, 4.5, {vehicle_color(run, vehicle.id)},
              "true begin and end, " + vehicle_name(run, vehicle.id));
  }
  figure.body = plot.svg();
  return figure;
}

// ---- Fig. 10 and 11 ----

/// Draws one vehicle's SLAM-only path with its ellipses; the same content serves the whole view and the zoom.
void draw_drift(SvgPlot& plot, const RunRecord& run, const VehicleRecord& vehicle, const Placement& placement,
                const std::vector<const MapAnchor*>& anchors, bool with_slam_ellipses, double line_width) {
  const std::string color = vehicle_color(run, vehicle.id);
  if (placement.T_frame_world)
    plot.line(truth_path(vehicle, *placement.T_frame_world), {truth_color, line_width}, "ground truth");
  plot.line(slam_path(vehicle, placement.T_frame_slam), {color, line_width + 0.4}, "SLAM");
  for (const MapAnchor* anchor : anchors)
    plot.ellipse(placement.T_frame_slam * anchor->T_slam_body->translation(), drift_covariance(*anchor, placement),
                 {color, 1.0, "", 0.75}, "95 %, drift model");
  if (!with_slam_ellipses) return;
  std::vector<const PoseRow*> rows;
  for (const PoseRow& row : own_rows(vehicle))
    if (row.vehicle == vehicle.id && row.slam) rows.push_back(&row);
  for (const PoseRow* row : spread(rows, 150)) {
    const PoseEstimate placed{placement.T_frame_slam * row->slam->T, row->slam->P};
    plot.ellipse(placed.T.translation(), position_covariance(placed), {color, 0.8, "2 2", 1.0}, "95 %, SLAM alone");
  }
}

/// Where the zoom looks: at three quarters of the way, wide enough for the truth and the SLAM's own ellipse.
std::optional<Window> zoom_window(const VehicleRecord& vehicle, const Placement& placement) {
  std::vector<const PoseRow*> rows;
  for (const PoseRow& row : own_rows(vehicle))
    if (row.vehicle == vehicle.id && row.slam) rows.push_back(&row);
  if (rows.empty()) return std::nullopt;
  const PoseRow& row = *rows[rows.size() * 3 / 4];
  const Point centre = placement.T_frame_slam * row.slam->T.translation();
  double half = 6.0 * std::sqrt(std::max(1e-6, position_covariance(*row.slam).trace()));
  if (const auto truth = truth_at(vehicle.truth, row.t_s); truth && placement.T_frame_world && !placement.by_prior)
    half = std::max(half, 1.5 * (*placement.T_frame_world * truth->translation() - centre).norm());
  half = std::clamp(half, 0.2, 6.0);
  return window_around(centre, half);
}

std::string drift_drawing(const RunRecord& run, const Evaluation& evaluation, const VehicleRecord& vehicle) {
  const Placement placement = placement_of(run, evaluation, vehicle);
  const auto anchors = spread(anchors_of(run, vehicle.id), 10);
  SvgPlot whole(main_width, 460.0);
  whole.equal_aspect(250.0, 480.0);
  metres(whole);
  draw_drift(whole, run, vehicle, placement, anchors, false, 1.6);
  if (placement.by_prior && placement.prior.trace() > 0.0)
    whole.ellipse(placement.T_frame_slam.translation(), placement.prior.topLeftCorner<2, 2>(),
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
Share held_by_drift(const RunRecord& run, const VehicleRecord& vehicle, const Placement& placement) {
  static const double bound = chi2_quantile(0.95, 2.0);
  Share share;
  for (const MapAnchor* anchor : anchors_of(run, vehicle.id)) {
    const auto truth = truth_at(vehicle.truth, anchor->stamp_s);
    if (!truth || !placement.T_frame_world) continue;
    const Eigen::Vector2d error =
        (*placement.T_frame_world * *truth).translation() - placement.T_frame_slam * anchor->T_slam_body->translation();
    const double square = squared_mahalanobis(error, drift_covariance(*anchor, placement));
    if (std::isfinite(square)) share.add(square <= bound);  // the start is known exactly and cannot be judged
  }
  return share;
}

/// The same for the SLAM's own ellipses along the way.
Share held_by_slam(const VehicleRecord& vehicle, const Placement& placement) {
  static const double bound = chi2_quantile(0.95, 2.0);
  Share share;
  for (const PoseRow& row : own_rows(vehicle)) {
    if (row.vehicle != vehicle.id || !row.slam) continue;
    const auto truth = truth_at(vehicle.truth, row.t_s);
    if (!truth || !placement.T_frame_world) continue;
    const PoseEstimate placed{placement.T_frame_slam * row.slam->T, row.slam->P};
    const Eigen::Vector2d error = (*placement.T_frame_world * *truth).translation() - placed.T.translation();
    const double square = squared_mahalanobis(error, position_covariance(placed));
    if (std::isfinite(square)) share.add(square <= bound);
  }
  return share;
}

/// Half the length of the 95 % ellipse.
double reach_m(const Eigen::Matrix2d& covariance) {
  const double largest =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(covariance, Eigen::EigenvaluesOnly).eigenvalues()[1];
  return std::sqrt(chi2_quantile(0.95, 2.0) * std::max(0.0, largest));
}

/// What the run shows of a drift drawing: which ellipses hold the truth, and how large they are in the end.
std::string drift_findings(const RunRecord& run, const VehicleRecord& vehicle, const Placement& placement) {
  std::string text;
  const Share drift = held_by_drift(run, vehicle, placement), slam = held_by_slam(vehicle, placement);
  if (drift.judged > 0)
    text +=
        " At the ends of its segments, " + drift.text() + " true positions lie within the ellipse of the drift model.";
  if (slam.judged > 0) text += " Along the way, " + slam.text() + " lie within that of the SLAM alone.";
  const auto anchors = anchors_of(run, vehicle.id);
  const auto& rows = own_rows(vehicle);
  const auto last = std::find_if(rows.rbegin(), rows.rend(), [&](const PoseRow& row) {
    return row.vehicle == vehicle.id && row.slam && !anchors.empty() && row.t_s <= anchors.back()->stamp_s;
  });
  if (last != rows.rend())
    text += " At the last of these ends the one reaches " +
            metres_text(reach_m(drift_covariance(*anchors.back(), placement))) + ", the other " +
            metres_text(reach_m(position_covariance(*last->slam))) + ".";
  if (drift.judged == 0 && slam.judged == 0) text += " There is no pose truth to judge the ellipses by.";
  return text;
}

Figure drift_of_first(const RunRecord& run, const Evaluation& evaluation) {
  const VehicleRecord& vehicle = run.vehicles.front();
  return {
      "Drift of " + the_vehicle(run, vehicle.id) + " (paper, Fig. 10)", drift_drawing(run, evaluation, vehicle),
      "SLAM-only trajectory before any fusion, with the 95 % ellipses of the position by the drift model (solid) and, "
      "in the zoom, by the SLAM alone (dashed)." +
          drift_findings(run, vehicle, placement_of(run, evaluation, vehicle))};
}

std::string small_drift_drawing(const RunRecord& run, const Evaluation& evaluation, const VehicleRecord& vehicle,
                                double width) {
  SvgPlot plot(width, small_map_height);
  plot.equal_aspect(small_map_height, small_map_height);
  plot.title(vehicle_name(run, vehicle.id));
  metres(plot);
  plot.no_legend();
  const std::string color = vehicle_color(run, vehicle.id);
  const Placement placement = placement_of(run, evaluation, vehicle);
  if (placement.T_frame_world) plot.line(truth_path(vehicle, *placement.T_frame_world), truth_style());
  plot.line(slam_path(vehicle, placement.T_frame_slam), {color, 1.2, "", 0.75});
  for (const MapAnchor* anchor : spread(anchors_of(run, vehicle.id), 8))
    plot.ellipse(placement.T_frame_slam * anchor->T_slam_body->translation(), drift_covariance(*anchor, placement),
                 {color, 2.2});
  return plot.svg();
}

Figure drift_of_others(const RunRecord& run, const Evaluation& evaluation) {
  Figure figure;
  if (!crowded(run)) {
    const VehicleRecord& vehicle = run.vehicles.back();
    figure.title = "Drift of " + the_vehicle(run, vehicle.id) + " (paper, Fig. 11)";
    figure.body = drift_drawing(run, evaluation, vehicle);
    const Placement placement = placement_of(run, evaluation, vehicle);
    figure.caption =
        (placement.by_prior ? "SLAM-only trajectory, placed in the common frame by its static prior alone; the dashed "
                              "ellipse around its start is all that is known of that (95 %)."
                            : "SLAM-only trajectory in the frame in which it started.") +
        drift_findings(run, vehicle, placement);
    return figure;
  }
  figure.title = "Drift of the other robots (paper, Fig. 11)";
  Share held;
  for (std::size_t i = 1; i < run.vehicles.size(); ++i) {
    const VehicleRecord& vehicle = run.vehicles[i];
    const Share own = held_by_drift(run, vehicle, placement_of(run, evaluation, vehicle));
    held.held += own.held;
    held.judged += own.judged;
  }
  figure.caption =
      "The same for the other robots, each in the frame in which it started, which lies anywhere in the common "
      "frame before the first association." +
      (held.judged > 0 ? " At the ends of their segments, " + held.text() +
                             " true positions lie within the ellipse of the drift model."
                       : " There is no pose truth to judge the ellipses by.");
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

// ---- Fig. 12 ----

struct CommonLandmarks {
  std::set<Key> paired;
  std::vector<std::pair<Point, Point>> lines;
};

CommonLandmarks pairings_found(const MapRecord& map) {
  std::map<Key, Point> place;
  for (const MapLandmark& landmark : map.landmarks)
    if (landmark.p_common_m) place[landmark.key] = *landmark.p_common_m;
  CommonLandmarks result;
  for (const MapAssociation& association : map.associations) {
    if (!association.accepted) continue;
    for (const auto& [one, other] : association.pairings) {
      if (!place.contains(one) || !place.contains(other)) continue;
      result.paired.insert(one);
      result.paired.insert(other);
      result.lines.push_back({place[one], place[other]});
    }
  }
  return result;
}

void draw_map_landmarks(SvgPlot& plot, const RunRecord& run, const MapRecord& map) {
  const CommonLandmarks common = pairings_found(map);
  std::map<VehicleId, std::vector<Point>> landmarks;
  std::vector<Point> shared;
  for (const MapLandmark& landmark : map.landmarks) {
    if (!landmark.p_common_m) continue;
    landmarks[landmark.key.chain.vehicle].push_back(*landmark.p_common_m);
    if (common.paired.contains(landmark.key)) shared.push_back(*landmark.p_common_m);
  }
  // Members of a pairing lie so near to one another that a line between them would hide under full dots.
  const double radius = 2.0;
  plot.segments(common.lines, {common_color, 1.4}, "pairings");
  plot.rings(shared, radius + 2.2, {common_color, 1.3}, "landmarks found common");
  for (const auto& [id, points] : landmarks)
    plot.dots(points, radius, {vehicle_color(run, id), 1.0, "", 0.9}, "landmarks of " + the_vehicle(run, id));
}

/// How many pairings are drawn, and how long their lines are.
std::string pairing_findings(const MapRecord& map) {
  const CommonLandmarks common = pairings_found(map);
  if (common.lines.empty()) return " No landmark has been found common yet.";
  std::vector<double> lengths;
  for (const auto& [one, other] : common.lines) lengths.push_back((one - other).norm());
  std::sort(lengths.begin(), lengths.end());
  return " Red rings: " + std::to_string(common.paired.size()) + " landmarks in " + std::to_string(lengths.size()) +
         " pairings found between submaps, with a red line between the two members of each: " +
         metres_text(lengths[lengths.size() / 2]) + " long in the median, " + metres_text(lengths.back()) + " at most.";
}

std::vector<const PoseRow*> aligned_rows(const VehicleRecord& vehicle) {
  std::vector<const PoseRow*> rows;
  for (const PoseRow& row : own_rows(vehicle))
    if (row.vehicle == vehicle.id && row.common) rows.push_back(&row);
  return rows;
}

void draw_common_map(SvgPlot& plot, const RunRecord& run, const Evaluation& evaluation, const MapRecord& map,
                     std::size_t ellipses) {
  const bool many = crowded(run);
  draw_map_landmarks(plot, run, map);
  for (const VehicleRecord& vehicle : run.vehicles)
    plot.line(common_path(vehicle), {vehicle_color(run, vehicle.id), many ? 0.9 : 2.4, "", many ? 0.55 : 1.0},
              vehicle_name(run, vehicle.id));
  for (const VehicleRecord& vehicle : run.vehicles)
    for (const PoseRow* row : spread(aligned_rows(vehicle), ellipses))
      plot.ellipse(row->common->T.translation(), position_covariance(*row->common),
                   {vehicle_color(run, vehicle.id), 1.4});
  if (!evaluation.T_world_common) return;
  const SE2 T_common_world = evaluation.T_world_common->inverse();
  for (const VehicleRecord& vehicle : run.vehicles)
    if (!vehicle.truth.empty())
      plot.line(truth_path(vehicle, T_common_world), {truth_color, many ? 0.8 : 1.0, "", many ? 0.55 : 1.0},
                "ground truth");
  if (!many || run.landmarks.size() > 60) return;
  std::vector<Point> places;
  for (const TruthLandmark& landmark : run.landmarks) places.push_back(T_common_world * landmark.p_world_m);
  plot.rings(places, 7.0, {truth_color, 1.1}, "true landmarks");
}

Figure common_map(const RunRecord& run, const Evaluation& evaluation) {
  Figure figure;
  figure.title = "The common map (paper, Fig. 12)";
  const VehicleRecord* survivor = run.first_survivor();
  if (!survivor) {
    figure.caption = "No vehicle left a map.";
    return figure;
  }
  figure.caption = "The map as " + the_vehicle(run, survivor->id) +
                   " holds it in the end: corrected trajectories with 95 % ellipses, and landmarks in the colour of "
                   "who mapped them." +
                   pairing_findings(*survivor->map);
  const MapRecord& map = *survivor->map;
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
  const PoseEstimate& pose = *rows[rows.size() * 3 / 4]->common;
  const Window window =
      window_around(pose.T.translation(), std::clamp(12.0 * std::sqrt(position_covariance(pose).trace()), 2.0, 15.0));
  whole.box(window.first, window.second, {"#52606d", 1.2}, "zoom");
  const std::string zoom = zoom_drawing(window, "zoom; ellipses: 95 %, fused",
                                        [&](SvgPlot& plot) { draw_common_map(plot, run, evaluation, map, 150); });
  figure.body = row_of(cell(whole.svg(), "two-thirds") + cell(zoom, "third"));
  return figure;
}

// ---- Fig. 13 ----

/// Means over blocks of `block` seconds: many vehicles over a long time would only make a carpet.
std::vector<Point> block_means(const std::vector<TimedValue>& seconds, std::size_t block) {
  std::vector<Point> points;
  for (std::size_t i = 0; i < seconds.size(); i += block) {
    const std::size_t end = std::min(seconds.size(), i + block);
    double sum = 0.0;
    for (std::size_t k = i; k < end; ++k) sum += seconds[k].value;
    points.emplace_back(0.5 * (seconds[i].t_s + seconds[end - 1].t_s), sum / static_cast<double>(end - i));
  }
  return points;
}

/// The most in any one second: in the first one, which holds all that came before it as well, and later.
std::string traffic_findings(const RunRecord& run, const Evaluation& evaluation) {
  double first = 0.0, later = 0.0;
  for (const auto& [id, seconds] : evaluation.bytes_per_s)
    for (std::size_t i = 0; i < seconds.size(); ++i)
      (i == 0 ? first : later) = std::max(i == 0 ? first : later, seconds[i].value);
  if (first == 0.0 && later == 0.0) return " No vehicle left its counters.";
  const json rate = run.info.value("rate", json());
  const bool pressed = rate.is_number() && rate.get<double>() != 1.0;
  return " The first second holds up to " + fixed(first / 1000.0, 1) +
         " KB: all that was sent up to then, when vehicles and endpoints discover each other" +
         (pressed ? ". That takes wall time, and one second of this replay lasted " +
                        fixed(1.0 / rate.get<double>(), rate.get<double>() > 10.0 ? 3 : 2) + " s"
                  : "") +
         ". Later it is at most " + fixed(later / 1000.0, 1) + " KB in a second; the paper stays below 10.";
}

Figure bytes_sent(const RunRecord& run, const Evaluation& evaluation) {
  SvgPlot plot(page_width, 320.0);
  plot.x_label("time [s]");
  const std::size_t block = crowded(run) ? 10 : 1;
  plot.y_label(block == 1 ? "sent in each second [byte]" : "sent per second, mean of 10 s [byte]");
  plot.include({0.0, 0.0});
  for (const VehicleRecord& vehicle : run.vehicles) {
    std::vector<Point> points;
    if (const auto it = evaluation.bytes_per_s.find(vehicle.id); it != evaluation.bytes_per_s.end())
      points = block_means(it->second, block);
    plot.line(points, {vehicle_color(run, vehicle.id), 1.3, "", 0.9}, vehicle_name(run, vehicle.id));
  }
  return {"Amount of data sent (paper, Fig. 13)", plot.svg(),
          "Bytes that each vehicle put on the network per second of vehicle time, as counted by its own process." +
              traffic_findings(run, evaluation)};
}

// ---- Fig. 14 ----

constexpr double longest_step_s = 3.0;  // live poses come every second

void draw_distances(SvgPlot& plot, const PairSeries& pair, double width) {
  std::vector<Point> truth, raw, convoy;
  for (const DistanceSample& sample : pair.distances) {
    if (!truth.empty() && sample.t_s - truth.back().x() > longest_step_s)  // nothing known between: no line
      for (auto* line : {&truth, &raw, &convoy}) line->emplace_back(NAN, NAN);
    truth.emplace_back(sample.t_s, sample.true_m);
    raw.emplace_back(sample.t_s, sample.raw_m);
    convoy.emplace_back(sample.t_s, sample.convoy_m.value_or(NAN));
  }
  plot.x_label("time [s]");
  plot.y_label("distance [m]");
  plot.include({0.0, 0.0});
  plot.line(raw, {raw_color, width}, "SLAM alone, started in one place");
  plot.line(truth, {truth_color, width + 1.8}, "truth");
  plot.line(convoy, {convoy_color, width}, "convoy");
  if (pair.first_association_s) plot.vertical(*pair.first_association_s, {"#7b8794", 1.2, "4 3"}, "first association");
}

/// How well blue lies on black from the first association on, and why lines have gaps.
std::string distance_findings(const Evaluation& evaluation, const std::vector<const PairSeries*>& pairs) {
  std::string text;
  json best, worst;
  for (const json& pair : evaluation.metrics.at("pairs"))
    if (const json& rmse = pair.at("distance_rmse_m"); rmse.is_number()) {
      if (best.is_null() || rmse < best) best = rmse;
      if (worst.is_null() || rmse > worst) worst = rmse;
    }
  if (best.is_number())
    text += " From the first association on, blue is off by " + fixed(best.get<double>(), 2) +
            (worst == best ? "" : " to " + fixed(worst.get<double>(), 2)) + " m RMSE.";
  std::size_t after = 0, not_aligned = 0, without_peer = 0, without_truth = 0;
  for (const PairSeries* pair : pairs) {
    for (const DistanceSample& sample : pair->distances) {
      if (!pair->first_association_s || sample.t_s < *pair->first_association_s) continue;
      ++after;
      not_aligned += !sample.convoy_m;
    }
    without_peer += pair->without_peer;
    without_truth += pair->without_truth;
  }
  const auto count = [](std::size_t n, const std::string& what) { return std::to_string(n) + " " + what; };
  if (not_aligned > 0)
    text += " Blue has a gap where the vehicle did not hold both poses in the common frame: " +
            count(not_aligned, "of the ") + count(after, "poses after the first association.");
  if (without_truth > 0 || without_peer > 0)
    text += " No line is drawn over " + std::to_string(static_cast<int>(longest_step_s)) +
            " s and more without a comparison: the truth has a gap at " + count(without_truth, "poses") +
            ", and nothing was heard of the other one within 1.5 s of " + count(without_peer, "poses.");
  return text;
}

Figure distances(const RunRecord& run, const Evaluation& evaluation) {
  Figure figure;
  figure.title = "Distance between vehicles (paper, Fig. 14)";
  std::vector<const PairSeries*> drawable;
  for (const PairSeries& pair : evaluation.pairs)
    if (!pair.distances.empty()) drawable.push_back(&pair);
  if (drawable.empty()) {
    figure.caption =
        "No pair of vehicles with a true distance: the data set has no pose truth, or nothing was exchanged.";
    return figure;
  }
  const auto name_of = [&run](const PairSeries& pair) {
    return vehicle_name(run, pair.a) + " and " + vehicle_name(run, pair.b);
  };
  SvgPlot first(page_width, 360.0);
  first.title(name_of(*drawable.front()));
  draw_distances(first, *drawable.front(), 1.5);
  figure.body = first.svg();
  std::string cells;
  for (std::size_t i = 1; i < drawable.size(); ++i) {
    SvgPlot plot(small_width, 220.0);
    plot.title(name_of(*drawable[i]));
    plot.no_legend();
    draw_distances(plot, *drawable[i], 1.0);
    cells += cell(plot.svg(), "third");
  }
  if (!cells.empty()) figure.body += row_of(cells);
  figure.caption =
      "What the first of the two says live about its distance to the other one (blue) against the truth (black); red "
      "is "
      "what the two SLAMs give without any exchange. The two poses are those that the vehicle has at the time, up to "
      "1.5 s "
      "apart, and the truth is taken at the same two moments." +
      distance_findings(evaluation, drawable);
  return figure;
}

// ---- consistency ----

Figure consistency(const RunRecord& run, const Evaluation& evaluation) {
  SvgPlot plot(page_width, 340.0);
  plot.x_label("time [s]");
  plot.y_label("NEES of the live pose");
  plot.log_y(0.01);
  const double low = chi2_quantile(0.025, 3.0), high = chi2_quantile(0.975, 3.0);
  plot.band(low, high, {"#2f9e63", 1.0, "", 0.13}, "95 % of a consistent estimate");
  plot.include({0.0, 0.05});
  plot.include({0.0, 20.0});
  bool any = false;
  for (const VehicleRecord& vehicle : run.vehicles) {
    std::vector<Point> points;
    if (const auto it = evaluation.live_nees.find(vehicle.id); it != evaluation.live_nees.end())
      for (const TimedValue& sample : it->second) {
        if (!points.empty() && sample.t_s - points.back().x() > longest_step_s) points.emplace_back(NAN, NAN);
        points.emplace_back(sample.t_s, sample.value);
      }
    any = any || !points.empty();
    plot.line(points, {vehicle_color(run, vehicle.id), 1.3, "", 0.9}, vehicle_name(run, vehicle.id));
  }
  Figure figure{"Consistency over time", plot.svg(),
                "Normalised squared error of each vehicle's own live pose in the common frame (3 degrees of freedom, "
                "logarithmic); above the band the vehicle is surer of itself than it may be, below it is more cautious "
                "than needed." +
                    (evaluation.metrics.at("gauge") != json("fit")
                         ? ""
                         : " Judged in gauge fit, which counts against the first poses of " +
                               the_vehicle(run, run.common_frame_vehicle) + ": see below the table of vehicles.")};
  if (!any) figure = {figure.title, "", "There is no pose truth to judge the live poses by."};
  return figure;
}

}  // namespace

std::string gauge_note(const RunRecord& run, const json& m) {
  if (!m.at("gauge_shift_m").is_number()) return "";
  for (const json& v : m.at("vehicles")) {
    if (v.at("id") != json(run.common_frame_vehicle) || !v.at("pose_anees_fit").is_number() ||
        !v.at("pose_anees_start").is_number())
      continue;
    const auto of = [&v](const std::string& gauge) {
      return fixed(v.at("pose_anees_" + gauge).get<double>(), 2) + " (" +
             fixed(100.0 * v.at("pose_coverage95_" + gauge).get<double>(), 1) + " % within the bound)";
    };
    return " Here the two lie " + fixed(m.at("gauge_shift_m").get<double>(), 3) + " m and " +
           fixed(m.at("gauge_turn_rad").get<double>() * 180.0 / M_PI, 1) + " degrees apart. The start of " +
           the_vehicle(run, run.common_frame_vehicle) +
           " is the origin of the common frame and known exactly, so whatever the fit is off counts in full against "
           "its first "
           "poses: its ANEES is " +
           of("fit") + " in gauge fit and " + of("start") + " in gauge start.";
  }
  return "";
}

std::string vehicle_name(const RunRecord& run, VehicleId id) {
  if (run.scenario == "street" && run.vehicles.size() == 2) return id == 1 ? "front vehicle" : "back vehicle";
  return "robot " + std::to_string(id);
}

std::string vehicle_color(const RunRecord& run, VehicleId id) {
  static const char* const colors[] = {"#1a8f3c", "#1f5fbf", "#e07b00", "#8e3fb5", "#7a5230",
                                       "#009aa6", "#b8860b", "#5b6770", "#c2185b", "#4b7a00"};
  const auto it = std::find_if(run.vehicles.begin(), run.vehicles.end(), [id](const auto& v) { return v.id == id; });
  return colors[static_cast<std::size_t>(it - run.vehicles.begin()) % std::size(colors)];
}

std::string the_vehicle(const RunRecord& run, VehicleId id) {
  const std::string name = vehicle_name(run, id);
  return name.ends_with("vehicle") ? "the " + name : name;
}

std::vector<Figure> make_figures(const RunRecord& run, const Evaluation& evaluation) {
  if (run.vehicles.empty()) return {};
  std::vector<Figure> figures{slam_only(run, evaluation), drift_of_first(run, evaluation)};
  if (run.vehicles.size() > 1) figures.push_back(drift_of_others(run, evaluation));
  figures.push_back(common_map(run, evaluation));
  figures.push_back(bytes_sent(run, evaluation));
  if (run.vehicles.size() > 1) figures.push_back(distances(run, evaluation));
  figures.push_back(consistency(run, evaluation));
  return figures;
}

}  // namespace convoy::cli
