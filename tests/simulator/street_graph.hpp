// Streets between junctions, and closed ways through them.
#pragma once

#include "osm_map.hpp"
#include "polyline.hpp"

#include <functional>

namespace convoy::simulator {

struct GraphEdge {
  std::int64_t from = 0, to = 0;  ///< nodes of the map
  Polyline line;
  double length_m = 0.0;
  bool backward = true;    ///< may be driven from `to` to `from`, too
  bool on_routes = true;   ///< not just a yard's entrance
  std::size_t street = 0;  ///< of the caller's
};

/// An edge in the direction it is driven.
struct Leg {
  std::size_t edge = 0;
  bool reversed = false;
};

class StreetGraph {
 public:
  explicit StreetGraph(std::vector<GraphEdge> edges);

  /// Closed ways of `shortest_m` to `longest_m` that pass no junction twice and turn nowhere by more than 125 degrees,
  /// those with the best score first, at most `count`. Deterministic.
  std::vector<std::vector<Leg>> loops(double shortest_m, double longest_m, bool keep_oneway, std::size_t count,
                                      const std::function<double(const Polyline&)>& score) const;
  /// A way from the edge on at both ends, along the longest edge each time, until it would pass a node twice, turn by
  /// more than 125 degrees, lead against a one-way street or be longer than that.
  std::vector<Leg> way_through(std::size_t edge, double longest_m) const;
  /// Shortest way along these nodes, in their order. @throws std::runtime_error where there is none.
  std::vector<Leg> way_along(const std::vector<std::int64_t>& nodes) const;

  Polyline line_of(const std::vector<Leg>& legs) const;
  const std::vector<GraphEdge>& edges() const { return edges_; }

 private:
  std::int64_t end_of(const Leg& leg) const { return leg.reversed ? edges_[leg.edge].from : edges_[leg.edge].to; }
  std::int64_t begin_of(const Leg& leg) const { return leg.reversed ? edges_[leg.edge].to : edges_[leg.edge].from; }
  Polyline points_of(const Leg& leg) const;
  bool turns_too_sharply(const Leg& before, const Leg& after) const;
  std::vector<GraphEdge> edges_;
  std::map<std::int64_t, std::vector<Leg>> out_;
};

}  // namespace convoy::simulator
