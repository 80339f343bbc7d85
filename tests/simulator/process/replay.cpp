#include "camera_file.hpp"
#include "digest.hpp"
#include "recording.hpp"
#include "sim_error.hpp"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <fstream>
#include <limits>
#include <map>

namespace convoy::simulator {
namespace {

constexpr std::int64_t largest = std::numeric_limits<std::uint32_t>::max();

struct Note {
  RunNote run;
  std::vector<std::uint32_t> vehicles;
};

Note read_note(const std::filesystem::path& file) {
  std::ifstream in(file);
  if (!in) throw SetUpError(file.string() + " cannot be read; is the folder a recording of convoy sim?");
  Note note;
  try {
    const nlohmann::json json = nlohmann::json::parse(in);
    if (json.at("format") != 1) throw SetUpError(file.string() + ": this is of another version of convoy sim");
    note.run.attribution = json.at("attribution");
    note.run.step_s = json.at("step_s");
    note.vehicles = json.at("vehicles").get<std::vector<std::uint32_t>>();
  } catch (const nlohmann::json::exception& error) {  // tells line and column
    throw SetUpError(file.string() + ": " + error.what());
  }
  if (!(note.run.step_s > 0.0 && note.run.step_s <= 10.0))
    throw SetUpError(file.string() + ": step_s must lie in (0, 10]");
  const bool rising =
      std::adjacent_find(note.vehicles.begin(), note.vehicles.end(), std::greater_equal<>()) == note.vehicles.end();
  if (note.vehicles.empty() || !rising || note.vehicles.front() == 0)
    throw SetUpError(file.string() + ": 'vehicles' must be rising numbers from 1 on");
  return note;
}

/// How the recording's end tells that it is not as it was written; empty: it is.
std::string fault_at_end(const std::filesystem::path& folder, const Note& note, std::uint32_t steps, bool& complete) {
  const std::filesystem::path file = folder / "end.json";
  std::ifstream in(file);
  if (!in)
    return file.string() + " is missing: the recording was interrupted, and ends at step " + std::to_string(steps);
  try {
    const nlohmann::json json = nlohmann::json::parse(in);
    complete = json.at("complete");
    const auto all = json.at("steps").get<std::uint32_t>();
    const auto changed = [&](const std::string& name) {
      return json.at("fnv1a64").at(name) != digest_of(folder / name);
    };
    const auto is_not = [&](const std::string& name) {
      return (folder / name).string() + " is not what was recorded: it was cut or changed";
    };
    if (changed("run.json")) return is_not("run.json");
    for (const std::uint32_t vehicle : note.vehicles) {
      const std::string own = "vehicle_" + std::to_string(vehicle) + "/";
      if (steps < all && changed(own + "truth.csv"))
        return (folder / own / "truth.csv").string() + ": the recording ends at step " + std::to_string(steps) +
               " of " + std::to_string(all) + ": it was cut";
      for (const char* name : recorded_files)
        if (changed(own + name)) return is_not(own + name);
    }
    if (steps != all) return is_not("end.json");
  } catch (const nlohmann::json::exception& error) {
    return file.string() + ": " + error.what();
  }
  return {};
}

/// The step of a row, its first column: not before the last one.
std::uint32_t step_of(TableRow& row, std::uint32_t last) {
  const auto step = static_cast<std::uint32_t>(row.whole(1, largest));
  if (step < last) row.fail("step " + std::to_string(step) + " comes after step " + std::to_string(last));
  return step;
}

/// Rows by step.
template <class Data, class Read>
std::multimap<std::uint32_t, Data> read_rows(const std::filesystem::path& file, std::string_view header,
                                             const Read& read) {
  std::multimap<std::uint32_t, Data> rows;
  std::uint32_t step = 1;
  for (TableRow& row : read_table(file, header)) {
    step = step_of(row, step);
    rows.emplace_hint(rows.end(), step, read(row));
  }
  return rows;
}

struct RecordedFrame {
  std::uint32_t frame = 0;
  double stamp_s = 0.0;
  std::string digest, where;
};

RecordedFrame read_frame(TableRow& row) {
  RecordedFrame frame;
  frame.frame = static_cast<std::uint32_t>(row.whole(0, largest));
  frame.stamp_s = row.number();
  frame.digest = row.text();
  frame.where = row.where();
  return frame;
}

OdometryData read_odometry(TableRow& row) {
  constexpr std::int64_t ticks = std::int64_t{1} << 52;
  OdometryData data;
  data.reading = static_cast<std::uint32_t>(row.whole(0, largest));
  data.stamp_s = row.number();
  data.left_ticks = row.whole(-ticks, ticks);
  data.right_ticks = row.whole(-ticks, ticks);
  for (double* value : {&data.distance_m, &data.speed_mps, &data.wheels_yaw_rate_radps, &data.gyro_yaw_rate_radps,
                        &data.sigma_distance_m, &data.sigma_wheels_yaw_rate_radps, &data.sigma_gyro_yaw_rate_radps})
    *value = row.number();
  return data;
}

GpsData read_gps(TableRow& row) {
  GpsData data;
  data.reading = static_cast<std::uint32_t>(row.whole(0, largest));
  data.stamp_s = row.number();
  const std::string kind = row.text();
  if (kind != "standard" && kind != "rtk") row.fail("'" + kind + "' is no kind of GPS: standard, rtk");
  data.kind = kind == "rtk" ? GpsKind::rtk : GpsKind::standard;
  data.fix = row.whole(0, 1) == 1;
  row.all(data.antenna_body);
  row.all(data.position);
  row.all(data.covariance);
  row.all(data.drift_covariance);
  data.correlation_s = row.number();
  return data;
}

struct RecordedTruth {
  double time_s = 0.0;
  TruthData truth;
};

RecordedTruth read_truth(TableRow& row) {
  RecordedTruth data;
  data.time_s = row.number();
  row.all(data.truth.T_world_body);
  row.all(data.truth.velocity_world);
  row.all(data.truth.turn_body);
  return data;
}

struct RecordedVehicle {
  RecordedVehicle(const std::filesystem::path& of, std::uint32_t number)
      : folder(of / ("vehicle_" + std::to_string(number))), vehicle{number, load_camera(folder / "camera.yaml")} {
    // One row for each step: how many there are, and without a hole.
    std::uint32_t step = 0;
    for (TableRow& row : read_table(folder / "truth.csv", table::truth)) {
      if (row.whole(1, largest) != ++step) row.fail("this row should be of step " + std::to_string(step));
      truth.push_back(read_truth(row));
    }
    if (truth.empty()) throw SetUpError((folder / "truth.csv").string() + ": there is no step in it");
  }

