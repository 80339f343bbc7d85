#include <convoy/components/vehicle_config.hpp>
#include <convoy/config_error.hpp>
#include <convoy/dds/discovery.hpp>
#include <convoy/dds/impaired_transport.hpp>
#include <convoy/dds/xml_fault.hpp>

#include <tinyxml2.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <set>
#include <sstream>

#include "vehicle_config_entries.hpp"

namespace convoy {
namespace {

struct Fleet {
  int dimension = 2;
};

template <class Visitor>
void describe(Fleet& f, Visitor&& visit) {
  visit("fleet", "dimension", f.dimension);
}

// Position, then the angles about x and y (in space) and z: in the order of a tangent vector, but not one.
template <class G>
struct StaticBias {
  typename G::Tangent mean = G::Tangent::Zero(), sigma = G::Tangent::Zero();
};

template <class G, class Visitor>
void describe(StaticBias<G>& b, Visitor&& visit) {
  visit("static_bias", "x_m", b.mean[0]);
  visit("static_bias", "y_m", b.mean[1]);
  visit("static_bias", "theta_rad", b.mean[G::Dof - 1]);
  visit("static_bias", "sigma_x_m", b.sigma[0]);
  visit("static_bias", "sigma_y_m", b.sigma[1]);
  visit("static_bias", "sigma_theta_rad", b.sigma[G::Dof - 1]);
  if constexpr (G::Dim == 3) {
    visit("static_bias", "z_m", b.mean[2]);
    visit("static_bias", "roll_rad", b.mean[3]);
    visit("static_bias", "pitch_rad", b.mean[4]);
    visit("static_bias", "sigma_z_m", b.sigma[2]);
    visit("static_bias", "sigma_roll_rad", b.sigma[3]);
    visit("static_bias", "sigma_pitch_rad", b.sigma[4]);
  }
}

SE2 pose_of(const StaticBias<SE2>& b) { return {b.mean[0], b.mean[1], b.mean[2]}; }
SE3 pose_of(const StaticBias<SE3>& b) {
  const auto turn = [&](int axis) { return SE3::Exp(b.mean[axis] * SE3::Tangent::Unit(axis)); };
  return SE3::from_rotation(Eigen::Matrix3d::Identity(), b.mean.head<3>()) * turn(5) * turn(4) * turn(3);
}

SE2::Tangent entries_of(const SE2& T) { return {T.translation().x(), T.translation().y(), T.theta()}; }
SE3::Tangent entries_of(const SE3& T) {
  const Eigen::Matrix3d R = T.rotation();
  SE3::Tangent entries;
  entries << T.translation(), std::atan2(R(2, 1), R(2, 2)), std::atan2(0.0 - R(2, 0), std::hypot(R(0, 0), R(1, 0))),
      std::atan2(R(1, 0), R(0, 0));
  return entries;
}

// ---- values as text --------------------------------------------------------------------------------------------

[[noreturn]] void refuse(const std::string& where, const std::string& what) { throw ConfigError(where + ": " + what); }

void parse(const std::string& where, const char* text, double& value) {
  const char* const end = text + std::strlen(text);
  const auto [rest, error] = std::from_chars(text, end, value);
  if (error != std::errc() || rest != end || !std::isfinite(value))
    refuse(where, std::string("'") + text + "' is no finite number; write one like 0.5, without blanks or unit");
}

template <class Integer>
requires std::is_integral_v<Integer>
void parse(const std::string& where, const char* text, Integer& value) {
  constexpr auto highest = static_cast<std::uint64_t>(std::numeric_limits<Integer>::max());
  std::uint64_t number = 0;
  const char* const end = text + std::strlen(text);
  const auto [rest, error] = std::from_chars(text, end, number);
  if (error != std::errc() || rest != end || number > highest)
    refuse(where, std::string("'") + text + "' is no whole number from 0 to " + std::to_string(highest));
  value = static_cast<Integer>(number);
}

template <class Value>
void parse_choice(const std::string& where, const char* text, Value& value,
                  std::initializer_list<std::pair<const char*, Value>> choices) {
  std::string allowed;
  for (const auto& [name, choice] : choices) {
    if (std::strcmp(name, text) == 0) {
      value = choice;
      return;
    }
    allowed += (allowed.empty() ? "" : " or ") + std::string(name);
  }
  refuse(where, std::string("'") + text + "' must be " + allowed);
}

void parse(const std::string& where, const char* text, bool& value) {
  parse_choice<bool>(where, text, value, {{"true", true}, {"false", false}});
}
void parse(const std::string& where, const char* text, DriftModel& value) {
  parse_choice<DriftModel>(where, text, value, {{"local", DriftModel::local}, {"literal", DriftModel::literal}});
}
void parse(const std::string& where, const char* text, SearchMethod& value) {
  parse_choice<SearchMethod>(
      where, text, value,
      {{"alignment", SearchMethod::alignment}, {"gcbb", SearchMethod::gcbb}, {"fig5", SearchMethod::fig5}});
}
void parse(const std::string& where, const char* text, MapBackend& value) {
  parse_choice<MapBackend>(where, text, value, {{"sparse", MapBackend::sparse}, {"ekf", MapBackend::ekf}});
}
void parse(const std::string&, const char* text, std::string& value) { value = text; }
void parse(const std::string& where, const char* text, Partition& value) {
  try {
    value = Partition::parse(text);
  } catch (const ConfigError& error) {
    refuse(where, error.what());
  }
}
void parse(const std::string&, const char* text, std::filesystem::path& value) { value = text; }

template <class Item>
void parse(const std::string& where, const char* text, std::vector<Item>& list) {
  std::istringstream words(text);
  list.clear();
  for (std::string word; words >> word;) parse(where, word.c_str(), list.emplace_back());
}

// The shortest text that reads back as the same number, whatever the locale.
std::string text_of(double value) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, value).ptr};
}
template <class Integer>
requires std::is_integral_v<Integer> std::string text_of(Integer value) { return std::to_string(value); }
std::string text_of(bool value) { return value ? "true" : "false"; }
std::string text_of(DriftModel model) { return model == DriftModel::local ? "local" : "literal"; }
std::string text_of(SearchMethod method) { return to_string(method); }
std::string text_of(MapBackend backend) { return backend == MapBackend::sparse ? "sparse" : "ekf"; }
std::string text_of(const std::string& value) { return value; }
std::string text_of(const Partition& partition) { return to_string(partition); }
std::string text_of(const std::filesystem::path& value) { return value.string(); }
template <class Item>
std::string text_of(const std::vector<Item>& list) {
  std::string text;
  for (const Item& item : list) text += (text.empty() ? "" : " ") + text_of(item);
  return text;
}

