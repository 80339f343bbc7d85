#include "osm_map.hpp"

#include <tinyxml2.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <stdexcept>

namespace convoy::simulator {
namespace {

constexpr double widest_m = 10'000.0;

[[noreturn]] void refuse(const std::string& file, int line, const std::string& what, const std::string& mend) {
  throw std::runtime_error(file + (line > 0 ? ":" + std::to_string(line) : "") + ": " + what + "; " + mend);
}

/// False unless the whole text is the number: "60.17abc" is none.
template <class Number>
bool read_whole(const char* text, Number& number) {
  if (text == nullptr) return false;
  const char* const end = text + std::strlen(text);
  const auto [read, error] = std::from_chars(text, end, number);
  return error == std::errc() && read == end;
}

struct Degrees {
  double latitude, longitude;
};

Degrees degrees_of(const std::string& file, const tinyxml2::XMLElement& element, const char* latitude,
                   const char* longitude) {
  Degrees d{};
  if (!read_whole(element.Attribute(latitude), d.latitude) || !read_whole(element.Attribute(longitude), d.longitude))
    refuse(file, element.GetLineNum(),
           std::string("<") + element.Name() + "> has no numbers " + latitude + " and " + longitude,
           "give both in degrees, or leave it out");
  // Nearer to the poles the local projection fails; what is not a number fails here, too.
  if (!(std::abs(d.latitude) <= 85.0) || !(std::abs(d.longitude) <= 180.0))
    refuse(file, element.GetLineNum(),
           "coordinates " + std::to_string(d.latitude) + ", " + std::to_string(d.longitude) + " are on no street map",
           "latitude must be within 85 and longitude within 180 degrees");
  return d;
}

std::int64_t id_of(const std::string& file, const tinyxml2::XMLElement& element, const char* name) {
  std::int64_t id = 0;
  if (!read_whole(element.Attribute(name), id))
    refuse(file, element.GetLineNum(), std::string("<") + element.Name() + "> has no number " + name,
           "export the map anew");
  return id;
}

/// Ids of one kind of element, each of which is there once.
class Ids {
 public:
  explicit Ids(const std::string& file) : file_(file) {}
  void add(std::int64_t id, const tinyxml2::XMLElement& element) {
    const auto [at, is_new] = lines_.emplace(id, element.GetLineNum());
    if (!is_new)
      refuse(file_, element.GetLineNum(),
             std::string(element.Name()) + " " + std::to_string(id) + " was on line " + std::to_string(at->second) +
                 " already",
             "keep one of them");
  }

