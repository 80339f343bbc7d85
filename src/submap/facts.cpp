#include <convoy/geometry/groups.hpp>
#include <convoy/submap/content_hash.hpp>
#include <convoy/submap/fact_fields.hpp>
#include <convoy/submap/facts.hpp>

#include <algorithm>

namespace convoy {
namespace {

/// An archive (see fact_fields.hpp) that hashes.
class HashingArchive {
 public:
  explicit HashingArchive(FactKind kind) { hash_.add(static_cast<std::uint64_t>(kind), 1); }
  template <class Number>
  void natural(Number value, int bytes) {
    hash_.add(static_cast<std::uint64_t>(value), bytes);
  }
  void real(double value) { hash_.add(value); }
  template <class Matrix>
  void matrix(const Matrix& m) {
    hash_.add(m);
  }
  template <class G>
  void pose(const G& T) {
    add_group(hash_, T);
  }
  template <class Bytes>
  void bytes(const Bytes& bytes) {
    for (const std::uint8_t byte : bytes) hash_.add(byte, 1);
  }
  template <class Item, class Visit>
  void list(const std::vector<Item>& items, const Visit& visit) {
    for (const Item& item : items) visit(item);
  }
  Hash value() const { return hash_.value(); }

 private:
  ContentHash hash_;
};

template <class Fact>
Hash hash_fields(const Fact& fact) {
  HashingArchive archive(kind_of<Fact>);
  fact_fields(archive, fact);
  return archive.value();
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
Hash hash_of(const AnchorFact<G>& fact) {
  return hash_fields(fact);
}
template <class G>
Hash hash_of(const LandmarkFact<G>& fact) {
  return hash_fields(fact);
}
template <class G>
Hash hash_of(const PriorFact<G>& fact) {
  return hash_fields(fact);
}
template <class G>
Hash hash_of(const AbsoluteFixFact<G>& fact) {
  return hash_fields(fact);
}
template <class G>
Hash hash_of(const EncounterFact<G>& fact) {
  return hash_fields(fact);
}
template <class G>
Hash hash_of(const WaypointFact<G>& fact) {
  return hash_fields(fact);
}
Hash hash_of(const AssociationFact& fact) { return hash_fields(fact); }
Hash hash_of(const VerdictFact& fact) { return hash_fields(fact); }

Hash hypothesis_id(const std::vector<Pairing>& pairings) {
  ContentHash h;
  for (const auto& [a, b] : pairings) {
    add_key(h, a);
    add_key(h, b);
  }
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
