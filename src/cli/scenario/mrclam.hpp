// Loader of the UTIAS MR.CLAM data sets (Leung, Halpern, Barfoot, Liu: The UTIAS multi-robot cooperative localization
// and mapping dataset, IJRR 30(8), 2011): small robots that see the barcodes of landmarks and of each other.
#pragma once

#include <filesystem>

#include "scenario/scenario.hpp"

namespace convoy::cli {

/// Reads Barcodes.dat, Landmark_Groundtruth.dat and, for every robot N with an odometry file, RobotN_Odometry.dat,
/// RobotN_Measurement.dat and, if it is there, RobotN_Groundtruth.dat.
/// - Barcodes become subjects; subjects 6..20 are landmarks and become sightings with track = subject. Sightings of
///   robots (subjects 1..5) and of codes that belong to nothing are dropped and counted per vehicle.
/// - Times count from the first odometry stamp of all robots; what is older is left out, except for the truth.
/// - Stamps that step back by at most `max_step_back_s` are sorted (stable); further back is refused.
/// - There are no priors: nobody knows where the robots start. The common frame is that of the smallest robot number.
/// Throws ConfigError with file:line if a file is missing, cut or malformed.
Scenario<SE2> load_mrclam(const std::filesystem::path& folder, double max_step_back_s = 1.0);

}  // namespace convoy::cli