 private:
  const std::string& file_;
  std::map<std::int64_t, int> lines_;
};

OsmWay way_of(const std::string& file, const tinyxml2::XMLElement& element) {
  OsmWay way;
  way.id = id_of(file, element, "id");
  way.line = element.GetLineNum();
  for (auto* nd = element.FirstChildElement("nd"); nd != nullptr; nd = nd->NextSiblingElement("nd")) {
    const std::int64_t node = id_of(file, *nd, "ref");
    if (way.nodes.empty() || way.nodes.back() != node) way.nodes.push_back(node);
  }
  for (auto* tag = element.FirstChildElement("tag"); tag != nullptr; tag = tag->NextSiblingElement("tag")) {
    const char *key = tag->Attribute("k"), *value = tag->Attribute("v");
    if (key != nullptr && value != nullptr) way.tags[key] = value;
  }
  return way;
}

/// Buildings with courtyards: their outer rings, where one way is a ring.
void add_outer_rings(const std::string& file, const tinyxml2::XMLElement& root,
                     const std::map<std::int64_t, OsmWay>& ways, std::vector<OsmWay>& buildings) {
  for (auto* relation = root.FirstChildElement("relation"); relation != nullptr;
       relation = relation->NextSiblingElement("relation")) {
    const OsmWay itself = way_of(file, *relation);
    if (itself.tag("type") != "multipolygon" || itself.tag("building").empty()) continue;
    for (auto* member = relation->FirstChildElement("member"); member != nullptr;
         member = member->NextSiblingElement("member")) {
      const char *role = member->Attribute("role"), *type = member->Attribute("type");
      if (role == nullptr || type == nullptr || std::string(role) != "outer" || std::string(type) != "way") continue;
      const auto way = ways.find(id_of(file, *member, "ref"));
      if (way == ways.end() || !way->second.tag("building").empty()) continue;
      OsmWay ring = way->second;
      ring.tags.insert(itself.tags.begin(), itself.tags.end());
      buildings.push_back(std::move(ring));
    }
  }
}

}  // namespace

const std::string& OsmWay::tag(const std::string& key) const {
  static const std::string none;
  const auto found = tags.find(key);
  return found == tags.end() ? none : found->second;
}

void LeftOut::add(const OsmWay& left) {
  if (count++ == 0) way = left.id, line = left.line;
}

std::vector<Eigen::Vector2d> OsmMap::line_of(const OsmWay& way) const {
  std::vector<Eigen::Vector2d> line;
  for (const std::int64_t node : way.nodes) line.push_back(nodes.at(node));
  return line;
}

double number_of(const std::string& tag, double otherwise, int& not_understood) {
  if (tag.empty()) return otherwise;
  try {
    const double value = std::stod(tag);
    if (std::isfinite(value)) return value;
  } catch (const std::logic_error&) {
  }
  ++not_understood;
  return otherwise;
}

bool begins_like_a_map(const std::string& file) {
  std::string head(512, ' ');
  std::ifstream(file, std::ios::binary).read(head.data(), static_cast<std::streamsize>(head.size()));
  return head.find("<osm") != std::string::npos;
}

OsmMap read_osm(const std::string& file) {
  tinyxml2::XMLDocument document;
  const tinyxml2::XMLError error = document.LoadFile(file.c_str());
  if (error == tinyxml2::XML_ERROR_FILE_NOT_FOUND || error == tinyxml2::XML_ERROR_FILE_COULD_NOT_BE_OPENED ||
      error == tinyxml2::XML_ERROR_FILE_READ_ERROR)
    refuse(file, 0, "cannot be read", "give the path of an OpenStreetMap XML file (.osm)");
  if (error == tinyxml2::XML_ERROR_EMPTY_DOCUMENT)
    refuse(file, 0, "is empty", "export the map anew, as OpenStreetMap XML (.osm)");
  if (error != tinyxml2::XML_SUCCESS && begins_like_a_map(file))
    refuse(file, document.ErrorLineNum(), std::string("is cut off or damaged (") + document.ErrorName() + ")",
           "export or download it again");
  if (error != tinyxml2::XML_SUCCESS)
    refuse(file, document.ErrorLineNum(), std::string("is not XML (") + document.ErrorName() + ")",
           "export it as OpenStreetMap XML (.osm), not as .pbf or .json");
  const tinyxml2::XMLElement* root = document.FirstChildElement("osm");
  if (root == nullptr) refuse(file, 1, "has no <osm> element", "export it as OpenStreetMap XML (.osm)");

  std::map<std::int64_t, Degrees> nodes;
  Ids node_ids(file), way_ids(file);
  for (auto* node = root->FirstChildElement("node"); node != nullptr; node = node->NextSiblingElement("node")) {
    const std::int64_t id = id_of(file, *node, "id");
    node_ids.add(id, *node);
    nodes[id] = degrees_of(file, *node, "lat", "lon");
  }

  OsmMap map;
  std::map<std::int64_t, OsmWay> others;  // which may be rings of relations
  Degrees least{90, 180}, most{-90, -180};
  for (auto* element = root->FirstChildElement("way"); element != nullptr;
       element = element->NextSiblingElement("way")) {
    OsmWay way = way_of(file, *element);
    way_ids.add(way.id, *element);
    const bool street = !way.tag("highway").empty(), building = !way.tag("building").empty();
    const bool complete =
        std::all_of(way.nodes.begin(), way.nodes.end(), [&](std::int64_t node) { return nodes.count(node) > 0; });
    if (!complete) {
      if (building) map.buildings_without_nodes.add(way);
      else if (street) map.streets_without_nodes.add(way);
      continue;
    }
    for (const std::int64_t id : way.nodes) {
      if (!street && !building) break;
      const Degrees& d = nodes.at(id);
      least = {std::min(least.latitude, d.latitude), std::min(least.longitude, d.longitude)};
      most = {std::max(most.latitude, d.latitude), std::max(most.longitude, d.longitude)};
    }
    if (building) map.buildings.push_back(std::move(way));
    else if (street) map.streets.push_back(std::move(way));
    else others.emplace(way.id, std::move(way));
  }
  add_outer_rings(file, *root, others, map.buildings);
  if (map.streets.empty())
    refuse(file, 0, "has no streets (no way tagged highway with all its nodes)",
           "export ways tagged highway together with their nodes");
  if (const auto* bounds = root->FirstChildElement("bounds")) {
    least = degrees_of(file, *bounds, "minlat", "minlon");
    most = degrees_of(file, *bounds, "maxlat", "maxlon");
    if (least.latitude > most.latitude || least.longitude > most.longitude)
      refuse(file, bounds->GetLineNum(), "has <bounds> whose minimum lies above the maximum",
             "take out <bounds>, or export the map anew");
  }
  // A local plane about the middle: on 10 km it is true to a few parts in 10^4.
  constexpr double earth_m = 6371008.8, to_rad = M_PI / 180.0;
  const double latitude = (least.latitude + most.latitude) / 2, longitude = (least.longitude + most.longitude) / 2;
  const auto local = [&](const Degrees& d) {
    return Eigen::Vector2d(earth_m * std::cos(latitude * to_rad) * (d.longitude - longitude) * to_rad,
                           earth_m * (d.latitude - latitude) * to_rad);
  };
  map.low = local(least), map.high = local(most);
  const Eigen::Vector2d size = map.high - map.low;
  if (!(size.maxCoeff() <= widest_m))
    refuse(file, 0,
           "is " + std::to_string(static_cast<long>(size.x() / 1000)) + " x " +
               std::to_string(static_cast<long>(size.y() / 1000)) + " km, 10 km is the most",
           "cut out the district, for instance with: osmium extract -b WEST,SOUTH,EAST,NORTH");
  for (const auto& [id, d] : nodes) map.nodes[id] = local(d);
  return map;
}

}  // namespace convoy::simulator
