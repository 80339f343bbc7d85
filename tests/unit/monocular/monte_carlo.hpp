// Runs of a synthetic street, and what they say about the filter's honesty.
#pragma once

#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/covariance.hpp>

#include "monocular_world.hpp"

#include <cstdio>

namespace convoy::test {

/// Mean of squared normalised errors, per degree of freedom.
struct MeanNees {
  double sum = 0.0;
  int values = 0, dof = 1;
  void add(double nees) {
    sum += nees;
    ++values;
  }
  double per_dof() const { return values ? sum / values / dof : 0.0; }
};

struct MonteCarlo {
  MeanNees pose{0, 0, 6};      ///< at the end of a run, by what the front end states
  MeanNees step{0, 0, 6};      ///< between neighbouring anchors
  MeanNees exported{0, 0, 3};  ///< landmarks relative to their closing anchor
  MeanNees relative{0, 0, 3};  ///< landmarks that the filter follows, relative to the pose
  double drift_squared = 0.0;  ///< of the position at the end [m^2]
  double driven_m = 0.0, worst_eigenvalue = 0.0;
  int runs = 0, exports = 0, lost = 0, segments = 0;
  std::size_t largest_state = 0;
  MonocularCounters counters;

  double drift_percent() const { return runs ? 100.0 * std::sqrt(drift_squared / runs) / (driven_m / runs) : 0.0; }
  double exports_per_100m() const { return 100.0 * exports / driven_m; }
  void print(const char* name) const {
    std::printf(
        "%s: %d runs, drift %.3f %%, ANEES/dof pose %.2f step %.2f, landmarks relative %.2f exported %.2f, "
        "%.0f exports per 100 m, state %zu, lost %d\n",
        name, runs, drift_percent(), pose.per_dof(), step.per_dof(), relative.per_dof(), exported.per_dof(),
        exports_per_100m(), largest_state, lost);
  }
};

inline void judge_relative(MonocularWorld& world, MonteCarlo& result) {
  const MonocularState& slam = world.ekf().filter().state();
  for (std::size_t i = 0; i < slam.landmarks().size(); ++i) {
    const Eigen::Vector3d truth = world.seen_from().inverse() * world.points()[world.point_of(slam.landmarks()[i].id)];
    const Eigen::Matrix3d P = slam.relative_covariance({i});
    const Eigen::Vector3d error = slam.pose().inverse() * slam.position(i) - truth;
    const double nees = squared_mahalanobis(error, P);
    if (std::isfinite(nees)) result.relative.add(nees);
  }
}

inline void run_once(const MonocularParams& params, const MonocularWorldParams& world_params, std::uint64_t seed,
                     MonteCarlo& result) {
  MonocularWorld world(params, world_params, seed);
  std::vector<Segment<SE3>> segments;
  int inputs = 0;
  world.run([&] {
    for (auto& segment : world.ekf().take_segments()) segments.push_back(std::move(segment));
    if (++inputs % 300 == 0) judge_relative(world, result);
  });
  ++result.runs;
  if (world.ekf().lost()) {
    ++result.lost;
    return;
  }
  SE3 before;
  FrontEndState<SE3> last;
  for (const auto& segment : segments) {
    const auto at = world.passed().find(segment.closing.stamp_s);
    if (at == world.passed().end()) continue;
    for (const auto& l : segment.landmarks) {
      const Eigen::Vector3d error = l.position - at->second.inverse() * world.points()[world.point_of(l.track)];
      result.exported.add(squared_mahalanobis(error, l.covariance));
      ++result.exports;
    }
    const auto step = increment(ChainState<SE3>{0, 0, last.pose, last.slam_drift, {}},
                                ChainState<SE3>{0, 0, segment.closing.pose, segment.closing.slam_drift, {}});
    const SE3 actual = before.inverse() * at->second;
    result.step.add(squared_mahalanobis((step.motion.inverse() * actual).Log(), step.covariance));
    before = at->second;
    last = segment.closing;
    ++result.segments;
  }
  const auto state = world.ekf().state();
  const SE3::Adjoint back = state.pose.inverse().adjoint();
  const SE3::Covariance P = back * state.slam_drift * back.transpose();
  result.pose.add(squared_mahalanobis((state.pose.inverse() * world.truth()).Log(), symmetrised(P)));
  result.drift_squared += (state.pose.translation() - world.truth().translation()).squaredNorm();
  result.driven_m += world.driven_m();
  result.largest_state = std::max(result.largest_state, world.largest_state);
  const MonocularCounters& c = world.ekf().counters();
  result.counters.landmarks_started += c.landmarks_started;
  result.counters.landmarks_dropped += c.landmarks_dropped;
  result.counters.landmarks_unfit += c.landmarks_unfit;
  result.counters.candidates_refused += c.candidates_refused;
  result.counters.slip_frames += c.slip_frames;
  result.counters.observations_used += c.observations_used;
  result.counters.observations_outlying += c.observations_outlying;
  result.counters.frames += c.frames;
}

inline MonteCarlo monte_carlo(const MonocularParams& params, const MonocularWorldParams& world,
                              std::uint64_t first_seed, int runs) {
  MonteCarlo result;
  for (int k = 0; k < runs; ++k) run_once(params, world, first_seed + static_cast<std::uint64_t>(k), result);
  return result;
}

}  // namespace convoy::test
