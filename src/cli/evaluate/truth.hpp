// Geometry of judgement: rigid fits without scale, the truth at any moment, and where the body frame of the truth sits.
#pragma once

#include <Eigen/Core>
#include <convoy/geometry/groups.hpp>
#include <optional>
#include <vector>

#include "scenario/scenario.hpp"

namespace convoy::cli {

template <class G>
struct RigidFit {
  G T_to_from;
  double rmse_m = 0.0;
};

/// Least squares T with to_i = T from_i, no scale. Empty if the points do not fix it: fewer than two, sizes that
/// differ, all points of either set in one place, or in space on one line.
template <class G>
std::optional<RigidFit<G>> fit_rigid(const std::vector<typename G::Point>& from,
                                     const std::vector<typename G::Point>& to);

/// The pose at `share` (0..1) of the way from T_a to T_b along the geodesic, that is on one arc or helix.
template <class G>
G interpolated(const G& T_a, const G& T_b, double share);

/// The true pose at t, along the arc between the two neighbours. Empty before the first pose, after the last, and
/// inside a gap longer than max_gap_s.
template <class G>
std::optional<G> truth_at(const std::vector<TruthPose<G>>& truth, double t_s, double max_gap_s = 0.5);

/// Where the body frame of the truth (markers of a motion capture system) sits on the vehicle, whose own body frame is
/// the odometer's: x along the way it drives. T_odometer_truth = (forward_m, 0, heading_rad).
struct TruthMount {
  double forward_m = 0.0;
  double heading_rad = 0.0;
  SE2 T_body_truth() const { return {forward_m, 0.0, heading_rad}; }
};

/// Found from the truth alone: a wheeled vehicle does not slip sideways, so over any short time rho_y = -tan(heading)
/// rho_x + forward / cos(heading) omega. Trimmed least squares; empty if it hardly moves. Seen by nobody but the judge.
std::optional<TruthMount> find_truth_mount(const std::vector<TruthPose<SE2>>& truth);

}  // namespace convoy::cli
