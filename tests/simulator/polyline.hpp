// Lines of points in the plane.
#pragma once

#include <Eigen/Core>

#include <vector>

namespace convoy::simulator {

using Polyline = std::vector<Eigen::Vector2d>;

double length_m(const Polyline& line, bool closed = false);
double distance_m(const Eigen::Vector2d& point, const Eigen::Vector2d& a, const Eigen::Vector2d& b);

struct PointOnLine {
  Eigen::Vector2d at, ahead;  ///< ahead: unit
};
/// At arc length s, held at the ends; a closed line goes round.
PointOnLine point_at(const Polyline& line, double s_m, bool closed = false);
/// Points every `step_m` or a little less.
Polyline resampled(const Polyline& line, double step_m, bool closed = false);
/// Bends no sharper than `radius` [m], resampled to 0.5 m: smoothed by as little as does it. Ends of an open line stay.
/// @throws std::runtime_error where no smoothing does it.
Polyline rounded(const Polyline& line, double radius, bool closed);
/// The line so far to the right [m], for lines that are smooth.
Polyline to_the_right(const Polyline& line, double offset_m, bool closed);
/// Smallest radius over neighbours about 1 m apart [m].
double smallest_radius_m(const Polyline& line, bool closed);

bool contains(const Polyline& polygon, const Eigen::Vector2d& point);
bool crosses_itself(const Polyline& polygon);
/// The area, positive where corners run counter-clockwise [m^2].
double signed_area_m2(const Polyline& polygon);

/// Distance to a set of lines, looked up in cells.
class NearLines {
 public:
  void add(const Polyline& line, bool closed);
  /// At most `far_m`.
  double distance_m(const Eigen::Vector2d& point) const;
  explicit NearLines(double far_m) : far_m_(far_m) {}

 private:
  double far_m_;
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> pieces_;
  std::vector<std::vector<std::size_t>> buckets_ = std::vector<std::vector<std::size_t>>(4096);
  std::size_t bucket(int x, int y) const;
};

}  // namespace convoy::simulator
