// R1: what vehicles tell each other never depends on what they have made of it.
#include <gtest/gtest.h>

#include <algorithm>

#include "scripted_fleet.hpp"

namespace convoy {
namespace {

/// Everything that three vehicles state while each keeps a map of its own, built with `backend` as often as `period_s`.
std::vector<Hash> stated(MapBackend backend, double period_s) {
  InProcessNetwork<SE2> network;
  std::vector<std::unique_ptr<test::MemberOf<SE2>>> members;
  test::MemberOptionsOf<SE2> options;
  options.submaps.backend = backend;
  options.submaps.map_period_s = period_s;
  for (const VehicleId v : {1U, 2U, 3U})
    members.push_back(std::make_unique<test::MemberOf<SE2>>(v, network.join(), options));
  double now_s = 0.0;
  for (int k = 0; k < 140; ++k, now_s += 0.5)
    for (auto& member : members) {
      member->drive();
      member->step(now_s);
    }
  std::vector<Hash> hashes;
  std::size_t associations = 0, maps = 0;
  for (const auto& [id, chain] : members.front()->manager.store().chains()) {
    for (const auto& [index, fact] : chain.anchors) hashes.push_back(hash_of(fact));
    for (const auto& [index, fact] : chain.landmarks) hashes.push_back(hash_of(fact));
    for (const auto& [index, fact] : chain.priors) hashes.push_back(hash_of(fact));
    for (const auto& [index, fact] : chain.associations) hashes.push_back(hypothesis_id(fact.pairings));
    associations += chain.associations.size();
  }
  for (const auto& member : members) maps += member->manager.counters().maps_built;
  EXPECT_GT(associations, 3U);
  EXPECT_EQ(maps > 3, period_s < 1e6);  // the first is due at once
  std::sort(hashes.begin(), hashes.end());
  return hashes;
}

TEST(Rules, NoEstimateOfTheMapEntersAFact) {
  const auto without_maps = stated(MapBackend::sparse, 1e9);
  EXPECT_EQ(stated(MapBackend::sparse, 1.0), without_maps);
  EXPECT_EQ(stated(MapBackend::ekf, 1.0), without_maps);
}

}  // namespace
}  // namespace convoy
