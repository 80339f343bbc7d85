// OpenStreetMap XML as it is, in metres.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace convoy::simulator {

struct OsmWay {
  std::int64_t id = 0;
  int line = 0;                     ///< of the file
  std::vector<std::int64_t> nodes;  ///< the first again at the end where it is closed
  std::map<std::string, std::string> tags;

  /// The tag's value; empty where there is none.
  const std::string& tag(const std::string& key) const;
};

/// Ways that were left out for one reason.
struct LeftOut {
  int count = 0;
  std::int64_t way = 0;  ///< the first
  int line = 0;

  void add(const OsmWay& left);
};

struct OsmMap {
  std::map<std::int64_t, Eigen::Vector2d> nodes;  ///< east and north of the map's middle [m]
  std::vector<OsmWay> streets, buildings;         ///< in the order of the file; outer rings of multipolygons too
  LeftOut streets_without_nodes, buildings_without_nodes;  ///< nodes of theirs are missing
  int tags_not_understood = 0;                             ///< heights and levels that are no numbers
  Eigen::Vector2d low, high;  ///< what the file says it covers, or else where its nodes are [m]

  std::vector<Eigen::Vector2d> line_of(const OsmWay& way) const;
};

/// @throws std::runtime_error with file, line where there is one, what is wrong and how to mend it.
OsmMap read_osm(const std::string& file);

/// The number at the beginning of a tag ("12.5 m" is 12.5); `otherwise`, and counted, where there is none.
double number_of(const std::string& tag, double otherwise, int& not_understood);

}  // namespace convoy::simulator
