#include "osm_world.hpp"

#include "polyline.hpp"
#include "street_graph.hpp"
#include "street_network.hpp"

#include <Eigen/Geometry>

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace convoy::simulator {
namespace {

struct Kind {
  const char* highway;
  double half_width_m, one_way_half_width_m;
  int lanes;
  bool on_routes;
};
constexpr std::array<Kind, 14> kinds{{{"trunk", 6.6, 6.0, 2, true},
                                      {"primary", 6.6, 5.8, 2, true},
                                      {"secondary", 6.2, 5.4, 2, true},
                                      {"tertiary", 5.6, 5.0, 2, true},
                                      {"residential", 5.2, 4.6, 2, true},
                                      {"unclassified", 5.2, 4.6, 2, true},
                                      {"living_street", 4.2, 4.0, 1, true},
                                      {"trunk_link", 4.6, 3.4, 1, true},
                                      {"primary_link", 4.6, 3.4, 1, true},
                                      {"secondary_link", 4.6, 3.4, 1, true},
                                      {"tertiary_link", 4.6, 3.4, 1, true},
                                      {"road", 4.6, 4.0, 1, true},
                                      {"motorway", 7.5, 6.0, 2, false},
                                      {"service", 2.7, 2.7, 1, false}}};

const Kind* kind_of(const OsmWay& way) {
  const std::string &tunnel = way.tag("tunnel"), &layer = way.tag("layer");
  if ((!tunnel.empty() && tunnel != "no") || (!layer.empty() && layer[0] == '-')) return nullptr;
  if (way.tag("area") == "yes" || way.tag("covered") == "yes" || way.nodes.size() < 2) return nullptr;
  const auto found =
      std::find_if(kinds.begin(), kinds.end(), [&](const Kind& kind) { return way.tag("highway") == kind.highway; });
  return found == kinds.end() ? nullptr : &*found;
}

std::uint32_t short_id(std::int64_t id) {
  const auto bits = static_cast<std::uint64_t>(id);
  return static_cast<std::uint32_t>(bits ^ (bits >> 32U));
}

std::vector<Outline> footprints_of(const OsmMap& map, OsmReport& report) {
  std::vector<Outline> footprints;
  for (const OsmWay& way : map.buildings) {
    if (way.tag("building") == "no" || way.tag("building") == "roof") continue;
    Polyline corners = map.line_of(way);
    const bool closed = way.nodes.size() >= 4 && way.nodes.front() == way.nodes.back();
    if (closed) corners.pop_back();
    corners.erase(
        std::unique(corners.begin(), corners.end(), [](const auto& a, const auto& b) { return (a - b).norm() < 0.05; }),
        corners.end());
    LeftOut* fault = nullptr;
    if (!closed) fault = &report.buildings_not_closed;
    else if (corners.size() >= 3 && crosses_itself(corners)) fault = &report.buildings_crossing;
    else if (corners.size() < 3 || std::abs(signed_area_m2(corners)) < 4.0) fault = &report.buildings_without_area;
    if (fault != nullptr) {
      fault->add(way);
      continue;
    }
    if (signed_area_m2(corners) < 0.0) std::reverse(corners.begin(), corners.end());
    const std::uint32_t id = short_id(way.id);
    const double guess = 4.0 + static_cast<double>(id % 3);  // houses of no known height stand among such as have one
    const double levels = number_of(way.tag("building:levels"), guess, report.tags_not_understood);
    const double height = number_of(way.tag("height"), 1.2 + 3.2 * levels, report.tags_not_understood);
    footprints.push_back({std::move(corners), std::clamp(height, 2.5, 150.0), id});
  }
  return footprints;
}

/// Ways cut at junctions and joined where one goes on as the next.
struct Network {
  std::vector<Street> streets;
  std::vector<GraphEdge> edges;
};

Network network_of(const OsmMap& map, const std::vector<std::int64_t>& keep) {
  struct Part {
    std::vector<std::int64_t> nodes;
    const Kind* kind;
    bool two_way;
    std::uint32_t id;
  };
  const Eigen::AlignedBox2d covered(map.low.array() - 40.0, map.high.array() + 40.0);
  std::map<std::int64_t, int> uses;
  std::vector<Part> ways;
  for (const OsmWay& way : map.streets) {
    const Kind* kind = kind_of(way);
    if (kind == nullptr) continue;
    Part part{way.nodes, kind, true, short_id(way.id)};
    const std::string& oneway = way.tag("oneway");
    part.two_way = !(oneway == "yes" || oneway == "1" || oneway == "true" || oneway == "-1" ||
                     way.tag("junction") == "roundabout");
    if (oneway == "-1") std::reverse(part.nodes.begin(), part.nodes.end());
    // What lies outside of the map is cut off.
    Part inside = part;
    inside.nodes.clear();
    for (std::size_t i = 0; i <= part.nodes.size(); ++i) {
      if (i < part.nodes.size() && covered.contains(map.nodes.at(part.nodes[i]))) inside.nodes.push_back(part.nodes[i]);
      else if (inside.nodes.size() > 1) ways.push_back(std::exchange(inside, {{}, part.kind, part.two_way, part.id}));
      else inside.nodes.clear();
    }
  }
  for (const Part& way : ways) {
    for (const std::int64_t node : way.nodes) ++uses[node];
    ++uses[way.nodes.front()], ++uses[way.nodes.back()];  // ends count twice, to be cut at
  }
  for (const std::int64_t node : keep) uses[node] += 2;
  std::vector<Part> parts;
  for (const Part& way : ways) {
    Part part{{way.nodes.front()}, way.kind, way.two_way, way.id};
    for (std::size_t i = 1; i < way.nodes.size(); ++i) {
      part.nodes.push_back(way.nodes[i]);
      if (i + 1 == way.nodes.size() || uses[way.nodes[i]] > 1) {
        parts.push_back(part);
        part.nodes = {way.nodes[i]};
      }
    }
  }
  std::map<std::int64_t, int> ends;
  for (const Part& part : parts) ++ends[part.nodes.front()], ++ends[part.nodes.back()];
  for (const std::int64_t node : keep) ends[node] += 2;
  const auto goes_on = [&](const std::vector<std::int64_t>& a, const std::vector<std::int64_t>& b) {
    const Eigen::Vector2d in = map.nodes.at(a.back()) - map.nodes.at(a[a.size() - 2]),
                          out = map.nodes.at(b[1]) - map.nodes.at(b[0]);
    return in.dot(out) > 0.5 * in.norm() * out.norm();
  };
  for (std::size_t i = 0; i < parts.size(); ++i) {
    for (bool grown = true; grown && !parts[i].nodes.empty();) {
      grown = false;
      for (std::size_t j = 0; j < parts.size() && !grown; ++j) {
        if (j == i || parts[j].nodes.empty() || parts[j].kind != parts[i].kind || parts[j].two_way != parts[i].two_way)
          continue;
        if (ends[parts[i].nodes.back()] != 2 || parts[i].nodes.front() == parts[i].nodes.back()) break;
        std::vector<std::int64_t> more = parts[j].nodes;
        if (more.front() != parts[i].nodes.back() && more.back() == parts[i].nodes.back() && parts[i].two_way)
          std::reverse(more.begin(), more.end());
        if (more.front() != parts[i].nodes.back() || !goes_on(parts[i].nodes, more)) continue;
        parts[i].nodes.insert(parts[i].nodes.end(), more.begin() + 1, more.end());
        parts[j].nodes.clear();
        grown = true;
      }
    }
  }
  Network network;
  for (const Part& part : parts) {
    if (part.nodes.size() < 2) continue;
    Polyline line;
    for (const std::int64_t node : part.nodes) line.push_back(map.nodes.at(node));
    const double length = length_m(line);
    if (length < 0.1) continue;
    network.edges.push_back({part.nodes.front(), part.nodes.back(), line, length, part.two_way, part.kind->on_routes,
                             network.streets.size()});
    network.streets.push_back({std::move(line),
                               part.two_way ? part.kind->half_width_m : part.kind->one_way_half_width_m,
                               part.kind->lanes, part.two_way, part.id});
  }
  return network;
}

/// Roads are no wider than there is room between the houses.
void fit_between(const std::vector<Outline>& footprints, std::vector<Street>& streets) {
  NearLines walls(12.0);
  for (const Outline& footprint : footprints) walls.add(footprint.corners, true);
  for (Street& street : streets) {
    std::vector<double> room;
    const Polyline points = resampled(street.line, 2.0);
    for (const auto& point : points) room.push_back(walls.distance_m(point));
    std::sort(room.begin(), room.end());
    street.half_width_m = std::max(2.6, std::min(street.half_width_m, room[room.size() / 20] - 1.3));
    if (street.half_width_m < 4.4) street.lanes = 1;
  }
}

/// Long, round a block rather than to and fro, with houses to its left and right.
double score_of(const NearLines& walls, const Polyline& line) {
  const Polyline points = resampled(line, 8.0, true);
  double lined = 0.0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector2d ahead = (points[(i + 1) % points.size()] - points[i]).normalized();
    for (const double side : {-9.0, 9.0})
      lined += walls.distance_m(points[i] + side * Eigen::Vector2d(ahead.y(), -ahead.x())) < 7.0;
  }
  const double length = length_m(line, true), share = lined / (2.0 * static_cast<double>(points.size()));
  const double round = std::min(1.0, 16.0 * std::abs(signed_area_m2(line)) / (length * length));
  return length * (0.1 + share) * (0.3 + 0.7 * round);
}

/// The lane: right of the middle where there is oncoming traffic.
Polyline lane_of(const std::vector<Street>& streets, const Polyline& middle, double beside_m, bool closed) {
  constexpr double radius_m = 5.2;
  const Polyline smooth = rounded(middle, 7.0, closed);
  std::vector<double> offsets;
  for (const auto& point : smooth) {
    double best = 1e9, offset = 0.0;
    for (const Street& street : streets) {
      for (std::size_t i = 0; i + 1 < street.line.size(); ++i) {
        const double away = distance_m(point, street.line[i], street.line[i + 1]);
        if (away < best) best = away, offset = street.two_way ? std::clamp(street.half_width_m - 3.6, 0.0, 1.5) : 0.0;
      }
    }
    offsets.push_back(offset + beside_m);
  }
  const auto n = static_cast<int>(smooth.size());
  constexpr int reach = 24;
  Polyline moved;
  for (int i = 0; i < n; ++i) {
    double offset = 0.0;
    for (int k = -reach; k <= reach; ++k)
      offset += offsets[static_cast<std::size_t>(closed ? ((i + k) % n + n) % n : std::clamp(i + k, 0, n - 1))] /
                (2 * reach + 1);
    const auto at = [&](int k) {
      return smooth[static_cast<std::size_t>(closed ? (k % n + n) % n : std::clamp(k, 0, n - 1))];
    };
    const Eigen::Vector2d ahead = (at(i + 1) - at(i - 1)).normalized();
    moved.push_back(at(i) + offset * Eigen::Vector2d(ahead.y(), -ahead.x()));
  }
  return rounded(moved, radius_m, closed);
}

Polyline opened(Polyline line) {
  line.pop_back();
  return line;
}

/// Ways that a car can drive: away from walls, and not far over what the map says is road.
class Drivable {
 public:
  explicit Drivable(const StreetPlan& plan) : streets_(plan.streets), roads_(plan.streets) {
    for (const Outline& footprint : plan.footprints) walls_.add(footprint.corners, true);
  }
  const NearLines& walls() const { return walls_; }

  bool operator()(const Polyline& middle, bool closed) const {
    constexpr double to_walls_m = 1.7, over_kerb_m = 1.0;
    try {
      const Polyline lane = lane_of(streets_, middle, 0.0, closed);
      return std::all_of(lane.begin(), lane.end(), [&](const Eigen::Vector2d& point) {
        return walls_.distance_m(point) > to_walls_m && roads_.beyond_kerb_m(point) < over_kerb_m;
      });
    } catch (const std::runtime_error&) {  // a bend that no car can drive
      return false;
    }
  }

 private:
  const std::vector<Street>& streets_;
  StreetNetwork roads_;
  NearLines walls_{12.0};
};

/// The drivable loop with the best score; empty if there is none.
Polyline find_loop(const StreetGraph& graph, const Drivable& drivable, const OsmParams& params, OsmReport& report) {
  constexpr double against_oneway = 0.7;
  const auto score = [&](const Polyline& line) { return score_of(drivable.walls(), line); };
  Polyline best;
  double best_score = 0.0;
  for (const bool keep_oneway : {true, false}) {
    for (const auto& legs : graph.loops(params.shortest_loop_m, params.longest_loop_m, keep_oneway, 40, score)) {
      const Polyline middle = opened(graph.line_of(legs));
      const double value = score(middle) * (keep_oneway ? 1.0 : against_oneway);
      if (value <= best_score || !drivable(middle, true)) continue;
      best = middle, best_score = value, report.against_oneway = !keep_oneway;
    }
  }
  return best;
}

/// The longest drivable way that leads on from one of the longest streets; empty if there is none.
Polyline find_way(const StreetGraph& graph, const Drivable& drivable, const OsmParams& params) {
  constexpr double shortest_m = 50.0;
  constexpr std::size_t tried = 40;
  std::vector<std::size_t> order;
  for (std::size_t i = 0; i < graph.edges().size(); ++i)
    if (graph.edges()[i].on_routes && graph.edges()[i].from != graph.edges()[i].to) order.push_back(i);
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return graph.edges()[a].length_m > graph.edges()[b].length_m; });
  if (order.size() > tried) order.resize(tried);
  Polyline best;
  for (const std::size_t edge : order) {
    for (Polyline way : {graph.line_of(graph.way_through(edge, params.longest_loop_m)), graph.edges()[edge].line}) {
      const double length = length_m(way);
      if (length < shortest_m || (!best.empty() && length <= length_m(best)) || !drivable(way, false)) continue;
      best = std::move(way);
    }
  }
  return best;
}

