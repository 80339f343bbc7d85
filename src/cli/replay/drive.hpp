// A recording driven by one vehicle: MonocularSlam within the components, on the recording's clock, in the caller's
// thread. It leaves what a vehicle leaves (vehicle_output.hpp).
#pragma once

#include <convoy/components/vehicle.hpp>
#include <convoy/exchange/in_process.hpp>
#include <convoy/vision/monocular_slam.hpp>

#include <cstdint>
#include <filesystem>
#include <optional>
#include <vector>

#include "evaluate/front_end_record.hpp"
#include "replay/frame_pictures.hpp"
#include "replay/progress.hpp"
#include "replay/recording.hpp"
#include "vehicle_output.hpp"

namespace convoy::cli {

/// What an image came to, without a pose.
FrontEndFrame counted(const ImageReport& report);

class Drive {
 public:
  static constexpr VehicleId self = 1;

  /// `recording` has an odometer and must outlive it. `folder`: of the vehicle, made if need be. Throws ConfigError.
  Drive(Recording& recording, const MonocularSlamParams& params, const std::filesystem::path& folder);

  /// The whole recording, once.
  void run();

  const std::vector<FrontEndFrame>& frames() const { return frames_; }
  const FramePictures& pictures() const { return pictures_; }
  /// Images that could not be read or that the front end would not take.
  std::uint64_t images_refused() const { return recording_.images->refused() + slam_.counters().images_refused; }
  const ActiveSearch& search() const { return slam_.search(); }
  /// Images before the odometer's first reading or after its last: of no use.
  std::uint64_t images_outside() const { return images_outside_; }

 private:
  void feed_images(double until_s);
  void drive(const OdometerReading& reading);
  void note(const ImageReport& report, const cv::Mat& grey);
  void begin_epoch();
  void begin_again();
  void tell(double now_s);
  void finish();

  Recording& recording_;
  MonocularSlam slam_;
  VehicleOutput<SE3> output_;
  InProcessNetwork<SE3> network_;
  double now_s_ = 0.0, next_live_s_ = 0.0;
  Vehicle<SE3> vehicle_;
  SourceImage image_;  // the next one
  Epoch epoch_ = 0;
  SE3 T_start_epoch_;              // from the first epoch's start to this one's
  double path_before_m_ = 0.0;     // of the epochs before
  SE3 T_start_from_, T_start_to_;  // by the odometer alone, at the last two readings, ...
  double from_s_ = 0.0;            // ... and when they were
  std::optional<double> to_s_;
  std::uint32_t exported_ = 0;
  std::uint64_t images_outside_ = 0;
  std::vector<FrontEndFrame> frames_;
  FramePictures pictures_;
  Progress progress_;
};

}  // namespace convoy::cli
