#include "evaluate/run_folder.hpp"

#include <algorithm>
#include <convoy/config_error.hpp>
#include <set>

#include "scenario/json_fault.hpp"
#include "scenario/table_file.hpp"

namespace convoy::cli {
namespace fs = std::filesystem;
using nlohmann::json;
namespace {

template <class G>
constexpr std::size_t estimate_columns = coordinate_count<G> + covariance_count<G>;

/// Pose and covariance in the columns from `first`: all there or all empty.
template <class G>
std::optional<PoseEstimate<G>> read_estimate(const TableFile& table, std::size_t first) {
  constexpr std::size_t coordinates = coordinate_count<G>, columns = estimate_columns<G>;
  std::size_t empty = 0;
  for (std::size_t i = first; i < first + columns; ++i) empty += table.text(i).empty();
  if (empty == columns) return std::nullopt;
  if (empty != 0) table.refuse("a pose and its covariance must be given in full or left empty in full");
  return PoseEstimate<G>{read_pose<G>(table, first), symmetric_from<typename G::Covariance>([&](std::size_t i) {
                           return table.number(first + coordinates + i);
                         })};
}

/// A vehicle that lived to its end has written at least one row.
void expect_rows(const TableFile& table, std::size_t rows, bool may_be_cut) {
  if (rows == 0 && !may_be_cut)
    table.refuse("no row below the header; the file was emptied, the run has to be repeated");
}

template <class G>
std::vector<PoseRow<G>> read_live(const fs::path& file, bool may_be_cut, const std::set<VehicleId>& fleet) {
  std::vector<PoseRow<G>> rows;
  TableFile table(file, {.header = live_header<G>, .drop_cut_last_line = may_be_cut});
  while (table.next()) {
    rows.push_back({table.number(0), table.small_number(1), table.optional_number(2).value_or(0.0),
                    read_estimate<G>(table, 3), read_estimate<G>(table, 3 + estimate_columns<G>)});
    if (fleet.count(rows.back().vehicle) == 0)
      table.refuse("vehicle " + std::to_string(rows.back().vehicle) +
                   " is not among those of run.json; correct either file");
  }
  expect_rows(table, rows.size(), may_be_cut);
  return rows;
}

template <class G>
std::vector<PoseRow<G>> read_trajectory(const fs::path& file, VehicleId id, bool may_be_cut) {
  std::vector<PoseRow<G>> rows;
  TableFile table(file, {.header = trajectory_header<G>, .drop_cut_last_line = may_be_cut});
  while (table.next())
    rows.push_back({table.number(0), id, table.number(1), read_estimate<G>(table, 2),
                    read_estimate<G>(table, 2 + estimate_columns<G>)});
  expect_rows(table, rows.size(), may_be_cut);
  return rows;
}

std::vector<TrafficRow> read_traffic(const fs::path& file, bool may_be_cut) {
  std::vector<TrafficRow> rows;
  TableFile table(file, {.header = traffic_header, .drop_cut_last_line = may_be_cut});
  while (table.next()) {
    rows.push_back({table.number(0), table.number(1)});
    if (rows.size() > 1 && rows.back().t_s < rows[rows.size() - 2].t_s)
      table.refuse("time runs backwards; the run has to be repeated");
  }
  expect_rows(table, rows.size(), may_be_cut);
  return rows;
}

template <class G>
void read_labels(const fs::path& file, bool may_be_cut, VehicleRecord<G>& vehicle) {
  TableFile table(file, {.header = labels_header, .drop_cut_last_line = may_be_cut});
  while (table.next())
    vehicle.track_of_landmark[{table.whole_number(1), table.small_number(0)}] = table.small_number(2);
  vehicle.has_labels = true;
}

template <class G>
void read_tracks(const fs::path& file, VehicleRecord<G>& vehicle) {
  TableFile table(file, {.header = tracks_header});
  while (table.next())
    vehicle.place_of_track[table.small_number(0)] = {table.number(1), table.number(2), table.number(3)};
}

/// The list of this name, by `read`; empty if it is not there or null.
template <class Read>
auto if_given(const json& object, const char* name, const Read& read) -> std::optional<decltype(read(object))> {
  const auto it = object.find(name);
  if (it == object.end() || it->is_null()) return std::nullopt;
  return read(*it);
}

Key key_from(const json& object) { return {{object.at("vehicle"), object.at("epoch")}, object.at("index")}; }

template <class G>
MapAnchor<G> anchor_from(const json& object) {
  using Covariance = typename G::Covariance;
  const auto covariance = [&](const char* name) {
    return if_given(object, name, upper_from<Covariance>).value_or(Covariance::Zero());
  };
  MapAnchor<G> anchor;
  anchor.key = key_from(object);
  anchor.stamp_s = object.at("stamp_s");
  if (const auto pose = if_given(object, "pose", pose_from_list<G>))
    anchor.common = PoseEstimate<G>{*pose, covariance("cov")};
  anchor.T_slam_body = if_given(object, "slam", pose_from_list<G>);
  anchor.drift = covariance("drift");
  return anchor;
}

template <class G>
MapLandmark<G> landmark_from(const json& object) {
  MapLandmark<G> landmark;
  landmark.key = key_from(object);
  landmark.anchor = object.value("anchor", std::uint32_t{0});
  typename G::Point p;
  bool known = true;
  for (int c = 0; c < G::Dim; ++c) {
    const json value = object.value(std::string(1, "xyz"[c]), json());
    known = known && value.is_number();
    if (known) p[c] = value;
  }
  if (known) landmark.p_common_m = p;
  landmark.landmark_class = object.value("class", std::int64_t{-1});
  return landmark;
}

MapAssociation association_from(const json& object) {
  MapAssociation association;
  association.author = object.at("author");
  association.t_s = object.at("t_s");
  association.accepted = object.at("accepted");
  for (const json& p : object.at("pairings")) {
    const Key one{{p.at(0), p.at(1)}, p.at(2)}, other{{p.at(3), p.at(4)}, p.at(5)};
    association.pairings.push_back({std::min(one, other), std::max(one, other)});
  }
  return association;
}

template <class G>
MapRecord<G> map_from(const json& object) {
  MapRecord<G> map;
  map.map_digest = object.at("map_digest");
  for (const json& c : object.at("chains")) map.chains.push_back({{c.at("vehicle"), c.at("epoch")}, c.at("aligned")});
  for (const json& a : object.at("anchors")) map.anchors.push_back(anchor_from<G>(a));
  for (const json& l : object.at("landmarks")) map.landmarks.push_back(landmark_from<G>(l));
  for (const json& a : object.at("associations")) map.associations.push_back(association_from(a));
  return map;
}

/// `use` on the parsed file; every fault of the text is a ConfigError that names the file.
template <class Use>
void with_json(const fs::path& file, const Use& use) {
  const std::string text = read_text_file(file);
  try {
    use(json::parse(text));
  } catch (const json::exception& error) {
    throw ConfigError(file.string() + ": not what it should be: " + json_fault(error, text) +
                      "; the run has to be repeated");
  }
}

/// What the judge takes from summary.json must be of its kind. Throws ConfigError.
void check_summary(const fs::path& file, const json& summary, VehicleId id) {
  const auto refuse = [&file](const std::string& what) {
    throw ConfigError(file.string() + ": " + what + "; the run has to be repeated");
  };
  if (!summary.is_object()) refuse("not an object");
  for (const char* key : {"map_digest", "integrity"})
    if (!summary.contains(key) || !summary.at(key).is_string())
      refuse(std::string("'") + key + "' is not there or no text");
  for (const char* key : {"landmarks_exported", "landmarks_known", "facts_missing", "bytes_sent", "requests_sent"})
    if (!summary.contains(key) || !summary.at(key).is_number() || summary.at(key).get<double>() < 0.0)
      refuse(std::string("'") + key + "' is not there or no number from 0");
  // Older runs have none.
  if (summary.contains("facts_lost") && !(summary.at("facts_lost").is_number() && summary.at("facts_lost") >= 0))
    refuse("'facts_lost' is no number from 0");
  if (summary.contains("vehicle") && summary.at("vehicle") != json(id)) refuse("it is that of another vehicle");
}

template <class G>
void read_vehicle_files(const fs::path& folder, const std::set<VehicleId>& fleet, VehicleRecord<G>& vehicle) {
  const auto if_there = [&folder](const char* name, const auto& use) {
    if (fs::exists(folder / name)) use(folder / name);
  };
  const bool may_be_cut = vehicle.lost;
  if_there("live.csv", [&](const fs::path& file) { vehicle.live = read_live<G>(file, may_be_cut, fleet); });
  if_there("trajectory.csv",
           [&](const fs::path& file) { vehicle.trajectory = read_trajectory<G>(file, vehicle.id, may_be_cut); });
  if_there("traffic.csv", [&](const fs::path& file) { vehicle.traffic = read_traffic(file, may_be_cut); });
  if_there("labels.csv", [&](const fs::path& file) { read_labels(file, may_be_cut, vehicle); });
  if_there("front_end.csv", [&](const fs::path& file) { vehicle.front_end = read_front_end(file, may_be_cut); });
  if_there("map.json", [&](const fs::path& file) {
    with_json(file, [&](const json& object) { vehicle.map = map_from<G>(object); });
  });
  if_there("summary.json", [&](const fs::path& file) {
    with_json(file, [&](const json& object) { vehicle.summary = object; });
    check_summary(file, vehicle.summary, vehicle.id);
  });
}

/// The ids in a list of run.json, each from 1 and there once. Throws ConfigError.
std::set<VehicleId> ids_of(const fs::path& file, const char* name, const json& list) {
  const auto refuse = [&](const std::string& what) {
    throw ConfigError(file.string() + ": '" + name + "' " + what + "; write it again, or repeat the run");
  };
  if (!list.is_array()) refuse("is no list of ids");
  std::set<VehicleId> ids;
  for (const json& entry : list) {
    if (!entry.is_number_unsigned() || entry.get<std::uint64_t>() == 0 || entry.get<std::uint64_t>() > UINT32_MAX)
      refuse("holds " + entry.dump() + ", and an id is a whole number from 1 to 4294967295");
    if (!ids.insert(entry.get<VehicleId>()).second) refuse("names vehicle " + entry.dump() + " twice");
  }
  return ids;
}

template <class G>
std::set<VehicleId> read_run_info(const fs::path& file, RunRecord<G>& run) {
  const auto refuse = [&file](const std::string& what) { throw ConfigError(file.string() + ": " + what); };
  std::set<VehicleId> fleet;
  with_json(file, [&](const json& info) {
    if (dimension_in(file, info) != G::Dim)
      refuse("this run is of the other dimension, and of " + std::to_string(G::Dim) + " one is read here");
    run.info = info;
    run.scenario = info.at("scenario");
    fleet = ids_of(file, "vehicles", info.at("vehicles"));
    if (fleet.empty()) refuse("'vehicles' names none, so that there is nothing to judge; repeat the run");
    const auto lost = ids_of(file, "lost_vehicles", info.value("lost_vehicles", json::array()));
    if (!std::includes(fleet.begin(), fleet.end(), lost.begin(), lost.end()))
      refuse("'lost_vehicles' names a vehicle that is not among 'vehicles'; correct either list");
    run.common_frame_vehicle =
        *ids_of(file, "common_frame_vehicle", json::array({info.at("common_frame_vehicle")})).begin();
    if (fleet.count(run.common_frame_vehicle) == 0)
      refuse("'common_frame_vehicle' is not among 'vehicles'; correct either");
    for (const VehicleId id : fleet) {
      run.vehicles.emplace_back();
      run.vehicles.back().id = id;
      run.vehicles.back().lost = lost.count(id) != 0;
    }
  });
  return fleet;
}

/// What of scenario.json the judge needs, if it is there.
template <class G>
void read_scenario(const fs::path& file, RunRecord<G>& run) {
  if (!fs::exists(file)) return;
  with_json(file, [&](const json& object) {
    run.pose_tolerance = pose_tolerance_in(object);
    for (const json& vehicle : object.at("vehicles"))
      for (VehicleRecord<G>& record : run.vehicles)
        if (vehicle.at("id") == json(record.id) && vehicle.contains("prior"))
          record.prior = {pose_from_list<G>(vehicle.at("prior").at("mean")),
                          vector_from<typename G::Tangent>(vehicle.at("prior").at("sigma"))};
  });
}

/// Time of the first row of sensors.csv, without reading the rest.
template <class G>
std::optional<double> first_event(const fs::path& file) {
  if (!fs::exists(file)) return std::nullopt;
  TableFile table(file, {.header = sensors_header<G>});
  if (!table.next()) return std::nullopt;
  return table.number(0);
}

}  // namespace

template <class G>
const VehicleRecord<G>* RunRecord<G>::find(VehicleId id) const {
  const auto it = std::find_if(vehicles.begin(), vehicles.end(), [id](const auto& v) { return v.id == id; });
  return it == vehicles.end() ? nullptr : &*it;
}

template <class G>
const VehicleRecord<G>* RunRecord<G>::first_survivor() const {
  const auto it = std::find_if(vehicles.begin(), vehicles.end(), [](const auto& v) { return !v.lost && v.map; });
  return it == vehicles.end() ? nullptr : &*it;
}

template <class G>
void expect_survivors(const RunRecord<G>& run) {
  for (const VehicleRecord<G>& vehicle : run.vehicles) {
    if (vehicle.lost) continue;
    for (const char* name : {"live.csv", "trajectory.csv", "traffic.csv", "labels.csv", "map.json", "summary.json"})
      if (const fs::path file = vehicle_folder(run.folder, vehicle.id) / name; !fs::exists(file))
        throw ConfigError(file.string() + ": no such file, though vehicle " + std::to_string(vehicle.id) +
                          " lived to the end by run.json; put the folder back as it was, or repeat the run");
  }
}

template <class G>
RunRecord<G> read_run(const fs::path& folder) {
  RunRecord<G> run;
  run.folder = folder;
  const std::set<VehicleId> fleet = read_run_info(folder / "run.json", run);
  read_scenario(folder / "scenario.json", run);
  for (VehicleRecord<G>& vehicle : run.vehicles) {
    const fs::path own = vehicle_folder(folder, vehicle.id);
    read_vehicle_files(own, fleet, vehicle);
    if (const auto t_s = first_event<G>(own / "sensors.csv")) run.first_event_s[vehicle.id] = *t_s;
    if (fs::exists(tracks_file(folder, vehicle.id))) read_tracks(tracks_file(folder, vehicle.id), vehicle);
    if (fs::exists(truth_file(folder, vehicle.id))) vehicle.truth = read_truth<G>(truth_file(folder, vehicle.id));
    // A camera has no log of its readings. Its vehicle stands still when they begin.
    if (!vehicle.place_of_track.empty() && !vehicle.truth.empty())
      run.first_event_s.emplace(vehicle.id, vehicle.truth.front().t_s);
  }
  if (fs::exists(folder / "truth" / "landmarks.csv"))
    run.landmarks = read_landmarks<G>(folder / "truth" / "landmarks.csv");
  return run;
}

fs::path tracks_file(const fs::path& run_folder, VehicleId id) {
  return run_folder / "truth" / ("tracks_" + std::to_string(id) + ".csv");
}

int run_dimension(const fs::path& folder) {
  int dimension = 2;
  with_json(folder / "run.json", [&](const json& info) { dimension = dimension_in(folder / "run.json", info); });
  return dimension;
}

#define CONVOY_INSTANTIATE(G)                      \
  template struct RunRecord<G>;                    \
  template RunRecord<G> read_run(const fs::path&); \
  template void expect_survivors(const RunRecord<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