void add_routes(const std::string& file, const OsmMap& map, const Network& network, const OsmParams& params,
                StreetPlan& plan, OsmReport& report) {
  Polyline middle;
  bool closed = true;
  std::string name = "loop";
  if (!params.along.empty()) {
    name = "along";
    for (const std::int64_t node : params.along)
      if (map.nodes.count(node) == 0)
        throw std::runtime_error(file + ": has no node " + std::to_string(node) + " to drive along; name another");
    const StreetGraph graph(network.edges);
    middle = graph.line_of(graph.way_along(params.along));
    if (middle.size() < 2) throw std::runtime_error(file + ": a route needs two nodes at least; name more");
    closed = params.along.front() == params.along.back();
    if (closed) middle.pop_back();
  } else {
    const StreetGraph graph(network.edges);
    const Drivable drivable(plan);
    middle = find_loop(graph, drivable, params, report);
    if (middle.empty()) {
      name = "way";
      middle = find_way(graph, drivable, params);
      closed = false;
      report.open = true;
    }
    if (middle.empty())
      throw std::runtime_error(file +
                               ": no way of 50 m or more that a car can drive leads over its streets; export a " +
                               "larger part of the map, with the nodes of its streets");
  }
  if (name == "loop") {
    // Begins in the middle of its longest street.
    std::size_t longest = 0;
    const auto piece = [&](std::size_t i) { return (middle[(i + 1) % middle.size()] - middle[i]).norm(); };
    for (std::size_t i = 1; i < middle.size(); ++i)
      if (piece(i) > piece(longest)) longest = i;
    std::rotate(middle.begin(), middle.begin() + static_cast<std::ptrdiff_t>((longest + 1) % middle.size()),
                middle.end());
    middle.insert(middle.begin(), Eigen::Vector2d((middle.back() + middle.front()) / 2));
  }
  const Polyline back(middle.rbegin(), middle.rend());
  plan.routes.push_back({name, lane_of(plan.streets, middle, 0.0, closed), closed});
  plan.routes.push_back({name + "_beside", to_the_right(plan.routes[0].points, 2.0, closed), closed});
  plan.routes.push_back({name + "_opposite", lane_of(plan.streets, back, 0.0, closed), closed});
}

