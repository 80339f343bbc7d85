#include "route_line.hpp"

#include "parameter_check.hpp"

#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>
#include <limits>

namespace convoy::simulator {
namespace {

constexpr double spacing_m = 0.25;

std::vector<Eigen::Vector2d> checked_points(const Route& route) {
  const std::string what = "Route \"" + route.name + "\"";
  std::vector<Eigen::Vector2d> points;
  for (std::size_t i = 0; i < route.points.size(); ++i) {
    check_that(route.points[i].allFinite(), what + ", point " + std::to_string(i), "not finite; take it out");
    if (points.empty() || (route.points[i] - points.back()).norm() > 1e-3) points.push_back(route.points[i]);
  }
  if (route.closed && points.size() > 1) {
    if ((points.front() - points.back()).norm() <= 1e-3) points.pop_back();
    points.push_back(points.front());
  }
  check_that(
      points.size() >= (route.closed ? 4U : 2U), what,
      std::to_string(route.points.size()) + " points, too few that differ; an open route needs 2, a closed one 3");
  return points;
}

double distance_to_segment(const Eigen::Vector2d& p, const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  const double part = std::clamp((p - a).dot(b - a) / (b - a).squaredNorm(), 0.0, 1.0);
  return (p - a - part * (b - a)).norm();
}

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

}  // namespace

double wrapped_rad(double angle_rad) {
  const double rest = std::remainder(angle_rad, 2.0 * M_PI);
  return rest <= -M_PI ? M_PI : rest;
}

RouteLine::RouteLine(const Route& route, double offset_m) : name_(route.name), closed_(route.closed) {
  check_range("RouteLine.offset_m", offset_m, -50.0, 50.0, "m");
  const std::vector<Eigen::Vector2d> corners = checked_points(route);
  std::vector<Eigen::Vector2d> middle{corners.front()};
  std::vector<double> abscissas{0.0};
  for (std::size_t i = 1; i < corners.size(); ++i) {
    const double length = (corners[i] - corners[i - 1]).norm();
    const int parts = std::max(1, static_cast<int>(std::lround(length / spacing_m)));
    const double start = abscissas.back();
    for (int part = 1; part <= parts; ++part) {
      middle.push_back(corners[i - 1] + (corners[i] - corners[i - 1]) * part / parts);
      abscissas.push_back(start + length * part / parts);
    }
  }
  if (offset_m == 0.0) {
    points_ = std::move(middle);
    abscissas_ = std::move(abscissas);
  } else {
    set_beside(middle, abscissas, offset_m);
  }
  ways_.assign(1, 0.0);
  for (std::size_t i = 1; i < points_.size(); ++i) ways_.push_back(ways_.back() + (points_[i] - points_[i - 1]).norm());
}

// Points beside the middle, without those that inside of a bend would come nearer to it than the offset.
void RouteLine::set_beside(const std::vector<Eigen::Vector2d>& middle, const std::vector<double>& abscissas,
                           double offset_m) {
  const auto n = static_cast<std::ptrdiff_t>(middle.size());
  const auto reach = static_cast<std::ptrdiff_t>((4.0 * std::abs(offset_m) + 2.0) / spacing_m);
  const auto at = [&](std::ptrdiff_t i) -> const Eigen::Vector2d& {
    if (closed_) i = (i % (n - 1) + n - 1) % (n - 1);
    return middle[static_cast<std::size_t>(std::clamp<std::ptrdiff_t>(i, 0, n - 1))];
  };
  for (std::ptrdiff_t i = 0; i < (closed_ ? n - 1 : n); ++i) {
    const Eigen::Vector2d before = at(i) - at(i - 1), after = at(i + 1) - at(i);
    const Eigen::Vector2d along = before.normalized() + after.normalized();
    if (along.norm() < 1e-6) continue;
    const Eigen::Vector2d point = at(i) + Eigen::Vector2d(-along.y(), along.x()).normalized() * offset_m;
    bool far_enough = true;
    for (std::ptrdiff_t j = i - reach; j < i + reach && far_enough; ++j)
      if ((at(j + 1) - at(j)).norm() > 0.0)
        far_enough = distance_to_segment(point, at(j), at(j + 1)) > 0.98 * std::abs(offset_m);
    if (!far_enough || (!points_.empty() && (point - points_.back()).norm() < 1e-3)) continue;
    points_.push_back(point);
    abscissas_.push_back(abscissas[static_cast<std::size_t>(i)]);
  }
  check_that(points_.size() >= (closed_ ? 3U : 2U), "Route \"" + name_ + "\"",
             "nothing is left of it at the offset asked for; offset less than its bends' radii");
  if (!closed_) return;
  const double start = abscissas_.front();  // the lap begins at the first point that is left
  points_.push_back(points_.front());
  abscissas_.push_back(abscissas.back() + start);
}

double RouteLine::within_lap(double way_m) const {
  return closed_ ? way_m - length_m() * std::floor(way_m / length_m()) : way_m;
}

std::size_t RouteLine::segment(double way_m) const {
  const auto after = std::upper_bound(ways_.begin(), ways_.end(), way_m);
  const auto i = static_cast<std::size_t>(std::max<std::ptrdiff_t>(1, after - ways_.begin()));
  return std::min(i, ways_.size() - 1) - 1;
}

Eigen::Vector2d RouteLine::point(double way_m) const {
  const double way = within_lap(way_m);
  const std::size_t i = segment(way);
  return points_[i] + (points_[i + 1] - points_[i]) * (way - ways_[i]) / (ways_[i + 1] - ways_[i]);
}

double RouteLine::heading_rad(double way_m) const {
  const std::size_t i = segment(within_lap(way_m));
  const Eigen::Vector2d along = points_[i + 1] - points_[i];
  return std::atan2(along.y(), along.x());
}

double RouteLine::abscissa_m(double way_m) const {
  const double way = within_lap(way_m);
  const std::size_t i = segment(way);
  const double part = (way - ways_[i]) / (ways_[i + 1] - ways_[i]);
  const double laps = closed_ ? std::floor(way_m / length_m()) : 0.0;
  return abscissas_[i] + (abscissas_[i + 1] - abscissas_[i]) * part + laps * (abscissas_.back() - abscissas_.front());
}

double RouteLine::way_of_abscissa_m(double abscissa_m) const {
  const double lap = abscissas_.back() - abscissas_.front();
  const double laps = closed_ ? std::floor((abscissa_m - abscissas_.front()) / lap) : 0.0;
  const double rest = abscissa_m - laps * lap;
  const auto after = std::upper_bound(abscissas_.begin(), abscissas_.end(), rest);
  const auto i = std::min(static_cast<std::size_t>(std::max<std::ptrdiff_t>(1, after - abscissas_.begin())),
                          abscissas_.size() - 1);
  const double part = (rest - abscissas_[i - 1]) / (abscissas_[i] - abscissas_[i - 1]);
  return ways_[i - 1] + part * (ways_[i] - ways_[i - 1]) + laps * length_m();
}

double RouteLine::curvature_pm(double way_m) const {
  double from = way_m - 1.0, to = way_m + 1.0;
  if (!closed_) from = std::max(0.0, from), to = std::min(length_m(), to);
  if (to - from < 0.5) return 0.0;
  return wrapped_rad(heading_rad(to) - heading_rad(from)) / (to - from);
}

std::vector<double> RouteLine::corners_m(double angle_rad) const {
  std::vector<double> corners;
  const std::size_t last = points_.size() - 1;
  for (std::size_t i = closed_ ? 0 : 1; i < last; ++i) {
    const Eigen::Vector2d before = i > 0 ? points_[i] - points_[i - 1] : points_[last] - points_[last - 1];
    const Eigen::Vector2d after = points_[i + 1] - points_[i];
    if (std::abs(std::atan2(cross(before, after), before.dot(after))) > angle_rad) corners.push_back(ways_[i]);
  }
  return corners;
}

RouteLine::Place RouteLine::find(const Eigen::Vector2d& p, double heading_rad) const {
  const Eigen::Vector2d ahead(std::cos(heading_rad), std::sin(heading_rad));
  double best_way = 0.0, least = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i + 1 < points_.size(); ++i) {
    const Eigen::Vector2d along = points_[i + 1] - points_[i];
    // A line that leads back is as if ten metres farther.
    const double distance = distance_to_segment(p, points_[i], points_[i + 1]) + (along.dot(ahead) < 0.0 ? 10.0 : 0.0);
    if (distance < least) least = distance, best_way = ways_[i];
  }
  return find_near(p, best_way, spacing_m, 2.0 * spacing_m);
}

RouteLine::Place RouteLine::find_near(const Eigen::Vector2d& p, double way_m, double behind_m, double ahead_m) const {
  Place best;
  double least = std::numeric_limits<double>::infinity();
  double from = way_m - behind_m;
  if (!closed_) from = std::clamp(from, 0.0, length_m());
  const double lap_start = way_m - behind_m - within_lap(way_m - behind_m);
  std::size_t i = segment(within_lap(from));
  double base = closed_ ? lap_start : 0.0;
  while (base + ways_[i] <= way_m + ahead_m) {
    const Eigen::Vector2d along = points_[i + 1] - points_[i], to = p - points_[i];
    const double part = std::clamp(to.dot(along) / along.squaredNorm(), 0.0, 1.0);
    const double distance = (to - part * along).norm();
    if (distance < least) {
      least = distance;
      best = {base + ways_[i] + part * along.norm(), cross(along, to) >= 0.0 ? distance : -distance};
    }
    if (++i + 1 < points_.size()) continue;
    if (!closed_) break;
    i = 0;
    base += length_m();
  }
  return best;
}

}  // namespace convoy::simulator
