#include <convoy/geometry/groups.hpp>
#include <convoy/submap/content_hash.hpp>
#include <convoy/submap/facts.hpp>

#include <algorithm>

namespace convoy {
namespace {

ContentHash start(FactKind kind, const Key& key) {
  ContentHash h;
  h.add(static_cast<std::uint64_t>(kind), 1).add(key.chain.vehicle, 4).add(key.chain.epoch).add(key.index, 4);
  return h;
}

void add(ContentHash& h, const std::vector<Pairing>& pairings) {
  for (const auto& [a, b] : pairings)
    for (const Key& k : {a, b}) h.add(k.chain.vehicle, 4).add(k.chain.epoch).add(k.index, 4);
}

template <class G>
ContentHash& add(ContentHash& h, const ChainState<G>& s) {
  h.add(s.stamp_s).add(s.abscissa_m);
  add_group(h, s.pose);
  return h.add(s.drift).add(s.heading_lever);
}

}  // namespace

const char* to_string(FactKind kind) {
  switch (kind) {
    case FactKind::anchor: return "anchor";
    case FactKind::landmark: return "landmark";
    case FactKind::prior: return "prior";
    case FactKind::association: return "association";
    case FactKind::verdict: return "verdict";
    case FactKind::absolute_fix: return "absolute_fix";
    case FactKind::encounter: return "encounter";
    case FactKind::waypoint: return "waypoint";
  }
  return "unknown";
}

template <class G>
Hash hash_of(const AnchorFact<G>& f) {
  ContentHash h = start(FactKind::anchor, f.key);
  return add(h, f.state).add(f.first_landmark, 4).add(f.landmark_count, 4).value();
}

template <class G>
Hash hash_of(const LandmarkFact<G>& f) {
  ContentHash h = start(FactKind::landmark, f.key);
  h.add(f.anchor, 4)
      .add(f.position)
      .add(f.covariance)
      .add(f.loading)
      .add(f.kind, 1)
      .add(static_cast<std::uint64_t>(f.descriptor.kind), 1);
  for (const std::uint8_t byte : f.descriptor.bytes) h.add(byte, 1);
  return h.value();
}

template <class G>
Hash hash_of(const PriorFact<G>& f) {
  ContentHash h = start(FactKind::prior, f.key);
  h.add(f.known ? 1U : 0U, 1);
  add_group(h, f.mean);
  const PersistentDrift& p = f.persistent;
  h.add(f.covariance).add(p.scale).add(p.heading_rad_per_m).add(p.tilt_rad).add(p.height_m).add(p.correlation_m);
  return h.add(p.up).value();
}

template <class G>
Hash hash_of(const AbsoluteFixFact<G>& f) {
  ContentHash h = start(FactKind::absolute_fix, f.key);
  return add(h.add(f.anchor, 4), f.state).add(f.lever).add(f.position).add(f.covariance).value();
}

template <class G>
Hash hash_of(const EncounterFact<G>& f) {
  ContentHash h = start(FactKind::encounter, f.key);
  return add(h.add(f.anchor, 4), f.state).add(f.other, 4).add(f.position).add(f.covariance).value();
}

template <class G>
Hash hash_of(const WaypointFact<G>& f) {
  ContentHash h = start(FactKind::waypoint, f.key);
  const Key& e = f.encounter;
  add(h.add(f.anchor, 4), f.state).add(e.chain.vehicle, 4).add(e.chain.epoch).add(e.index, 4);
  return h.add(f.mark).value();
}

Hash hash_of(const AssociationFact& f) {
  ContentHash h = start(FactKind::association, f.key);
  add(h, f.pairings);
  return h.value();
}

Hash hash_of(const VerdictFact& f) {
  return start(FactKind::verdict, f.key).add(f.hypothesis).add(f.veto ? 1U : 0U, 1).value();
}

Hash hypothesis_id(const std::vector<Pairing>& pairings) {
  ContentHash h;
  add(h, pairings);
  return h.value();
}

std::vector<Pairing> canonical(std::vector<Pairing> pairings) {
  for (auto& [a, b] : pairings)
    if (b < a) std::swap(a, b);
  std::sort(pairings.begin(), pairings.end());
  pairings.erase(std::unique(pairings.begin(), pairings.end()), pairings.end());
  return pairings;
}

#define CONVOY_INSTANTIATE(G)                       \
  template Hash hash_of(const AnchorFact<G>&);      \
  template Hash hash_of(const LandmarkFact<G>&);    \
  template Hash hash_of(const PriorFact<G>&);       \
  template Hash hash_of(const AbsoluteFixFact<G>&); \
  template Hash hash_of(const EncounterFact<G>&);   \
  template Hash hash_of(const WaypointFact<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
