// Real drift: what the drift model covers and what it does not, on recordings of KITTI's vehicle. Part of `convoy
// consistency` where the recordings are on the machine.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "consistency/span_study.hpp"
#include "consistency/two_halves.hpp"

namespace convoy::cli::consistency {

struct RealDrift {
  std::string left_out;             ///< why nothing was measured, and how to mend it; empty: it was
  std::vector<std::string> absent;  ///< known recordings that the folder does not hold
  std::vector<std::pair<std::string, LateralSense>> lateral;  ///< of the graphs' odometry as published
  std::vector<SpanStudy> spans;
  std::vector<HalvesStudy> halves;
};

/// `data`: a folder that holds kitti_trajectories/ (gt/NN.txt, slam_estimates/NAME.txt) and pose_graphs/
/// (single/kitti_NN.g2o); whichever recordings are there are judged. Empty: the environment variable CONVOY_DATA_DIR,
/// and nothing is measured if there is none or it holds neither. Deterministic. Throws ConfigError if a folder that is
/// given holds neither, or a file is damaged.
RealDrift measure_real_drift(std::filesystem::path data);

/// One entry per sequence, length of span and model, and one per graph, start and model.
nlohmann::ordered_json to_json(const RealDrift& drift);

}  // namespace convoy::cli::consistency
