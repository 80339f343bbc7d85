#include "street_network.hpp"

#include "noise.hpp"

#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>

namespace convoy::simulator {
namespace {

constexpr double cell_m = 16.0;
constexpr double corner_m = 6.0;  // how far apart two roads begin to round their corner: a radius of some 5 m

int cell_of(double x) { return static_cast<int>(std::floor(x / cell_m)); }

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

double smooth_min(double a, double b, double reach) {
  if (reach < 1e-6) return std::min(a, b);
  const double h = std::max(reach - std::abs(a - b), 0.0) / reach;
  return std::min(a, b) - h * h * reach * 0.25;
}

}  // namespace

StreetNetwork::StreetNetwork(const std::vector<Street>& streets) {
  for (std::size_t s = 0; s < streets.size(); ++s) {
    const auto& line = streets[s].line;
    for (std::size_t i = 0; i + 1 < line.size(); ++i) {
      const Eigen::Vector2d step = line[i + 1] - line[i];
      const double length = step.norm();
      if (length < 1e-9) continue;
      segments_.push_back({line[i], step / length, length, streets[s].half_width_m, s});
      const double reach = streets[s].half_width_m + far_m;
      const Eigen::Vector2d low = line[i].cwiseMin(line[i + 1]).array() - reach;
      const Eigen::Vector2d high = line[i].cwiseMax(line[i + 1]).array() + reach;
      for (int cx = cell_of(low.x()); cx <= cell_of(high.x()); ++cx)
        for (int cy = cell_of(low.y()); cy <= cell_of(high.y()); ++cy) cells_[{cx, cy}].push_back(segments_.size() - 1);
    }
  }
}

const std::vector<std::size_t>& StreetNetwork::near(const Eigen::Vector2d& point) const {
  static const std::vector<std::size_t> none;
  const auto cell = cells_.find({cell_of(point.x()), cell_of(point.y())});
  return cell == cells_.end() ? none : cell->second;
}

double StreetNetwork::distance_m(const Segment& segment, const Eigen::Vector2d& point) {
  const double along = std::clamp((point - segment.from).dot(segment.along), 0.0, segment.length);
  return (point - segment.from - along * segment.along).norm() - segment.half_width;
}

double StreetNetwork::beyond_kerb_m(const Eigen::Vector2d& point) const {
  const auto& candidates = near(point);
  double best = far_m;
  const Segment* nearest = nullptr;
  for (const std::size_t i : candidates) {
    const double distance = distance_m(segments_[i], point);
    if (distance < best) best = distance, nearest = &segments_[i];
  }
  if (nearest == nullptr) return best;
  double rounded = best;
  for (const std::size_t i : candidates) {
    const double reach = corner_m * std::abs(cross(segments_[i].along, nearest->along));
    const double distance = distance_m(segments_[i], point);
    if (distance < best + reach) rounded = std::min(rounded, smooth_min(best, distance, reach));
  }
  return rounded;
}

double StreetNetwork::beyond_others_m(const Eigen::Vector2d& point, std::size_t street) const {
  double best = far_m;
  for (const std::size_t i : near(point))
    if (segments_[i].street != street && segments_[i].half_width > entrance_half_width_m)
      best = std::min(best, distance_m(segments_[i], point));
  return best;
}

double Terrain::bed_m(double x_m, double y_m) const {
  constexpr double level_m = 50.0;  // the outermost metres lead to the level land around
  const double inside = std::min({x_m - low_.x(), high_.x() - x_m, y_m - low_.y(), high_.y() - y_m});
  if (inside <= 0.0) return 0.0;
  const double t = std::min(inside / level_m, 1.0), fade = t * t * (3.0 - 2.0 * t);
  const double phase = 0.7 * static_cast<double>(seed_ % 97U);
  const double slope = 1.3 * std::sin(x_m / 52.0 + phase) + 1.1 * std::sin(y_m / 43.0 + 1.9 * phase);
  const double uneven = 0.007 * value_noise(seed_ + 11, x_m / 4.1, y_m / 4.1) +
                        0.004 * value_noise(seed_ + 12, x_m / 1.3, y_m / 1.3) +
                        0.0015 * value_noise(seed_ + 13, x_m / 0.5, y_m / 0.5);
  return fade * slope + uneven;
}

double Terrain::height_m(double x_m, double y_m) const {
  constexpr double ramp_m = 0.06;
  const double beyond = network_.beyond_kerb_m({x_m, y_m});
  return bed_m(x_m, y_m) + kerb_m * std::clamp(beyond / ramp_m, 0.0, 1.0);
}

}  // namespace convoy::simulator
