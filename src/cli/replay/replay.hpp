// convoy replay: a recording through the front end and the components of a vehicle, as a vehicle would have it, and
// judged as a run is. On the recording's own clock, as fast as it goes, in one thread: the same recording gives the
// same facts, to the bit.
//
// victoria: the scenario of victoria_park.hpp, three vehicles that hear each other at once. RUN is their run folder
// (scenario.hpp, run_folder.hpp), with
//   RUN/vehicle_<id>/front_end.csv   what the front end did, scan by scan (front_end_record.hpp)
//
// images, kitti: RUN is the run folder of a fleet of one, with
//   RUN/vehicle_1/front_end.csv   what the front end did, image by image (front_end_record.hpp)
//   RUN/frames/000123.png         some images, with the features that were found in them
// Times in it count from the recording's first image or reading (run.json, start_stamp_s). Each time that the front end
// is lost, it begins anew, and a new epoch with it. Of images without an odometer there are only front_end.csv,
// frames/, metrics.json and report.html.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

namespace convoy::cli {

struct ReplayOptions {
  std::string dataset;  ///< "images" or "kitti", see recording.hpp, or "victoria"
  std::filesystem::path folder, out;
  double rate_hz = 0.0;    ///< of images whose stamps are not told; 0: not given
  int features = 0;        ///< MonocularSlamParams::features; 0: its default
  std::uint64_t seed = 1;  ///< of the priors of victoria
};

/// The exit status: 0, or 1 if a fleet did not come to hold the same map. Throws ConfigError.
int run_replay(const ReplayOptions& options);

}  // namespace convoy::cli
