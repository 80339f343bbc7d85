#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/selection.hpp>
#include <convoy/submap/content_hash.hpp>

#include <algorithm>
#include <cmath>
#include <map>

namespace convoy {
namespace {

// Union-find over landmarks that refuses to put two landmarks of one batch into one class (DESIGN R4).
class Classes {
 public:
  Key root(Key key) {
    while (true) {
      const auto it = parent_.find(key);
      if (it == parent_.end() || it->second == key) return key;
      key = it->second;
    }
  }

  // Joins all pairings, or none of them. batch_of(landmark) names its anchor.
  template <class BatchOf>
  bool join(const std::vector<Pairing>& pairings, BatchOf batch_of) {
    const auto before_parent = parent_;
    const auto before_members = members_;
    for (const auto& [a, b] : pairings) {
      const Key ra = std::min(root(a), root(b)), rb = std::max(root(a), root(b));
      if (ra == rb) continue;
      std::vector<Key> both = members(ra);
      const std::vector<Key> other = members(rb);
      both.insert(both.end(), other.begin(), other.end());
      std::set<Key> batches;
      for (const Key& landmark : both)
        if (!batches.insert(batch_of(landmark)).second) {
          parent_ = before_parent;
          members_ = before_members;
          return false;
        }
      parent_[ra] = ra;
      parent_[rb] = ra;
      members_.erase(rb);
      members_[ra] = std::move(both);
    }
    return true;
  }

  std::vector<std::vector<Key>> sorted() const {
    std::vector<std::vector<Key>> classes;
    for (const auto& [root, members] : members_) {
      classes.push_back(members);
      std::sort(classes.back().begin(), classes.back().end());
    }
    std::sort(classes.begin(), classes.end());
    return classes;
  }

 private:
  std::vector<Key> members(const Key& root) const {
    const auto it = members_.find(root);
    return it == members_.end() ? std::vector<Key>{root} : it->second;
  }

