#include "sample_facts.hpp"

#include <utility>
#include <variant>

namespace convoy::test {

Anchor anchor(VehicleId vehicle, std::uint32_t index) {
  Anchor fact{key_of(vehicle, index), {}};
  fact.state.stamp_s = 10.0 * index;
  fact.state.abscissa_m = 25.0 * index;
  fact.state.pose = SE2::Exp({25.0 * index, 0.0, 0.01 * index});
  fact.state.drift = 0.01 * index * SE2::Covariance::Identity();
  return fact;
}

Landmark landmark(VehicleId vehicle, std::uint32_t index) {
  Landmark fact;
  fact.key = key_of(vehicle, index);
  fact.anchor = index / 4;
  fact.position = {3.0 + index % 4, -2.0 - 0.5 * vehicle};
  fact.covariance << 0.04, 0.01, 0.01, 0.09;
  fact.loading.col(0) << 0.1, 0.05;
  fact.kind = 3;
  fact.descriptor.kind = Descriptor::Kind::patch_8x8_4bit;
  fact.descriptor.bytes[index % 32] = static_cast<std::uint8_t>(vehicle);
  return fact;
}

Prior prior(VehicleId vehicle) {
  Prior fact{key_of(vehicle, 0), true, SE2(-20.0 * vehicle, 1.0, 0.1)};
  fact.covariance = Eigen::Vector3d(81.0, 81.0, 0.02).asDiagonal();
  return fact;
}

std::vector<Pairing> pairings(VehicleId a, VehicleId b, std::uint32_t anchor_index, std::uint32_t count) {
  std::vector<Pairing> list;
  for (std::uint32_t i = 0; i < count; ++i)
    list.emplace_back(key_of(a, 4 * anchor_index + i), key_of(b, 4 * anchor_index + i));
  return canonical(std::move(list));
}

AssociationFact association(VehicleId author, std::uint32_t index, std::vector<Pairing> list) {
  return {key_of(author, index), std::move(list)};
}

VerdictFact verdict(VehicleId author, std::uint32_t index, Hash hypothesis, bool veto) {
  return {key_of(author, index), hypothesis, veto};
}

AbsoluteFixFact<SE2> absolute_fix(VehicleId vehicle, std::uint32_t index) {
  AbsoluteFixFact<SE2> fact{key_of(vehicle, index), index, anchor(vehicle, index).state};
  fact.lever = {1.0, 0.25};
  fact.position = {400.0 + 25.0 * index, -3.0 * vehicle};
  fact.covariance << 2.0, 0.5, 0.5, 1.0;
  return fact;
}

EncounterFact<SE2> encounter(VehicleId vehicle, std::uint32_t index) {
  EncounterFact<SE2> fact{key_of(vehicle, index), index, anchor(vehicle, index).state, vehicle + 1, {7.0, 0.5}};
  fact.covariance << 0.2, 0.05, 0.05, 0.1;
  return fact;
}

WaypointFact<SE2> waypoint(VehicleId vehicle, std::uint32_t index) {
  return {key_of(vehicle, index), index, anchor(vehicle, index).state, key_of(vehicle - 1, index), {0.5, -0.25}};
}

std::vector<Fact> chain_facts(VehicleId vehicle, std::uint32_t anchors) {
  std::vector<Fact> facts{prior(vehicle)};
  for (std::uint32_t k = 0; k < anchors; ++k) {
    facts.emplace_back(anchor(vehicle, k));
    facts.emplace_back(absolute_fix(vehicle, k));
    facts.emplace_back(encounter(vehicle, k));
    if (vehicle > 1) facts.emplace_back(waypoint(vehicle, k));
    for (std::uint32_t i = 0; i < 4; ++i) facts.emplace_back(landmark(vehicle, 4 * k + i));
    facts.emplace_back(association(vehicle, k, pairings(vehicle, vehicle + 1, k, 3)));
  }
  facts.emplace_back(verdict(vehicle, 0, hypothesis_id(pairings(vehicle, vehicle + 1, anchors - 1, 3)), true));
  return facts;
}

template <class G>
Insertion insert(FactStore<G>& store, const std::type_identity_t<AnyFact<G>>& fact) {
  return std::visit([&](const auto& f) { return store.insert(f); }, fact);
}

#define CONVOY_INSTANTIATE(G) template Insertion insert<G>(FactStore<G>&, const std::type_identity_t<AnyFact<G>>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::test
