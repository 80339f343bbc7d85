// FrontEnd: the seam to a vehicle's own ("low-level") SLAM, whatever it is (paper, Section III: "any sensor and
// filtering method as long as it furnishes accurate landmarks and their uncertainties along with vehicle information").
//
// What a front end promises, checked by the contract tests:
// - each landmark is exported once, in a segment, and has left the SLAM then: a later sighting is a new landmark;
// - landmark covariances are relative to the closing anchor, never to the start frame (DESIGN B3);
// - stamps and abscissa never decrease, nor does slam_drift from anchor to anchor (between anchors a SLAM may regain
// some
//   of what it lost); poses are in the start frame of the epoch, whose first pose is the identity.
#pragma once

#include <convoy/submap/facts.hpp>

#include <optional>
#include <vector>

namespace convoy {

template <class G>
struct FrontEndState {
  double stamp_s = 0.0;
  double abscissa_m = 0.0;
  G pose;  ///< T_slam_body
  /// Cumulative covariance of the SLAM's own motion error, slam frame: sum over the anchors passed of
  /// Ad_{X^_k} S_k Ad_{X^_k}^T, with S_k the covariance of the relative pose between neighbouring anchors (right
  /// perturbation), plus the part since the last one. Zero from a black box that states none.
  typename G::Covariance slam_drift = G::Covariance::Zero();
};

template <class G>
struct FrozenLandmark {
  typename G::Point position = G::Point::Zero();                        ///< in the closing anchor's frame [m]
  typename G::PointCovariance covariance = G::PointCovariance::Zero();  ///< relative to the closing anchor [m^2]
  typename G::Loading loading = G::Loading::Zero();  ///< shared part of the error, see LandmarkFact; zero: none stated
  Descriptor descriptor;
  std::uint64_t track =
      0;                  ///< the front end's own name for what it followed; never leaves the vehicle; see remembered()
  std::uint8_t kind = 0;  ///< what sort of thing it is, see LandmarkFact
};

/// Splits the joint covariance of a batch (Dim n x Dim n, positive semidefinite) into the loadings of each landmark:
/// the G::Shared strongest components that they have in common. Exact in every landmark's own block.
template <class G>
std::vector<typename G::Loading> shared_loadings(const Eigen::MatrixXd& joint);

/// A piece of the path with the landmarks that converged on it, all in the frame of its closing anchor.
template <class G>
struct Segment {
  FrontEndState<G> closing;
  /// States along the segment, in order, as the SLAM knows them now that it has closed (smoothed); may be empty. What
  /// state() said then was filtered only.
  std::vector<FrontEndState<G>> trail;
  std::vector<FrozenLandmark<G>> landmarks;
};

/// Landmarks that a SLAM still knows, relative to where it is now.
template <class G>
struct RelativeLandmarks {
  std::vector<std::uint64_t> tracks;         ///< the front end's own names, as in FrozenLandmark
  std::vector<typename G::Point> positions;  ///< body frame [m]
  Eigen::MatrixXd covariance;                ///< joint, Dim n x Dim n [m^2]
};

/// Some of them, in the order of `indices`.
template <class G>
RelativeLandmarks<G> subset(const RelativeLandmarks<G>& landmarks, const std::vector<std::size_t>& indices);

/// The joint covariance of landmarks in two parts: what moves them all like one body, and what is each one's own (its
/// block of the rest, with a floor of (1 cm)^2). Whoever lays them onto something by their own parts adds the shared
/// one.
template <class G>
struct RigidPart {
  typename G::Covariance shared =
      G::Covariance::Zero();                     ///< as an error of the pose they are seen from: right perturbation
  std::vector<typename G::PointCovariance> own;  ///< [m^2]
};

/// Empty if they are fewer than Dim + 1, or lie so that they do not fix a pose.
template <class G>
std::optional<RigidPart<G>> rigid_part(const RelativeLandmarks<G>& landmarks);

template <class G>
class FrontEnd {
 public:
  virtual ~FrontEnd() = default;
  virtual FrontEndState<G> state() const = 0;
  /// The same without what no fact may use (DESIGN R5), for facts that are stated between anchors. A SLAM that knows
  /// its present pose by landmarks it has exported must leave them out here; relative to the last anchor.
  virtual FrontEndState<G> exportable_state() const { return state(); }
  /// What the SLAM still knows of landmarks that it has exported, however long ago it saw them: the live pose is
  /// improved by laying them onto the map; no fact uses it. Give each once, by the FrozenLandmark::track it was
  /// exported under, which must then be unique; others may be among them. What is not usable (see RelativeLandmarks) is
  /// counted and left out (FrontEndComponent::remembered_unfit). Called at every live pose and snapshot.
  virtual RelativeLandmarks<G> remembered() const { return {}; }
  /// True if the world is measured by the odometer, as with a single camera: an error of its scale is then one of all
  /// landmarks, too (PersistentDrift::scales_landmarks). Asked once, at the beginning of a chain.
  virtual bool scales_landmarks() const { return false; }
  /// Segments closed since the last call, oldest first; none closes later than state().
  virtual std::vector<Segment<G>> take_segments() = 0;
};

}  // namespace convoy
