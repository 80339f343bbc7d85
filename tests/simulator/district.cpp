#include "district.hpp"

#include "polyline.hpp"
#include "random.hpp"

#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace convoy::simulator {
namespace {

using Eigen::Vector2d;

constexpr double inner_lane_m = 1.2, outer_lane_m = 3.2;  // right of the middle of the street

void check(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return;  // not a number fails this, too
  throw std::runtime_error(std::string("district: ") + name + " is " + std::to_string(value) + ", not between " +
                           std::to_string(low) + " and " + std::to_string(high));
}

/// A street from a to b that swings to the left by `bow` and back.
Polyline bent(const Vector2d& a, const Vector2d& b, double bow) {
  const Vector2d along = b - a, left = Vector2d(-along.y(), along.x()).normalized();
  Polyline line;
  constexpr int pieces = 24;
  for (int i = 0; i <= pieces; ++i) {
    const double t = static_cast<double>(i) / pieces, swing = 0.5 - 0.5 * std::cos(2.0 * M_PI * t);
    line.push_back(a + t * along + bow * swing * left);
  }
  return line;
}

struct Corners {
  Vector2d south_west, south_east, north_west, north_east, south, north;
};

/// Houses in a row along one side of a street.
class Rows {
 public:
  Rows(StreetPlan& plan, const StreetNetwork& network, double gap_share, Stream& random)
      : plan_(plan), network_(network), gap_share_(gap_share), random_(random) {}

  void build(const Street& street, double side) {
    const Polyline line = street.line;
    const double length = length_m(line);
    double s = 0.0;
    while (s < length - 8.0) {
      const double width = random_.uniform(8.0, 25.0), depth = random_.uniform(9.0, 13.0);
      const double setback = random_.chance(0.25) ? random_.uniform(0.4, 2.2) : 0.0;
      const int storeys = 3 + static_cast<int>(random_.below(4));
      const bool notched = width > 13.0 && random_.chance(0.4), gap = random_.chance(gap_share_);
      const double notch = random_.uniform(0.8, 1.8), height = 4.4 + 3.2 * (storeys - 1) + random_.uniform(-0.2, 0.5);
      double taken = 0.0;
      for (double tried = std::min(width, length - s); tried >= 8.0 && taken == 0.0; tried -= 2.0) {
        Polyline lot =
            lot_of(street, side, s, tried, street.half_width_m + 3.4 + setback, depth, notched ? notch : 0.0);
        if (!fits(lot)) continue;
        taken = tried;
        if (!gap)
          plan_.footprints.push_back({std::move(lot), height, static_cast<std::uint32_t>(plan_.footprints.size() + 1)});
      }
      s += taken > 0.0 ? taken : 1.0;
    }
  }

 private:
  static Polyline lot_of(const Street& street, double side, double s, double width, double front, double depth,
                         double notch) {
    const PointOnLine first = point_at(street.line, s + 1e-6), last = point_at(street.line, s + width - 1e-6);
    const auto beside = [&](const PointOnLine& p, double out) {
      return Vector2d(p.at + side * out * Vector2d(p.ahead.y(), -p.ahead.x()));
    };
    // Along a bend a house is as straight as another.
    const Vector2d a = beside(first, front), b = beside(last, front);
    const Vector2d along = (b - a).normalized(), out = side * Vector2d(along.y(), -along.x());
    const double length = (b - a).norm();
    Polyline lot{a};
    if (notch > 0.0) {
      for (const double share : {0.3, 0.7}) {
        const Vector2d edge = a + share * length * along, inner = edge + notch * out;
        share < 0.5 ? lot.insert(lot.end(), {edge, inner}) : lot.insert(lot.end(), {inner, edge});
      }
    }
    lot.insert(lot.end(), {b, b + depth * out, a + depth * out});
    if (signed_area_m2(lot) < 0.0) std::reverse(lot.begin(), lot.end());
    return lot;
  }

  bool fits(const Polyline& lot) const {
    const Polyline rim = resampled(lot, 1.0, true);
    Eigen::Vector2d middle = Vector2d::Zero();
    for (const Vector2d& point : rim) middle += point / static_cast<double>(rim.size());
    return std::all_of(rim.begin(), rim.end(),
                       [&](const Vector2d& edge) {
                         const Vector2d point = middle + 0.985 * (edge - middle);
                         if (network_.beyond_kerb_m(edge) < 2.6) return false;
                         return std::none_of(plan_.footprints.begin(), plan_.footprints.end(),
                                             [&](const Outline& other) { return contains(other.corners, point); });
                       }) &&
           std::none_of(plan_.footprints.begin(), plan_.footprints.end(), [&](const Outline& other) {
             return std::any_of(other.corners.begin(), other.corners.end(), [&](const Vector2d& corner) {
               return contains(lot, middle + 1.03 * (corner - middle));
             });
           });
  }