/// A house above a street would stop every car on it; a yard's entrance through a house is left out instead.
void clear_streets(Network& network, std::vector<Outline>& footprints, OsmReport& report) {
  const auto leads_through = [](const Street& street, const Outline& footprint) {
    Eigen::AlignedBox2d box;
    for (const auto& corner : footprint.corners) box.extend(corner);
    const Polyline points = resampled(street.line, 2.0);
    return std::any_of(points.begin(), points.end(),
                       [&](const auto& p) { return box.contains(p) && contains(footprint.corners, p); });
  };
  std::vector<bool> gone(network.edges.size(), false);
  std::vector<Outline> kept;
  for (Outline& footprint : footprints) {
    bool keep = true;
    for (std::size_t i = 0; i < network.edges.size(); ++i) {
      if (!leads_through(network.streets[i], footprint)) continue;
      network.edges[i].on_routes ? static_cast<void>(keep = false) : static_cast<void>(gone[i] = true);
    }
    if (keep) kept.push_back(std::move(footprint));
    else ++report.buildings_in_streets;
  }
  footprints = std::move(kept);
  Network rest;
  for (std::size_t i = 0; i < network.edges.size(); ++i) {
    if (gone[i]) continue;
    rest.edges.push_back(std::move(network.edges[i]));
    rest.edges.back().street = rest.streets.size();
    rest.streets.push_back(std::move(network.streets[i]));
  }
  network = std::move(rest);
}

}  // namespace

