#include "scenario/mrclam.hpp"

#include <algorithm>
#include <cmath>
#include <convoy/config_error.hpp>
#include <limits>
#include <map>

#include "scenario/table_file.hpp"

namespace convoy::cli {
namespace fs = std::filesystem;
namespace {

constexpr std::uint32_t first_landmark_subject = 6;
constexpr std::uint32_t last_landmark_subject = 20;
constexpr VehicleId max_robots = 5;

using SubjectOfBarcode = std::map<std::uint32_t, std::uint32_t>;

TableFormat dat_format(std::size_t columns) { return {.separator = ' ', .header = {}, .columns = columns}; }

bool is_landmark(std::uint32_t subject) {
  return subject >= first_landmark_subject && subject <= last_landmark_subject;
}

SubjectOfBarcode read_barcodes(const fs::path& file) {
  SubjectOfBarcode subjects;
  for (TableFile table(file, dat_format(2)); table.next();) {
    const std::uint32_t subject = table.small_number(0);
    if (subject == 0 || subject > last_landmark_subject) table.refuse("the subject must be 1 to 20");
    if (!subjects.emplace(table.small_number(1), subject).second) table.refuse("this barcode is given twice");
  }
  if (subjects.empty()) throw ConfigError(file.string() + ": holds no barcode; fetch the data set again");
  return subjects;
}

std::vector<TruthLandmark<SE2>> read_landmark_truth(const fs::path& file) {
  std::vector<TruthLandmark<SE2>> landmarks;
  for (TableFile table(file, dat_format(5)); table.next();) {
    if (!is_landmark(table.small_number(0))) table.refuse("the subject of a landmark must be 6 to 20");
    landmarks.push_back({table.small_number(0), {table.number(1), table.number(2)}});
  }
  return landmarks;
}

/// Refuses a stamp that is further behind the latest one than sorting should repair.
class StampCheck {
 public:
  explicit StampCheck(double max_step_back_s) : max_step_back_s_(max_step_back_s) {}
  double check(const TableFile& table, double stamp_s) {
    if (stamp_s < latest_s_ - max_step_back_s_)
      table.refuse("time steps back by " + std::to_string(latest_s_ - stamp_s) + " s, more than the " +
                   std::to_string(max_step_back_s_) + " s that are sorted; repair or fetch the file again");
    latest_s_ = std::max(latest_s_, stamp_s);
    return stamp_s;
  }