// ---- reading ---------------------------------------------------------------------------------------------------

std::string at(const std::filesystem::path& file, int line) {
  return file.string() + ":" + std::to_string(std::max(line, 1));
}

// Where an entry stands, so that a value that is found wrong later can be pointed at.
class Lines {
 public:
  void put(const std::string& element, int line) { lines_[element] = line; }
  void put(const std::string& element, const std::string& name, int line) { lines_[element + " " + name] = line; }
  bool has(const std::string& element) const { return lines_.count(element) != 0; }
  /// Of the entry; if it is not there, of its element; else the first.
  int of(const std::string& element, const std::string& name = {}) const {
    for (const std::string& key : {element + " " + name, element})
      if (const auto it = lines_.find(key); it != lines_.end()) return it->second;
    return 1;
  }

 private:
  std::map<std::string, int> lines_;
};

// Every attribute of `element` must be one that describe() knows for it.
template <class Described>
void read_element(const std::filesystem::path& file, const tinyxml2::XMLElement& element, Described& target,
                  Lines& lines) {
  std::set<std::string> known;
  lines.put(element.Name(), element.GetLineNum());
  for (const auto* attribute = element.FirstAttribute(); attribute != nullptr; attribute = attribute->Next()) {
    bool found = false;
    describe(target, [&](const char* element_name, const char* name, auto& value) {
      if (std::strcmp(element_name, element.Name()) != 0) return;
      known.insert(name);
      if (std::strcmp(name, attribute->Name()) != 0) return;
      const std::string where = at(file, attribute->GetLineNum()) + ": <" + element.Name() + " " + name + ">";
      parse(where, attribute->Value(), value);
      lines.put(element_name, name, attribute->GetLineNum());
      found = true;
    });
    if (found) continue;
    std::string allowed;
    for (const std::string& name : known) allowed += (allowed.empty() ? "" : ", ") + name;
    refuse(at(file, attribute->GetLineNum()),
           std::string("<") + element.Name() + "> has no entry '" + attribute->Name() + "'; it has: " + allowed);
  }
  for (const auto* child = element.FirstChild(); child != nullptr; child = child->NextSibling())
    if (child->ToComment() == nullptr)
      refuse(at(file, child->GetLineNum()),
             std::string("<") + element.Name() + "> holds attributes only; take out what stands in it");
}

