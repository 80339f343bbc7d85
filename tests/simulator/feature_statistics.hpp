// How trackable a scene's frames are: what a front end of small patches would find in them, judged by the truth.
#pragma once

#include "camera.hpp"
#include "scene.hpp"

#include <Eigen/Geometry>

#include <cstddef>
#include <vector>

namespace convoy::simulator {

struct FeatureParams {
  std::size_t tracks = 60;        ///< held at a time; new Shi-Tomasi corners replace lost ones
  double prediction_px = 2.0;     ///< noise of where a patch is looked for, standard deviation per axis
  int search_px = 6;              ///< each way: three standard deviations
  double accept = 0.8;            ///< least ZNCC of 11 x 11 patches
  double renew = 0.9;             ///< below that, a track goes on with the patch as it is seen now
  double good_px = 2.5;           ///< of the truth
  std::size_t misses = 1;         ///< frames in a row that a track outlives its patch not being found
  std::size_t mapped_after = 7;   ///< frames of its track: a landmark by then
  double second_left_m = 2.0;     ///< of the second vehicle's line
  std::size_t second_reach = 10;  ///< frames before and after in which it may find a patch
};

struct FeatureStatistics {
  std::size_t frames = 0, tracks = 0, matches = 0, mapped = 0, pairs = 0;
  double median_track = 0.0, p95_track = 0.0;  ///< frames
  double good_matches = 0.0;                   ///< share of matches within good_px of the truth
  double found_by_second = 0.0;                ///< share of the mapped patches that the second vehicle sees
  double wrong_pairs = 0.0;                    ///< share of pairs of different patches of a frame above `accept`
};

/// Drives the poses, one per frame, and again beside them. A patch that is matched beside the truth counts as not
/// found, as a gate would have it. A track ends as its patch leaves the frame, too; its length is that of its good
/// matches and its first sight. A patch is mapped when its track has been good for long
/// enough, as it looks then and where its middle is.
FeatureStatistics feature_statistics(const Scene& scene, const CameraParams& camera,
                                     const std::vector<Eigen::Isometry3d>& T_world_body,
                                     const FeatureParams& params = {});

}  // namespace convoy::simulator