StreetPlan plan_osm(const std::string& file, const OsmParams& params, OsmReport& report) {
  const OsmMap map = read_osm(file);
  report.streets_without_nodes = map.streets_without_nodes;
  report.buildings_without_nodes = map.buildings_without_nodes;
  StreetPlan plan;
  plan.attribution = "(c) OpenStreetMap contributors, ODbL 1.0";
  plan.footprints = footprints_of(map, report);
  Network network = network_of(map, params.along);
  clear_streets(network, plan.footprints, report);
  if (network.streets.empty())
    throw std::runtime_error(
        file + ": has no streets a car can drive; export ways tagged highway of other kinds than footway");
  fit_between(plan.footprints, network.streets);
  plan.streets = network.streets;
  add_routes(file, map, network, params, plan, report);

  const double reach = std::max(params.reach_m, 50.0);
  NearLines near(reach + 1.0);
  for (const Route& route : plan.routes) near.add(resampled(route.points, 20.0, route.closed), route.closed);
  const auto far = [&](const Polyline& line) {
    return std::all_of(line.begin(), line.end(),
                       [&](const Eigen::Vector2d& point) { return near.distance_m(point) > reach; });
  };
  std::erase_if(plan.footprints, [&](const Outline& footprint) { return far(footprint.corners); });
  std::erase_if(plan.streets, [&](const Street& street) { return far(resampled(street.line, 20.0)); });
  report.streets = static_cast<int>(plan.streets.size());
  // Where a route cuts a corner there is road.
  for (const Route& route : plan.routes) {
    Polyline line = resampled(route.points, 2.0, route.closed);
    if (route.closed) line.push_back(line.front());
    plan.streets.push_back({std::move(line), 2.0, 0, true, 0});
  }
  report.buildings = static_cast<int>(plan.footprints.size());
  return plan;
}

