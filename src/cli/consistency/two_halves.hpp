// A real drive cut at its middle frame into two vehicles that do not know where they start: is their common map
// consistent?
//
// The odometry of the graph is what each vehicle's SLAM says (a black box: no covariance of its own). A loop edge
// becomes six landmarks that both ends have seen, placed as the edge says, with the edge's uncertainty as their shared
// error, so that the whole way from facts to map is taken: selection, problem, sparse map, classes.
#pragma once

#include <convoy/map/hypothesis.hpp>

#include <array>
#include <string>
#include <vector>

#include "consistency/kitti_data.hpp"
#include "consistency/span_study.hpp"
#include "consistency/statistic.hpp"

namespace convoy::cli::consistency {

/// A graph with its odometry and the truth.
struct RealGraph {
  std::string name;
  G2oFile graph;
  Recording<SE2> odometry;
};

/// What a loop edge says, against the truth: are the edges as good as they claim?
struct LoopQuality {
  int edges = 0, crossing = 0;  ///< crossing: between the two vehicles
  double median_error_m = 0.0, median_error_rad = 0.0, worst_error_m = 0.0;
  double stated_sigma_m = 0.0;  ///< median over the edges, root of the mean variance of x and y
  double anees = 0.0;
};

struct HalvesRow {
  std::string model;
  std::string start;  ///< what is known of the second vehicle's start
  bool fused = false;
  bool linked = false;  ///< the map ties the two together
  double ate_m = 0.0;   ///< RMSE of positions, in the frame of the first vehicle's known start; nothing is aligned
  double anees = 0.0, coverage95 = 0.0;
  double first_anees = 0.0, second_anees = 0.0;
  double distance_rmse_m = 0.0;
  int stated = 0, accepted = 0;
  std::string left_out;                             ///< why the others were
  std::vector<std::vector<Eigen::Vector2d>> paths;  ///< of each vehicle, common frame
  std::vector<std::vector<Eigen::Vector2d>> nees;   ///< of each vehicle: (m driven, NEES / d)
};

struct HalvesStudy {
  std::string name;
  FitFigures fit;
  double length_m = 0.0;
  int anchors = 0;  ///< judged, both vehicles
  LoopQuality loops;
  std::vector<std::vector<Eigen::Vector2d>> truth;
  std::vector<HalvesRow> rows;
};

/// `graph` under models that were fitted to the halves of `others`. Deterministic.
HalvesStudy study_halves(const RealGraph& graph, const std::vector<RealGraph>& others);

}  // namespace convoy::cli::consistency
