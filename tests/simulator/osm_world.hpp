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
  LeftOut streets_without_nodes, buildings_without_nodes;  ///< nodes of theirs are missing
  LeftOut buildings_not_closed, buildings_crossing, buildings_without_area;
  int buildings_in_streets = 0;  ///< left out, since a street leads through them
  int tags_not_understood = 0;   ///< heights and levels that are no numbers
  bool against_oneway = false;   ///< the loop leads against one-way streets
  bool open = false;             ///< no loop was found
};

/// In lines for the user: what was left out, and that there is no closed route. Empty for a map that is whole.
std::vector<std::string> what_is_missing(const OsmReport& report);

/// Routes: "loop" (closed), "loop_beside" (2 m to its right), "loop_opposite"; with `along` the first is "along", and
/// where no loop is found it is "way", which is open.
/// A map without buildings is allowed (report says 0).
/// @throws std::runtime_error with the file, the line where there is one, what is wrong and how to mend it.
World load_osm(const std::string& file, const OsmParams& params = {}, OsmReport* report = nullptr);

/// Its plan alone.
StreetPlan plan_osm(const std::string& file, const OsmParams& params, OsmReport& report);

}  // namespace convoy::simulator
