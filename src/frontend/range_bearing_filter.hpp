// The right-invariant filter of the planar front end: a pose, the landmarks it follows, clones of past poses.
//
// It lives in the frame of its last anchor, so that its covariances are relative to it and stay small however far the
// vehicle has come. Error state (DESIGN B3): X = Exp(xi) X^ for the pose, l = R(xi_theta) l^ + xi_l for a landmark,
// xi = (rho, theta, l_1, l_2, ..., c_1, c_2, ...), with clones c of past poses that are smoothed along. In these coordinates
// F = I, a sighting sees R^T (xi_l - xi_rho) and no heading, so that the heading, which nothing observes, gains no
// information from moving linearisation points.
#pragma once

#include <convoy/geometry/se2.hpp>

#include <cstdint>
#include <optional>
#include <vector>

namespace convoy {

/// A landmark that the filter follows.
struct RangeBearingTrack {
  std::uint64_t id = 0;
  Eigen::Vector2d position = Eigen::Vector2d::Zero();  ///< frame of the last anchor [m]
  double last_s = 0.0;                                 ///< time of the last sighting that was used
  int sightings = 0;
  int rejections = 0;                                  ///< in a row
  double ray_low = 0.0, ray_high = 0.0;                ///< directions it was seen along, relative to the first one [rad]
  double first_ray = 0.0;                              ///< frame of the last anchor [rad]
  std::vector<double> nis;                             ///< latest, at most `nis_window`
};

/// A past pose that later sightings smooth.
struct PoseClone {
  double stamp_s = 0.0, abscissa_m = 0.0;
  SE2 pose;  ///< T_anchor_body
  SE2::Covariance covariance = SE2::Covariance::Zero();  ///< of a left perturbation, relative to the anchor
};

class RangeBearingFilter {
 public:
  /// variance: of (along, across, heading) of this step, body frame.
  void move(const SE2& step, const Eigen::Vector3d& variance);

  /// A landmark never seen before. noise: of (range [m], bearing [rad]).
  void add(double stamp_s, std::uint64_t id, double range_m, double bearing_rad, const Eigen::Matrix2d& noise);

  /// How far track `index` should be. [m]
  double predicted_range(std::size_t index) const { return (tracks_[index].position - pose_.translation()).norm(); }

  /// Track `index` was seen. Returns the squared normalised innovation; beyond `gate` nothing but `rejections` changes.
  double update(std::size_t index, double stamp_s, double range_m, double bearing_rad, const Eigen::Matrix2d& noise,
                double gate, int nis_window);

  void clone_pose(double stamp_s, double abscissa_m);
  void drop(const std::vector<std::size_t>& tracks);
  /// The current pose becomes the anchor; clones are forgotten.
  void rebase();

  std::optional<std::size_t> find(std::uint64_t id) const;
  const std::vector<RangeBearingTrack>& tracks() const { return tracks_; }
  const SE2& pose() const { return pose_; }  ///< T_anchor_body
  SE2::Covariance pose_covariance() const { return P_.topLeftCorner<3, 3>(); }
  /// Joint covariance of these tracks relative to the current pose, in its frame. 2 n x 2 n.
  Eigen::MatrixXd relative_covariance(const std::vector<std::size_t>& tracks) const;
  std::vector<PoseClone> clones() const;

 private:
  void correct(const Eigen::MatrixXd& H, const Eigen::Vector2d& innovation, const Eigen::Matrix2d& S);
  static Eigen::Index column(std::size_t track) { return 3 + 2 * static_cast<Eigen::Index>(track); }
  Eigen::Index clone_column(std::size_t clone) const {
    return column(tracks_.size()) + 3 * static_cast<Eigen::Index>(clone);
  }

  SE2 pose_;
  std::vector<RangeBearingTrack> tracks_;
  std::vector<PoseClone> clones_;
  Eigen::MatrixXd P_ = Eigen::MatrixXd::Zero(3, 3);  // (3 + 2 tracks + 3 clones)^2, error state in the order above
};

}  // namespace convoy
