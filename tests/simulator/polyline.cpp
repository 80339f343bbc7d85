#include "polyline.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace convoy::simulator {
namespace {

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

/// Radius of the circle through three points; 0 where the line turns back.
double radius_m(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c) {
  if ((b - a).dot(c - b) <= 0.0) return 0.0;
  const double doubled = std::abs(cross(b - a, c - a));
  if (doubled < 1e-9) return std::numeric_limits<double>::infinity();
  return (b - a).norm() * (c - b).norm() * (c - a).norm() / (2.0 * doubled);
}

/// Draws points in where the line is bent more than by `radius`; whether it was anywhere.
bool ease(Polyline& line, double radius, bool closed) {
  constexpr std::size_t reach = 2;
  const std::size_t n = line.size();
  std::vector<bool> sharp(n, false);
  bool any = false;
  for (std::size_t i = closed ? 0 : reach; i < (closed ? n : n - reach); ++i) {
    if (radius_m(line[(i + n - reach) % n], line[i], line[(i + reach) % n]) >= radius) continue;
    any = true;
    for (const std::size_t k : {i + n - 1, i, i + 1}) sharp[k % n] = true;
  }
  const Polyline before = line;
  for (std::size_t i = closed ? 0 : 1; i < (closed ? n : n - 1); ++i)
    if (sharp[i]) line[i] = 0.5 * before[i] + 0.25 * (before[(i + n - 1) % n] + before[(i + 1) % n]);
  return any;
}

}  // namespace

double length_m(const Polyline& line, bool closed) {
  double length = closed && line.size() > 1 ? (line.front() - line.back()).norm() : 0.0;
  for (std::size_t i = 0; i + 1 < line.size(); ++i) length += (line[i + 1] - line[i]).norm();
  return length;
}

double distance_m(const Eigen::Vector2d& point, const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  const Eigen::Vector2d along = b - a;
  const double squared = along.squaredNorm();
  const double t = squared > 0.0 ? std::clamp((point - a).dot(along) / squared, 0.0, 1.0) : 0.0;
  return (point - a - t * along).norm();
}

PointOnLine point_at(const Polyline& line, double s_m, bool closed) {
  const std::size_t pieces = closed ? line.size() : line.size() - 1;
  double left = s_m;
  if (closed) {
    const double around = length_m(line, true);
    left = s_m - around * std::floor(s_m / around);
  }
  for (std::size_t i = 0; i < pieces; ++i) {
    const Eigen::Vector2d &a = line[i], &b = line[(i + 1) % line.size()];
    const double length = (b - a).norm();
    if (left <= length || i + 1 == pieces) {
      const Eigen::Vector2d ahead = length > 0.0 ? Eigen::Vector2d((b - a) / length) : Eigen::Vector2d(1.0, 0.0);
      return {a + std::clamp(left, 0.0, length) * ahead, ahead};
    }
    left -= length;
  }
  return {line.front(), {1.0, 0.0}};
}

Polyline resampled(const Polyline& line, double step_m, bool closed) {
  const double length = length_m(line, closed);
  const int n = std::max(2, static_cast<int>(std::ceil(length / step_m)));
  Polyline points;
  const std::size_t pieces = closed ? line.size() : line.size() - 1;
  double start = 0.0;
  int next = 0;
  for (std::size_t i = 0; i < pieces; ++i) {
    const Eigen::Vector2d &a = line[i], &b = line[(i + 1) % line.size()];
    const double piece = (b - a).norm();
    for (; next < n && next * length / n < start + piece; ++next)
      points.push_back(a + (next * length / n - start) / piece * (b - a));
    start += piece;
  }
  if (!closed) points.push_back(line.back());
  return points;
}

double smallest_radius_m(const Polyline& line, bool closed) {
  const Polyline points = resampled(line, 1.0, closed);
  const std::size_t n = points.size();
  double smallest = std::numeric_limits<double>::infinity();
  for (std::size_t i = closed ? 0 : 1; i < (closed ? n : n - 1); ++i)
    smallest = std::min(smallest, radius_m(points[(i + n - 1) % n], points[i], points[(i + 1) % n]));
  return smallest;
}