std::filesystem::path beside(const std::filesystem::path& file, const std::filesystem::path& path) {
  if (path.empty()) return path;
  return path.is_absolute() ? path : std::filesystem::absolute(file).parent_path() / path;
}

template <class Params>
void check(const std::filesystem::path& file, const Lines& lines, const std::string& element, const Params& params) {
  try {
    validate(params);
  } catch (const RangeError& error) {
    refuse(at(file, lines.of(element, error.name())), "<" + element + " " + error.name() + ">" + error.fault());
  } catch (const ConfigError& error) {
    refuse(at(file, lines.of(element)), error.what());
  }
}

// The document holds one root, <convoy version="1">, and besides a declaration and comments nothing.
const tinyxml2::XMLElement& only_root(const std::filesystem::path& file, const tinyxml2::XMLDocument& document) {
  const tinyxml2::XMLElement* root = nullptr;
  for (const auto* node = document.FirstChild(); node != nullptr; node = node->NextSibling()) {
    if (node->ToComment() != nullptr || node->ToDeclaration() != nullptr) continue;
    if (node->ToElement() == nullptr)
      refuse(at(file, node->GetLineNum()), "only <convoy version=\"1\"> may stand here; take this out");
    if (root != nullptr)
      refuse(at(file, node->GetLineNum()),
             std::string("a second root <") + node->Value() + ">; one file is one vehicle, with one <convoy>");
    root = node->ToElement();
  }
  if (root == nullptr || std::strcmp(root->Name(), "convoy") != 0)
    refuse(at(file, root == nullptr ? 1 : root->GetLineNum()), "the root element must be <convoy version=\"1\">");
  const char* version = nullptr;
  for (const auto* attribute = root->FirstAttribute(); attribute != nullptr; attribute = attribute->Next()) {
    if (std::strcmp(attribute->Name(), "version") != 0)
      refuse(at(file, attribute->GetLineNum()),
             std::string("<convoy> has no entry '") + attribute->Name() + "'; it has: version");
    version = attribute->Value();
  }
  if (version == nullptr || std::strcmp(version, "1") != 0)
    refuse(at(file, root->GetLineNum()), std::string("<convoy> needs version=\"1\", the only one there is") +
                                             (version == nullptr ? "" : std::string(", not '") + version + "'"));
  return *root;
}

