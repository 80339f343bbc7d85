#include <convoy/components/vehicle_config.hpp>
#include <convoy/config_error.hpp>

#include <tinyxml2.h>

#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <set>
#include <sstream>

namespace convoy {
namespace {

// One description of every entry serves reading and writing: visit(element, attribute, value).
template <class Visitor>
void describe(VehicleConfig& c, Visitor&& visit) {
  VehicleParams<SE2>& v = c.vehicle;
  visit("vehicle", "id", v.id);
  visit("vehicle", "state_folder", v.state_folder);
  visit("vehicle", "output_folder", c.output_folder);
  visit("vehicle", "roster", v.submaps.limits.roster);
  visit("vehicle", "live_period_s", v.live_period_s);
  visit("vehicle", "step_period_s", v.step_period_s);
  visit("vehicle", "searches_per_step", v.searches_per_step);

  visit("dds", "domain", c.dds.domain);
  visit("dds", "profile", c.dds.profile_file);
  visit("dds", "participant_profile", c.dds.participant_profile);
  visit("dds", "interfaces", c.dds.interface_whitelist);

  visit("impairment", "loss", c.impairment.loss);
  visit("impairment", "duplicate", c.impairment.duplicate);
  visit("impairment", "delay_s", c.impairment.delay_s);
  visit("impairment", "jitter_s", c.impairment.jitter_s);
  visit("impairment", "seed", c.impairment.seed);

  RangeBearingEkfParams& f = c.front_end;
  visit("front_end", "sigma_along_per_sqrt_m", f.sigma_along_per_sqrt_m);
  visit("front_end", "sigma_along_per_sqrt_rad", f.sigma_along_per_sqrt_rad);
  visit("front_end", "sigma_across_per_sqrt_m", f.sigma_across_per_sqrt_m);
  visit("front_end", "sigma_heading_per_sqrt_m", f.sigma_heading_per_sqrt_m);
  visit("front_end", "sigma_heading_per_sqrt_rad", f.sigma_heading_per_sqrt_rad);
  visit("front_end", "sigma_heading_per_sqrt_s", f.sigma_heading_per_sqrt_s);
  visit("front_end", "distance_scale", f.distance_scale);
  visit("front_end", "angle_scale", f.angle_scale);
  visit("front_end", "sigma_range_m", f.sigma_range_m);
  visit("front_end", "sigma_range_share", f.sigma_range_share);
  visit("front_end", "sigma_bearing_rad", f.sigma_bearing_rad);
  visit("front_end", "min_sighting_interval_s", f.min_sighting_interval_s);
  visit("front_end", "gate", f.gate);
  visit("front_end", "max_rejections", f.max_rejections);
  visit("front_end", "min_range_m", f.min_range_m);
  visit("front_end", "max_range_m", f.max_range_m);
  visit("front_end", "max_odometry_gap_s", f.max_odometry_gap_s);
  visit("front_end", "min_sightings", f.min_sightings);
  visit("front_end", "min_parallax_rad", f.min_parallax_rad);
  visit("front_end", "max_sigma_m", f.max_sigma_m);
  visit("front_end", "nis_confidence", f.nis_confidence);
  visit("front_end", "nis_window", f.nis_window);
  visit("front_end", "segment_length_m", f.segment_length_m);
  visit("front_end", "min_batch", f.min_batch);
  visit("front_end", "max_segment_length_m", f.max_segment_length_m);
  visit("front_end", "trail_spacing_m", f.trail_spacing_m);

  DriftParams<SE2>& d = v.drift;
  visit("drift", "model", d.model);
  visit("drift", "gamma", d.gamma);
  visit("drift", "rate_x_m2_per_m", d.rate[0]);
  visit("drift", "rate_y_m2_per_m", d.rate[1]);
  visit("drift", "rate_theta_rad2_per_m", d.rate[2]);
  visit("drift", "landmark_inflation", d.landmark_inflation);

  AssociationParams& a = v.association;
  visit("association", "compatibility", a.constraints.compatibility);
  visit("association", "distance", a.constraints.distance);
  visit("association", "min_distance_m", a.constraints.min_distance_m);
  visit("association", "literal_search", a.literal_search);
  visit("association", "max_nodes", a.max_nodes);
  visit("association", "min_pairings", a.min_pairings);
  visit("association", "residual", a.residual);
  visit("association", "pairing", a.pairing);
  visit("association", "separation", a.separation);
  visit("association", "max_false_alarms", a.max_false_alarms);
  visit("association", "max_runner_up_share", a.max_runner_up_share);

  SubmapManagerParams& s = v.submaps;
  visit("map", "backend", s.backend);
  visit("map", "period_s", s.map_period_s);
  visit("map", "min_pairings", s.selection.min_pairings);
  visit("map", "residual", s.selection.residual);
  visit("map", "map_residual", s.selection.map_residual);
  visit("map", "reference_vehicle", s.selection.reference);
  visit("map", "stale_peer_s", s.stale_peer_s);

  visit("repair", "digest_period_s", s.repair.digest_period_s);
  visit("repair", "grace_s", s.repair.grace_s);
  visit("repair", "backoff_min_s", s.repair.backoff_min_s);
  visit("repair", "backoff_max_s", s.repair.backoff_max_s);
  visit("repair", "relay_delay_s", s.repair.relay_delay_s);
  visit("repair", "max_ranges", s.repair.max_ranges);
  visit("repair", "answers_per_s", s.repair.answers_per_s);
  visit("repair", "batch_limit", s.repair.batch_limit);
  visit("repair", "seed", s.seed);

  visit("sensors", "file", c.sensors.file);
  visit("sensors", "rate", c.sensors.rate);
  visit("sensors", "start_unix_s", c.sensors.start_unix_s);
}

struct StaticBias {
  double x_m = 0, y_m = 0, theta_rad = 0, sigma_x_m = 0, sigma_y_m = 0, sigma_theta_rad = 0;
};

template <class Visitor>
void describe(StaticBias& b, Visitor&& visit) {
  visit("static_bias", "x_m", b.x_m);
  visit("static_bias", "y_m", b.y_m);
  visit("static_bias", "theta_rad", b.theta_rad);
  visit("static_bias", "sigma_x_m", b.sigma_x_m);
  visit("static_bias", "sigma_y_m", b.sigma_y_m);
  visit("static_bias", "sigma_theta_rad", b.sigma_theta_rad);
}

// ---- values as text --------------------------------------------------------------------------------------------

[[noreturn]] void refuse(const std::string& where, const std::string& what) { throw ConfigError(where + ": " + what); }

void parse(const std::string& where, const char* text, double& value) {
  char* end = nullptr;
  value = std::strtod(text, &end);
  if (end == text || *end != '\0' || !std::isfinite(value)) refuse(where, std::string("'") + text + "' is no finite number");
}

template <class Integer>
  requires std::is_integral_v<Integer>
void parse(const std::string& where, const char* text, Integer& value) {
  char* end = nullptr;
  errno = 0;
  const long long number = std::strtoll(text, &end, 10);
  const auto highest = static_cast<long long>(std::min<std::uint64_t>(std::numeric_limits<Integer>::max(),
                                                                      std::numeric_limits<long long>::max()));
  if (end == text || *end != '\0' || errno != 0 || number < 0 || number > highest)
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
void parse(const std::string& where, const char* text, MapBackend& value) {
  parse_choice<MapBackend>(where, text, value, {{"sparse", MapBackend::sparse}, {"ekf", MapBackend::ekf}});
}
void parse(const std::string&, const char* text, std::string& value) { value = text; }
void parse(const std::string&, const char* text, std::filesystem::path& value) { value = text; }

template <class Item>
void parse(const std::string& where, const char* text, std::vector<Item>& list) {
  std::istringstream words(text);
  list.clear();
  for (std::string word; words >> word;) parse(where, word.c_str(), list.emplace_back());
}

std::string text_of(double value) {
  std::ostringstream out;
  out.precision(17);
  out << value;
  return out.str();
}
template <class Integer>
  requires std::is_integral_v<Integer>
std::string text_of(Integer value) {
  return std::to_string(value);
}
std::string text_of(bool value) { return value ? "true" : "false"; }
std::string text_of(DriftModel model) { return model == DriftModel::local ? "local" : "literal"; }
std::string text_of(MapBackend backend) { return backend == MapBackend::sparse ? "sparse" : "ekf"; }
std::string text_of(const std::string& value) { return value; }
std::string text_of(const std::filesystem::path& value) { return value.string(); }
template <class Item>
std::string text_of(const std::vector<Item>& list) {
  std::string text;
  for (const Item& item : list) text += (text.empty() ? "" : " ") + text_of(item);
  return text;
}

// ---- reading ---------------------------------------------------------------------------------------------------

std::string at(const std::filesystem::path& file, int line) { return file.string() + ":" + std::to_string(line); }

// Every attribute of `element` must be one that describe() knows for it.
template <class Described>
void read_element(const std::filesystem::path& file, const tinyxml2::XMLElement& element, Described& target) {
  std::set<std::string> known;
  for (const auto* attribute = element.FirstAttribute(); attribute != nullptr; attribute = attribute->Next()) {
    bool found = false;
    describe(target, [&](const char* element_name, const char* name, auto& value) {
      if (std::strcmp(element_name, element.Name()) != 0) return;
      known.insert(name);
      if (std::strcmp(name, attribute->Name()) != 0) return;
      const std::string where = at(file, attribute->GetLineNum()) + ": <" + element.Name() + " " + name + ">";
      parse(where, attribute->Value(), value);
      found = true;
    });
    if (found) continue;
    std::string allowed;
    for (const std::string& name : known) allowed += (allowed.empty() ? "" : ", ") + name;
    refuse(at(file, attribute->GetLineNum()),
           std::string("<") + element.Name() + "> has no entry '" + attribute->Name() + "'; it has: " + allowed);
  }
  for (const auto* child = element.FirstChild(); child != nullptr; child = child->NextSibling())
    if (child->ToComment() == nullptr) refuse(at(file, child->GetLineNum()), std::string("<") + element.Name() + "> holds attributes only");
}

std::filesystem::path beside(const std::filesystem::path& file, const std::filesystem::path& path) {
  if (path.empty()) return path;
  return path.is_absolute() ? path : std::filesystem::absolute(file).parent_path() / path;
}

template <class Check>
void checked(const std::filesystem::path& file, int line, Check check) {
  try {
    check();
  } catch (const ConfigError& error) {
    refuse(at(file, line), error.what());
  }
}

}  // namespace

VehicleConfig load_vehicle_config(const std::filesystem::path& file) {
  tinyxml2::XMLDocument document;
  if (document.LoadFile(file.string().c_str()) != tinyxml2::XML_SUCCESS) {
    if (document.ErrorID() == tinyxml2::XML_ERROR_FILE_NOT_FOUND) refuse(file.string(), "no such file");
    refuse(at(file, document.ErrorLineNum()), std::string("not well-formed XML: ") + document.ErrorName());
  }
  const tinyxml2::XMLElement* root = document.RootElement();
  if (root == nullptr || std::strcmp(root->Name(), "convoy") != 0) refuse(at(file, 1), "the root element must be <convoy version=\"1\">");
  if (root->IntAttribute("version") != 1) refuse(at(file, root->GetLineNum()), "<convoy> needs version=\"1\"");

  VehicleConfig config;
  config.file = file;
  std::set<std::string> elements{"static_bias"}, seen;
  describe(config, [&](const char* element, const char*, auto&) { elements.insert(element); });
  int drift_line = 1, front_end_line = 1, association_line = 1, vehicle_line = root->GetLineNum();
  for (const auto* element = root->FirstChildElement(); element != nullptr; element = element->NextSiblingElement()) {
    const std::string name = element->Name();
    const int line = element->GetLineNum();
    if (!elements.count(name)) {
      std::string allowed;
      for (const std::string& known : elements) allowed += (allowed.empty() ? "<" : ", <") + known + ">";
      refuse(at(file, line), "no such element <" + name + ">; there are: " + allowed);
    }
    if (!seen.insert(name).second) refuse(at(file, line), "<" + name + "> stands here for the second time");
    if (name == "static_bias") {
      StaticBias b;
      read_element(file, *element, b);
      if (b.sigma_x_m < 0 || b.sigma_y_m < 0 || b.sigma_theta_rad < 0) refuse(at(file, line), "<static_bias> sigmas must be >= 0");
      const SE2::Tangent sigma(b.sigma_x_m, b.sigma_y_m, b.sigma_theta_rad);
      config.vehicle.static_bias = Estimate<SE2>{SE2(b.x_m, b.y_m, b.theta_rad), sigma.cwiseAbs2().asDiagonal()};
    } else {
      read_element(file, *element, config);
    }
    if (name == "drift") drift_line = line;
    if (name == "front_end") front_end_line = line;
    if (name == "association") association_line = line;
    if (name == "vehicle") vehicle_line = line;
  }
  if (config.vehicle.id == 0) refuse(at(file, vehicle_line), "<vehicle id=\"N\"/> with N >= 1 is needed");
  if (config.dds.domain > 232) refuse(file.string(), "<dds domain> must lie in 0..232");
  if (!(config.sensors.rate > 0)) refuse(file.string(), "<sensors rate> must be > 0");
  checked(file, drift_line, [&] { validate(config.vehicle.drift); });
  checked(file, front_end_line, [&] { validate(config.front_end); });
  checked(file, association_line, [&] { validate(config.vehicle.association); });

  config.dds.profile_file = beside(file, config.dds.profile_file).string();
  config.sensors.file = beside(file, config.sensors.file);
  config.vehicle.state_folder = beside(file, config.vehicle.state_folder);
  config.output_folder = config.output_folder.empty() ? std::filesystem::absolute(file).parent_path()
                                                      : beside(file, config.output_folder);
  return config;
}

void save_vehicle_config(const VehicleConfig& config, const std::filesystem::path& file) {
  tinyxml2::XMLDocument document;
  tinyxml2::XMLElement* root = document.NewElement("convoy");
  root->SetAttribute("version", 1);
  document.InsertEndChild(root);
  VehicleConfig copy = config, defaults;
  std::vector<std::string> default_text;
  describe(defaults, [&](const char*, const char*, auto& value) { default_text.push_back(text_of(value)); });
  std::size_t entry = 0;
  const auto write = [&](const char* element_name, const char* name, const std::string& text) {
    tinyxml2::XMLElement* element = root->FirstChildElement(element_name);
    if (element == nullptr) element = root->InsertNewChildElement(element_name);
    element->SetAttribute(name, text.c_str());
  };
  describe(copy, [&](const char* element, const char* name, auto& value) {
    const std::string text = text_of(value);
    if (text != default_text[entry++]) write(element, name, text);
  });
  if (config.vehicle.static_bias) {
    const Estimate<SE2>& bias = *config.vehicle.static_bias;
    const Eigen::Vector3d sigma = bias.covariance.diagonal().cwiseSqrt();
    StaticBias b{bias.mean.translation().x(), bias.mean.translation().y(), bias.mean.theta(), sigma[0], sigma[1], sigma[2]};
    describe(b, [&](const char* element, const char* name, double value) { write(element, name, text_of(value)); });
  }
  if (document.SaveFile(file.string().c_str()) != tinyxml2::XML_SUCCESS)
    refuse(file.string(), "cannot write; is the folder there and writable?");
}

std::unique_ptr<SubmapExchange<SE2>> open_exchange(const VehicleConfig& config) {
  std::unique_ptr<SubmapExchange<SE2>> exchange = std::make_unique<dds::DdsExchange<SE2>>(config.dds);
  if (!config.impairment.any()) return exchange;
  return std::make_unique<ImpairedExchange<SE2>>(std::move(exchange), config.impairment);
}

}  // namespace convoy