  std::map<Key, Key> parent_;
  std::map<Key, std::vector<Key>> members_;
};

template <class G>
std::vector<Hypothesis<G>> stated(const FactStore<G>& store) {
  std::map<Hash, Hypothesis<G>> by_id;
  for (const auto& [chain_id, chain] : store.chains())
    for (const auto& [index, fact] : chain.associations) {
      const Hash id = hypothesis_id(fact.pairings);
      Hypothesis<G>& hypothesis = by_id[id];
      if (!hypothesis.pairings.empty()) continue;
      hypothesis.id = id;
      hypothesis.pairings = fact.pairings;
      hypothesis.author = chain_id;
    }
  std::vector<Hypothesis<G>> all;
  for (auto& [id, hypothesis] : by_id) all.push_back(std::move(hypothesis));
  std::stable_sort(all.begin(), all.end(),
                   [](const auto& a, const auto& b) { return a.pairings.size() > b.pairings.size(); });
  return all;
}

// A veto stands while the last verdict of any author on the hypothesis is one.
template <class G>
std::set<Hash> vetoed(const FactStore<G>& store) {
  std::set<Hash> result;
  for (const auto& [chain_id, chain] : store.chains()) {
    std::map<Hash, bool> last;
    for (const auto& [index, verdict] : chain.verdicts) last[verdict.hypothesis] = verdict.veto;
    for (const auto& [hypothesis, veto] : last)
      if (veto) result.insert(hypothesis);
  }
  return result;
}

// One-to-one between exactly two batches; finds them and the alignment.
template <class G>
HypothesisState examine(const FactStore<G>& store, const SelectionParams& params, Hypothesis<G>& h) {
  if (static_cast<int>(h.pairings.size()) < params.min_pairings) return HypothesisState::malformed;
  Batch<G> a, b;
  std::vector<IndexPairing> pairs;
  std::set<Key> seen;
  for (const auto& [ka, kb] : h.pairings) {
    const LandmarkFact<G>*la = store.landmark(ka), *lb = store.landmark(kb);
    if (la == nullptr || lb == nullptr) return HypothesisState::waiting;
    if (lb->anchor_key() < la->anchor_key()) std::swap(la, lb);
    if (pairs.empty()) {
      h.batch_a = a.anchor = la->anchor_key();
      h.batch_b = b.anchor = lb->anchor_key();
    }
    const bool fits = la->anchor_key() == a.anchor && lb->anchor_key() == b.anchor && a.anchor != b.anchor;
    if (!fits || !seen.insert(ka).second || !seen.insert(kb).second) return HypothesisState::malformed;
    pairs.emplace_back(static_cast<int>(pairs.size()), static_cast<int>(pairs.size()));
    a.landmarks.push_back(*la);
    b.landmarks.push_back(*lb);
  }
  if (store.anchor(a.anchor) == nullptr || store.anchor(b.anchor) == nullptr) return HypothesisState::waiting;
  const auto alignment = align(a, b, pairs);
  if (!alignment || alignment->chi2 > chi2_quantile(params.residual, alignment->dof)) return HypothesisState::geometry;
  h.alignment = *alignment;
  return HypothesisState::accepted;
}

// One fix per vehicle and correlation time, the earliest by key, so that errors that hang together do not count twice
// (DESIGN B7). A fix whose anchor has not arrived is absent.
template <class G>
std::vector<Key> thinned_fixes(const FactStore<G>& store, const SelectionParams& params, const Exclusions& excluded) {
  std::vector<Key> kept;
  VehicleId vehicle = 0;
  double last_s = 0.0;
  for (const auto& [id, chain] : store.chains())
    for (const auto& [index, fix] : chain.absolute_fixes) {
      const bool first = id.vehicle != vehicle;
      const AnchorFact<G>* anchor = store.anchor(fix.anchor_key());
      if (anchor == nullptr || anchor->state.abscissa_m > fix.state.abscissa_m || excluded.fixes.count(fix.key)) continue;
      if (!first && std::abs(fix.state.stamp_s - last_s) < params.fix_correlation_s) continue;
      vehicle = id.vehicle;
      last_s = fix.state.stamp_s;
      kept.push_back(fix.key);
    }
  return kept;
}

}  // namespace

const char* to_string(HypothesisState state) {
  switch (state) {
    case HypothesisState::accepted: return "accepted";
    case HypothesisState::waiting: return "waiting";
    case HypothesisState::vetoed: return "vetoed";
    case HypothesisState::malformed: return "malformed";
    case HypothesisState::geometry: return "geometry";
    case HypothesisState::class_conflict: return "class_conflict";
    case HypothesisState::map_residual: return "map_residual";
  }
  return "unknown";
}

template <class G>
Selection<G> select(const FactStore<G>& store, const SelectionParams& params, const Exclusions& excluded) {
  Selection<G> selection;
  selection.hypotheses = stated(store);
  const std::set<Hash> vetoes = vetoed(store);
  Classes classes;
  for (Hypothesis<G>& h : selection.hypotheses) {
    h.state = vetoes.count(h.id)     ? HypothesisState::vetoed
              : excluded.hypotheses.count(h.id) ? HypothesisState::map_residual
                                     : examine(store, params, h);
    const auto batch_of_landmark = [&](const Key& key) { return store.landmark(key)->anchor_key(); };
    std::vector<Pairing> fitting;
    for (const Pairing& p : h.pairings)
      if (!excluded.landmarks.count(p.first) && !excluded.landmarks.count(p.second)) fitting.push_back(p);
    if (h.state == HypothesisState::accepted && !classes.join(fitting, batch_of_landmark))
      h.state = HypothesisState::class_conflict;
  }
  selection.classes = classes.sorted();
  ContentHash hash;
  for (const auto& members : selection.classes) {
    hash.add(static_cast<std::uint64_t>(members.size()), 4);
    for (const Key& k : members) hash.add(k.chain.vehicle, 4).add(k.chain.epoch).add(k.index, 4);
  }
  selection.fixes = thinned_fixes(store, params, excluded);
  for (const Key& key : selection.fixes) hash.add(key.chain.vehicle, 4).add(key.chain.epoch).add(key.index, 4);
  selection.digest = hash.value();
  return selection;
}

#define CONVOY_INSTANTIATE(G) \
  template Selection<G> select(const FactStore<G>&, const SelectionParams&, const Exclusions&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
