// Loader of the Victoria Park data set (Guivant, Nebot: Optimization of the simultaneous localization and map-building
// algorithm for real-time implementation, IEEE T-RA 17(3), 2001): a truck with a laser that sees the trunks of trees.
#pragma once

#include <cstdint>
#include <filesystem>

#include "scenario/scenario.hpp"

namespace convoy::cli {

/// Reads odometry.csv, gps.csv and tree_detections.csv, and cuts the drive into three windows of equal length: three
/// vehicles that drive through the same park at the same time, ids 1 to 3, each with a clock that starts at 0.
/// - Odometry is that of the rear axle's centre; detections are taken from the laser to there.
/// - Detections have no identities: tree_tracker.hpp follows them, window by window. Those without a track are dropped
///   and counted as dropped_unknown_sightings; `source` says why.
/// - GPS is used for three things only: the truth, the means of the priors, and two constants of the steering sensor,
///   found once and for all. Its fixes are no sensor events.
/// - Truth: gps_reference.hpp, a measurement itself. Of the first 778 s of the recording it covers 84 %. Fixes left out
///   of the fit, 20 m of the way at a time, lie 0.40 m (median) and 1.3 m (90 %) from it. What GPS drifts by over
///   minutes is not in that: where accepted hypotheses bring two passes together, it contradicts them by 1.1 m in the
///   median, 2.3 m (90 %) and 3.0 m at most, and by 0.12 rad at most; pose_tolerance, 6 m and 0.25 rad, is twice that.
///   A hypothesis that is off by less goes unnoticed. Of landmarks there is no truth.
/// - Priors: vehicle 1 starts at the origin of the common frame; the others where the reference says, displaced by a
///   draw of 11 m in x and in y and 0.15 rad, which is their sigma.
/// Throws ConfigError with file:line if a file is missing, cut or malformed, or says nothing of one of the windows.
Scenario<SE2> load_victoria_park(const std::filesystem::path& folder, std::uint64_t seed);

}  // namespace convoy::cli