 private:
  double max_step_back_s_;
  double latest_s_ = -std::numeric_limits<double>::infinity();
};

struct Files {
  fs::path folder;
  VehicleId robot;
  fs::path operator()(const char* what) const {
    return folder / ("Robot" + std::to_string(robot) + "_" + what + ".dat");
  }
};

void read_odometry(const fs::path& file, double max_step_back_s, VehicleLog<SE2>& log) {
  StampCheck stamps(max_step_back_s);
  for (TableFile table(file, dat_format(3)); table.next();)
    log.sensors.push_back(
        SensorEvent::odometry(stamps.check(table, table.number(0)), table.number(1), table.number(2)));
  if (log.sensors.empty()) throw ConfigError(file.string() + ": holds no odometry; fetch the data set again");
}

void read_measurements(const fs::path& file, const SubjectOfBarcode& subjects, double max_step_back_s,
                       VehicleLog<SE2>& log) {
  StampCheck stamps(max_step_back_s);
  for (TableFile table(file, dat_format(4)); table.next();) {
    const double stamp_s = stamps.check(table, table.number(0));
    const auto subject = subjects.find(table.small_number(1));
    const double range_m = table.number(2), bearing_rad = table.number(3);
    if (range_m <= 0.0) table.refuse("the range must be above 0");
    if (subject == subjects.end() || subject->second == log.id) ++log.dropped_unknown_sightings;  // none sees itself
    else if (!is_landmark(subject->second))
      log.sensors.push_back(SensorEvent::encounter(stamp_s, subject->second, range_m, bearing_rad));
    else log.sensors.push_back(SensorEvent::sighting(stamp_s, subject->second, range_m, bearing_rad));
  }
}

void read_pose_truth(const fs::path& file, double max_step_back_s, VehicleLog<SE2>& log) {
  StampCheck stamps(max_step_back_s);
  for (TableFile table(file, dat_format(4)); table.next();)
    log.truth.push_back({stamps.check(table, table.number(0)), SE2(table.number(1), table.number(2), table.number(3))});
}

VehicleLog<SE2> read_robot(const Files& file, const SubjectOfBarcode& subjects, double max_step_back_s) {
  VehicleLog<SE2> log;
  log.id = file.robot;
  read_odometry(file("Odometry"), max_step_back_s, log);
  read_measurements(file("Measurement"), subjects, max_step_back_s, log);
  if (fs::exists(file("Groundtruth"))) read_pose_truth(file("Groundtruth"), max_step_back_s, log);
  const auto earlier = [](const auto& a, const auto& b) { return a.t_s < b.t_s; };
  std::stable_sort(log.sensors.begin(), log.sensors.end(), earlier);  // at equal times odometry stays first
  std::stable_sort(log.truth.begin(), log.truth.end(), earlier);
  return log;
}

double first_odometry_stamp(const std::vector<VehicleLog<SE2>>& vehicles) {
  double first_s = std::numeric_limits<double>::infinity();
  for (const VehicleLog<SE2>& log : vehicles)
    for (const SensorEvent& event : log.sensors)
      if (event.kind == SensorEvent::Kind::odometry) {
        first_s = std::min(first_s, event.t_s);
        break;
      }
  return first_s;
}

/// The stamps have milliseconds; so have the differences, once the rounding of the subtraction is taken off.
double since(double stamp_s, double origin_s) { return std::round((stamp_s - origin_s) * 1e6) / 1e6; }

}  // namespace

Scenario<SE2> load_mrclam(const fs::path& folder, double max_step_back_s) {
  if (!fs::is_directory(folder))
    throw ConfigError(folder.string() + ": no such folder; give the folder of one MR.CLAM data set");
  if (!fs::exists(folder / "Barcodes.dat"))
    throw ConfigError(folder.string() +
                      ": holds no Barcodes.dat; give the folder of one MR.CLAM data set, with its Barcodes.dat, "
                      "Landmark_Groundtruth.dat and RobotN_*.dat");
  Scenario<SE2> scenario;
  scenario.name = "mrclam";
  scenario.source = fs::weakly_canonical(folder).filename().string();
  const SubjectOfBarcode subjects = read_barcodes(folder / "Barcodes.dat");
  scenario.landmarks = read_landmark_truth(folder / "Landmark_Groundtruth.dat");
  for (VehicleId robot = 1; robot <= max_robots; ++robot) {
    const Files files{folder, robot};
    if (fs::exists(files("Odometry"))) scenario.vehicles.push_back(read_robot(files, subjects, max_step_back_s));
  }
  if (scenario.vehicles.empty())
    throw ConfigError(folder.string() + ": holds no RobotN_Odometry.dat; give the folder of one MR.CLAM data set");

  const double origin_s = first_odometry_stamp(scenario.vehicles);
  for (VehicleLog<SE2>& log : scenario.vehicles) {
    std::erase_if(log.sensors, [origin_s](const SensorEvent& event) { return event.t_s < origin_s; });
    for (SensorEvent& event : log.sensors) event.t_s = since(event.t_s, origin_s);
    for (TruthPose<SE2>& pose : log.truth) pose.t_s = since(pose.t_s, origin_s);
    scenario.duration_s = std::max(scenario.duration_s, log.sensors.back().t_s);
  }
  scenario.common_frame_vehicle = scenario.vehicles.front().id;
  return scenario;
}

}  // namespace convoy::cli
