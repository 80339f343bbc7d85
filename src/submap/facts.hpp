// Facts: all that vehicles ever exchange about the world (paper, Section III; DESIGN A2, B9).
//
// A fact is first-hand, immutable and written once under a key that is never reused. Estimates that were fused from
// facts are never exchanged, so nothing can be counted twice. Frames: "slam" is the start frame of one vehicle's own
// SLAM, "anchor" the body frame of an anchor, "common" the frame of the fleet. Units: metres, radians, seconds.
#pragma once

#include <Eigen/Core>
#include <array>
#include <compare>
#include <cstdint>
#include <functional>
#include <utility>
#include <variant>
#include <vector>

namespace convoy {

using VehicleId = std::uint32_t;  ///< 1..4294967295; 0 means "nobody"
using Epoch = std::uint64_t;      ///< one uninterrupted run of a vehicle's SLAM; grows with each restart

/// One chain of anchors: a vehicle in one epoch. A restart shares nothing with the epoch before (DESIGN R5).
struct ChainId {
  VehicleId vehicle = 0;
  Epoch epoch = 0;
  auto operator<=>(const ChainId&) const = default;
};

/// Identity of a fact within its kind. The order of keys is the canonical order of every computation.
struct Key {
  ChainId chain;
  std::uint32_t index = 0;  ///< counts from 0 without holes, per chain and kind
  auto operator<=>(const Key&) const = default;
};

/// The kinds of fact, each with an index sequence of its own. The numbers are part of the wire format.
enum class FactKind : std::uint8_t {
  anchor = 0,
  landmark = 1,
  prior = 2,
  association = 3,
  verdict = 4,
  absolute_fix = 5,
  encounter = 6,
  waypoint = 7,
};
inline constexpr int fact_kind_count = 8;
const char* to_string(FactKind kind);

/// 64-bit content hash. The order-free sum of hashes is the digest of a set.
using Hash = std::uint64_t;

/// What a landmark looks like. Never compared across kinds.
struct Descriptor {
  enum class Kind : std::uint8_t {
    none = 0,
    /// 64 grey values of 4 bits, row by row, two to a byte, the first in the low half: an upright piece of a blurred
    /// image with a footprint of fixed size in metres, so that the distance it was seen from does not matter.
    patch_8x8_4bit = 1,
  };
  Kind kind = Kind::none;
  std::array<std::uint8_t, 32> bytes{};
  bool operator==(const Descriptor&) const = default;
};

/// Where a vehicle's own SLAM says it is, and how uncertain the drift up to there is.
template <class G>
struct ChainState {
  double stamp_s = 0.0;                                  ///< the vehicle's own clock
  double abscissa_m = 0.0;                               ///< curvilinear abscissa s since the epoch's start, >= 0
  G pose;                                                ///< X^: T_slam_body
  typename G::Covariance drift = G::Covariance::Zero();  ///< C, cumulative drift covariance (DESIGN eq. 2), slam frame
  /// What a heading drift of 1 rad per metre would have amounted to by now: the sum of Ad_{X^} e_yaw ds, slam frame.
  /// Like C, it lets anybody who holds two states know the effect in between (DESIGN B1.4). Zero if the chain states no
  /// such drift.
  typename G::Tangent heading_lever = G::Tangent::Zero();
};

/// What is known beforehand of the errors of a SLAM that are no random walk (DESIGN B1.3, F5). Zero: there are none.
struct PersistentDrift {
  double scale = 0.0;              ///< standard deviation of kappa: true distances are (1 + kappa) times what was said
  double heading_rad_per_m = 0.0;  ///< standard deviation of g: the true heading turns by g more per metre
  /// In space only: components whose errors are bounded, since something (gravity, pressure) is measured all the time.
  /// Their errors are an AR(1) process along the way, of this standard deviation and correlation exp(-ds /
  /// correlation_m); what the drift of the chain says of them is not used.
  double tilt_rad = 0.0;                         ///< of roll and pitch each
  double height_m = 0.0;                         ///< of the height above the level of the chain's start
  double correlation_m = 0.0;                    ///< > 0 if one of them is bounded
  Eigen::Vector3d up = Eigen::Vector3d::Zero();  ///< unit vector, slam frame; zero if none is bounded
  /// The SLAM measures the world by its odometer, as one with a single camera does: landmarks are (1 + kappa) times as
  /// far from their anchor as was said, too. Needs scale > 0.
  bool scales_landmarks = false;
  bool bounded() const { return tilt_rad > 0.0 || height_m > 0.0; }
  bool constant() const { return scale > 0.0 || heading_rad_per_m > 0.0; }
  bool operator==(const PersistentDrift&) const = default;
};

/// The anchor / bias node: index 0 is the epoch's start (identity, s = 0, C = 0).
template <class G>
struct AnchorFact {
  Key key;
  ChainState<G> state;
  /// The batch that closed here: indices [first_landmark, first_landmark + landmark_count). So everybody knows when a
  /// batch has arrived in full.
  std::uint32_t first_landmark = 0;
  std::uint32_t landmark_count = 0;
};

/// A landmark, frozen once converged, in the frame of its anchor. Landmarks of one anchor form a batch: they were
/// seen together as different things, so no two of them may ever be fused (DESIGN R4).
template <class G>
struct LandmarkFact {
  Key key;
  std::uint32_t anchor = 0;                                             ///< index of the anchor, same chain
  typename G::Point position = G::Point::Zero();                        ///< p_anchor [m]
  typename G::PointCovariance covariance = G::PointCovariance::Zero();  ///< Cov(l | anchor) [m^2]
  /// Landmarks of a batch were seen from one moving vehicle, so their errors have a part in common: for two of them
  /// Cov(l_i, l_j | anchor) = loading_i loading_j^T, and covariance - loading loading^T is what is a landmark's own.
  typename G::Loading loading = G::Loading::Zero();
  Descriptor descriptor;
  /// What sort of thing it is, by numbers that the fleet has agreed on; 0: not said. Things of two kinds are not the
  /// same.
  std::uint8_t kind = 0;
  Key anchor_key() const { return {key.chain, anchor}; }
  typename G::PointCovariance own_covariance() const { return covariance - loading * loading.transpose(); }
};

/// Static bias (paper, Fig. 2): where this chain starts in the common frame. Every chain states it once, at index 0;
/// an unknown start is stated too, so that nobody takes "not arrived yet" for "unknown".
template <class G>
struct PriorFact {
  Key key;
  bool known = false;                                         ///< false: mean is the identity, covariance zero
  G mean;                                                     ///< T_common_slam
  typename G::Covariance covariance = G::Covariance::Zero();  ///< of a right perturbation
  PersistentDrift persistent = {};
};

/// "These landmarks are the same": which, never how well (DESIGN R2). Selection demands pairs between two batches.
using Pairing = std::pair<Key, Key>;  ///< canonical: first < second
struct AssociationFact {
  Key key;                        ///< of the author; two authors may state the same hypothesis
  std::vector<Pairing> pairings;  ///< sorted, without repeats
};

/// An author's last word on a hypothesis: a later index of the same author replaces an earlier one.
struct VerdictFact {
  Key key;
  Hash hypothesis = 0;
  bool veto = false;
};

/// A receiver of absolute positions (GPS) said where its antenna was (F3). Hangs on the last anchor before it.
template <class G>
struct AbsoluteFixFact {
  Key key;
  std::uint32_t anchor = 0;                       ///< index of the anchor, same chain
  ChainState<G> state;                            ///< where the vehicle's own SLAM said it was at the fix
  typename G::Point lever = G::Point::Zero();     ///< the antenna in the body frame [m]
  typename G::Point position = G::Point::Zero();  ///< of the antenna, east-north(-up) of the fleet's datum [m]
  typename G::PointCovariance covariance = G::PointCovariance::Zero();  ///< of position [m^2]
  Key anchor_key() const { return {key.chain, anchor}; }
};

/// One vehicle saw another one (F4): where the other's mark was in the body frame of the observer. Where the other was
/// then, by its own SLAM, only the other can say: see WaypointFact. An encounter without one waits.
template <class G>
struct EncounterFact {
  Key key;                                        ///< of the observer
  std::uint32_t anchor = 0;                       ///< index of the observer's last anchor before it
  ChainState<G> state;                            ///< where the observer's SLAM said it was
  VehicleId other = 0;                            ///< who was seen; not the observer
  typename G::Point position = G::Point::Zero();  ///< of the other's mark, body frame of the observer [m]
  typename G::PointCovariance covariance = G::PointCovariance::Zero();  ///< of position [m^2]
  Key anchor_key() const { return {key.chain, anchor}; }
};

/// Where a vehicle's own SLAM said it was at the moment of an encounter in which it was the other.
template <class G>
struct WaypointFact {
  Key key;
  std::uint32_t anchor = 0;  ///< index of the last anchor before it, same chain
  ChainState<G> state;
  Key encounter;                              ///< what it answers
  typename G::Point mark = G::Point::Zero();  ///< what others see of this vehicle, body frame [m]
  Key anchor_key() const { return {key.chain, anchor}; }
};

/// Any fact; the alternatives are in the order of FactKind.
template <class G>
using AnyFact = std::variant<AnchorFact<G>, LandmarkFact<G>, PriorFact<G>, AssociationFact, VerdictFact,
                             AbsoluteFixFact<G>, EncounterFact<G>, WaypointFact<G>>;

/// Of a type of fact.
template <class Fact>
inline constexpr FactKind kind_of = FactKind::anchor;
template <class G>
inline constexpr FactKind kind_of<LandmarkFact<G>> = FactKind::landmark;
template <class G>
inline constexpr FactKind kind_of<PriorFact<G>> = FactKind::prior;
template <>
inline constexpr FactKind kind_of<AssociationFact> = FactKind::association;
template <>
inline constexpr FactKind kind_of<VerdictFact> = FactKind::verdict;
template <class G>
inline constexpr FactKind kind_of<AbsoluteFixFact<G>> = FactKind::absolute_fix;
template <class G>
inline constexpr FactKind kind_of<EncounterFact<G>> = FactKind::encounter;
template <class G>
inline constexpr FactKind kind_of<WaypointFact<G>> = FactKind::waypoint;

/// Content hashes: FNV-1a over the little-endian bytes of every field, key included, then mixed.
template <class G>
Hash hash_of(const AnchorFact<G>& fact);
template <class G>
Hash hash_of(const LandmarkFact<G>& fact);
template <class G>
Hash hash_of(const PriorFact<G>& fact);
template <class G>
Hash hash_of(const AbsoluteFixFact<G>& fact);
template <class G>
Hash hash_of(const EncounterFact<G>& fact);
template <class G>
Hash hash_of(const WaypointFact<G>& fact);
Hash hash_of(const AssociationFact& fact);
Hash hash_of(const VerdictFact& fact);

/// Identity of a hypothesis: the hash of its pairings alone, whoever states it.
Hash hypothesis_id(const std::vector<Pairing>& pairings);

/// Sorts each pairing, then the list, and removes repeats.
std::vector<Pairing> canonical(std::vector<Pairing> pairings);

}  // namespace convoy

template <>
struct std::hash<convoy::Key> {
  std::size_t operator()(const convoy::Key& key) const noexcept {
    std::uint64_t h = (key.chain.epoch * 0x9e3779b97f4a7c15U) ^ (std::uint64_t{key.chain.vehicle} << 32 | key.index);
    h = (h ^ (h >> 32)) * 0xd6e8feb86659fd93U;
    return static_cast<std::size_t>(h ^ (h >> 32));
  }
};
