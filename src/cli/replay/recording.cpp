#include "replay/recording.hpp"

#include <convoy/config_error.hpp>
#include <convoy/text_fields.hpp>
#include <convoy/vision/calibration_file.hpp>
#include <convoy/vision/kitti_sequence.hpp>

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <optional>

#include "replay/named_table.hpp"
#include "scenario/counter_rng.hpp"
#include "scenario/table_file.hpp"

namespace convoy::cli {

namespace fs = std::filesystem;

namespace {

constexpr double odometer_sigma = 0.005;
constexpr std::uint64_t odometer_seed = 1;
constexpr double kitti_rate_hz = 10.0;

void expect_folder(const fs::path& folder, const char* what) {
  std::error_code error;
  if (!fs::is_directory(folder, error))
    throw ConfigError(folder.string() + ": is no folder; give the folder of " + what);
}

/// Where there is a truth, the drive begins with it, to be judged from its first pose on. Stamps may be those of a
/// clock that has run since 1970.
void begin_at_its_start(Recording& recording) {
  auto& odometry = recording.odometry;
  if (!recording.truth.empty()) {
    const double from_s = recording.truth.front().t_s;
    const auto first =
        std::find_if(odometry.begin(), odometry.end(), [&](const auto& r) { return r.stamp_s >= from_s; });
    if (odometry.end() - first >= 2) odometry.erase(odometry.begin(), first);
  }
  recording.start_stamp_s = std::floor(recording.odometry.front().stamp_s);
  for (OdometerReading& reading : recording.odometry) reading.stamp_s -= recording.start_stamp_s;
  for (TruthPose<SE3>& pose : recording.truth) pose.t_s -= recording.start_stamp_s;
}

// ---- images ----

ImageTimes times_of(const fs::path& folder, double rate_hz) {
  for (const char* name : {"frames.csv", "times.txt"})
    if (fs::exists(folder / name)) return {0.0, folder / name};
  if (rate_hz == 0.0)
    throw ConfigError(folder.string() +
                      ": says nowhere when its images were taken; write frames.csv (a column stamp_s) or times.txt (a "
                      "stamp per line), or give --rate HZ");
  return {rate_hz, {}};
}

std::vector<OdometerReading> read_odometry(const fs::path& file) {
  std::vector<OdometerReading> readings;
  NamedTable table(file);
  const std::size_t stamp = table.column("stamp_s"), distance = table.column("distance_m"),
                    yaw = table.column_of({"gyro_yaw_rate_radps", "wheels_yaw_rate_radps", "yaw_rate_radps"});
  while (table.rows().next()) {
    readings.push_back({table.rows().number(stamp), table.rows().number(distance), table.rows().number(yaw)});
    if (readings.size() > 1 && readings.back().stamp_s <= readings[readings.size() - 2].stamp_s)
      table.rows().refuse("stamp_s is not later than that of the row before; sort the rows, or remove what is twice");
  }
  if (readings.size() < 2)
    throw ConfigError(file.string() +
                      ": has fewer than two readings; without them there is no path. Remove the file to "
                      "look at the images alone");
  return readings;
}

std::vector<TruthPose<SE3>> read_true_poses(const fs::path& file) {
  std::vector<TruthPose<SE3>> truth;
  NamedTable table(file);
  std::vector<std::size_t> at;
  for (const char* name : {"time_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"}) at.push_back(table.column(name));
  while (table.rows().next()) {
    const auto number = [&](std::size_t i) { return table.rows().number(at[i]); };
    const Eigen::Vector4d q(number(4), number(5), number(6), number(7));
    if (std::abs(q.norm() - 1.0) > 1e-3) table.rows().refuse("(qw, qx, qy, qz) is no rotation: its length must be 1");
    truth.push_back({number(0), SE3(SE3::Quaternion(q), {number(1), number(2), number(3)})});
    if (truth.size() > 1 && truth.back().t_s <= truth[truth.size() - 2].t_s)
      table.rows().refuse("time_s is not later than that of the row before; sort the rows, or remove what is twice");
  }
  return truth;
}

void read_camera(const fs::path& folder, Recording& recording) {
  const fs::path file = folder / "camera.yaml";
  if (!fs::exists(file))
    throw ConfigError(file.string() + ": no such file; put the calibration of the camera there, with T_body_camera");
  const CameraFile camera = load_calibration(file);
  if (!camera.T_body_camera)
    throw ConfigError(file.string() +
                      ": does not say where the camera sits on the vehicle; add T_body_camera, a 4 x 4 matrix (body: x "
                      "ahead, y left, z up, at the middle of the rear axle; camera: x right, y down, z ahead)");
  recording.calibration = camera.calibration;
  recording.T_body_camera = *camera.T_body_camera;
}

fs::path pictures_of(const fs::path& folder) {
  if (fs::is_directory(folder / "images")) return folder / "images";
  for (const fs::directory_entry& entry : fs::directory_iterator(folder))
    if (entry.is_directory() && fs::exists(entry.path() / "odometry.csv") && fs::is_directory(entry.path() / "images"))
      throw ConfigError(folder.string() + ": holds the recordings of vehicles; give that of one of them, such as " +
                        entry.path().string());
  return folder;
}

// ---- KITTI ----

/// The body of a camera that drives ahead: x where it moves on a straight road, y to the left, z up.
SE3 body_of_camera(const std::vector<SE3>& poses) {
  constexpr double straight_rad = 0.01;  // from one image to the next
  Eigen::Vector3d ahead = Eigen::Vector3d::Zero();
  for (std::size_t k = 1; k < poses.size(); ++k) {
    const SE3::Tangent step = (poses[k - 1].inverse() * poses[k]).Log();
    if (step.tail<3>().norm() < straight_rad) ahead += step.head<3>();
  }
  if (ahead.z() <= 0.0) ahead = Eigen::Vector3d::UnitZ();  // it never drives straight: taken for level
  Eigen::Matrix3d R_camera_body;
  R_camera_body.col(0) = ahead.normalized();
  R_camera_body.col(1) = Eigen::Vector3d(0.0, -1.0, 0.0).cross(ahead).normalized();
  R_camera_body.col(2) = R_camera_body.col(0).cross(R_camera_body.col(1));
  return SE3::from_rotation(R_camera_body.transpose(), Eigen::Vector3d::Zero());
}

std::vector<SE3> read_kitti_poses(const fs::path& file) {
  const std::string kind = "KITTI's poses: twelve numbers (3 x 4) per image";
  if (!fs::exists(file))
    throw ConfigError(file.string() + ": no such file, and the odometer of a KITTI drive is made from it; give " +
                      kind);
  const std::string text = convoy::read_text(file, kind);
  TextFields fields(text, file.string(), kind);
  std::vector<SE3> poses;
  while (fields.next_line()) {
    if (fields.empty()) continue;
    if (fields.size() != 12) fields.refuse("the line has " + std::to_string(fields.size()) + " numbers, a pose has 12");
    Eigen::Matrix<double, 3, 4> T;
    for (int i = 0; i < 12; ++i) T(i / 4, i % 4) = fields.number(static_cast<std::size_t>(i));
    const Eigen::Matrix3d R = T.leftCols<3>();
    if ((R * R.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() > 1e-3 || R.determinant() < 0.0)
      fields.refuse("the first three columns are no rotation; is it " + kind + "?");
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
    poses.push_back(SE3::from_rotation(svd.matrixU() * svd.matrixV().transpose(), T.col(3)));
  }
  return poses;
}

/// More than a metre from one image to the next, at twice the focal length of a slow vehicle's camera: features go
/// further, and are seen from further away, and the odometer is a noisy one. Chosen looking at the first 60 m of
/// sequence 06.
void tune_for_kitti(MonocularSlamParams& params) {
  params.filter = MonocularParams{};
  params.search.max_radius_px = 200.0;
  params.filter.candidate_depth_m = 25.0;
}

/// Of all images, without looking at them.
std::vector<double> kitti_stamps(const fs::path& folder) {
  std::vector<double> stamps;
  const fs::path times = folder / "times.txt", pictures = folder / "image_0";
  if (!fs::is_directory(pictures))
    throw ConfigError(folder.string() +
                      ": is no drive of KITTI's odometry benchmark; give a folder that holds image_0, "
                      "calib.txt and poses.txt");
  if (!fs::exists(times)) {
    for ([[maybe_unused]] const auto& entry : fs::directory_iterator(pictures))
      stamps.push_back(static_cast<double>(stamps.size()) / kitti_rate_hz);
    return stamps;
  }
  const std::string kind = "KITTI's times: the stamp [s] of an image on each line";
  const std::string text = convoy::read_text(times, kind);
  for (TextFields fields(text, times.string(), kind); fields.next_line();)
    if (!fields.empty()) stamps.push_back(fields.number(0));
  return stamps;
}

}  // namespace

SourceImage Recording::next_image() {
  SourceImage image = images->next();
  image.stamp_s -= start_stamp_s;
  return image;
}

std::vector<OdometerReading> odometer_from_truth(const std::vector<TruthPose<SE3>>& truth, double sigma,
                                                 std::uint64_t seed) {
  const CounterRng draw(seed, 1, 0);
  std::vector<OdometerReading> readings;
  for (std::size_t k = 0; k < truth.size(); ++k) {
    OdometerReading reading{truth[k].t_s, 0.0, 0.0};
    if (k > 0) {
      const SE3::Tangent step = (truth[k - 1].T_world_body.inverse() * truth[k].T_world_body).Log();
      const auto i = static_cast<std::uint32_t>(k);
      reading.distance_m = std::copysign(step.head<3>().norm(), step[0]) * (1.0 + sigma * draw.normal(i, 0));
      reading.yaw_rate_radps = step[5] / (truth[k].t_s - truth[k - 1].t_s) * (1.0 + sigma * draw.normal(i, 1));
    }
    readings.push_back(reading);
  }
  return readings;
}

Recording open_images(const fs::path& folder, double rate_hz) {
  expect_folder(folder, "a recording");
  Recording recording;
  recording.source = folder.string();
  const fs::path pictures = pictures_of(folder);
  recording.images = open_image_folder(pictures, times_of(folder, rate_hz));
  if (!fs::exists(folder / "odometry.csv")) {
    recording.notice = folder.string() +
                       ": no odometry.csv. Without an odometer there is no scale and no path: features are followed "
                       "from image to image, and nothing is mapped";
    return recording;
  }
  read_camera(folder, recording);
  expect_image_size(recording.calibration, recording.images->width(), recording.images->height(), pictures.string());
  recording.odometry = read_odometry(folder / "odometry.csv");
  if (fs::exists(folder / "truth.csv")) recording.truth = read_true_poses(folder / "truth.csv");
  begin_at_its_start(recording);
  return recording;
}

Recording open_kitti_drive(const fs::path& folder) {
  expect_folder(folder, "a KITTI drive");
  const std::vector<double> stamps = kitti_stamps(folder);
  KittiSequence sequence = open_kitti(folder);
  const std::vector<SE3> poses = read_kitti_poses(folder / "poses.txt");
  if (poses.size() != stamps.size())
    throw ConfigError((folder / "poses.txt").string() + ": has " + std::to_string(poses.size()) + " poses for " +
                      std::to_string(stamps.size()) + " images; there must be one for each, and two at least");
  if (poses.size() < 2) throw ConfigError(folder.string() + ": has fewer than two images; there is nothing to follow");
  Recording recording;
  recording.source = folder.string() + " (KITTI)";
  recording.seed = odometer_seed;
  recording.notice = folder.string() + ": KITTI has no odometer. Its readings are made from the true poses, with " +
                     "0.5 % noise of distance and yaw rate (seed " + std::to_string(odometer_seed) +
                     "), and so is the camera's angle to the way it drives";
  recording.images = std::move(sequence.images);
  recording.calibration = sequence.calibration;
  recording.T_body_camera = body_of_camera(poses);
  for (std::size_t k = 0; k < poses.size(); ++k)
    recording.truth.push_back({stamps[k], recording.T_body_camera * poses[k] * recording.T_body_camera.inverse()});
  recording.odometry = odometer_from_truth(recording.truth, odometer_sigma, odometer_seed);
  begin_at_its_start(recording);
  tune_for_kitti(recording.params);
  return recording;
}

}  // namespace convoy::cli