// Ranges that no stage checks by itself.
template <class G>
void check_ranges(const std::filesystem::path& file, const VehicleConfig<G>& c, const Lines& lines) {
  const auto demand = [&](bool holds, const char* element, const char* name, const std::string& range) {
    if (!holds) refuse(at(file, lines.of(element, name)), std::string("<") + element + " " + name + "> must " + range);
  };
  const auto above_zero = [&](double value, const char* element, const char* name) {
    demand(value > 0.0, element, name, "be > 0");
  };
  const VehicleParams<G>& v = c.vehicle;
  if (v.id == 0) refuse(at(file, lines.of("vehicle", "id")), "<vehicle id=\"N\"/> with N >= 1 is needed");
  above_zero(v.live_period_s, "vehicle", "live_period_s");
  demand(v.step_period_s > 0.0 && v.step_period_s <= 60.0, "vehicle", "step_period_s", "lie in (0, 60] s");
  demand(v.searches_per_step >= 1, "vehicle", "searches_per_step", "be 1 or more");
  demand(c.first_epoch == 0 || !v.state_folder.empty(), "vehicle", "first_epoch",
         "stand beside a state_folder; without one every start would use the same epoch again");
  demand(!v.journal || !v.state_folder.empty(), "vehicle", "journal", "stand beside a state_folder, where it lies");
  demand(v.submaps.limits.max_chains_per_vehicle >= 1, "peers", "max_chains_per_vehicle", "be 1 or more");
  demand(v.submaps.limits.max_facts_per_vehicle >= 1, "peers", "max_facts_per_vehicle", "be 1 or more");
  above_zero(v.submaps.rival_s, "peers", "rival_s");
  demand(c.first_epoch < std::numeric_limits<Epoch>::max(), "vehicle", "first_epoch", "leave room for later ones");
  const auto& roster = v.submaps.limits.roster;
  const std::set<VehicleId> members(roster.begin(), roster.end());
  demand(members.count(0) == 0 && members.size() == roster.size(), "vehicle", "roster",
         "name each vehicle once, by ids of 1 or more");
  demand(roster.empty() || members.count(v.id) != 0, "vehicle", "roster",
         "name this vehicle, too: " + std::to_string(v.id));

  demand(c.dds.domain <= 232, "dds", "domain", "lie in 0..232");
  const auto in_order = [&](const std::vector<std::string>& list, const char* name, auto& fault_of) {
    for (const std::string& entry : list)
      if (const std::string fault = fault_of(entry); !fault.empty())
        refuse(at(file, lines.of("dds", name)), std::string("<dds ") + name + ">: " + fault);
  };
  in_order(c.dds.initial_peers, "peers", dds::fault_of_peer);
  in_order(c.dds.discovery_servers, "discovery_servers", dds::fault_of_server);
  demand(c.dds.max_queued_messages >= 1, "dds", "max_queued_messages", "be 1 or more");
  above_zero(c.sensors.rate, "sensors", "rate");
  demand(v.mark.cwiseAbs().maxCoeff() <= 100.0, "vehicle", "mark_x_m",
         "lie in -100..100 m, as mark_y_m: it is on the vehicle");
  demand(v.submaps.encounter_period_s >= 0.0, "map", "encounter_period_s", "be >= 0");
  for (int axis = 0; axis < G::Dim; ++axis)
    demand(std::abs(c.sensors.fix_lever[axis]) <= 100.0, "sensors",
           std::array{"fix_lever_x_m", "fix_lever_y_m", "fix_lever_z_m"}[static_cast<std::size_t>(axis)],
           "lie in -100..100 m: the antenna is on the vehicle");
  demand(c.sensors.start_unix_s >= 0.0, "sensors", "start_unix_s",
         "be >= 0; 0 is the moment at which the process starts");

  if (lines.has("camera")) {
    const CameraConfig& camera = c.camera;
    demand(camera.domain <= 232, "camera", "domain", "be there, and lie in 0..232");
    demand(camera.domain != c.dds.domain, "camera", "domain",
           "differ from <dds domain>: sensors and fleet do not share one");
    demand(!camera.interfaces.empty(), "camera", "interfaces", "name an address of this machine, such as 127.0.0.1");
    demand(camera.wait_s >= 0.0 && camera.wait_s <= 86400.0, "camera", "wait_s", "lie in 0..86400 s");
    demand(camera.features >= 12 && camera.features <= 400, "camera", "features", "lie in 12..400");
    demand(camera.new_features >= 1 && camera.new_features <= 100, "camera", "new_features", "lie in 1..100");
    demand(c.sensors.file.empty(), "sensors", "file", "not stand beside <camera>: a vehicle has one or the other");
  }

  above_zero(v.submaps.map_period_s, "map", "period_s");
  demand(v.submaps.exact_share >= 0.0, "map", "exact_share", "be >= 0; 0 builds the exact map when nothing new comes");
  above_zero(v.submaps.stale_peer_s, "map", "stale_peer_s");
  demand(!v.submaps.selection.common_frame_is_enu || v.submaps.backend == MapBackend::sparse, "map",
         "common_frame_is_enu", "be false beside backend=\"ekf\", which takes no absolute fixes");
  const VehicleId reference = v.submaps.selection.reference;
  demand(reference == 0 || roster.empty() || members.count(reference) != 0, "map", "reference_vehicle",
         "be on the roster, or 0");
}

