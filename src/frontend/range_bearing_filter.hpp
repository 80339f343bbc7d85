// The right-invariant filter of the range-bearing front end: a pose, the landmarks it follows, clones of past poses; in
// the plane or in space.
//
// It lives in the frame of its last anchor, so that its covariances are relative to it and stay small however far the
// vehicle has come. Error state (DESIGN B3): X = Exp(xi) X^ for the pose, l = R(xi_theta) l^ + xi_l for a landmark,
// xi = (rho, theta, l_1, l_2, ..., c_1, c_2, ...), with clones c of past poses that are smoothed along. In these
// coordinates F = I, a sighting sees R^T (xi_l - xi_rho) and no rotation, so that the rotation, which nothing observes,
// gains no information from moving linearisation points.
#pragma once

#include <convoy/geometry/groups.hpp>

#include <cstdint>
#include <optional>
#include <vector>

namespace convoy {

/// A landmark that the filter follows.
template <class G>
struct RangeBearingTrack {
  std::uint64_t id = 0;
  typename G::Point position = G::Point::Zero();  ///< frame of the last anchor [m]
  double last_s = 0.0;                            ///< time of the last sighting that was used
  int sightings = 0;
  int rejections = 0;                          ///< in a row
  typename G::Point ray_a = G::Point::Zero();  ///< of the unit vectors that it was seen along, frame of the last
  typename G::Point ray_b = G::Point::Zero();  ///< anchor, those two that are furthest apart ...
  double parallax_rad = 0.0;                   ///< ... by this angle
  std::vector<double> nis;                     ///< latest, at most `nis_window`
};

/// A past pose that later sightings smooth.
template <class G>
struct PoseClone {
  double stamp_s = 0.0, abscissa_m = 0.0;
  G pose;                                                     ///< T_anchor_body
  typename G::Covariance covariance = G::Covariance::Zero();  ///< of a left perturbation, relative to the anchor
};

template <class G>
class RangeBearingFilter {
 public:
  using Polar = typename G::Point;  ///< a sighting, polar.hpp: (range [m], bearing [rad], in space elevation [rad])
  using PolarNoise = typename G::PointCovariance;  ///< its covariance

  /// variance: of a right perturbation of this step, order (rho, theta).
  void move(const G& step, const typename G::Tangent& variance);

  /// A landmark never seen before.
  void add(double stamp_s, std::uint64_t id, const Polar& sighting, const PolarNoise& noise);

  /// How far track `index` should be. [m]
  double predicted_range(std::size_t index) const { return (tracks_[index].position - pose_.translation()).norm(); }

  /// Track `index` was seen. Returns the squared normalised innovation; beyond `gate` nothing but `rejections` changes.
  double update(std::size_t index, double stamp_s, const Polar& sighting, const PolarNoise& noise, double gate,
                int nis_window);

  void clone_pose(double stamp_s, double abscissa_m);
  void drop(const std::vector<std::size_t>& tracks);
  /// The current pose becomes the anchor; clones are forgotten.
  void rebase();

  std::optional<std::size_t> find(std::uint64_t id) const;
  const std::vector<RangeBearingTrack<G>>& tracks() const { return tracks_; }
  const G& pose() const { return pose_; }  ///< T_anchor_body
  /// Of a left perturbation, relative to the anchor.
  typename G::Covariance pose_covariance() const { return P_.template topLeftCorner<G::Dof, G::Dof>(); }
  /// Joint covariance of these tracks relative to the current pose, in its frame. Dim n x Dim n.
  Eigen::MatrixXd relative_covariance(const std::vector<std::size_t>& tracks) const;
  std::vector<PoseClone<G>> clones() const;

 private:
  void correct(const Eigen::MatrixXd& H, const Polar& innovation, const PolarNoise& S);
  static void widen_parallax(RangeBearingTrack<G>& track, const typename G::Point& ray);
  static Eigen::Index column(std::size_t track) { return G::Dof + G::Dim * static_cast<Eigen::Index>(track); }
  Eigen::Index clone_column(std::size_t clone) const {
    return column(tracks_.size()) + G::Dof * static_cast<Eigen::Index>(clone);
  }

  G pose_;
  std::vector<RangeBearingTrack<G>> tracks_;
  std::vector<PoseClone<G>> clones_;
  Eigen::MatrixXd P_ = Eigen::MatrixXd::Zero(G::Dof, G::Dof);  // (Dof + Dim tracks + Dof clones)^2, in the order above
};

}  // namespace convoy
