// What "consistent" means here, as numbers (DESIGN B8).
//
// Per step: r = Log(T^^-1 T), NEES = r^T P^-1 r. Averaged over M runs and divided by d it lies, for an honest
// covariance, in the band chi2_{Md}(0.025, 0.975) / (Md) at 95 % of the steps. Steps of one run are correlated, so the
// interval of the mean over all steps is a bootstrap over runs, never over steps.
#pragma once

#include <convoy/geometry/groups.hpp>
#include <convoy/map/map.hpp>

#include <cstdint>
#include <vector>

namespace convoy::cli::consistency {

/// One pose of one run against the truth.
struct PoseSample {
  int vehicle = 0, step = 0;
  double abscissa_m = 0.0;        ///< driven so far
  double squared_distance = 0.0;  ///< r^T P^-1 r, d degrees of freedom
  double position_error_m = 0.0;
};

/// One run under one model.
struct RunSample {
  std::vector<PoseSample> poses;
  std::vector<double> distance_errors_m;  ///< between vehicles at the same step, once they have recognised each other
  bool unlinked = false;                  ///< a vehicle that the map ties to no other
  int false_fusions = 0;                  ///< classes of the final map that hold different things
  int true_stated = 0, true_dropped = 0;  ///< hypotheses that are right, and those of them that the map left out
  int false_stated = 0;                   ///< hypotheses that are wrong
};

/// A vehicle's true poses where its SLAM said `state`.
template <class G>
struct TrueStep {
  ChainState<G> state;
  G T_common_body;
};
template <class G>
struct TrueTrack {
  ChainId chain;
  PriorFact<G> start;
  std::vector<TrueStep<G>> steps;
};

/// Poses as the map has them.
template <class G>
RunSample judge(Map<G>& map, const std::vector<TrueTrack<G>>& tracks);

/// Poses as each vehicle's SLAM has them, composed in its start frame behind the static bias; nothing is fused.
/// The covariance is the one that `state` carries.
template <class G>
RunSample judge_raw(const std::vector<TrueTrack<G>>& tracks);

/// Over the runs, at about the same distance driven, all vehicles together.
struct CurvePoint {
  double abscissa_m = 0.0;
  double anees = 0.0;
  double coverage95 = 0.0;
  double pos_rmse_m = 0.0;
};

struct Summary {
  int runs = 0;
  double anees = 0.0, anees_low = 0.0, anees_high = 0.0;  ///< mean over all steps, 95 % bootstrap interval over runs
  double steps_in_band = 0.0;                             ///< share of the steps (of each vehicle) in the 95 % band
  int steps = 0;
  double coverage95 = 0.0;  ///< share of the poses within their 95 % ellipsoid
  double pos_rmse_m = 0.0;
  double distance_rmse_m = 0.0;  ///< NaN with one vehicle
  double band_low = 0.0, band_high = 0.0;
  int false_fusions = 0, true_stated = 0, true_dropped = 0, false_stated = 0;
  int unlinked_runs = 0;
  std::vector<CurvePoint> curve;
};

/// `covariance_scale`: what the stated covariances are multiplied by first (negative controls). `bootstrap_seed` is
/// printed beside the results.
Summary summarise(const std::vector<RunSample>& runs, int dof, double covariance_scale = 1.0,
                  std::uint64_t bootstrap_seed = 1);

}  // namespace convoy::cli::consistency
