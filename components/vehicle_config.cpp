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

namespace convoy {
namespace {

// One description of every entry serves reading and writing: visit(element, attribute, value).
template <class Visitor>
void describe(const char* element, Impairment& i, Visitor& visit) {
  visit(element, "loss", i.loss);
  visit(element, "duplicate", i.duplicate);
  visit(element, "delay_s", i.delay_s);
  visit(element, "jitter_s", i.jitter_s);
  visit(element, "reorder", i.reorder);
  visit(element, "rate_bytes_per_s", i.rate_bytes_per_s);
  visit(element, "queue_s", i.queue_s);
  visit(element, "partitions", i.partitions);
  visit(element, "seed", i.seed);
}

template <class G, class Visitor>
void describe(VehicleConfig<G>& c, Visitor&& visit) {
  constexpr bool in_space = G::Dim == 3;
  VehicleParams<G>& v = c.vehicle;
  visit("vehicle", "id", v.id);
  visit("vehicle", "state_folder", v.state_folder);
  visit("vehicle", "journal", v.journal);
  visit("vehicle", "first_epoch", c.first_epoch);
  visit("vehicle", "output_folder", c.output_folder);
  visit("vehicle", "roster", v.submaps.limits.roster);
  visit("vehicle", "live_period_s", v.live_period_s);
  visit("vehicle", "step_period_s", v.step_period_s);
  visit("vehicle", "searches_per_step", v.searches_per_step);

  visit("dds", "domain", c.dds.domain);
  visit("dds", "profile", c.dds.profile_file);
  visit("dds", "participant_profile", c.dds.participant_profile);
  visit("dds", "interfaces", c.dds.interface_whitelist);
  visit("dds", "peers", c.dds.initial_peers);
  visit("dds", "discovery_servers", c.dds.discovery_servers);
  visit("dds", "max_queued_messages", c.dds.max_queued_messages);
  visit("dds", "security", c.dds.security_folder);

  describe("impairment", c.impairment.received, visit);
  describe("impairment_sent", c.impairment.sent, visit);

  RangeBearingEkfParams& f = c.front_end;
  visit("front_end", "sigma_along_per_sqrt_m", f.sigma_along_per_sqrt_m);
  visit("front_end", "sigma_along_per_sqrt_rad", f.sigma_along_per_sqrt_rad);
  visit("front_end", "sigma_across_per_sqrt_m", f.sigma_across_per_sqrt_m);
  visit("front_end", "sigma_heading_per_sqrt_m", f.sigma_heading_per_sqrt_m);
  visit("front_end", "sigma_heading_per_sqrt_rad", f.sigma_heading_per_sqrt_rad);
  visit("front_end", "sigma_heading_per_sqrt_s", f.sigma_heading_per_sqrt_s);
  if constexpr (in_space) {
    visit("front_end", "sigma_vertical_per_sqrt_m", f.sigma_vertical_per_sqrt_m);
    visit("front_end", "sigma_tilt_per_sqrt_m", f.sigma_tilt_per_sqrt_m);
    visit("front_end", "sigma_elevation_rad", f.sigma_elevation_rad);
  }
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
  visit("front_end", "max_remembered", f.max_remembered);
  visit("front_end", "nis_confidence", f.nis_confidence);
  visit("front_end", "nis_window", f.nis_window);
  visit("front_end", "segment_length_m", f.segment_length_m);
  visit("front_end", "min_batch", f.min_batch);
  visit("front_end", "max_segment_length_m", f.max_segment_length_m);
  visit("front_end", "trail_spacing_m", f.trail_spacing_m);

  DriftParams<G>& d = v.drift;
  visit("drift", "model", d.model);
  visit("drift", "gamma", d.gamma);
  visit("drift", "rate_x_m2_per_m", d.rate[0]);
  visit("drift", "rate_y_m2_per_m", d.rate[1]);
  if constexpr (in_space) {
    visit("drift", "rate_z_m2_per_m", d.rate[2]);
    visit("drift", "rate_roll_rad2_per_m", d.rate[3]);
    visit("drift", "rate_pitch_rad2_per_m", d.rate[4]);
    visit("drift", "tilt_sigma_rad", d.persistent.tilt_rad);
    visit("drift", "height_sigma_m", d.persistent.height_m);
    visit("drift", "correlation_m", d.persistent.correlation_m);
  }
  visit("drift", "rate_theta_rad2_per_m", d.rate[G::Dof - 1]);
  visit("drift", "landmark_inflation", d.landmark_inflation);
  visit("drift", "scale_sigma", d.persistent.scale);
  visit("drift", "heading_sigma_rad_per_m", d.persistent.heading_rad_per_m);

  AssociationParams& a = v.association;
  visit("association", "compatibility", a.constraints.compatibility);
  visit("association", "loop", a.constraints.loop);
  visit("association", "distance", a.constraints.distance);
  visit("association", "heading", a.constraints.heading);
  visit("association", "min_distance_m", a.constraints.min_distance_m);
  visit("association", "method", a.method);
  visit("association", "max_nodes", a.max_nodes);
  visit("association", "max_candidates", a.max_candidates);
  visit("association", "max_landmarks", a.max_landmarks);
  visit("association", "min_pairings", a.min_pairings);
  visit("association", "residual", a.residual);
  visit("association", "pairing", a.pairing);
  visit("association", "separation", a.separation);
  visit("association", "max_false_alarms", a.max_false_alarms);
  visit("association", "max_runner_up_share", a.max_runner_up_share);
  visit("association", "min_runner_up_false_alarms", a.min_runner_up_false_alarms);
  visit("association", "alignment_gate", a.alignment.gate);
  visit("association", "min_odds", a.alignment.min_odds);
  visit("association", "density_radius_m", a.alignment.density_radius_m);
  visit("association", "max_proposals", a.alignment.max_proposals);
  visit("association", "max_votes", a.alignment.max_votes);
  visit("association", "max_chance_places", a.max_chance_places);
  visit("association", "max_doubt", a.max_doubt);
  visit("association", "min_similarity", a.min_similarity);

  SubmapManagerParams& s = v.submaps;
  visit("map", "backend", s.backend);
  visit("map", "period_s", s.map_period_s);
  visit("map", "exact_share", s.exact_share);
  visit("map", "min_pairings", s.selection.min_pairings);
  visit("map", "residual", s.selection.residual);
  visit("map", "map_residual", s.selection.map_residual);
  visit("map", "max_runner_up_share", s.selection.max_runner_up_share);
  visit("map", "min_confirmed", s.selection.min_confirmed);
  visit("map", "scale_slack", s.selection.slack.scale);
  visit("map", "heading_slack_rad_per_m", s.selection.slack.heading_rad_per_m);
  visit("map", "fix_correlation_s", s.selection.fix_correlation_s);
  visit("map", "fix_residual", s.selection.fix_residual);
  visit("map", "common_frame_is_enu", s.selection.common_frame_is_enu);
  visit("map", "encounter_period_s", s.encounter_period_s);
  visit("map", "reference_vehicle", s.selection.reference);
  visit("map", "stale_peer_s", s.stale_peer_s);

  visit("repair", "digest_period_s", s.repair.digest_period_s);
  visit("repair", "digest_idle_s", s.repair.digest_idle_s);
  visit("repair", "max_chains", s.repair.max_chains);
  visit("repair", "grace_s", s.repair.grace_s);
  visit("repair", "backoff_min_s", s.repair.backoff_min_s);
  visit("repair", "backoff_max_s", s.repair.backoff_max_s);
  visit("repair", "relay_delay_s", s.repair.relay_delay_s);
  visit("repair", "max_ranges", s.repair.max_ranges);
  visit("repair", "asks_per_s", s.repair.asks_per_s);
  visit("repair", "answers_per_s", s.repair.answers_per_s);
  visit("repair", "resend_s", s.repair.resend_s);
  visit("repair", "batch_limit", s.repair.batch_limit);
  visit("repair", "requests_per_s", s.repair.requests_per_s);
  visit("repair", "max_answers", s.repair.max_answers);
  visit("repair", "lost_after_s", s.repair.lost_after_s);
  visit("repair", "seed", s.seed);

  visit("budget", "bytes_per_s", v.budget.bytes_per_s);
  visit("budget", "burst_s", v.budget.burst_s);
  visit("budget", "batch_limit", v.budget.batch_limit);
  visit("budget", "max_waiting", v.budget.max_waiting);

  visit("peers", "messages_per_s", s.peers.messages_per_s);
  visit("peers", "burst", s.peers.burst);
  visit("peers", "quarantine_s", s.peers.quarantine_s);
  visit("peers", "max_peers", s.peers.max_peers);
  visit("peers", "forget_after_s", s.peers.forget_after_s);
  visit("peers", "max_chains_per_vehicle", s.limits.max_chains_per_vehicle);
  visit("peers", "max_facts_per_vehicle", s.limits.max_facts_per_vehicle);
  visit("peers", "rival_s", s.rival_s);

  visit("watchdog", "deaf_s", v.watchdog.deaf_s);
  visit("watchdog", "mute_s", v.watchdog.mute_s);
  visit("watchdog", "lonely_s", v.watchdog.lonely_s);
  visit("watchdog", "pause_s", v.watchdog.pause_s);
  visit("watchdog", "max_pause_s", v.watchdog.max_pause_s);

  visit("sensors", "file", c.sensors.file);
  visit("sensors", "rate", c.sensors.rate);
  visit("sensors", "start_unix_s", c.sensors.start_unix_s);
  visit("vehicle", "mark_x_m", v.mark[0]);
  visit("vehicle", "mark_y_m", v.mark[1]);
  visit("sensors", "encounters", c.sensors.encounters);
  visit("sensors", "fix_lever_x_m", c.sensors.fix_lever[0]);
  visit("sensors", "fix_lever_y_m", c.sensors.fix_lever[1]);
  if constexpr (in_space) {
    visit("vehicle", "mark_z_m", v.mark[2]);
    visit("sensors", "fix_lever_z_m", c.sensors.fix_lever[2]);
  }
}

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