template <class G>
Estimate<G> estimate_of(const std::filesystem::path& file, StaticBias<G>& b, const Lines& lines) {
  describe(b, [&](const char* element, const char* name, double value) {
    if (std::strncmp(name, "sigma_", 6) == 0 && !(value >= 0.0))
      refuse(at(file, lines.of(element, name)), std::string("<static_bias ") + name + "> must be >= 0");
  });
  return {pose_of(b), b.sigma.cwiseAbs2().asDiagonal()};
}

// The vehicle would tell everybody of it as a fact; what no fact may hold is an error here, where it is written.
template <class G>
void check_static_bias(const std::filesystem::path& file, const VehicleConfig<G>& c, const Lines& lines) {
  if (!c.vehicle.static_bias) return;
  PriorFact<G> prior;
  prior.key.chain = {c.vehicle.id, 1};
  prior.known = true;
  prior.mean = c.vehicle.static_bias->mean;
  prior.covariance = c.vehicle.static_bias->covariance;
  if (const Insertion fit = FactStore<G>(c.vehicle.submaps.limits).check(prior); fit != Insertion::inserted)
    refuse(at(file, lines.of("static_bias")), std::string("<static_bias> cannot be told to the other vehicles (") +
                                                  to_string(fit) +
                                                  "); give a pose and standard deviations of a usual size");
}

void load_document(const std::filesystem::path& file, tinyxml2::XMLDocument& document) {
  std::error_code error;
  if (!std::filesystem::exists(file, error)) refuse(file.string(), "no such file");
  if (std::filesystem::is_directory(file, error)) refuse(file.string(), "a folder; name the XML file in it");
  const auto result = document.LoadFile(file.string().c_str());
  if (result == tinyxml2::XML_ERROR_FILE_NOT_FOUND || result == tinyxml2::XML_ERROR_FILE_COULD_NOT_BE_OPENED ||
      result == tinyxml2::XML_ERROR_FILE_READ_ERROR)
    refuse(file.string(), "cannot be read; check its permissions");
  if (result != tinyxml2::XML_SUCCESS) refuse(at(file, document.ErrorLineNum()), dds::xml_fault(document));
}

}  // namespace

int fleet_dimension(const std::filesystem::path& file) {
  tinyxml2::XMLDocument document;
  load_document(file, document);
  Lines lines;
  Fleet fleet;
  if (const auto* element = only_root(file, document).FirstChildElement("fleet"))
    read_element(file, *element, fleet, lines);
  if (fleet.dimension != 2 && fleet.dimension != 3)
    refuse(at(file, lines.of("fleet", "dimension")), "<fleet dimension> must be 2 (planar) or 3 (in space)");
  return fleet.dimension;
}