namespace {

void add_reason(std::string& reasons, int count, const std::string& reason) {
  if (count > 0) reasons += (reasons.empty() ? "" : ", ") + reason + " " + std::to_string(count);
}

std::string place_of(const LeftOut& first) {
  return " (first: way " + std::to_string(first.way) + ", line " + std::to_string(first.line) + ")";
}

}  // namespace

std::vector<std::string> what_is_missing(const OsmReport& report) {
  std::vector<std::string> lines;
  std::string reasons;
  LeftOut all;
  for (const auto& [reason, left] : {std::pair{"self-crossing", report.buildings_crossing},
                                     {"without area", report.buildings_without_area},
                                     {"not closed", report.buildings_not_closed},
                                     {"nodes missing", report.buildings_without_nodes}}) {
    add_reason(reasons, left.count, reason);
    if (left.count > 0 && (all.count == 0 || left.line < all.line)) all.way = left.way, all.line = left.line;
    all.count += left.count;
  }
  add_reason(reasons, report.buildings_in_streets, "in the middle of a street");
  if (const int count = all.count + report.buildings_in_streets; count > 0)
    lines.push_back(std::to_string(count) + " building" + (count > 1 ? "s" : "") + " left out: " + reasons +
                    (all.count > 0 ? place_of(all) : ""));
  if (const int count = report.streets_without_nodes.count; count > 0)
    lines.push_back(std::to_string(count) + " street" + (count > 1 ? "s" : "") + " left out: nodes missing " +
                    std::to_string(count) + place_of(report.streets_without_nodes));
  if (const int count = report.tags_not_understood; count > 0)
    lines.push_back(std::to_string(count) + (count > 1 ? " heights or levels are no numbers: they are guessed"
                                                       : " height or number of levels is no number: it is guessed"));
  if (report.against_oneway) lines.push_back("the loop leads against one-way streets: no other one can be driven");
  if (report.open) lines.push_back("no closed way of a length to drive round is on the map; its route is open");
  return lines;
}

World load_osm(const std::string& file, const OsmParams& params, OsmReport* report) {
  OsmReport own;
  const StreetPlan plan = plan_osm(file, params, report == nullptr ? own : *report);
  return build_world(plan, params.seed, params.detail);
}

}  // namespace convoy::simulator
