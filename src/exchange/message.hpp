// What crosses the exchange: facts, the live pose (a last value, not a fact), and the two messages of the repair
// protocol. One alternative of Payload is one topic of the middleware.
#pragma once

#include <convoy/submap/fact_store.hpp>
#include <convoy/submap/facts.hpp>

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

namespace convoy {

/// How far the pose of a vehicle can be trusted, with the reasons (bit set) when it cannot.
enum class Integrity : std::uint8_t {
  unaligned = 0,  ///< not yet in the common frame
  ok = 1,
  suspect = 2,  ///< see IntegrityReason
};
const char* to_string(Integrity integrity);

enum IntegrityReason : std::uint32_t {
  reason_none = 0,
  reason_innovation = 1U << 0,     ///< residuals of the map lie outside their chi-square band
  reason_disagreement = 1U << 1,   ///< a peer holds the same facts and reports another map
  reason_stale_peer = 1U << 2,     ///< nothing heard of the vehicle for longer than the limit
  reason_equivocation = 1U << 3,   ///< the vehicle used a key twice with different contents
  reason_missing_facts = 1U << 4,  ///< facts are known to exist that have not arrived
  reason_impersonated = 1U << 5,   ///< somebody else has spoken in the vehicle's name: two vehicles have its id
  reason_drift = 1U << 6,          ///< the vehicle's drift is not the white noise it is taken for (lag-1 correlation)
  reason_ambiguous =
      1U << 7,  ///< UNALIGNED though places in common were found: they fit in two ways, or one is all there is
};

/// "drift", "ambiguous", ...: the bits of IntegrityReason, lowest first.
std::vector<std::string> names_of_reasons(std::uint32_t reasons);

/// Landmarks frozen together, in the frame of one anchor (all of one chain, same `anchor`).
template <class G>
struct LandmarkBatch {
  std::vector<LandmarkFact<G>> landmarks;
};

/// A landmark that a vehicle has exported, where its SLAM says it is now. Second-hand: it may hold the same
/// measurements as the fact and later ones, so that it serves a live pose and no map.
template <class G>
struct RememberedLandmark {
  std::uint32_t index = 0;                                              ///< of the vehicle's chain
  typename G::Point position = G::Point::Zero();                        ///< body frame [m]
  typename G::PointCovariance covariance = G::PointCovariance::Zero();  ///< of what it shares with no other [m^2]
};

/// Where a vehicle is now, relative to its last anchor, and to landmarks that it remembers.
template <class G>
struct LivePose {
  static constexpr std::size_t max_remembered = 8;
  ChainId chain;
  std::uint32_t anchor = 0;  ///< index of the anchor that `state` continues
  ChainState<G> state;
  Integrity integrity = Integrity::unaligned;
  std::uint32_t reasons = reason_none;
  std::vector<RememberedLandmark<G>> remembered = {};  ///< at most `max_remembered`
  /// Of the error that all of `remembered` share, as an error of the body's pose: right perturbation.
  typename G::Covariance shared = G::Covariance::Zero();
};

/// "Send me these again."
struct Request {
  ChainId target;
  FactKind kind = FactKind::anchor;
  std::vector<IndexRange> ranges;
  /// How often it was asked in vain. 0: their author alone is asked, since it is there; with 3 or more, those who have
  /// them repeat them even if they see others do so: not all hear everybody.
  std::uint8_t in_vain = 1;
};

/// What the sender knows. High-water marks make lost tails visible; equal `map_facts` with unequal `map` is an alarm.
struct Digest {
  std::uint8_t dimension = 2;    ///< 2: SE(2) fleet, 3: SE(3) fleet
  std::vector<ChainMark> marks;  ///< of some chains, or of none (RepairProtocol::digest_due)
  double stamp_s = 0.0;          ///< the sender's clock when it was sent; no algorithm depends on it
  Hash holdings = 0;             ///< FactStore::holdings()
  Hash facts = 0;                ///< FactStore::digest()
  Hash selection = 0;            ///< Selection::digest of the last solved map
  Hash map = 0;                  ///< Map::digest() of the last solved map
  Hash map_facts = 0;            ///< FactStore::digest() that map was solved from
};

template <class G>
using Payload = std::variant<AnchorFact<G>, LandmarkBatch<G>, PriorFact<G>, AssociationFact, VerdictFact,
                             AbsoluteFixFact<G>, EncounterFact<G>, WaypointFact<G>, LivePose<G>, Request, Digest>;

template <class G>
struct Message {
  ChainId sender;  ///< who put it on the wire; not always who wrote the facts in it
  Payload<G> payload;
  bool repeated = false;  ///< facts that were said before, by whomever, and asked for since
};

}  // namespace convoy
