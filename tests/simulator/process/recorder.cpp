#include "camera_file.hpp"
#include "digest.hpp"
#include "recording.hpp"
#include "sim_error.hpp"
#include "whole_file.hpp"

#include <nlohmann/json.hpp>

namespace convoy::simulator {
namespace {

std::filesystem::path vehicle_folder(const std::filesystem::path& folder, std::uint32_t vehicle) {
  return folder / ("vehicle_" + std::to_string(vehicle));
}

void make_folders(const std::filesystem::path& folder, const std::vector<SourceVehicle>& vehicles) {
  expect_room_for_recording(folder);
  std::error_code error;
  for (const SourceVehicle& vehicle : vehicles) {
    const std::filesystem::path images = vehicle_folder(folder, vehicle.vehicle) / "images";
    std::filesystem::create_directories(images, error);
    if (error) throw SetUpError(images.string() + " cannot be made: " + error.message());
  }
}

void write_json(const std::filesystem::path& file, const nlohmann::ordered_json& json) {
  write_whole(file, json.dump(2) + '\n');
}

void write_note(const std::filesystem::path& file, const RunNote& note, const std::vector<SourceVehicle>& vehicles) {
  nlohmann::ordered_json json{{"format", 1},        {"world", note.world},     {"attribution", note.attribution},
                              {"seed", note.seed},  {"options", note.options}, {"step_s", note.step_s},
                              {"vehicles", nullptr}};
  json["vehicles"] = nlohmann::json::array();
  for (const SourceVehicle& vehicle : vehicles) json["vehicles"].push_back(vehicle.vehicle);
  write_json(file, json);
}

}  // namespace

void expect_room_for_recording(const std::filesystem::path& folder) {
  std::error_code error;
  if (std::filesystem::exists(folder, error) &&
      (!std::filesystem::is_directory(folder, error) || !std::filesystem::is_empty(folder, error)))
    throw SetUpError(folder.string() + ": there is something already; name an empty or a new folder to record to");
}

Recorder::Recorder(const std::filesystem::path& folder, const RunNote& note, const std::vector<SourceVehicle>& vehicles)
    : folder_(folder) {
  make_folders(folder, vehicles);
  write_note(folder / "run.json", note, vehicles);
  for (const SourceVehicle& vehicle : vehicles) {
    const std::filesystem::path own = vehicle_folder(folder, vehicle.vehicle);
    save_camera(vehicle.camera, own / "camera.yaml");
    vehicles_.push_back({own,
                         {own / "frames.csv", table::frames},
                         {own / "odometry.csv", table::odometry},
                         {own / "gps.csv", table::gps},
                         {own / "truth.csv", table::truth}});
  }
}

void Recorder::write(const StepData& step) {
  try {
    write_rows(step);
  } catch (const SetUpError& error) {
    throw SetUpError(error.what() + (". The recording ends at step " + std::to_string(steps_)) +
                     "; it is replayed by --as-is only");
  }
  steps_ = step.step;
}

void Recorder::write_rows(const StepData& step) {
  const std::int64_t number = step.step;
  for (std::size_t i = 0; i < vehicles_.size(); ++i) {
    Tables& tables = vehicles_[i];
    const VehicleStep& sensed = step.vehicles.at(i);
    for (const FrameData& frame : sensed.frames) {
      char name[16];
      std::snprintf(name, sizeof name, "%06u.png", frame.frame);
      save_picture(tables.folder / "images" / name, frame.width, frame.height, frame.grey);
      tables.frames << number << std::int64_t{frame.frame} << frame.stamp_s << std::string_view(digest_of(frame));
      tables.frames.end_row();
    }
    for (const OdometryData& r : sensed.odometry) {
      tables.odometry << number << std::int64_t{r.reading} << r.stamp_s << r.left_ticks << r.right_ticks << r.distance_m
                      << r.speed_mps << r.wheels_yaw_rate_radps << r.gyro_yaw_rate_radps << r.sigma_distance_m
                      << r.sigma_wheels_yaw_rate_radps << r.sigma_gyro_yaw_rate_radps;
      tables.odometry.end_row();
    }
    for (const GpsData& r : sensed.gps) {
      tables.gps << number << std::int64_t{r.reading} << r.stamp_s
                 << std::string_view(r.kind == GpsKind::rtk ? "rtk" : "standard") << std::int64_t{r.fix};
      tables.gps.all(r.antenna_body).all(r.position).all(r.covariance).all(r.drift_covariance) << r.correlation_s;
      tables.gps.end_row();
    }
    tables.truth << number << step.time_s;
    tables.truth.all(sensed.truth.T_world_body).all(sensed.truth.velocity_world).all(sensed.truth.turn_body);
    tables.truth.end_row();
  }
}

void Recorder::end(bool complete) {
  nlohmann::ordered_json json{{"steps", steps_}, {"complete", complete}, {"fnv1a64", nullptr}};
  const auto add = [&](const std::filesystem::path& file) {
    json["fnv1a64"][file.lexically_relative(folder_).string()] = digest_of(file);
  };
  add(folder_ / "run.json");
  for (const Tables& tables : vehicles_)
    for (const char* name : recorded_files) add(tables.folder / name);
  write_json(folder_ / "end.json", json);
}

}  // namespace convoy::simulator
