// What was sensed, in a folder that a person can read:
//   run.json                           what made it: the world, the seed, the options, the vehicles
//   end.json                           written last: how many steps there are, and digests of the files
//   vehicle_N/camera.yaml              calibration, as OpenCV has it
//   vehicle_N/images/000000.png        by frame number
//   vehicle_N/{frames,odometry,gps,truth}.csv   a row for each; the first column is the step that it is part of
#pragma once

#include "sensor_source.hpp"
#include "table_file.hpp"

#include <array>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

namespace convoy::simulator {

namespace table {
inline constexpr std::string_view frames = "step,frame,stamp_s,fnv1a64";
inline constexpr std::string_view odometry =
    "step,reading,stamp_s,left_ticks,right_ticks,distance_m,speed_mps,wheels_yaw_rate_radps,gyro_yaw_rate_radps,"
    "sigma_distance_m,sigma_wheels_yaw_rate_radps,sigma_gyro_yaw_rate_radps";
inline constexpr std::string_view gps =
    "step,reading,stamp_s,kind,fix,antenna_x_m,antenna_y_m,antenna_z_m,east_m,north_m,up_m,"
    "cov_ee_m2,cov_en_m2,cov_eu_m2,cov_nn_m2,cov_nu_m2,cov_uu_m2,"
    "drift_ee_m2,drift_en_m2,drift_eu_m2,drift_nn_m2,drift_nu_m2,drift_uu_m2,correlation_s";
inline constexpr std::string_view truth =
    "step,time_s,x_m,y_m,z_m,qw,qx,qy,qz,vx_mps,vy_mps,vz_mps,roll_rate_radps,pitch_rate_radps,yaw_rate_radps";
}  // namespace table

/// Of each vehicle, beside pictures.
inline constexpr std::array<const char*, 5> recorded_files{"camera.yaml", "frames.csv", "odometry.csv", "gps.csv",
                                                           "truth.csv"};

/// What is told of a run beside its readings.
struct RunNote {
  std::string world, attribution;
  std::uint32_t seed = 1;
  std::string options;  ///< as on the command line
  double step_s = 0.1;
};

/// Throws SetUpError if there is something in the folder already, or it cannot be one.
void expect_room_for_recording(const std::filesystem::path& folder);

class Recorder {
 public:
  /// Makes the folder. Throws SetUpError, see expect_room_for_recording.
  Recorder(const std::filesystem::path& folder, const RunNote& note, const std::vector<SourceVehicle>& vehicles);
  /// Throws SetUpError that names the file that cannot be written. Without end() the recording is not whole.
  void write(const StepData& step);
  /// What was written last was the last. `complete`: it was the end of the run, too.
  void end(bool complete);

 private:
  void write_rows(const StepData& step);

  struct Tables {
    std::filesystem::path folder;
    TableWriter frames, odometry, gps, truth;
  };
  std::filesystem::path folder_;
  std::vector<Tables> vehicles_;
  std::uint32_t steps_ = 0;
};

/// A recording, played back. Everything but the pictures is read and checked by the constructor, which throws
/// SetUpError with file and line for what is wrong. Ends after the last step that all vehicles have.
class Replay final : public SensorSource {
 public:
  /// as_is: a recording that was cut or changed is played, too, as far as it can be read.
  explicit Replay(const std::filesystem::path& folder, bool as_is = false);
  ~Replay() override;
  const std::vector<SourceVehicle>& vehicles() const override;
  StepData next() override;
  double duration_s() const override;
  double step_s() const override;
  std::string attribution() const override;
  const std::string& warning() const;  ///< how it is not a whole run as it was recorded; empty: it is

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace convoy::simulator