  std::filesystem::path folder;
  SourceVehicle vehicle;
  std::vector<RecordedTruth> truth;
  std::multimap<std::uint32_t, RecordedFrame> frames =
      read_rows<RecordedFrame>(folder / "frames.csv", table::frames, read_frame);
  std::multimap<std::uint32_t, OdometryData> odometry =
      read_rows<OdometryData>(folder / "odometry.csv", table::odometry, read_odometry);
  std::multimap<std::uint32_t, GpsData> gps = read_rows<GpsData>(folder / "gps.csv", table::gps, read_gps);

  FrameData picture(const RecordedFrame& recorded) const {
    FrameData frame;
    frame.frame = recorded.frame;
    frame.stamp_s = recorded.stamp_s;
    frame.width = vehicle.camera.width;
    frame.height = vehicle.camera.height;
    char name[16];
    std::snprintf(name, sizeof name, "%06u", recorded.frame);
    std::filesystem::path file = folder / "images" / (std::string(name) + ".png");
    if (const std::filesystem::path other = file.parent_path() / (std::string(name) + ".pgm");
        !std::filesystem::exists(file) && std::filesystem::exists(other))
      file = other;
    if (!std::filesystem::exists(file)) throw SetUpError(recorded.where + ": there is no " + file.string());
    frame.grey = load_picture(file, frame.width, frame.height);
    if (digest_of(frame) != recorded.digest)
      throw SetUpError(recorded.where + ": " + file.string() + " is not the picture that was recorded");
    return frame;
  }

  VehicleStep step(std::uint32_t number) const {
    VehicleStep sensed;
    sensed.vehicle = vehicle.vehicle;
    sensed.truth = truth[number - 1].truth;
    for (auto [at, end] = frames.equal_range(number); at != end; ++at) sensed.frames.push_back(picture(at->second));
    for (auto [at, end] = odometry.equal_range(number); at != end; ++at) sensed.odometry.push_back(at->second);
    for (auto [at, end] = gps.equal_range(number); at != end; ++at) sensed.gps.push_back(at->second);
    return sensed;
  }
};

}  // namespace

struct Replay::Impl {
  Impl(const std::filesystem::path& folder, bool as_is) : note(read_note(folder / "run.json")) {
    for (const std::uint32_t number : note.vehicles) {
      recorded.emplace_back(folder, number);
      vehicles.push_back(recorded.back().vehicle);
      const auto has = static_cast<std::uint32_t>(recorded.back().truth.size());
      steps = steps == 0 ? has : std::min(steps, has);
    }
    bool complete = true;
    warning = fault_at_end(folder, note, steps, complete);
    if (!warning.empty() && !as_is) throw SetUpError(warning + "; --as-is replays what is there");
    if (warning.empty() && !complete)
      warning = folder.string() + ": the run was stopped at step " + std::to_string(steps) + ", before its end";
  }

  Note note;
  std::vector<RecordedVehicle> recorded;
  std::vector<SourceVehicle> vehicles;
  std::uint32_t steps = 0, done = 0;
  std::string warning;
};

Replay::Replay(const std::filesystem::path& folder, bool as_is) : impl_(std::make_unique<Impl>(folder, as_is)) {}
Replay::~Replay() = default;

const std::vector<SourceVehicle>& Replay::vehicles() const { return impl_->vehicles; }
double Replay::duration_s() const { return impl_->steps * impl_->note.run.step_s; }
double Replay::step_s() const { return impl_->note.run.step_s; }
std::string Replay::attribution() const { return impl_->note.run.attribution; }
const std::string& Replay::warning() const { return impl_->warning; }

StepData Replay::next() {
  StepData step;
  step.step = ++impl_->done;
  step.time_s = impl_->recorded.front().truth.at(step.step - 1).time_s;
  step.last = step.step == impl_->steps;
  for (const RecordedVehicle& vehicle : impl_->recorded) step.vehicles.push_back(vehicle.step(step.step));
  return step;
}

}  // namespace convoy::simulator
