#include "scenario/scenario.hpp"

#include <algorithm>
#include <cmath>
#include <convoy/config_error.hpp>
#include <nlohmann/json.hpp>

#include "scenario/json_fault.hpp"
#include "scenario/pose_columns.hpp"
#include "scenario/table_file.hpp"

namespace convoy::cli {
namespace fs = std::filesystem;
namespace {

template <class G>
constexpr std::string_view truth_header = G::Dim == 2 ? "t_s,x_m,y_m,theta_rad" : "t_s,x_m,y_m,z_m,qw,qx,qy,qz";
template <class G>
constexpr std::string_view landmarks_header = G::Dim == 2 ? "id,x_m,y_m" : "id,x_m,y_m,z_m";

template <class G>
nlohmann::json prior_to_json(const StaticPrior<G>& prior) {
  return {{"mean", pose_list(prior.mean)}, {"sigma", list_of(prior.sigma)}};
}

template <class G>
StaticPrior<G> prior_from_json(const nlohmann::json& json) {
  return {pose_from_list<G>(json.at("mean")), vector_from<typename G::Tangent>(json.at("sigma"))};
}

template <class G>
VehicleLog<G> read_vehicle(const fs::path& run_folder, const nlohmann::json& json) {
  VehicleLog<G> vehicle;
  vehicle.id = json.at("id");
  vehicle.dropped_unknown_sightings = json.at("dropped_unknown_sightings");
  if (json.contains("prior")) vehicle.prior = prior_from_json<G>(json.at("prior"));
  vehicle.sensors = read_sensors<G>(vehicle_folder(run_folder, vehicle.id) / "sensors.csv");
  if (json.at("has_truth")) vehicle.truth = read_truth<G>(truth_file(run_folder, vehicle.id));
  return vehicle;
}

// The numbers of a row behind its kind; a field that the kind does not use is empty.
template <class G>
std::string row_of(const SensorEvent& event) {
  std::string row;
  const auto append = [&row](auto... numbers) {
    append_csv_row(row, numbers...);
    row.pop_back();
  };
  switch (event.kind) {
    case SensorEvent::Kind::odometry:
      append(event.v_m_s, event.omega_rad_s);
      return ",odometry," + row + (G::Dim == 2 ? ",\n" : ",,\n");
    case SensorEvent::Kind::fix:
      if constexpr (G::Dim == 2) append(event.east_m, event.north_m, event.sigma_m);
      else append(event.east_m, event.north_m, event.up_m, event.sigma_m);
      return ",fix," + row + "\n";
    case SensorEvent::Kind::sighting:
    case SensorEvent::Kind::encounter: break;
  }
  if constexpr (G::Dim == 2) append(event.track, event.range_m, event.bearing_rad);
  else append(event.track, event.range_m, event.bearing_rad, event.elevation_rad);
  return (event.kind == SensorEvent::Kind::encounter ? ",encounter," : ",sighting,") + row + "\n";
}

// Of a sighting or an encounter.
template <class G>
double elevation_in(const TableFile& table) {
  if constexpr (G::Dim == 2) return 0.0;
  const double elevation_rad = table.number(5);
  if (std::abs(elevation_rad) > 0.5 * M_PI) table.refuse("an elevation lies within +-pi/2; the unit is rad");
  return elevation_rad;
}

template <class G>
SensorEvent event_in(const TableFile& table) {
  const double t_s = table.number(0);
  const std::string_view kind = table.text(1);
  if (kind == "odometry") {
    if (!table.text(4).empty()) table.refuse("an odometry row has no fifth field; leave it empty");
    if (G::Dim == 3 && !table.text(5).empty()) table.refuse("an odometry row has no sixth field; leave it empty");
    return SensorEvent::odometry(t_s, table.number(2), table.number(3));
  }
  if (kind == "fix") {
    constexpr std::size_t last = 2 + G::Dim;
    const SensorEvent event = SensorEvent::fix(t_s, table.number(2), table.number(3), table.number(last),
                                               G::Dim == 2 ? 0.0 : table.number(4));
    if (event.sigma_m <= 0.0) table.refuse("the sigma of a fix must be above 0");
    return event;
  }
  if (kind != "sighting" && kind != "encounter")
    table.refuse("the kind is '" + std::string(kind) + "'; it must be odometry, sighting, fix or encounter");
  SensorEvent event =
      SensorEvent::sighting(t_s, table.small_number(2), table.number(3), table.number(4), elevation_in<G>(table));
  if (event.range_m <= 0.0)
    table.refuse(kind == "sighting" ? "the range of a sighting must be above 0"
                                    : "the range of an encounter must be above 0");
  if (kind == "sighting") return event;
  if (event.track == 0) table.refuse("vehicle ids are 1 or more");
  event.kind = SensorEvent::Kind::encounter;
  return event;
}

}  // namespace

fs::path vehicle_folder(const fs::path& run_folder, VehicleId id) {
  return run_folder / ("vehicle_" + std::to_string(id));
}

fs::path truth_file(const fs::path& run_folder, VehicleId id) {
  return run_folder / "truth" / ("vehicle_" + std::to_string(id) + ".csv");
}

template <class G>
void write_sensors(const fs::path& file, const std::vector<SensorEvent>& sensors) {
  std::string text(sensors_header<G>);
  text += '\n';
  for (const SensorEvent& event : sensors) {
    append_number(text, event.t_s);
    text += row_of<G>(event);
  }
  write_text_file(file, text);
}

template <class G>
std::vector<SensorEvent> read_sensors(const fs::path& file) {
  std::vector<SensorEvent> sensors;
  for (TableFile table(file, {.header = sensors_header<G>}); table.next();) {
    const double t_s = table.number(0);
    if (!sensors.empty() && t_s < sensors.back().t_s) table.refuse("time runs backwards; sort the rows by t_s");
    sensors.push_back(event_in<G>(table));
  }
  return sensors;
}

template <class G>
void write_truth(const fs::path& file, const std::vector<TruthPose<G>>& truth) {
  std::string text(truth_header<G>);
  text += '\n';
  for (const TruthPose<G>& pose : truth) {
    append_number(text, pose.t_s);
    append_pose(text, pose.T_world_body);
    text += '\n';
  }
  write_text_file(file, text);
}

template <class G>
std::vector<TruthPose<G>> read_truth(const fs::path& file) {
  std::vector<TruthPose<G>> truth;
  for (TableFile table(file, {.header = truth_header<G>}); table.next();) {
    truth.push_back({table.number(0), read_pose<G>(table, 1)});
    if (truth.size() > 1 && truth.back().t_s < truth[truth.size() - 2].t_s)
      table.refuse("time runs backwards; sort the rows by t_s");
  }
  return truth;
}

template <class G>
void write_landmarks(const fs::path& file, const std::vector<TruthLandmark<G>>& landmarks) {
  std::string text(landmarks_header<G>);
  text += '\n';
  for (const TruthLandmark<G>& l : landmarks) {
    append_number(text, std::uint64_t{l.id});
    for (const double x : l.p_world_m) {
      text += ',';
      append_number(text, x);
    }
    text += '\n';
  }
  write_text_file(file, text);
}

template <class G>
std::vector<TruthLandmark<G>> read_landmarks(const fs::path& file) {
  std::vector<TruthLandmark<G>> landmarks;
  for (TableFile table(file, {.header = landmarks_header<G>}); table.next();) {
    TruthLandmark<G> landmark;
    landmark.id = table.small_number(0);
    for (int c = 0; c < G::Dim; ++c) landmark.p_world_m[c] = table.number(1 + static_cast<std::size_t>(c));
    landmarks.push_back(landmark);
  }
  return landmarks;
}

int dimension_in(const fs::path& file, const nlohmann::json& json) {
  const nlohmann::json dimension = json.value("dimension", nlohmann::json(2));
  if (dimension != 2 && dimension != 3)
    throw ConfigError(file.string() + ": 'dimension' is " + dimension.dump() +
                      "; a fleet is of dimension 2 or 3, correct it");
  return dimension;
}

nlohmann::json tolerance_to_json(const PoseTolerance& tolerance) {
  return {{"position_m", tolerance.position_m}, {"heading_rad", tolerance.heading_rad}};
}

std::optional<PoseTolerance> pose_tolerance_in(const nlohmann::json& json) {
  if (!json.contains("pose_tolerance")) return std::nullopt;
  const nlohmann::json& tolerance = json.at("pose_tolerance");
  return PoseTolerance{tolerance.at("position_m"), tolerance.at("heading_rad")};
}

template <class G>
void Scenario<G>::write(const fs::path& run_folder) const {
  nlohmann::json json = {{"name", name},
                         {"source", source},
                         {"seed", seed},
                         {"dimension", G::Dim},
                         {"duration_s", duration_s},
                         {"common_frame_vehicle", common_frame_vehicle},
                         {"vehicles", nlohmann::json::array()}};
  if (pose_tolerance) json["pose_tolerance"] = tolerance_to_json(*pose_tolerance);
  for (const VehicleLog<G>& vehicle : vehicles) {
    nlohmann::json entry = {{"id", vehicle.id},
                            {"has_truth", !vehicle.truth.empty()},
                            {"dropped_unknown_sightings", vehicle.dropped_unknown_sightings}};
    if (vehicle.prior) entry["prior"] = prior_to_json(*vehicle.prior);
    json["vehicles"].push_back(std::move(entry));
    write_sensors<G>(vehicle_folder(run_folder, vehicle.id) / "sensors.csv", vehicle.sensors);
    if (!vehicle.truth.empty()) write_truth(truth_file(run_folder, vehicle.id), vehicle.truth);
  }
  write_landmarks(run_folder / "truth" / "landmarks.csv", landmarks);
  write_text_file(run_folder / "scenario.json", json.dump(2) + "\n");
}

template <class G>
Scenario<G> Scenario<G>::read(const fs::path& run_folder) {
  const fs::path file = run_folder / "scenario.json";
  const std::string text = read_text_file(file);
  try {
    const auto json = nlohmann::json::parse(text);
    if (dimension_in(file, json) != G::Dim)
      throw ConfigError(file.string() + ": this scenario is of the other dimension, and of " + std::to_string(G::Dim) +
                        " one is read here");
    Scenario scenario;
    scenario.name = json.at("name");
    scenario.source = json.at("source");
    scenario.seed = json.at("seed");
    scenario.duration_s = json.at("duration_s");
    scenario.common_frame_vehicle = json.at("common_frame_vehicle");
    scenario.pose_tolerance = pose_tolerance_in(json);
    for (const auto& entry : json.at("vehicles")) scenario.vehicles.push_back(read_vehicle<G>(run_folder, entry));
    scenario.landmarks = read_landmarks<G>(run_folder / "truth" / "landmarks.csv");
    return scenario;
  } catch (const nlohmann::json::exception& error) {
    throw ConfigError(file.string() + ": not a scenario: " + json_fault(error, text) + "; write the run folder again");
  }
}

template <class G>
const VehicleLog<G>* Scenario<G>::find(VehicleId id) const {
  const auto it = std::find_if(vehicles.begin(), vehicles.end(), [id](const auto& v) { return v.id == id; });
  return it == vehicles.end() ? nullptr : &*it;
}

#define CONVOY_INSTANTIATE(G)                                                       \
  template struct Scenario<G>;                                                      \
  template std::vector<SensorEvent> read_sensors<G>(const fs::path&);               \
  template void write_sensors<G>(const fs::path&, const std::vector<SensorEvent>&); \
  template std::vector<TruthPose<G>> read_truth(const fs::path&);                   \
  template void write_truth(const fs::path&, const std::vector<TruthPose<G>>&);     \
  template std::vector<TruthLandmark<G>> read_landmarks(const fs::path&);           \
  template void write_landmarks(const fs::path&, const std::vector<TruthLandmark<G>>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
