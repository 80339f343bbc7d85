// `convoy calibrate`: the drift noise of a fleet, learnt from its runs (DESIGN B6).
#pragma once

#include <convoy/drift/calibration.hpp>
#include <convoy/geometry/groups.hpp>

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace convoy::cli {

struct CalibrateOptions {
  std::vector<std::filesystem::path> runs;  ///< run folders of `convoy demo`
  std::filesystem::path out;                ///< XML file for the fragment; empty: not written
  std::string by = "auto";                  ///< truth, closures, or auto: truth if every run has it
  double span_m = 80.0;                     ///< of a span against the truth; a third of the drive if that is shorter
  double truth_sigma_m = 0.003, truth_sigma_rad = 0.002;  ///< of the truth itself
  /// <drift> of a vehicle's configuration file: what its facts were made with has to be taken off again.
  std::function<DriftParams<SE2>(const std::filesystem::path&)> drift_of_config;
};

struct CalibratedDrive {
  std::string run;
  VehicleId vehicle = 0;
  double length_m = 0.0;
  std::size_t constants_group = 0, constants_chain = 0;  ///< where its constants are in with_constants.constants
};

struct CalibrationResult {
  bool by_truth = false;
  double span_m = 0.0;  ///< the shortest used; 0: by closures
  std::vector<CalibratedDrive> drives;
  std::size_t closures = 0;  ///< used as evidence, without truth
  VarianceFit fit;           ///< without constants
  /// What a vehicle is to be given: as `fit`, but gamma = 1, the safe default, as long as the interval of gamma holds 1
  /// (SLAM and unknown drift grow alike, so that few drives can only tell their sum), and with the constants if they
  /// are there.
  VarianceFit given;
  VarianceFit with_constants;
  /// The constants explain what chance would in one case of twenty only.
  bool constants_found() const { return 2.0 * (with_constants.log_likelihood - fit.log_likelihood) > 5.99; }
  std::optional<Lag1> lag1;           ///< of the drift, whitened by `fit`
  PartEstimate landmark_inflation;    ///< unknown if the runs hold no loadings of landmarks, or no association
  std::vector<std::string> left_out;  ///< what was not used, and why
};

/// Throws ConfigError when a folder is no run or nothing is left to learn from.
CalibrationResult calibrate(const CalibrateOptions& options);

/// The element that `convoy vehicle` takes, with the intervals as a comment before it.
std::string drift_fragment(const CalibrationResult& result);

/// For a terminal: estimates with intervals, lag-1 correlation, what was left out.
std::string calibration_text(const CalibrationResult& result);

/// The command: prints, and writes the fragment. Returns 0.
int run_calibrate(const CalibrateOptions& options);

}  // namespace convoy::cli
