// A real place from OpenStreetMap.
#pragma once

#include "osm_map.hpp"
#include "world_builder.hpp"

namespace convoy::simulator {

struct OsmParams {
  double shortest_loop_m = 400.0, longest_loop_m = 650.0;  ///< of the route that is looked for
  std::vector<std::int64_t> along;  ///< nodes of the map to drive along instead; the first again at the end: closed
  double reach_m = 250.0;           ///< what is farther from every route is left out; >= 50
  std::uint32_t seed = 1;           ///< of everything the map does not say
  DetailParams detail;
};

/// What was made of a map.
struct OsmReport {
  int streets = 0, buildings = 0;
  int ways_without_nodes = 0;    ///< skipped
  int outlines_refused = 0;      ///< not closed, crossing themselves, or next to nothing
  int buildings_in_streets = 0;  ///< left out, since a street leads through them
  int tags_not_understood = 0;   ///< heights and levels that are no numbers
  bool against_oneway = false;   ///< the loop leads against one-way streets
};

/// Routes: "loop" (closed), "loop_beside" (2 m to its right), "loop_opposite"; with `along` the first is "along".
/// A map without buildings is allowed (report says 0).
/// @throws std::runtime_error with the file, the line where there is one, what is wrong and how to mend it.
World load_osm(const std::string& file, const OsmParams& params = {}, OsmReport* report = nullptr);

/// Its plan alone.
StreetPlan plan_osm(const std::string& file, const OsmParams& params, OsmReport& report);

}  // namespace convoy::simulator