  StreetPlan& plan_;
  const StreetNetwork& network_;
  double gap_share_;
  Stream& random_;
};

Street street_of(Polyline line, double half_width, std::uint32_t id) {
  return {std::move(line), half_width, 2, true, id};
}

void add_routes(StreetPlan& plan, const Polyline& loop, const Polyline& through) {
  constexpr double radius_m = 9.5;
  const Polyline middle = rounded(loop, radius_m, true);  // clockwise: the right lane is the inner one
  Polyline back(middle.rbegin(), middle.rend());
  plan.routes.push_back({"loop", to_the_right(middle, inner_lane_m, true), true});
  plan.routes.push_back({"loop_beside", to_the_right(middle, outer_lane_m, true), true});
  plan.routes.push_back({"loop_opposite", to_the_right(back, inner_lane_m, true), true});
  plan.routes.push_back({"through", to_the_right(rounded(through, radius_m, false), inner_lane_m, false), false});
}

}  // namespace

StreetPlan plan_district(std::uint32_t seed, const DistrictParams& params) {
  check("width_m", params.width_m, 120.0, 200.0);
  check("depth_m", params.depth_m, 80.0, 150.0);
  check("half_width_m", params.half_width_m, 5.5, 8.0);
  check("gap_share", params.gap_share, 0.0, 0.5);
  Stream random({seed, 0, 10, 0});
  const double w = params.width_m / 2, d = params.depth_m / 2, hw = params.half_width_m;
  const auto near = [&](double x, double y) {
    const double dx = random.uniform(-5.0, 5.0), dy = random.uniform(-5.0, 5.0);
    return Vector2d(x + dx, y + dy);
  };
  const Corners c{near(-w, -d), near(w, -d), near(-w, d), near(w, d), near(-0.1 * w, -d), near(0.05 * w, d)};
  const double bow = random.uniform(7.0, 12.0), east_bow = random.uniform(-8.0, -4.0);
  const auto joined = [](Polyline a, const Polyline& b) {
    a.insert(a.end(), b.begin() + 1, b.end());
    return a;
  };
  const Polyline north = joined(bent(c.north_west, c.north, bow), bent(c.north, c.north_east, -0.6 * bow));
  const Polyline east = bent(c.south_east, c.north_east, east_bow);
  constexpr double stub = 75.0;
  const auto beyond = [&](const Vector2d& from, const Vector2d& to) {
    return Vector2d(to + stub * (to - from).normalized());
  };
  // The street between the blocks goes on to the south and the north: two crossings.
  const Vector2d far_south = beyond(c.north, c.south), far_north = beyond(c.south, c.north);

  StreetPlan plan;
  plan.streets.push_back(street_of({beyond(c.south, c.south_west), c.south_west, c.south, c.south_east}, hw, 1));
  plan.streets.push_back(street_of(north, hw, 2));
  plan.streets.push_back(street_of(east, hw, 3));
  plan.streets.push_back(street_of({c.south_west, c.north_west}, hw, 4));
  plan.streets.push_back(street_of({far_south, c.south, c.north, far_north}, hw - 0.8, 5));
  plan.streets.push_back(street_of({c.north_east, c.north_east + Vector2d(stub, 12.0)}, hw - 1.0, 6));

  // Clockwise, from the middle of the west side on, where a vehicle can stand.
  Polyline loop = joined({(c.south_west + c.north_west) / 2, c.north_west}, north);
  loop = joined(loop, Polyline(east.rbegin(), east.rend()));
  loop = joined(loop, {c.south_east, c.south, c.south_west});
  const Polyline entry{far_south + 6.0 * (c.south - far_south).normalized(), c.south, c.north};
  add_routes(plan, loop, joined(entry, bent(c.north, c.north_east, -0.6 * bow)));

  const StreetNetwork network(plan.streets);
  Rows rows(plan, network, params.gap_share, random);
  for (std::size_t i = 0; i < plan.streets.size(); ++i)
    for (const double side : {1.0, -1.0}) rows.build(plan.streets[i], side);
  // A second row all around, so that no gap looks out on the plain.
  const double x = w + 42.0, y = d + 42.0;
  rows.build(street_of({{-x, -y}, {-x, y}, {x, y}, {x, -y}, {-x, -y}}, 0.0, 7), -1.0);
  // What closes the view where a street leaves the district.
  for (const std::size_t i : {0U, 4U, 5U}) {
    for (const bool at_end : {false, true}) {
      if ((i == 0 && at_end) || (i == 5 && !at_end)) continue;
      const Polyline& line = plan.streets[i].line;
      const Vector2d end = at_end ? line.back() : line.front();
      const Vector2d before = at_end ? line[line.size() - 2] : line[1];
      const Vector2d ahead = (end - before).normalized(), side(-ahead.y(), ahead.x());
      const Vector2d front = end + 12.0 * ahead;
      for (int k = -2; k <= 1; ++k) {
        const double height = 4.4 + 3.2 * (2 + random.below(4));
        plan.footprints.push_back({{front + 16.0 * k * side, front + 16.0 * k * side + 12.0 * ahead,
                                    front + 16.0 * (k + 1) * side + 12.0 * ahead, front + 16.0 * (k + 1) * side},
                                   height,
                                   static_cast<std::uint32_t>(plan.footprints.size() + 1)});
        Polyline& corners = plan.footprints.back().corners;
        if (signed_area_m2(corners) < 0.0) std::reverse(corners.begin(), corners.end());
      }
    }
  }
  return plan;
}

World make_district(std::uint32_t seed, const DistrictParams& params) {
  return build_world(plan_district(seed, params), seed, params.detail);
}

}  // namespace convoy::simulator
