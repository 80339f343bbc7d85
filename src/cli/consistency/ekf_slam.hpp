// Sensors simulated, everything behind them real: RangeBearingEkf, drift model, facts, associate(), global map. In the
// plane and in space, where the vehicle stands on a surface that nothing measures: its odometer is that of the plane.
#pragma once

#include <convoy/association/reach.hpp>
#include <convoy/drift/drift_model.hpp>
#include <convoy/frontend/range_bearing_ekf.hpp>
#include <convoy/map/global_map.hpp>

#include <cstdint>
#include <map>
#include <vector>

#include "consistency/paths.hpp"
#include "consistency/statistic.hpp"

namespace convoy::cli::consistency {

struct EkfSlamParams {
  Path path = Path::loop;
  int vehicles = 2;
  double noise = 1.0;  ///< factor on the sensors' standard deviations, which the front end is told
  // Sensor noise, one standard deviation; the front end is told.
  double sigma_along_per_sqrt_m = 0.05;
  double sigma_heading_per_sqrt_m = 0.004;  ///< 0.23 deg over a metre
  double sigma_range_m = 0.3;
  double sigma_bearing_rad = 0.0087;  ///< 0.5 deg; in space of the elevation, too
  // Violations: the front end is not told.
  double scale_error = 0.0;  ///< true distance per metre of odometry, minus 1
  double gyro_bias_rad_per_m = 0.0;
  double outliers = 0.0;  ///< share of sightings with a range and bearing of nothing
  double loss = 0.0;      ///< share of messages (an anchor, a batch, an association) that never arrive
  double start_sigma_m = 9.0, start_sigma_rad = 0.3;  ///< static bias of the second vehicle on
  double gap_m = 20.0;
  double repeat_m = 0.0;  ///< > 0: the street looks the same again after this length
  double landmarks_per_metre = 0.4, landmark_spacing_m = 2.0;
};

/// What the vehicles' own SLAMs said in one run, and the truth.
template <class G>
struct SlamRun {
  struct Vehicle {
    std::vector<FrontEndState<G>> states;                      ///< as the filter said them while driving
    std::vector<std::pair<std::size_t, Segment<G>>> segments;  ///< each closed before states[first]
    std::vector<G> truth;                                      ///< at the closing of each segment
    G T_start;
    PriorFact<G> start;
  };
  std::vector<Vehicle> vehicles;
};

template <class G>
SlamRun<G> drive_ekf_slam(const EkfSlamParams& params, std::uint64_t seed, int run);

/// The vehicles' anchors with the SLAM's own covariance and nothing else: the raw SLAM.
template <class G>
std::vector<TrueTrack<G>> raw_tracks(const SlamRun<G>& run);

/// The facts that the run amounts to under `drift`; every pair of batches through associate(); the global map of
/// `backend`. Of the facts, the share `params.loss` is not there.
template <class G>
RunSample judge_ekf_slam(const SlamRun<G>& run, const EkfSlamParams& params, const DriftParams<G>& drift,
                         const Backend<G>& backend, std::uint64_t seed, int index);

}  // namespace convoy::cli::consistency
