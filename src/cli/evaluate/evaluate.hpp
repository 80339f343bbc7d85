// The judge: a finished run against the truth.
//
// Frames. The common frame is the start frame of one vehicle's SLAM. To compare with the truth, T_world_common is
// needed, and there are two ways to it:
//   gauge "start"  the true pose of the common-frame vehicle at its first sensor event. Exact in simulation. With a
//                  motion capture system it is off by the angle at which the markers' frame happens to sit on that
//                  vehicle, and this angle turns the whole fleet.
//   gauge "fit"    one rigid motion (no scale) for the whole fleet, fitted to the positions of all corrected
//                  trajectories.
// pose_anees and pose_coverage95 use "start" for the street and "fit" for recordings; both are given under their own
// names (..._start, ..._fit). A third variant, ..._mounted, uses "fit" and takes off, vehicle by vehicle, the angle and
// the forward offset of the truth's body frame, found from the truth alone (find_truth_mount). Position errors (ATE)
// always use "fit" and the truth as it was recorded. gauge_shift_m and gauge_turn_rad say how far "fit" lies from
// "start". The start of the common-frame vehicle is known exactly, so that its first poses hardly have a covariance: in
// gauge "fit" this distance counts against them in full, and its pose_anees may be in the thousands by a few poses
// alone. Its pose_anees_start knows nothing of that, and a coverage counts those few poses as few; the report shows
// both gauges.
//
// Consistency. NEES = r^T P^-1 r, r = Log(T_est^-1 T_true), of Dof = 3 degrees of freedom in the plane, 6 in space;
// anees is the mean of NEES / Dof (1 is ideal, above is overconfident), coverage95 the share with NEES <= chi2(0.95,
// Dof). "Live" is what a vehicle said of itself at the time, once a second, once aligned; "trajectory" is the whole
// path corrected with the final map. Poses whose covariance is not positive definite (the start of the common-frame
// vehicle is known exactly) cannot be judged; they are left out and counted in poses_without_covariance.
//
// Distances. Of a pair, as both vehicles saw it live: a's own pose with the pose of b whose stamp is nearest (within
// 1.5 s), against the truth at the same two stamps, so that latency does not look like error. "raw" takes each
// vehicle's SLAM pose as if all had started in one place. The pair's first association is the first moment at which
// accepted associations link the two, directly or through others; distance_rmse_m and ..._settled_m (10 s later on)
// begin there, ..._raw_after_m and ..._raw_settled_m are of the very same samples, and distance_error_final_m is of the
// last of them, at distance_error_final_s. distance_rmse_corrected_m instead is of the whole run, as the vehicles know
// it in the end: at each row of one corrected trajectory the other's pose at the same moment, between its two
// neighbouring rows along the geodesic, and the same with the two exchanged. distance_samples, ..._raw, ..._settled and
// ..._corrected count what each of these rests on, both ways of looking together; below enough_distance_samples an RMSE
// says nothing.
//
// Associations. Where the tracks of a run are landmarks, a pairing is true if both are the same (judged_by
// "identities"), and a hypothesis false if one of its pairings is. Where cameras follow what has no name, the truth has
// the point of the world that each track's pixels showed (truth/tracks_<id>.csv), and a pairing is true if the two are
// no further apart than same_place_m ("places"; apart_median_m and apart_p95_m are of all pairings judged). Where
// nobody knows the landmarks and the truth of poses is itself a measurement (Scenario::pose_tolerance), judged_by is
// "poses": a hypothesis is false if the true poses at the two anchors put its landmarks, as each batch has them,
// further apart than that tolerance in the mean, or turn them against each other; hypotheses_unjudged count those with
// no true pose. Of single pairings nothing is said then, nor of covariances; errors of poses and distances are those of
// the truth, too.
//
// The entry "front_end", of the fleet and of each vehicle, is told of in front_end_record.hpp; null unless the run was
// one of `convoy replay`.
//
// In space all this is of three dimensions: distances, ATE, rigid fits, gauge_turn_rad (about any axis). Gauge
// "mounted" and truth_mount_... are planar, and null there.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "evaluate/run_folder.hpp"
#include "evaluate/truth.hpp"

namespace convoy::cli {

/// Live distances, of which both vehicles have one per second, that it takes to say how well a distance is known.
inline constexpr std::size_t enough_distance_samples = 10;

struct TimedValue {
  double t_s = 0.0;
  double value = 0.0;
};

struct DistanceSample {
  double t_s = 0.0;  ///< of the viewer's own pose
  double true_m = 0.0;
  double raw_m = 0.0;
  std::optional<double> convoy_m;  ///< empty while one of the two is not aligned
};

struct PairSeries {
  VehicleId a = 0, b = 0;
  std::optional<double> first_association_s;
  std::vector<DistanceSample> distances;  ///< as seen by the first vehicle of the pair that left a live.csv
  std::size_t without_peer = 0;           ///< its poses to which none of the other one was near enough in time
  std::size_t without_truth = 0;          ///< its poses where the truth of one of the two has a gap
};

template <class G>
struct Evaluation {
  nlohmann::json metrics;                                    ///< the content of metrics.json
  std::optional<G> T_world_common;                           ///< the gauge that the figures use
  std::map<VehicleId, std::vector<TimedValue>> live_nees;    ///< in the gauge of pose_anees
  std::map<VehicleId, std::vector<TimedValue>> bytes_per_s;  ///< by whole second
  std::vector<PairSeries> pairs;
};

/// Judges a run. What cannot be known (no truth, a missing file) is null in the metrics, never a guess.
template <class G>
Evaluation<G> evaluate(const RunRecord<G>& run);

/// Writes RUN/metrics.json and RUN/vehicle_<id>.tum. Throws ConfigError.
template <class G>
void write_evaluation(const RunRecord<G>& run, const Evaluation<G>& evaluation);

/// The corrected trajectory in the common frame as TUM text: t x y z qx qy qz qw.
template <class G>
std::string tum_trajectory(const std::vector<PoseRow<G>>& trajectory);

}  // namespace convoy::cli
