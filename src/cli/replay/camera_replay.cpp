#include "replay/camera_replay.hpp"

#include <convoy/config_error.hpp>

#include <chrono>
#include <cstdio>
#include <utility>

#include "evaluate/evaluate.hpp"
#include "replay/drive.hpp"
#include "replay/image_tracker.hpp"
#include "replay/outcome.hpp"
#include "report/front_end_section.hpp"
#include "report/report.hpp"

namespace convoy::cli {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

Recording open(const ReplayOptions& options) {
  if (options.dataset == "images") return open_images(options.folder, options.rate_hz);
  return open_kitti_drive(options.folder);
}

// ---- with an odometer ----

/// What the vehicle is given and what it is judged by. Odometry as sensors.csv has it: a velocity, from its stamp on.
Scenario<SE3> scenario_of(const Recording& recording) {
  VehicleLog<SE3> log;
  log.id = Drive::self;
  log.truth = recording.truth;
  log.prior = StaticPrior<SE3>{};
  for (std::size_t i = 1; i < recording.odometry.size(); ++i) {
    const OdometerReading &before = recording.odometry[i - 1], &reading = recording.odometry[i];
    log.sensors.push_back(SensorEvent::odometry(before.stamp_s, reading.distance_m / (reading.stamp_s - before.stamp_s),
                                                reading.yaw_rate_radps));
  }
  Scenario<SE3> scenario;
  scenario.name = "replay";
  scenario.source = recording.source;
  scenario.seed = recording.seed;
  scenario.vehicles.push_back(std::move(log));
  scenario.common_frame_vehicle = Drive::self;
  scenario.duration_s = recording.odometry.back().stamp_s;
  return scenario;
}

/// How often a track was found, and what else came of looking for it.
json search_outcomes(const ActiveSearch& search) {
  json outcomes = json::object();
  for (int k = 0; k < search_statuses; ++k) {
    const auto status = static_cast<PatchMatch::Status>(k);
    outcomes[to_string(status)] = search.count(status);
  }
  return outcomes;
}

void write_run_info(const Recording& recording, const Drive& drive, double wall_s, const fs::path& out) {
  const json run = {{"scenario", "replay"},
                    {"source", recording.source},
                    {"notice", recording.notice},
                    {"seed", recording.seed},
                    {"dimension", 3},
                    {"vehicles", {Drive::self}},
                    {"common_frame_vehicle", Drive::self},
                    {"start_stamp_s", recording.start_stamp_s},
                    {"images_refused", drive.images_refused()},
                    {"images_outside", drive.images_outside()},
                    {"searches", search_outcomes(drive.search())},
                    {"wall_s", wall_s},
                    {"vehicle_s", recording.odometry.back().stamp_s - recording.odometry.front().stamp_s},
                    {"lost_vehicles", json::array()}};
  write_text_file(out / "run.json", run.dump(1) + "\n");
}

void replay_drive(Recording& recording, const ReplayOptions& options) {
  scenario_of(recording).write(options.out);
  const auto began = std::chrono::steady_clock::now();
  const fs::path folder = vehicle_folder(options.out, Drive::self);
  Drive drive(recording, recording.params, folder);
  drive.run();
  if (drive.frames().empty())
    throw ConfigError(options.folder.string() + ": no image could be used: " + std::to_string(drive.images_refused()) +
                      " were refused, and " + std::to_string(drive.images_outside()) +
                      " lie before or after the odometer's readings; are the stamps of both by one clock?");
  write_front_end(folder / "front_end.csv", drive.frames());
  drive.pictures().write(options.out / "frames");
  write_run_info(recording, drive, seconds_since(began), options.out);
  const RunRecord<SE3> run = read_run<SE3>(options.out);
  const Evaluation<SE3> evaluation = evaluate(run);
  write_evaluation(run, evaluation);
  write_report(run, evaluation);
  if (drive.images_refused() + drive.images_outside() > 0)
    std::printf("%llu images were refused, %llu lie before or after the odometer's readings\n",
                static_cast<unsigned long long>(drive.images_refused()),
                static_cast<unsigned long long>(drive.images_outside()));
  print_front_end(evaluation.metrics.at("front_end"), "images");
}

// ---- images alone ----

void replay_images(Recording& recording, const ReplayOptions& options) {
  ImageTracker tracker(recording.params, recording.images->width(), recording.images->height());
  FramePictures pictures;
  std::vector<FrontEndFrame> frames;
  Progress progress;
  for (SourceImage image = recording.next_image(); image.status != SourceImage::Status::end;
       image = recording.next_image()) {
    if (image.status == SourceImage::Status::refused) {
      std::fprintf(stderr, "convoy replay: left out: %s\n", image.why.c_str());
      continue;
    }
    const ImageReport report = tracker.follow(image.stamp_s, image.grey);
    pictures.look(frames.size(), image.grey, report.features);
    frames.push_back(counted(report));
    progress.tell(frames.size(), image.stamp_s);
  }
  if (frames.empty()) throw ConfigError(options.folder.string() + ": none of its images could be read");
  write_front_end(options.out / "vehicle_1" / "front_end.csv", frames);
  pictures.write(options.out / "frames");
  const json front_end = judge_front_end(frames, {});
  const json metrics = {{"scenario", "replay"},
                        {"source", recording.source},
                        {"notice", recording.notice},
                        {"images_refused", recording.images->refused()},
                        {"front_end", front_end}};
  write_text_file(options.out / "metrics.json", metrics.dump(2) + "\n");
  write_text_file(options.out / "report.html", make_front_end_page(metrics, frames, options.out));
  print_front_end(front_end, "images");
}

}  // namespace

void replay_camera(const ReplayOptions& options) {
  Recording recording = open(options);
  if (options.features > 0) recording.params.features = options.features;
  if (!recording.notice.empty()) std::printf("%s.\n", recording.notice.c_str());
  std::fflush(stdout);
  if (recording.odometry.empty()) replay_images(recording, options);
  else replay_drive(recording, options);
}

}  // namespace convoy::cli
