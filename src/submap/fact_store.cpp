#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/submap/fact_store.hpp>

#include <algorithm>
#include <type_traits>

namespace convoy {
namespace {

bool finite(const SE2& T) { return T.translation().allFinite() && std::isfinite(T.theta()); }
bool finite(const SE3& T) { return T.translation().allFinite() && T.quaternion().allFinite(); }

template <class G>
Insertion check_pose(const G& pose, const FactLimits& limits) {
  if (!finite(pose)) return Insertion::not_finite;
  if (pose.translation().cwiseAbs().maxCoeff() > limits.max_coordinate_m) return Insertion::out_of_range;
  return Insertion::inserted;
}

template <class Matrix>
Insertion check_covariance(const Matrix& P, const FactLimits& limits) {
  if (!P.allFinite()) return Insertion::not_finite;
  if (!is_covariance(P)) return Insertion::not_covariance;
  if (P.diagonal().maxCoeff() > limits.max_sigma_m * limits.max_sigma_m) return Insertion::out_of_range;
  return Insertion::inserted;
}

template <class... Rest>
Insertion first_refusal(Insertion first, Rest... rest) {
  if constexpr (sizeof...(rest) == 0) return first;
  else return first != Insertion::inserted ? first : first_refusal(rest...);
}

}  // namespace

const char* to_string(Insertion result) {
  switch (result) {
    case Insertion::inserted: return "inserted";
    case Insertion::duplicate: return "duplicate";
    case Insertion::conflict: return "conflict";
    case Insertion::unknown_vehicle: return "unknown_vehicle";
    case Insertion::not_finite: return "not_finite";
    case Insertion::not_covariance: return "not_covariance";
    case Insertion::out_of_range: return "out_of_range";
    case Insertion::malformed: return "malformed";
    case Insertion::over_share: return "over_share";
  }
  return "unknown";
}

template <class G>
Insertion FactStore<G>::count(Insertion result) {
  ++insertions_[static_cast<std::size_t>(result)];
  return result;
}

template <class G>
Insertion FactStore<G>::check(const Key& key) const {
  const auto& roster = limits_.roster;
  if (key.chain.vehicle == 0) return Insertion::malformed;
  if (!roster.empty() && std::find(roster.begin(), roster.end(), key.chain.vehicle) == roster.end())
    return Insertion::unknown_vehicle;
  return key.index <= limits_.max_index ? Insertion::inserted : Insertion::out_of_range;
}

template <class G>
bool FactStore<G>::has_room_for(const ChainId& id) const {
  if (id == own_) return true;
  const auto chain = chains_.find(id);
  if (chain != chains_.end() && chain->second.facts > 0) return true;
  const auto share = shares_.find(id.vehicle);
  return share == shares_.end() || share->second.chains < limits_.max_chains_per_vehicle;
}

template <class G>
bool FactStore<G>::is_full(const ChainId& id) const {
  if (id == own_) return false;
  const auto share = shares_.find(id.vehicle);
  return !has_room_for(id) || (share != shares_.end() && share->second.facts >= limits_.max_facts_per_vehicle);
}

template <class G>
template <class Fact>
Insertion FactStore<G>::keep(Sequence<Fact> Chain::*sequence, FactKind kind, const Fact& fact, Insertion check) {
  if (check != Insertion::inserted) return count(check);
  if (!has_room_for(fact.key.chain)) return count(Insertion::over_share);
  const Hash hash = hash_of(fact);
  if (const auto known = chains_.find(fact.key.chain); known != chains_.end()) {
    const auto& held = known->second.*sequence;
    if (const auto it = held.find(fact.key.index); it != held.end()) {
      if (hash_of(it->second) == hash) return count(Insertion::duplicate);
      known->second.equivocated = true;
      return count(Insertion::conflict);
    }
  }
  if (is_full(fact.key.chain)) return count(Insertion::over_share);
  const auto [it, fresh] = chains_.try_emplace(fact.key.chain);
  Chain& chain = it->second;
  if (fact.key.chain != own_) {
    Share& share = shares_[fact.key.chain.vehicle];
    ++share.facts;
    share.chains += chain.facts == 0;
  }
  rumoured_ -= !fresh && chain.facts == 0;
  ++chain.facts;
  (chain.*sequence).emplace(fact.key.index, fact);
  prove(fact.key.chain, kind, fact.key.index + 1);
  ChainMark& mark = chain.marks[static_cast<std::size_t>(kind)];
  ++mark.count;
  mark.hash += hash;
  holdings_ += hash;
  if constexpr (std::is_same_v<Fact, AssociationFact>) {
    const Hash id = hypothesis_id(fact.pairings);
    if (statements_[id]++ == 0) digest_ += id;
  } else {
    digest_ += hash;
  }
  ++revision_;
  ++size_;
  return count(Insertion::inserted);
}

template <class G>
Insertion FactStore<G>::check(const ChainState<G>& s) const {
  Insertion ok = first_refusal(check_pose(s.pose, limits_), check_covariance(s.drift, limits_));
  if (ok != Insertion::inserted) return ok;
  if (!std::isfinite(s.stamp_s) || !std::isfinite(s.abscissa_m) || !s.heading_lever.allFinite())
    return Insertion::not_finite;
  // Metres driven, times how far away the place they were driven at is.
  const double longest = limits_.max_coordinate_m, farthest = longest * longest;
  const bool in_range =
      s.abscissa_m >= 0.0 && s.abscissa_m <= longest && s.heading_lever.cwiseAbs().maxCoeff() <= farthest;
  return in_range ? Insertion::inserted : Insertion::out_of_range;
}

template <class G>
Insertion FactStore<G>::check(const AnchorFact<G>& f) const {
  const auto& s = f.state;
  Insertion ok = first_refusal(check(f.key), check(s));
  const bool at_origin =
      s.abscissa_m == 0.0 && s.drift.isZero(0.0) && s.pose.Log().isZero(0.0) && s.heading_lever.isZero(0.0);
  if (ok == Insertion::inserted && f.key.index == 0 && !at_origin) ok = Insertion::malformed;
  const std::uint64_t end_landmark = std::uint64_t{f.first_landmark} + f.landmark_count;
  if (ok == Insertion::inserted && end_landmark > std::uint64_t{limits_.max_index} + 1) ok = Insertion::out_of_range;
  return ok;
}

template <class G>
Insertion FactStore<G>::insert(const AnchorFact<G>& f) {
  const Insertion result = keep(&Chain::anchors, FactKind::anchor, f, check(f));
  // An anchor proves that its landmarks exist, so that lost ones are asked for.
  if (result == Insertion::inserted && f.landmark_count > 0)
    prove(f.key.chain, FactKind::landmark, f.first_landmark + f.landmark_count);
  return result;
}

template <class G>
Insertion FactStore<G>::check(const LandmarkFact<G>& f) const {
  Insertion ok = first_refusal(check(f.key), f.position.allFinite() ? Insertion::inserted : Insertion::not_finite,
                               check_covariance(f.covariance, limits_));
  if (ok == Insertion::inserted && !f.loading.allFinite()) ok = Insertion::not_finite;
  if (ok == Insertion::inserted && !is_covariance(f.own_covariance(), f.covariance.cwiseAbs().maxCoeff()))
    ok = Insertion::not_covariance;
  if (ok == Insertion::inserted &&
      (f.position.cwiseAbs().maxCoeff() > limits_.max_coordinate_m || f.anchor > limits_.max_index))
    ok = Insertion::out_of_range;
  return ok;
}

template <class G>
Insertion FactStore<G>::insert(const LandmarkFact<G>& f) {
  const Insertion result = keep(&Chain::landmarks, FactKind::landmark, f, check(f));
  if (result == Insertion::inserted) {
    Chain& chain = chains_[f.key.chain];
    auto& batch = chain.batches[f.anchor];
    batch.insert(std::lower_bound(batch.begin(), batch.end(), f.key.index), f.key.index);
    // A landmark proves that its anchor exists, so a lost anchor is asked for.
    prove(f.key.chain, FactKind::anchor, f.anchor + 1);
  }
  return result;
}

template <class G>
Insertion FactStore<G>::check(const PriorFact<G>& f) const {
  Insertion ok = first_refusal(check(f.key), check_pose(f.mean, limits_), check_covariance(f.covariance, limits_));
  if (ok == Insertion::inserted && f.key.index != 0) ok = Insertion::out_of_range;
  const bool empty = f.covariance.isZero(0.0) && f.mean.Log().isZero(0.0);
  if (ok == Insertion::inserted && !f.known && !empty) ok = Insertion::malformed;
  return first_refusal(ok, check(f.persistent));
}

// A scale that is off by its own size, or a heading that turns about within a metre, is no drift.
template <class G>
Insertion FactStore<G>::check(const PersistentDrift& p) const {
  const std::array<double, 5> sigmas{p.scale, p.heading_rad_per_m, p.tilt_rad, p.height_m, p.correlation_m};
  const auto all = [&](auto&& holds) { return std::all_of(sigmas.begin(), sigmas.end(), holds); };
  if (!p.up.allFinite() || !all([](double s) { return std::isfinite(s); })) return Insertion::not_finite;
  const bool in_range = p.scale <= 1.0 && p.heading_rad_per_m <= 1.0 && p.tilt_rad <= 1.0 &&
                        p.height_m <= limits_.max_sigma_m && p.correlation_m <= limits_.max_coordinate_m;
  if (!in_range || !all([](double s) { return s >= 0.0; })) return Insertion::out_of_range;
  const bool complete = p.correlation_m > 0.0 && std::abs(p.up.norm() - 1.0) < 1e-6;
  const bool empty = p.correlation_m == 0.0 && p.up.isZero(0.0);
  if (p.bounded() ? G::Dim == 2 || !complete : !empty) return Insertion::malformed;
  if (p.scales_landmarks && p.scale == 0.0) return Insertion::malformed;
  return Insertion::inserted;
}

template <class G>
Insertion FactStore<G>::insert(const PriorFact<G>& f) {
  return keep(&Chain::priors, FactKind::prior, f, check(f));
}

template <class G>
Insertion FactStore<G>::check(const AssociationFact& f) const {
  Insertion ok = check(f.key);
  if (ok == Insertion::inserted && f.pairings.size() > limits_.max_pairings) ok = Insertion::out_of_range;
  if (ok == Insertion::inserted && (f.pairings.empty() || canonical(f.pairings) != f.pairings))
    ok = Insertion::malformed;
  for (const auto& [a, b] : f.pairings) {
    if (ok != Insertion::inserted) break;
    ok = a == b ? Insertion::malformed : first_refusal(check(a), check(b));
  }
  return ok;
}

template <class G>
Insertion FactStore<G>::insert(const AssociationFact& f) {
  return keep(&Chain::associations, FactKind::association, f, check(f));
}

template <class G>
Insertion FactStore<G>::insert(const VerdictFact& f) {
  return keep(&Chain::verdicts, FactKind::verdict, f, check(f));
}

template <class G>
Insertion FactStore<G>::check(const AbsoluteFixFact<G>& f) const {
  Insertion ok = first_refusal(check(f.key), check(f.state), check_covariance(f.covariance, limits_));
  if (ok == Insertion::inserted && !(f.lever.allFinite() && f.position.allFinite())) ok = Insertion::not_finite;
  const double largest = std::max(f.lever.cwiseAbs().maxCoeff(), f.position.cwiseAbs().maxCoeff());
  if (ok == Insertion::inserted && (largest > limits_.max_coordinate_m || f.anchor > limits_.max_index))
    ok = Insertion::out_of_range;
  return ok;
}

template <class G>
Insertion FactStore<G>::check(const EncounterFact<G>& f) const {
  Insertion ok = first_refusal(check(f.key), check(Key{{f.other, 0}, f.anchor}), check(f.state),
                               check_covariance(f.covariance, limits_));
  if (ok == Insertion::inserted && f.other == f.key.chain.vehicle) ok = Insertion::malformed;
  if (ok == Insertion::inserted && !f.position.allFinite()) ok = Insertion::not_finite;
  if (ok == Insertion::inserted && f.position.cwiseAbs().maxCoeff() > limits_.max_coordinate_m)
    ok = Insertion::out_of_range;
  return ok;
}

template <class G>
Insertion FactStore<G>::check(const WaypointFact<G>& f) const {
  Insertion ok = first_refusal(check(f.key), check(f.encounter), check(f.state));
  if (ok == Insertion::inserted && f.encounter.chain.vehicle == f.key.chain.vehicle) ok = Insertion::malformed;
  if (ok == Insertion::inserted && !f.mark.allFinite()) ok = Insertion::not_finite;
  if (ok == Insertion::inserted &&
      (f.mark.cwiseAbs().maxCoeff() > limits_.max_coordinate_m || f.anchor > limits_.max_index))
    ok = Insertion::out_of_range;
  return ok;
}

template <class G>
Insertion FactStore<G>::insert(const AbsoluteFixFact<G>& f) {
  const Insertion result = keep(&Chain::absolute_fixes, FactKind::absolute_fix, f, check(f));
  if (result == Insertion::inserted) prove(f.key.chain, FactKind::anchor, f.anchor + 1);  // a lost anchor is asked for
  return result;
}

template <class G>
Insertion FactStore<G>::insert(const EncounterFact<G>& f) {
  const Insertion result = keep(&Chain::encounters, FactKind::encounter, f, check(f));
  if (result == Insertion::inserted) prove(f.key.chain, FactKind::anchor, f.anchor + 1);
  return result;
}

template <class G>
Insertion FactStore<G>::insert(const WaypointFact<G>& f) {
  const Insertion result = keep(&Chain::waypoints, FactKind::waypoint, f, check(f));
  if (result != Insertion::inserted) return result;
  prove(f.key.chain, FactKind::anchor, f.anchor + 1);
  announce(f.encounter.chain, FactKind::encounter, f.encounter.index + 1);  // so is a lost encounter
  return result;
}

template <class G>
const AnchorFact<G>* FactStore<G>::anchor(const Key& key) const {
  const auto chain = chains_.find(key.chain);
  if (chain == chains_.end()) return nullptr;
  const auto it = chain->second.anchors.find(key.index);
  return it == chain->second.anchors.end() ? nullptr : &it->second;
}

template <class G>
const LandmarkFact<G>* FactStore<G>::landmark(const Key& key) const {
  const auto chain = chains_.find(key.chain);
  if (chain == chains_.end()) return nullptr;
  const auto it = chain->second.landmarks.find(key.index);
  return it == chain->second.landmarks.end() ? nullptr : &it->second;
}

template <class G>
const PriorFact<G>* FactStore<G>::prior(const ChainId& id) const {
  const auto chain = chains_.find(id);
  return chain == chains_.end() || chain->second.priors.empty() ? nullptr : &chain->second.priors.begin()->second;
}

// Of a chain that is held, or may be talked of; else null.
template <class G>
typename FactStore<G>::Chain* FactStore<G>::rumoured(const ChainId& id, FactKind kind, std::uint32_t high_water) {
  if (high_water == 0 || check(Key{id, high_water - 1}) != Insertion::inserted || !has_room_for(id)) return nullptr;
  if (id == own_ || (is_full_of_rumours() && !chains_.contains(id))) return nullptr;
  const auto [it, fresh] = chains_.try_emplace(id);
  rumoured_ += fresh;
  std::uint32_t& said = it->second.marks[static_cast<std::size_t>(kind)].high_water;
  said = std::max(said, high_water);
  return &it->second;
}

template <class G>
void FactStore<G>::announce(const ChainId& id, FactKind kind, std::uint32_t high_water) {
  rumoured(id, kind, high_water);
}

template <class G>
void FactStore<G>::announce_own(const ChainId& author, FactKind kind, std::uint32_t high_water) {
  const auto known = chains_.find(author);
  Chain* const nothing_of_it = known == chains_.end() || author == own_ ? nullptr : &known->second;
  Chain* const chain = high_water > 0 ? rumoured(author, kind, high_water) : nothing_of_it;
  if (chain == nullptr) return;
  const auto k = static_cast<std::size_t>(kind);
  chain->proven[k] = std::max(chain->proven[k], high_water);
  chain->marks[k].high_water = chain->proven[k];
}

// Of a chain that is held.
template <class G>
void FactStore<G>::prove(const ChainId& id, FactKind kind, std::uint32_t high_water) {
  Chain& chain = chains_.at(id);
  const auto k = static_cast<std::size_t>(kind);
  chain.proven[k] = std::max(chain.proven[k], high_water);
  chain.marks[k].high_water = std::max(chain.marks[k].high_water, high_water);
}

template <class G>
void FactStore<G>::forget_rumours(const ChainId& id) {
  const auto chain = chains_.find(id);
  if (chain == chains_.end() || chain->second.facts > 0) return;
  chains_.erase(chain);
  --rumoured_;
}

namespace {

template <class Sequence>
std::vector<IndexRange> holes(const Sequence& held, std::uint32_t high_water, std::size_t max_ranges,
                              std::uint32_t next) {
  std::vector<IndexRange> ranges;
  for (auto it = held.lower_bound(next); ranges.size() < max_ranges; ++it) {
    const std::uint32_t index = it == held.end() ? high_water : std::min(it->first, high_water);
    if (next < index) ranges.push_back({next, index});
    if (it == held.end() || index == high_water) break;
    next = index + 1;
  }
  return ranges;
}

}  // namespace

template <class G>
std::vector<IndexRange> FactStore<G>::missing(const ChainId& id, FactKind kind, std::size_t max_ranges,
                                              std::uint32_t from) const {
  const auto it = chains_.find(id);
  if (it == chains_.end()) return {};
  const Chain& chain = it->second;
  const ChainMark& mark = chain.marks[static_cast<std::size_t>(kind)];
  if (mark.count == mark.high_water) return {};
  return with_sequence(chain, kind, [&](const auto& held) { return holes(held, mark.high_water, max_ranges, from); });
}

template <class G>
std::uint64_t FactStore<G>::missing_count() const {
  std::uint64_t sum = 0;
  for (const auto& [id, chain] : chains_)
    for (const ChainMark& mark : chain.marks) sum += mark.high_water - mark.count;
  return sum;
}

template <class G>
std::vector<ChainMark> FactStore<G>::marks_of(const ChainId& id) const {
  std::vector<ChainMark> marks;
  const auto chain = chains_.find(id);
  if (chain == chains_.end()) return marks;
  for (int kind = 0; kind < fact_kind_count; ++kind)
    if (ChainMark mark = chain->second.marks[static_cast<std::size_t>(kind)];
        (mark.high_water = chain->second.proven[static_cast<std::size_t>(kind)]) > 0) {
      mark.chain = id;
      mark.kind = static_cast<FactKind>(kind);
      marks.push_back(mark);
    }
  return marks;
}

template <class G>
std::vector<ChainMark> FactStore<G>::marks() const {
  std::vector<ChainMark> marks;
  for (const auto& [id, chain] : chains_) {
    const auto of_chain = marks_of(id);
    marks.insert(marks.end(), of_chain.begin(), of_chain.end());
  }
  return marks;
}

#define CONVOY_INSTANTIATE(G) template class FactStore<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