Polyline rounded(const Polyline& line, double radius, bool closed) {
  constexpr double step_m = 0.5;
  Polyline smooth = resampled(line, step_m, closed);
  for (int round = 0; round < 60; ++round) {
    for (int i = 0; i < 60 && ease(smooth, 1.06 * radius, closed); ++i) {
    }
    smooth = resampled(smooth, step_m, closed);
    if (smallest_radius_m(smooth, closed) >= radius) return smooth;
  }
  throw std::runtime_error("route: no way round its bends by a radius of " + std::to_string(radius) +
                           " m; choose other streets");
}

Polyline to_the_right(const Polyline& line, double offset_m, bool closed) {
  const std::size_t n = line.size();
  Polyline moved(n);
  for (std::size_t i = 0; i < n; ++i) {
    const Eigen::Vector2d before = i > 0 ? line[i - 1] : closed ? line[n - 1] : line[0];
    const Eigen::Vector2d after = i + 1 < n ? line[i + 1] : closed ? line[0] : line[n - 1];
    const Eigen::Vector2d ahead = (after - before).normalized();
    moved[i] = line[i] + offset_m * Eigen::Vector2d(ahead.y(), -ahead.x());
  }
  return resampled(moved, 0.5, closed);
}

bool contains(const Polyline& polygon, const Eigen::Vector2d& point) {
  bool inside = false;
  for (std::size_t i = 0, j = polygon.size() - 1; i < polygon.size(); j = i++) {
    const Eigen::Vector2d &a = polygon[i], &b = polygon[j];
    if ((a.y() > point.y()) == (b.y() > point.y())) continue;
    if (point.x() < a.x() + (point.y() - a.y()) / (b.y() - a.y()) * (b.x() - a.x())) inside = !inside;
  }
  return inside;
}

bool crosses_itself(const Polyline& polygon) {
  const std::size_t n = polygon.size();
  for (std::size_t i = 0; i < n; ++i) {
    const Eigen::Vector2d &a = polygon[i], &b = polygon[(i + 1) % n];
    for (std::size_t j = i + 2; j < n; ++j) {
      if (i == 0 && j == n - 1) continue;
      const Eigen::Vector2d &c = polygon[j], &d = polygon[(j + 1) % n];
      if (cross(b - a, c - a) * cross(b - a, d - a) < 0.0 && cross(d - c, a - c) * cross(d - c, b - c) < 0.0)
        return true;
    }
  }
  return false;
}

double signed_area_m2(const Polyline& polygon) {
  double doubled = 0.0;
  for (std::size_t i = 0; i < polygon.size(); ++i) doubled += cross(polygon[i], polygon[(i + 1) % polygon.size()]);
  return doubled / 2.0;
}

std::size_t NearLines::bucket(int x, int y) const {
  return (static_cast<std::size_t>(x) * 73856093U ^ static_cast<std::size_t>(y) * 19349663U) % buckets_.size();
}

void NearLines::add(const Polyline& line, bool closed) {
  const std::size_t count = closed ? line.size() : line.size() - 1;
  const auto cell = [&](double x) { return static_cast<int>(std::floor(x / far_m_)); };
  for (std::size_t i = 0; i < count; ++i) {
    const Eigen::Vector2d &a = line[i], &b = line[(i + 1) % line.size()];
    pieces_.emplace_back(a, b);
    for (int x = cell(std::min(a.x(), b.x()) - far_m_); x <= cell(std::max(a.x(), b.x()) + far_m_); ++x)
      for (int y = cell(std::min(a.y(), b.y()) - far_m_); y <= cell(std::max(a.y(), b.y()) + far_m_); ++y)
        buckets_[bucket(x, y)].push_back(pieces_.size() - 1);
  }
}

double NearLines::distance_m(const Eigen::Vector2d& point) const {
  double best = far_m_;
  const auto cell = [&](double x) { return static_cast<int>(std::floor(x / far_m_)); };
  for (const std::size_t i : buckets_[bucket(cell(point.x()), cell(point.y()))])
    best = std::min(best, simulator::distance_m(point, pieces_[i].first, pieces_[i].second));
  return best;
}

}  // namespace convoy::simulator
