#include "street_graph.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <set>
#include <stdexcept>

namespace convoy::simulator {

StreetGraph::StreetGraph(std::vector<GraphEdge> edges) : edges_(std::move(edges)) {
  for (std::size_t i = 0; i < edges_.size(); ++i) {
    if (!edges_[i].on_routes) continue;
    out_[edges_[i].from].push_back({i, false});
    out_[edges_[i].to].push_back({i, true});
  }
}

Polyline StreetGraph::points_of(const Leg& leg) const {
  Polyline line = edges_[leg.edge].line;
  if (leg.reversed) std::reverse(line.begin(), line.end());
  return line;
}

Polyline StreetGraph::line_of(const std::vector<Leg>& legs) const {
  Polyline line;
  for (const Leg& leg : legs) {
    const Polyline points = points_of(leg);
    line.insert(line.end(), line.empty() ? points.begin() : points.begin() + 1, points.end());
  }
  return line;
}

bool StreetGraph::turns_too_sharply(const Leg& before, const Leg& after) const {
  constexpr double reach_m = 8.0;  // crossings are drawn with short edges: directions are taken beyond them
  const Polyline a = points_of(before), b = points_of(after);
  const double a_length = edges_[before.edge].length_m;
  const Eigen::Vector2d in = a.back() - point_at(a, a_length - std::min(reach_m, a_length)).at;
  const Eigen::Vector2d out = point_at(b, std::min(reach_m, edges_[after.edge].length_m)).at - b.front();
  return in.dot(out) < std::cos(125.0 * M_PI / 180.0) * in.norm() * out.norm();
}

std::vector<std::vector<Leg>> StreetGraph::loops(double shortest_m, double longest_m, bool keep_oneway,
                                                 std::size_t count,
                                                 const std::function<double(const Polyline&)>& score) const {
  std::vector<std::pair<double, std::vector<Leg>>> found;
  std::vector<Leg> way;
  std::set<std::int64_t> visited;
  long budget = 0;
  std::int64_t start = 0;
  Eigen::Vector2d home = Eigen::Vector2d::Zero();
  const std::function<void(std::int64_t, double)> search = [&](std::int64_t node, double length) {
    const auto legs = out_.find(node);
    if (legs == out_.end()) return;
    for (const Leg& leg : legs->second) {
      if (--budget < 0) return;
      const GraphEdge& edge = edges_[leg.edge];
      if (leg.reversed && keep_oneway && !edge.backward) continue;
      const std::int64_t next = end_of(leg);
      const double so_far = length + edge.length_m;
      const Eigen::Vector2d end = leg.reversed ? edge.line.front() : edge.line.back();
      // Every loop is found from its smallest node alone.
      if (next < start || so_far + (end - home).norm() > longest_m) continue;
      if (!way.empty() && (way.back().edge == leg.edge || turns_too_sharply(way.back(), leg))) continue;
      way.push_back(leg);
      if (next == start) {
        if (so_far >= shortest_m && !turns_too_sharply(way.back(), way.front()))
          found.emplace_back(score(line_of(way)), way);
      } else if (visited.insert(next).second) {
        search(next, so_far);
        visited.erase(next);
      }
      way.pop_back();
    }
  };
  for (const auto& [node, legs] : out_) {
    budget = 20'000;
    start = node;
    home = legs.front().reversed ? edges_[legs.front().edge].line.back() : edges_[legs.front().edge].line.front();
    visited = {node};
    search(node, 0.0);
  }
  std::stable_sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<std::vector<Leg>> best;
  for (std::size_t i = 0; i < std::min(count, found.size()); ++i) best.push_back(std::move(found[i].second));
  return best;
}

std::vector<Leg> StreetGraph::way_through(std::size_t edge, double longest_m) const {
  std::vector<Leg> way{{edge, false}};
  double length = edges_[edge].length_m;
  std::set<std::int64_t> visited{edges_[edge].from, edges_[edge].to};
  const auto grow = [&](bool ahead) {
    const auto legs = out_.find(ahead ? end_of(way.back()) : begin_of(way.front()));
    std::optional<Leg> best;
    for (const Leg& out : legs == out_.end() ? std::vector<Leg>() : legs->second) {
      const Leg leg{out.edge, out.reversed == ahead};
      const GraphEdge& next = edges_[leg.edge];
      if ((leg.reversed && !next.backward) || visited.count(end_of(out)) > 0 || length + next.length_m > longest_m ||
          (ahead ? turns_too_sharply(way.back(), leg) : turns_too_sharply(leg, way.front())))
        continue;
      if (!best || next.length_m > edges_[best->edge].length_m) best = leg;
    }
    if (!best) return false;
    visited.insert(ahead ? end_of(*best) : begin_of(*best));
    length += edges_[best->edge].length_m;
    way.insert(ahead ? way.end() : way.begin(), *best);
    return true;
  };
  while (grow(true)) {
  }
  while (grow(false)) {
  }
  return way;
}

std::vector<Leg> StreetGraph::way_along(const std::vector<std::int64_t>& nodes) const {
  std::vector<Leg> way;
  for (std::size_t i = 0; i + 1 < nodes.size(); ++i) {
    std::map<std::int64_t, std::pair<double, Leg>> reached;
    std::set<std::pair<double, std::int64_t>> front{{0.0, nodes[i]}};
    reached[nodes[i]] = {0.0, {}};
    while (!front.empty()) {
      const auto [length, node] = *front.begin();
      front.erase(front.begin());
      if (node == nodes[i + 1]) break;
      const auto legs = out_.find(node);
      if (legs == out_.end()) continue;
      for (const Leg& leg : legs->second) {
        const double longer = length + edges_[leg.edge].length_m;
        const auto known = reached.find(end_of(leg));
        if (known != reached.end() && known->second.first <= longer) continue;
        if (known != reached.end()) front.erase({known->second.first, end_of(leg)});
        reached[end_of(leg)] = {longer, leg};
        front.insert({longer, end_of(leg)});
      }
    }
    if (reached.count(nodes[i + 1]) == 0)
      throw std::runtime_error("no street leads from node " + std::to_string(nodes[i]) + " to node " +
                               std::to_string(nodes[i + 1]) + "; name junctions of drivable streets");
    std::vector<Leg> back;
    for (std::int64_t node = nodes[i + 1]; node != nodes[i];) {
      const Leg leg = reached.at(node).second;
      back.push_back(leg);
      node = leg.reversed ? edges_[leg.edge].to : edges_[leg.edge].from;
    }
    way.insert(way.end(), back.rbegin(), back.rend());
  }
  return way;
}

}  // namespace convoy::simulator