template <class G>
VehicleConfig<G> load_vehicle_config(const std::filesystem::path& file) {
  const int dimension = fleet_dimension(file);
  tinyxml2::XMLDocument document;
  load_document(file, document);
  const tinyxml2::XMLElement& root = only_root(file, document);
  if (dimension != G::Dim) {
    const auto* fleet = root.FirstChildElement("fleet");
    refuse(at(file, (fleet ? fleet : &root)->GetLineNum()), "<fleet dimension> is " + std::to_string(dimension) +
                                                                ", and a fleet of dimension " + std::to_string(G::Dim) +
                                                                " is driven here");
  }

  VehicleConfig<G> config;
  config.file = file;
  std::set<std::string> elements{"fleet", "static_bias"}, seen;
  describe(config, [&](const char* element, const char*, auto&) { elements.insert(element); });
  Lines lines;
  lines.put("vehicle", root.GetLineNum());
  for (const auto* child = root.FirstChild(); child != nullptr; child = child->NextSibling()) {
    if (child->ToComment() != nullptr) continue;
    const int line = child->GetLineNum();
    const auto* element = child->ToElement();
    if (element == nullptr)
      refuse(at(file, line), "<convoy> holds elements and comments only; take out the text in it");
    const std::string name = element->Name();
    if (!elements.count(name) && name == "camera")
      refuse(at(file, line), "<camera> is of a vehicle in space: it needs <fleet dimension=\"3\"/>");
    if (!elements.count(name)) {
      std::string allowed;
      for (const std::string& known : elements) allowed += (allowed.empty() ? "<" : ", <") + known + ">";
      refuse(at(file, line), "no such element <" + name + ">; there are: " + allowed);
    }
    if (!seen.insert(name).second)
      refuse(at(file, line), "<" + name + "> stands here for the second time; put both into one");
    if (name == "fleet") continue;  // read above
    if (name == "static_bias") {
      StaticBias<G> bias;
      read_element(file, *element, bias, lines);
      config.vehicle.static_bias = estimate_of(file, bias, lines);
    } else {
      read_element(file, *element, config, lines);
    }
  }
  check_ranges(file, config, lines);
  check_static_bias(file, config, lines);
  check(file, lines, "drift", config.vehicle.drift);
  check(file, lines, "front_end", config.front_end);
  check(file, lines, "camera", config.camera.slam);
  check(file, lines, "association", config.vehicle.association);
  check(file, lines, "map", config.vehicle.submaps.selection);
  check(file, lines, "repair", config.vehicle.submaps.repair);
  check(file, lines, "budget", config.vehicle.budget);
  check(file, lines, "peers", config.vehicle.submaps.peers);
  check(file, lines, "watchdog", config.vehicle.watchdog);
  check(file, lines, "impairment", config.impairment.received);
  check(file, lines, "impairment_sent", config.impairment.sent);
  if (config.first_epoch != 0) config.vehicle.fresh_epoch = [epoch = config.first_epoch] { return epoch; };

  config.dds.origin = at(file, lines.of("dds", "interfaces"));
  config.dds.profile_file = beside(file, config.dds.profile_file).string();
  if (!config.dds.security_folder.empty())
    config.dds.security_folder = beside(file, config.dds.security_folder).string();
  config.sensors.file = beside(file, config.sensors.file);
  config.sensors.origin = at(file, lines.of("sensors", "file"));
  config.camera.origin = at(file, lines.of("camera"));
  config.vehicle.state_folder = beside(file, config.vehicle.state_folder);
  config.output_folder =
      config.output_folder.empty() ? std::filesystem::absolute(file).parent_path() : beside(file, config.output_folder);
  return config;
}

template <class G>
void save_vehicle_config(const VehicleConfig<G>& config, const std::filesystem::path& file) {
  tinyxml2::XMLDocument document;
  tinyxml2::XMLElement* root = document.NewElement("convoy");
  root->SetAttribute("version", 1);
  document.InsertEndChild(root);
  VehicleConfig<G> copy = config, defaults;
  std::vector<std::string> default_text;
  describe(defaults, [&](const char*, const char*, auto& value) { default_text.push_back(text_of(value)); });
  std::size_t entry = 0;
  const auto write = [&](const char* element_name, const char* name, const std::string& text) {
    tinyxml2::XMLElement* element = root->FirstChildElement(element_name);
    if (element == nullptr) element = root->InsertNewChildElement(element_name);
    element->SetAttribute(name, text.c_str());
  };
  if (G::Dim != Fleet().dimension) write("fleet", "dimension", text_of(G::Dim));
  describe(copy, [&](const char* element, const char* name, auto& value) {
    const std::string text = text_of(value);
    if (text != default_text[entry++]) write(element, name, text);
  });
  if (config.vehicle.static_bias) {
    const Estimate<G>& bias = *config.vehicle.static_bias;
    StaticBias<G> b{entries_of(bias.mean), bias.covariance.diagonal().cwiseSqrt()};
    describe(b, [&](const char* element, const char* name, double value) { write(element, name, text_of(value)); });
  }
  if (document.SaveFile(file.string().c_str()) != tinyxml2::XML_SUCCESS)
    refuse(file.string(), "cannot write; is the folder there and writable?");
}

template <class G>
std::unique_ptr<SubmapExchange<G>> open_exchange(const VehicleConfig<G>& config) {
  dds::DdsConfig dds = config.dds;
  dds.vehicle = config.vehicle.id;
  if (config.impairment.any()) dds::impair(dds, config.impairment);
  return std::make_unique<dds::DdsExchange<G>>(dds);
}

#define CONVOY_INSTANTIATE(G)                                                               \
  template VehicleConfig<G> load_vehicle_config(const std::filesystem::path&);              \
  template void save_vehicle_config(const VehicleConfig<G>&, const std::filesystem::path&); \
  template std::unique_ptr<SubmapExchange<G>> open_exchange(const VehicleConfig<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
