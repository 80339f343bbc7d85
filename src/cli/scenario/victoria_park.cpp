#include "scenario/victoria_park.hpp"

#include <algorithm>
#include <cmath>
#include <convoy/config_error.hpp>
#include <cstdio>

#include "scenario/counter_rng.hpp"
#include "scenario/gps_reference.hpp"
#include "scenario/table_file.hpp"
#include "scenario/tree_tracker.hpp"

namespace convoy::cli {
namespace fs = std::filesystem;
namespace {

constexpr VehicleId windows = 3;
constexpr double truth_period_s = 0.25;

// The truck, by its makers' figures. The GPS antenna stands where the laser is.
constexpr double wheel_base_m = 2.83;
constexpr double encoder_left_m = 0.76;  // of the middle of the rear axle
const Eigen::Vector2d laser_m(3.78, 0.5);
// The laser's stamps are late, by what keeps trees best in place.
constexpr double laser_delay_s = 0.06;
// The steering sensor, fitted to GPS over the first 780 s of the recording.
constexpr double steering_gain = 1.04;
constexpr double steering_zero_rad = 0.004;

// What of two reference poses may contradict each other before two maps do.
constexpr PoseTolerance reference_tolerance{6.0, 0.25};

const SE2::Tangent prior_sigma(11.0, 11.0, 0.15);

struct Detections {
  double t_s = 0.0;
  std::size_t line = 0;                   ///< where they begin in the file
  std::vector<Eigen::Vector2d> points_m;  ///< body frame
};

/// Times must not run back.
void check_time(const TableFile& table, double t_s, double before_s) {
  if (t_s < before_s) table.refuse("time runs backwards; fetch the file again");
}

std::vector<SensorEvent> read_odometry(const fs::path& file) {
  std::vector<SensorEvent> odometry;
  for (TableFile table(file, {.header = "t_s,speed_mps,steering_rad"}); table.next();) {
    const double tangent = std::tan(steering_gain * table.number(2) + steering_zero_rad);
    const double v_m_s = table.number(1) / (1.0 - tangent * encoder_left_m / wheel_base_m);
    odometry.push_back(SensorEvent::odometry(table.number(0), v_m_s, v_m_s / wheel_base_m * tangent));
    if (odometry.size() > 1) check_time(table, odometry.back().t_s, odometry[odometry.size() - 2].t_s);
  }
  if (odometry.size() < windows)
    throw ConfigError(file.string() + ": holds too little odometry to be cut in three; fetch the data set again");
  return odometry;
}

std::vector<GpsFix> read_gps(const fs::path& file) {
  std::vector<GpsFix> fixes;
  for (TableFile table(file, {.header = "t_s,east_m,north_m"}); table.next();) {
    fixes.push_back({table.number(0), {table.number(1), table.number(2)}});
    if (fixes.size() > 1) check_time(table, fixes.back().t_s, fixes[fixes.size() - 2].t_s);
  }
  return fixes;
}

std::vector<Detections> read_detections(const fs::path& file) {
  std::vector<Detections> scans;
  for (TableFile table(file, {.header = "t_s,range_m,bearing_rad,diameter_m"}); table.next();) {
    const double t_s = table.number(0) - laser_delay_s;
    if (!scans.empty()) check_time(table, t_s, scans.back().t_s);
    if (scans.empty() || t_s > scans.back().t_s) scans.push_back({t_s, table.line(), {}});
    if (table.text(1).empty() && table.text(2).empty() && table.text(3).empty()) continue;  // a scan that saw nothing
    const double range_m = table.number(1), bearing_rad = table.number(2);
    if (range_m <= 0.0) table.refuse("the range must be above 0");
    scans.back().points_m.push_back(laser_m + range_m * Eigen::Vector2d(std::cos(bearing_rad), std::sin(bearing_rad)));
  }
  return scans;
}

/// [begin_s, end_s) of the recording is one vehicle.
struct Window {
  double begin_s = 0.0, end_s = 0.0;
  bool holds(double t_s) const { return t_s >= begin_s && t_s < end_s; }
  /// The stamps have milliseconds; so have the differences, once the rounding of the subtraction is taken off.
  double since_begin(double t_s) const { return std::round((t_s - begin_s) * 1e6) / 1e6; }
};

std::vector<Window> windows_of(const ReckonedPath& path) {
  std::vector<Window> cuts;
  const double length_s = (path.end_s() - path.begin_s()) / windows;
  for (VehicleId i = 0; i < windows; ++i)
    cuts.push_back({path.begin_s() + i * length_s, path.begin_s() + i * length_s + length_s});
  return cuts;
}

/// One row of a table, by time.
struct Row {
  double t_s = 0.0;
  std::size_t line = 0;
};

/// A vehicle whose part of the drive has none of `rows` could not drive, could not see, or could not be judged.
void expect_in_each(const std::vector<Window>& cuts, const fs::path& file, const std::vector<Row>& rows,
                    const char* what) {
  for (const Window& window : cuts) {
    const auto from = std::find_if(rows.begin(), rows.end(), [&](const Row& row) { return row.t_s >= window.begin_s; });
    if (from != rows.end() && window.holds(from->t_s)) continue;
    const std::size_t line = from != rows.end() ? from->line : rows.empty() ? 1 : rows.back().line;
    char seconds[64];
    std::snprintf(seconds, sizeof seconds, "%.2f s to %.2f s", window.begin_s, window.end_s);
    throw ConfigError(file.string() + ":" + std::to_string(line) + ": no " + what + " from " + seconds +
                      ", and that part of the drive is a vehicle of its own; fetch the data set again");
  }
}

/// Of a table with one of them a line, below the header.
template <class Timed>
std::vector<Row> rows_of(const std::vector<Timed>& timed) {
  std::vector<Row> rows;
  for (const Timed& each : timed) rows.push_back({each.t_s, rows.size() + 2});
  return rows;
}

std::vector<Row> seen_in(const std::vector<Detections>& detections) {
  std::vector<Row> rows;
  for (const Detections& d : detections)
    if (!d.points_m.empty()) rows.push_back({d.t_s, d.line});
  return rows;
}

struct Dropped {
  std::size_t unsure = 0, seldom = 0, moving = 0;
  std::string text() const {
    return std::to_string(unsure) + " that could be of two things, " + std::to_string(seldom) + " seen too seldom, " +
           std::to_string(moving) + " of what moved";
  }
};

void add_sightings(const std::vector<Detections>& detections, const ReckonedPath& path, const Window& window,
                   VehicleLog<SE2>& log, Dropped& dropped) {
  std::vector<TreeScan> scans;
  for (const Detections& d : detections)
    if (window.holds(d.t_s)) {
      const ReckonedPose pose = path.at(d.t_s);
      scans.push_back({d.t_s, pose.T_local_body, pose.driven_m, d.points_m});
    }
  const TreeTracks tracks = follow_trees(scans);
  for (std::size_t s = 0; s < scans.size(); ++s)
    for (std::size_t i = 0; i < scans[s].points_m.size(); ++i) {
      const Eigen::Vector2d& p = scans[s].points_m[i];
      if (tracks.track_of[s][i] != TreeTracks::none)
        log.sensors.push_back(SensorEvent::sighting(window.since_begin(scans[s].t_s), tracks.track_of[s][i], p.norm(),
                                                    std::atan2(p.y(), p.x())));
    }
  dropped.unsure += tracks.unsure;
  dropped.seldom += tracks.seldom;
  dropped.moving += tracks.moving;
  log.dropped_unknown_sightings = tracks.unsure + tracks.seldom + tracks.moving;
}

VehicleLog<SE2> cut(VehicleId id, const Window& window, const std::vector<SensorEvent>& odometry,
                    const ReckonedPath& path, const std::vector<Detections>& detections,
                    const std::vector<TruthPose<SE2>>& reference, Dropped& dropped) {
  VehicleLog<SE2> log;
  log.id = id;
  for (SensorEvent event : odometry)
    if (window.holds(event.t_s)) {
      event.t_s = window.since_begin(event.t_s);
      log.sensors.push_back(event);
    }
  add_sightings(detections, path, window, log, dropped);
  for (TruthPose<SE2> pose : reference)
    if (window.holds(pose.t_s)) {
      pose.t_s = window.since_begin(pose.t_s);
      log.truth.push_back(pose);
    }
  std::stable_sort(log.sensors.begin(), log.sensors.end(), [](const auto& a, const auto& b) { return a.t_s < b.t_s; });
  return log;
}

/// Where the reference has the vehicle's start, by dead reckoning from the first reference pose.
SE2 reference_start(const VehicleLog<SE2>& log, const fs::path& gps) {
  if (log.truth.empty())
    throw ConfigError(gps.string() + ": says too little of vehicle " + std::to_string(log.id) +
                      " to tell where it started; fetch the data set again");
  const ReckonedPath path(log.sensors);
  const SE2 T_start_body = path.at(0.0).T_local_body.inverse() * path.at(log.truth.front().t_s).T_local_body;
  return log.truth.front().T_world_body * T_start_body.inverse();
}

void set_priors(const fs::path& gps, Scenario<SE2>& scenario) {
  const SE2 T_world_common = reference_start(scenario.vehicles.front(), gps);
  scenario.vehicles.front().prior = StaticPrior<SE2>{};
  for (std::size_t i = 1; i < scenario.vehicles.size(); ++i) {
    VehicleLog<SE2>& log = scenario.vehicles[i];
    const CounterRng rng(scenario.seed, log.id, 0);
    const SE2::Tangent draw = prior_sigma.cwiseProduct(SE2::Tangent(rng.normal(0), rng.normal(1), rng.normal(2)));
    log.prior = StaticPrior<SE2>{T_world_common.inverse() * reference_start(log, gps) * SE2::Exp(draw), prior_sigma};
  }
}

}  // namespace

Scenario<SE2> load_victoria_park(const fs::path& folder, std::uint64_t seed) {
  if (!fs::is_directory(folder))
    throw ConfigError(folder.string() +
                      ": no such folder; give the folder of the Victoria Park data set, with its "
                      "odometry.csv, gps.csv and tree_detections.csv");
  const std::vector<SensorEvent> odometry = read_odometry(folder / "odometry.csv");
  const std::vector<GpsFix> fixes = read_gps(folder / "gps.csv");
  const std::vector<Detections> detections = read_detections(folder / "tree_detections.csv");
  const ReckonedPath path(odometry);
  const std::vector<Window> cuts = windows_of(path);
  expect_in_each(cuts, folder / "odometry.csv", rows_of(odometry), "odometry");
  expect_in_each(cuts, folder / "gps.csv", rows_of(fixes), "fix");
  expect_in_each(cuts, folder / "tree_detections.csv", seen_in(detections), "detection");
  GpsReferenceParams params;
  params.lever_m = laser_m;
  const GpsReference reference = gps_reference(path, fixes, truth_period_s, params);

  Scenario<SE2> scenario;
  scenario.name = "victoria-park";
  scenario.seed = seed;
  scenario.pose_tolerance = reference_tolerance;
  scenario.common_frame_vehicle = 1;
  Dropped dropped;
  for (VehicleId id = 1; id <= windows; ++id) {
    scenario.vehicles.push_back(cut(id, cuts[id - 1], odometry, path, detections, reference.poses, dropped));
    scenario.duration_s = std::max(scenario.duration_s, scenario.vehicles.back().sensors.back().t_s);
  }
  scenario.source = fs::weakly_canonical(folder).filename().string() + "; detections left out: " + dropped.text();
  set_priors(folder / "gps.csv", scenario);
  return scenario;
}

}  // namespace convoy::cli
