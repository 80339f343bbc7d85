// Small, valid, mutually consistent facts for tests.
#pragma once

#include <convoy/geometry/groups.hpp>
#include <convoy/submap/fact_store.hpp>
#include <convoy/submap/facts.hpp>

#include <type_traits>
#include <vector>

namespace convoy::test {

using Anchor = AnchorFact<SE2>;
using Landmark = LandmarkFact<SE2>;
using Prior = PriorFact<SE2>;
using Store = FactStore<SE2>;
using Fact = AnyFact<SE2>;

inline constexpr Epoch epoch = 1700000000;

inline ChainId chain_of(VehicleId vehicle) { return {vehicle, epoch}; }
inline Key key_of(VehicleId vehicle, std::uint32_t index) { return {chain_of(vehicle), index}; }

/// Anchors lie 25 m apart on a slight bend; number 0 is the origin, as it must be.
Anchor anchor(VehicleId vehicle, std::uint32_t index);

/// Four landmarks per anchor.
Landmark landmark(VehicleId vehicle, std::uint32_t index);

Prior prior(VehicleId vehicle);

/// The first `count` landmarks of a's batch at `anchor_index` are those of b's.
std::vector<Pairing> pairings(VehicleId a, VehicleId b, std::uint32_t anchor_index, std::uint32_t count);

AssociationFact association(VehicleId author, std::uint32_t index, std::vector<Pairing> list);

VerdictFact verdict(VehicleId author, std::uint32_t index, Hash hypothesis, bool veto);

/// At an anchor, the antenna 1 m ahead.
AbsoluteFixFact<SE2> absolute_fix(VehicleId vehicle, std::uint32_t index);

/// At an anchor, the next vehicle 7 m ahead.
EncounterFact<SE2> encounter(VehicleId vehicle, std::uint32_t index);

/// What the next vehicle says to that.
WaypointFact<SE2> waypoint(VehicleId vehicle, std::uint32_t index);

/// All facts of one vehicle: `anchors` anchors with their landmarks, a prior, and for each anchor an association with
/// the next vehicle's, the last of them vetoed.
std::vector<Fact> chain_facts(VehicleId vehicle, std::uint32_t anchors);

template <class G>
Insertion insert(FactStore<G>& store, const std::type_identity_t<AnyFact<G>>& fact);

template <class G>
std::uint64_t counted(const FactStore<G>& store, Insertion result) {
  return store.insertions()[static_cast<std::size_t>(result)];
}

}  // namespace convoy::test
