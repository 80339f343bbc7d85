#include "scenario/scenario.hpp"

#include <algorithm>
#include <convoy/config_error.hpp>
#include <nlohmann/json.hpp>

#include "scenario/json_fault.hpp"
#include "scenario/table_file.hpp"

namespace convoy::cli {
namespace fs = std::filesystem;
namespace {

constexpr std::string_view sensors_header = "t_s,kind,a,b,c";
constexpr std::string_view truth_header = "t_s,x_m,y_m,theta_rad";
constexpr std::string_view landmarks_header = "id,x_m,y_m";

nlohmann::json prior_to_json(const StaticPrior& prior) {
  return {{"mean", {prior.mean.translation().x(), prior.mean.translation().y(), prior.mean.theta()}},
          {"sigma", {prior.sigma_x_m, prior.sigma_y_m, prior.sigma_theta_rad}}};
}

StaticPrior prior_from_json(const nlohmann::json& json) {
  const auto& mean = json.at("mean");
  const auto& sigma = json.at("sigma");
  return {SE2(mean.at(0), mean.at(1), mean.at(2)), sigma.at(0), sigma.at(1), sigma.at(2)};
}

VehicleLog read_vehicle(const fs::path& run_folder, const nlohmann::json& json) {
  VehicleLog vehicle;
  vehicle.id = json.at("id");
  vehicle.dropped_unknown_sightings = json.at("dropped_unknown_sightings");
  if (json.contains("prior")) vehicle.prior = prior_from_json(json.at("prior"));
  vehicle.sensors = read_sensors(vehicle_folder(run_folder, vehicle.id) / "sensors.csv");
  if (json.at("has_truth")) vehicle.truth = read_truth(truth_file(run_folder, vehicle.id));
  return vehicle;
}

}  // namespace

fs::path vehicle_folder(const fs::path& run_folder, VehicleId id) {
  return run_folder / ("vehicle_" + std::to_string(id));
}

fs::path truth_file(const fs::path& run_folder, VehicleId id) {
  return run_folder / "truth" / ("vehicle_" + std::to_string(id) + ".csv");
}

void write_sensors(const fs::path& file, const std::vector<SensorEvent>& sensors) {
  std::string text(sensors_header);
  text += '\n';
  for (const SensorEvent& event : sensors) {
    append_number(text, event.t_s);
    if (event.kind == SensorEvent::Kind::odometry) {
      text += ",odometry,";
      append_number(text, event.v_m_s);
      text += ',';
      append_number(text, event.omega_rad_s);
      text += ",\n";
    } else if (event.kind == SensorEvent::Kind::fix) {
      text += ",fix,";
      append_csv_row(text, event.east_m, event.north_m, event.sigma_m);
    } else {
      text += event.kind == SensorEvent::Kind::encounter ? ",encounter," : ",sighting,";
      append_csv_row(text, event.track, event.range_m, event.bearing_rad);
    }
  }
  write_text_file(file, text);
}

std::vector<SensorEvent> read_sensors(const fs::path& file) {
  std::vector<SensorEvent> sensors;
  for (TableFile table(file, {.header = sensors_header}); table.next();) {
    const double t_s = table.number(0);
    if (!sensors.empty() && t_s < sensors.back().t_s) table.refuse("time runs backwards; sort the rows by t_s");
    if (table.text(1) == "odometry") {
      if (!table.text(4).empty()) table.refuse("an odometry row has no fifth field; leave it empty");
      sensors.push_back(SensorEvent::odometry(t_s, table.number(2), table.number(3)));
    } else if (table.text(1) == "sighting") {
      sensors.push_back(SensorEvent::sighting(t_s, table.small_number(2), table.number(3), table.number(4)));
      if (sensors.back().range_m <= 0.0) table.refuse("the range of a sighting must be above 0");
    } else if (table.text(1) == "fix") {
      sensors.push_back(SensorEvent::fix(t_s, table.number(2), table.number(3), table.number(4)));
      if (sensors.back().sigma_m <= 0.0) table.refuse("the sigma of a fix must be above 0");
    } else if (table.text(1) == "encounter") {
      sensors.push_back(SensorEvent::encounter(t_s, table.small_number(2), table.number(3), table.number(4)));
      if (sensors.back().range_m <= 0.0) table.refuse("the range of an encounter must be above 0");
      if (sensors.back().track == 0) table.refuse("vehicle ids are 1 or more");
    } else {
      table.refuse("the kind is '" + std::string(table.text(1)) + "'; it must be odometry, sighting, fix or encounter");
    }
  }
  return sensors;
}

void write_truth(const fs::path& file, const std::vector<TruthPose>& truth) {
  std::string text(truth_header);
  text += '\n';
  for (const TruthPose& pose : truth) {
    const auto& T = pose.T_world_body;
    append_csv_row(text, pose.t_s, T.translation().x(), T.translation().y(), T.theta());
  }
  write_text_file(file, text);
}

std::vector<TruthPose> read_truth(const fs::path& file) {
  std::vector<TruthPose> truth;
  for (TableFile table(file, {.header = truth_header}); table.next();) {
    truth.push_back({table.number(0), SE2(table.number(1), table.number(2), table.number(3))});
    if (truth.size() > 1 && truth.back().t_s < truth[truth.size() - 2].t_s)
      table.refuse("time runs backwards; sort the rows by t_s");
  }
  return truth;
}

void write_landmarks(const fs::path& file, const std::vector<TruthLandmark>& landmarks) {
  std::string text(landmarks_header);
  text += '\n';
  for (const TruthLandmark& l : landmarks) append_csv_row(text, l.id, l.p_world_m.x(), l.p_world_m.y());
  write_text_file(file, text);
}

std::vector<TruthLandmark> read_landmarks(const fs::path& file) {
  std::vector<TruthLandmark> landmarks;
  for (TableFile table(file, {.header = landmarks_header}); table.next();)
    landmarks.push_back({table.small_number(0), {table.number(1), table.number(2)}});
  return landmarks;
}

void Scenario::write(const fs::path& run_folder) const {
  nlohmann::json json = {{"name", name},
                         {"source", source},
                         {"seed", seed},
                         {"duration_s", duration_s},
                         {"common_frame_vehicle", common_frame_vehicle},
                         {"vehicles", nlohmann::json::array()}};
  for (const VehicleLog& vehicle : vehicles) {
    nlohmann::json entry = {{"id", vehicle.id},
                            {"has_truth", !vehicle.truth.empty()},
                            {"dropped_unknown_sightings", vehicle.dropped_unknown_sightings}};
    if (vehicle.prior) entry["prior"] = prior_to_json(*vehicle.prior);
    json["vehicles"].push_back(std::move(entry));
    write_sensors(vehicle_folder(run_folder, vehicle.id) / "sensors.csv", vehicle.sensors);
    if (!vehicle.truth.empty()) write_truth(truth_file(run_folder, vehicle.id), vehicle.truth);
  }
  write_landmarks(run_folder / "truth" / "landmarks.csv", landmarks);
  write_text_file(run_folder / "scenario.json", json.dump(2) + "\n");
}

Scenario Scenario::read(const fs::path& run_folder) {
  const fs::path file = run_folder / "scenario.json";
  const std::string text = read_text_file(file);
  try {
    const auto json = nlohmann::json::parse(text);
    Scenario scenario;
    scenario.name = json.at("name");
    scenario.source = json.at("source");
    scenario.seed = json.at("seed");
    scenario.duration_s = json.at("duration_s");
    scenario.common_frame_vehicle = json.at("common_frame_vehicle");
    for (const auto& entry : json.at("vehicles")) scenario.vehicles.push_back(read_vehicle(run_folder, entry));
    scenario.landmarks = read_landmarks(run_folder / "truth" / "landmarks.csv");
    return scenario;
  } catch (const nlohmann::json::exception& error) {
    throw ConfigError(file.string() + ": not a scenario: " + json_fault(error, text) + "; write the run folder again");
  }
}

const VehicleLog* Scenario::find(VehicleId id) const {
  const auto it = std::find_if(vehicles.begin(), vehicles.end(), [id](const auto& v) { return v.id == id; });
  return it == vehicles.end() ? nullptr : &*it;
}

}  // namespace convoy::cli
