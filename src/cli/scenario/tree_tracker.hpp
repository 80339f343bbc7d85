// Gives names to what a laser sees: which detections of successive scans are one tree. It looks at seconds, in a frame
// that dead reckoning carries along, and recognises nothing that was out of sight: that is left to the association.
// Where it is not sure, it says nothing: a tree that is lost under one name comes back under another.
#pragma once

#include <Eigen/Core>
#include <convoy/geometry/groups.hpp>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace convoy::cli {

struct TreeTrackerParams {
  double gate_m = 0.8;          ///< a detection belongs to a track at most this far away, > 0 [m]
  double clear_m = 2.0;         ///< ... if no other track or detection is nearer than this, >= gate_m [m]
  double max_unseen_s = 2.0;    ///< a track that has not been seen for longer ends [s]
  double max_unseen_m = 8.0;    ///< ... or over more than so much of the way [m]
  int min_sightings = 8;        ///< a track with fewer is clutter, >= 1
  double min_seen_share = 0.5;  ///< ... and one that was seen in fewer of its scans, 0..1
  double motion_span_s = 3.0;   ///< a track that within so much time ... [s]
  double max_motion_m = 1.2;    ///< ... moves further than this is no tree [m]
};

/// One turn of the laser.
struct TreeScan {
  double t_s = 0.0;
  SE2 T_local_body;                       ///< by dead reckoning
  double driven_m = 0.0;                  ///< since any start
  std::vector<Eigen::Vector2d> points_m;  ///< detections, body frame
};

struct TreeTracks {
  static constexpr std::uint32_t none = 0;
  /// Of each scan, of each of its points: the number of its track, from 1 in the order of appearance, or none.
  std::vector<std::vector<std::uint32_t>> track_of;
  std::uint32_t tracks = 0;
  // Detections without a track, by reason:
  std::size_t unsure = 0;  ///< could be of two things
  std::size_t seldom = 0;  ///< of tracks that were seen too seldom
  std::size_t moving = 0;  ///< of tracks that moved
  std::uint32_t moving_tracks = 0;
};

/// Scans by time.
TreeTracks follow_trees(const std::vector<TreeScan>& scans, const TreeTrackerParams& params = {});

}  // namespace convoy::cli
