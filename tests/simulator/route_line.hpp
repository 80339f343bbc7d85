// A route as a line with lengths: what lies where along it, beside it, and how it bends.
#pragma once

#include "ground.hpp"

#include <Eigen/Core>

#include <vector>

namespace convoy::simulator {

/// The route, or the line at a distance beside it. `way` is the length along this line, `abscissa` that along the route
/// itself [m]. On a closed route ways go on from lap to lap; on an open one the line goes on straight beyond its ends.
class RouteLine {
 public:
  /// offset_m: to the left of the route. Throws std::invalid_argument for a route that is none: too few points, not
  /// finite, of no length, or so bent that no line runs beside it at the offset.
  RouteLine(const Route& route, double offset_m);

  struct Place {
    double way_m = 0.0;
    double left_m = 0.0;  ///< the point asked for is to the left of the line by so much
  };
  /// Nearest place of the whole line that does not lead against the heading.
  Place find(const Eigen::Vector2d& point, double heading_rad) const;
  /// Nearest place from way_m - behind_m to way_m + ahead_m.
  Place find_near(const Eigen::Vector2d& point, double way_m, double behind_m, double ahead_m) const;

  bool closed() const { return closed_; }
  double length_m() const { return ways_.back(); }
  double route_length_m() const { return abscissas_.back(); }
  Eigen::Vector2d point(double way_m) const;
  double heading_rad(double way_m) const;
  double abscissa_m(double way_m) const;  ///< goes on from lap to lap
  double way_of_abscissa_m(double abscissa_m) const;
  /// Change of heading per metre over the two metres around [1/m], left positive.
  double curvature_pm(double way_m) const;

  /// Where the line turns at a point by more than angle_rad, in order. Not the ends.
  std::vector<double> corners_m(double angle_rad) const;

 private:
  std::size_t segment(double way_m) const;  // of a way within one lap
  double within_lap(double way_m) const;
  void set_beside(const std::vector<Eigen::Vector2d>& middle, const std::vector<double>& abscissas, double offset_m);

  std::string name_;
  bool closed_;
  std::vector<Eigen::Vector2d> points_;  // of a closed line, the last is the first again
  std::vector<double> ways_, abscissas_;
};

/// Into (-pi, pi].
double wrapped_rad(double angle_rad);

}  // namespace convoy::simulator
