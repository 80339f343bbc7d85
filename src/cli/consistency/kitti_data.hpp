// Real recordings: camera poses in KITTI's text format (the truth, and what a SLAM made of the images), and the
// odometry of pose graphs whose vertices are KITTI frames.
#pragma once

#include <convoy/drift/calibration.hpp>
#include <convoy/solver/g2o.hpp>

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace convoy::cli::consistency {

/// A pose of a file: body frame x forward, y left, z up; KITTI's camera is x right, y down, z forward.
struct FramePose {
  std::uint32_t frame = 0;
  SE3 T_start_body;
};

/// Lines of 12 numbers, the rows of a 3 x 4 pose of the left camera [m], one line per frame from 0; or of 13, the first
/// one the frame. Frames ascend, rotations are orthonormal to 1e-3. Throws ConfigError, "file:line: what".
std::vector<FramePose> read_kitti_poses(const std::filesystem::path& file);

/// Seen from above: x, y and where the forward axis points.
SE2 on_plane(const SE3& T);

/// What a SLAM said it drove, and the truth at the same frames.
template <class G>
struct Recording {
  std::string name;
  DrivenPath<G> slam;    ///< abscissa: the length of what the SLAM says; no covariance of its own
  std::vector<G> truth;  ///< one pose per state
  double scale = 1.0;    ///< that positions of the file were multiplied by
};

/// `estimate` beside `truth` at the frames of `estimate`. With `scale_over_m` > 0 positions are scaled so that the
/// SLAM's length of the first so many true metres is right; 0: as they are. Throws ConfigError if the truth lacks a
/// frame, or the estimate does not move.
Recording<SE3> recording_of(const std::string& name, const std::vector<FramePose>& estimate,
                            const std::vector<FramePose>& truth, double scale_over_m);

/// Metres to the left per radian of left turn, over the edges k -> k + 1: where the body's origin sits before the rear
/// axle. The odometry of the public graphs has it mirrored: its lateral component points right, its angle and the loop
/// edges left.
struct LateralSense {
  double said_m_per_rad = 0.0, true_m_per_rad = 0.0;
  bool mirrored() const { return said_m_per_rad * true_m_per_rad < 0.0; }
};
LateralSense lateral_sense(const G2oFile& graph, const std::vector<FramePose>& truth);

/// The chain of edges k -> k + 1, its lateral component turned round if it is mirrored. Throws ConfigError if vertices
/// are not 0, 1, ..., or an edge of the chain is not there. `file_name` stands for the file in errors.
Recording<SE2> odometry_of(const std::string& name, const G2oFile& graph, const std::string& file_name,
                           const std::vector<FramePose>& truth);

/// States [begin, end), as they stand in the frame of the whole chain.
template <class G>
Recording<G> part_of(const Recording<G>& whole, std::size_t begin, std::size_t end);

/// States [begin, end) as a chain of its own: the first one is the origin, abscissa 0. The truth stays as it is.
template <class G>
Recording<G> chain_of(const Recording<G>& whole, std::size_t begin, std::size_t end);

/// The first state in the second half of what was driven.
template <class G>
std::size_t middle_of(const Recording<G>& recording);

}  // namespace convoy::cli::consistency
