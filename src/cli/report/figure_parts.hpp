// What the figures of the report share, and each of them by itself.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "report/figures.hpp"
#include "report/svg_plot.hpp"

namespace convoy::cli::figures {

// ---- the figures ----

template <class G>
Figure slam_only(const RunRecord<G>& run, const Evaluation<G>& evaluation);
template <class G>
Figure drift_of_first(const RunRecord<G>& run, const Evaluation<G>& evaluation);
template <class G>
Figure drift_of_others(const RunRecord<G>& run, const Evaluation<G>& evaluation);
template <class G>
Figure common_map(const RunRecord<G>& run, const Evaluation<G>& evaluation);
Figure height_profile(const RunRecord<SE3>& run, const Evaluation<SE3>& evaluation);
template <class G>
Figure bytes_sent(const RunRecord<G>& run, const Evaluation<G>& evaluation);
template <class G>
Figure distances(const RunRecord<G>& run, const Evaluation<G>& evaluation);
template <class G>
Figure consistency(const RunRecord<G>& run, const Evaluation<G>& evaluation);

// ---- what they share ----

using Point = SvgPlot::Point;
using Style = SvgPlot::Style;
using Window = std::pair<Point, Point>;  // low and high corner

inline constexpr double page_width = 1060.0;  // px
inline constexpr double main_width = 700.0;   // main drawing with a zoom beside it
inline constexpr double side_width = 350.0;
inline constexpr double small_width = 346.0;  // three in a row
inline constexpr double small_map_height = 270.0;
inline constexpr double half_width = 525.0;    // two in a row
inline constexpr double truth_period_s = 0.2;  // finer truth than the eye can see makes the page heavy
inline const std::string truth_color = "#000000";
inline const std::string common_color = "#d62728";
inline const std::string raw_color = "#d62728";
inline const std::string convoy_color = "#1f5fbf";

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

/// How one vehicle's SLAM-only path is placed: by its static prior, or in its own start frame.
template <class G>
struct Placement {
  G T_frame_slam;
  typename G::Covariance prior = G::Covariance::Zero();
  std::optional<G> T_frame_world;  ///< for the truth
  bool by_prior = false;
};

std::string cell(const std::string& svg, const char* width_class);
std::string row_of(const std::string& cells);
/// The legend of several drawings in a row: what each kind of line is.
std::string key_of(const std::vector<std::pair<Style, std::string>>& entries);

std::string metres_text(double value);
template <class G>
bool has_truth(const RunRecord<G>& run);
/// " There is no pose truth to judge ... by.", or that it is too coarse.
template <class G>
std::string without_judgement(const RunRecord<G>& run, const std::string& of_what);
/// A point in space as drawings show it: from above.
inline Point from_above(const Eigen::Vector2d& p) { return p; }
inline Point from_above(const Eigen::Vector3d& p) { return p.head<2>(); }
inline Eigen::Matrix2d from_above(const Eigen::Matrix2d& covariance) { return covariance; }
inline Eigen::Matrix2d from_above(const Eigen::Matrix3d& covariance) { return covariance.topLeftCorner<2, 2>(); }

/// The true path, seen from the frame given by T_frame_world.
template <class G>
std::vector<Point> truth_path(const VehicleRecord<G>& vehicle, const G& T_frame_world);

template <class G>
const std::vector<PoseRow<G>>& own_rows(const VehicleRecord<G>& vehicle);
template <class G>
std::vector<Point> slam_path(const VehicleRecord<G>& vehicle, const G& T_frame_slam = G());
template <class G>
std::vector<Point> common_path(const VehicleRecord<G>& vehicle);
/// Position covariance in the frame of T, of the right perturbation of T.
template <class G>
typename G::PointCovariance position_covariance(const PoseEstimate<G>& estimate);

template <class G>
Placement<G> placement_of(const RunRecord<G>& run, const Evaluation<G>& evaluation, const VehicleRecord<G>& vehicle);
/// Position uncertainty of an anchor before any fusion: static prior and drift up to there (paper, eq. 4, and the
/// static part of the bias).
template <class G>
typename G::PointCovariance drift_covariance(const MapAnchor<G>& anchor, const Placement<G>& placement);

template <class G>
std::vector<const MapAnchor<G>*> anchors_of(const RunRecord<G>& run, VehicleId id);
Window window_around(const Point& centre, double half_m);
void metres(SvgPlot& plot);
template <class G>
bool crowded(const RunRecord<G>& run);

/// About `wanted` elements, evenly spread, the last one among them.
template <class T>
std::vector<T> spread(const std::vector<T>& all, std::size_t wanted) {
  if (all.size() <= wanted) return all;
  std::vector<T> some;
  for (std::size_t i = 1; i <= wanted; ++i) some.push_back(all[i * (all.size() - 1) / wanted]);
  return some;
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

}  // namespace convoy::cli::figures
