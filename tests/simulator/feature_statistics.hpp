// How trackable a scene's frames are: what a front end of small patches would find in them, judged by the truth.
#pragma once

#include "camera.hpp"
#include "scene.hpp"

#include <Eigen/Geometry>

#include <array>
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

/// How the second vehicle expects a patch to look from where it is; it knows both poses exactly.
enum class Warp {
  kNone,     ///< as it was when it was mapped
  kFacing,   ///< as if its surface had faced the camera that mapped it: what a tracker can do that knows no normals
  kSurface,  ///< by the normal of the surface that it is on: the best that can be done
};
constexpr std::size_t kWarps = 3;

struct FeatureStatistics {
  std::size_t frames = 0, tracks = 0, matches = 0, mapped = 0, pairs = 0;
  double median_track = 0.0, p95_track = 0.0;    ///< frames
  double good_matches = 0.0;                     ///< share of matches within good_px of the truth
  std::array<double, kWarps> found_by_second{};  ///< share of the mapped patches that the second vehicle sees, by Warp
  double wrong_pairs = 0.0;                      ///< share of pairs of different patches of a frame above `accept`
};

/// Drives the poses, one per frame, and again beside them.
///
/// First drive: corners are followed by the best ZNCC near where the truth, with noise, says they are. A match above
/// `accept` that is not within good_px of the truth is a bad one and counts as a miss, as a gate would have it. A track
/// ends by misses, or when its patch leaves the frame; its length is that of its good matches and its first sight. Its
/// patch is renewed only when it matches below `renew`, so that tracks are longer than with the first sight's patch.
///
/// Second drive: a patch is mapped as its track's length reaches mapped_after, as it looks then and where its middle
/// is; what never lasts that long is not asked for. It counts as seen if, in a frame within second_reach of that one,
/// its point is in the frame and nothing is in front of it, and as found if in any such frame the best match is above
/// `accept` and within good_px of the truth. The warp is linear about the patch's middle.
FeatureStatistics feature_statistics(const Scene& scene, const CameraParams& camera,
                                     const std::vector<Eigen::Isometry3d>& T_world_body,
                                     const FeatureParams& params = {});

}  // namespace convoy::simulator
