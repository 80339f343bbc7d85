#include <convoy/association/alignment.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/selection.hpp>
#include <convoy/submap/content_hash.hpp>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <numeric>
#include <tuple>

namespace convoy {
namespace {

bool is_left_out(const std::vector<bool>& left_out, int a, int b) {
  return left_out[static_cast<std::size_t>(a)] || left_out[static_cast<std::size_t>(b)];
}

// Union-find over landmarks, by number, that refuses to put two landmarks of one batch into one class (DESIGN R4). The
// members of a class are a ring: exchanging the successors of a member of each joins two rings, and parts them again.
class Classes {
 public:
  explicit Classes(const std::vector<int>& batch_of)
      : batch_of_(batch_of), parent_(batch_of.size()), next_(batch_of.size()), size_(batch_of.size(), 1) {
    std::iota(parent_.begin(), parent_.end(), 0);
    std::iota(next_.begin(), next_.end(), 0);
  }

  // Joins all pairings of landmarks that are not left out, or none of them.
  bool join(const std::vector<std::pair<int, int>>& pairs, const std::vector<bool>& left_out) {
    merged_.clear();
    for (const auto& [a, b] : pairs)
      if (!is_left_out(left_out, a, b) && !merge(root(a), root(b))) {
        while (!merged_.empty()) undo();
        return false;
      }
    return true;
  }

  // Those of two or more, with their facts. `in_order`: the numbers of all landmarks, by key.
  template <class Fact>
  std::pair<ClassList, std::vector<Fact>> listed(const std::vector<int>& in_order, const std::vector<Key>& keys,
                                                 const std::vector<Fact>& facts) const {
    std::vector<int> class_of(parent_.size(), -1);  // of roots
    std::vector<std::size_t> end;                   // of each class; first the place of its next member
    std::size_t members = 0;
    for (const int l : in_order) {
      const int r = root(l);
      if (at(size_, r) < 2 || at(class_of, r) >= 0) continue;
      at(class_of, r) = static_cast<int>(end.size());
      end.push_back(members);
      members += static_cast<std::size_t>(at(size_, r));
    }
    std::vector<Key> listed_keys(members);
    std::vector<Fact> listed_facts(members);
    for (const int l : in_order) {
      const int c = at(class_of, root(l));
      if (c < 0) continue;
      const std::size_t place = end[static_cast<std::size_t>(c)]++;
      listed_keys[place] = keys[static_cast<std::size_t>(l)];
      listed_facts[place] = facts[static_cast<std::size_t>(l)];
    }
    return {ClassList(std::move(listed_keys), std::move(end)), std::move(listed_facts)};
  }

 private:
  static int at(const std::vector<int>& v, int i) { return v[static_cast<std::size_t>(i)]; }
  static int& at(std::vector<int>& v, int i) { return v[static_cast<std::size_t>(i)]; }

  int root(int l) const {
    while (at(parent_, l) != l) l = at(parent_, l);
    return l;
  }

  // While `visit` returns true; returns whether it always did.
  template <class Visit>
  bool each_member(int root, const Visit& visit) const {
    int l = root;
    do {
      if (!visit(l)) return false;
      l = at(next_, l);
    } while (l != root);
    return true;
  }

  bool merge(int into, int from) {
    if (into == from) return true;
    if (at(size_, into) < at(size_, from)) std::swap(into, from);
    const bool fits = each_member(
        into, [&](int l) { return each_member(from, [&](int m) { return at(batch_of_, l) != at(batch_of_, m); }); });
    if (!fits) return false;
    merged_.emplace_back(into, from);
    std::swap(at(next_, into), at(next_, from));
    at(parent_, from) = into;
    at(size_, into) += at(size_, from);
    return true;
  }

  void undo() {
    const auto [into, from] = merged_.back();
    merged_.pop_back();
    std::swap(at(next_, into), at(next_, from));
    at(parent_, from) = from;
    at(size_, into) -= at(size_, from);
  }

  const std::vector<int>& batch_of_;
  std::vector<int> parent_, next_, size_;
  std::vector<std::pair<int, int>> merged_;  // (into, from), by the join() in progress
};

// True if no place elsewhere could pass for this one unnoticed: one that looks alike shows in the batches themselves if
// it is nearer than half of what is paired, and the prior leaves no room for one farther away.
template <class G>
bool is_confined(const RelativePrior<G>& prior, const Batch<G>& a, const Batch<G>& b, double gate) {
  double extent = 0.0;
  typename G::Point centre = G::Point::Zero();
  for (const auto& l : a.landmarks)
    for (const auto& m : a.landmarks) extent = std::max(extent, (l.position - m.position).norm());
  for (const auto& l : b.landmarks) centre += l.position / static_cast<double>(b.landmarks.size());
  const typename G::PointJacobian H = prior.mean.act_jacobian(centre);
  const typename G::PointCovariance C = H * prior.covariance * H.transpose();
  return std::sqrt(gate * eigenvalues(symmetrised(C)).maxCoeff()) <= 0.5 * extent;
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

template <class G>
bool passed(const ChainState<G>& first, const ChainState<G>& second) {
  return first.stamp_s <= second.stamp_s && first.abscissa_m <= second.abscissa_m;
}

// A state that is said to follow an anchor: absent if the anchor has not arrived, or if it lies before it or beyond the
// next.
template <class G>
bool in_place(const typename FactStore<G>::Chain& chain, std::uint32_t index, const ChainState<G>& state) {
  const auto anchor = chain.anchors.find(index);
  if (anchor == chain.anchors.end() || !passed(anchor->second.state, state)) return false;
  const auto next = std::next(anchor);
  return next == chain.anchors.end() || passed(state, next->second.state);
}

// One fix per chain and correlation time, the first by key, so that errors that hang together do not count twice
// (DESIGN B7). One that contradicts the map is not replaced: its neighbours in time share its error.
template <class G>
std::vector<Key> thinned_fixes(const FactStore<G>& store, const SelectionParams& params, const Exclusions& excluded) {
  std::vector<Key> kept;
  for (const auto& [id, chain] : store.chains()) {
    std::set<double> taken_s;  // whatever the order of the stamps: their author need not be honest
    for (const auto& [index, fix] : chain.absolute_fixes) {
      if (!in_place<G>(chain, fix.anchor, fix.state)) continue;
      const double stamp_s = fix.state.stamp_s;
      const auto near = taken_s.upper_bound(stamp_s - params.fix_correlation_s);
      if (near != taken_s.end() && *near < stamp_s + params.fix_correlation_s) continue;
      taken_s.insert(stamp_s);
      if (excluded.fixes.count(fix.key) == 0) kept.push_back(fix.key);
    }
  }
  return kept;
}

// Encounters that the vehicle seen has answered; of several answers (it began a new epoch meanwhile) the first by key.
template <class G>
std::vector<SelectedEncounter> answered_encounters(const FactStore<G>& store, const Exclusions& excluded) {
  std::map<Key, Key> answer_to;
  for (const auto& [id, chain] : store.chains())
    for (const auto& [index, waypoint] : chain.waypoints) {
      const auto observer = store.chains().find(waypoint.encounter.chain);
      if (observer == store.chains().end() || excluded.encounters.count(waypoint.encounter) != 0) continue;
      const auto encounter = observer->second.encounters.find(waypoint.encounter.index);
      if (encounter == observer->second.encounters.end() || encounter->second.other != id.vehicle) continue;
      if (!in_place<G>(chain, waypoint.anchor, waypoint.state)) continue;
      if (!in_place<G>(observer->second, encounter->second.anchor, encounter->second.state)) continue;
      answer_to.try_emplace(waypoint.encounter, waypoint.key);
    }
  std::vector<SelectedEncounter> all;
  for (const auto& [encounter, waypoint] : answer_to) all.push_back({encounter, waypoint});
  return all;
}

}  // namespace

const char* to_string(HypothesisState state) {
  switch (state) {
    case HypothesisState::accepted: return "accepted";
    case HypothesisState::waiting: return "waiting";
    case HypothesisState::vetoed: return "vetoed";
    case HypothesisState::malformed: return "malformed";
    case HypothesisState::geometry: return "geometry";
    case HypothesisState::prior: return "prior";
    case HypothesisState::outvoted: return "outvoted";
    case HypothesisState::ambiguous: return "ambiguous";
    case HypothesisState::unconfirmed: return "unconfirmed";
    case HypothesisState::doubtful: return "doubtful";
    case HypothesisState::class_conflict: return "class_conflict";
    case HypothesisState::map_residual: return "map_residual";
  }
  return "unknown";
}

template <class G>
Selector<G>::Selector(const SelectionParams& params)
    : params_(params), map_residual_chi2_(chi2_quantile(params.map_residual, G::Dof)) {
  validate(params);
}

template <class G>
int Selector<G>::number(const FactStore<G>& store, const Key& landmark) {
  const auto [it, fresh] = landmark_number_.try_emplace(landmark, static_cast<int>(landmarks_.size()));
  if (fresh) {
    keys_.push_back(landmark);
    landmarks_.push_back(store.landmark(landmark));
    const Key batch = landmarks_.back()->anchor_key();
    batch_of_.push_back(batch_number_.try_emplace(batch, static_cast<int>(batch_number_.size())).first->second);
  }
  return it->second;
}

// What is new since the last time, merged in.
template <class G>
void Selector<G>::put_in_order() {
  const auto by_key = [&](int a, int b) {
    return keys_[static_cast<std::size_t>(a)] < keys_[static_cast<std::size_t>(b)];
  };
  const auto old = static_cast<std::ptrdiff_t>(in_order_.size());
  for (std::size_t l = in_order_.size(); l < landmarks_.size(); ++l) in_order_.push_back(static_cast<int>(l));
  std::sort(in_order_.begin() + old, in_order_.end(), by_key);
  std::inplace_merge(in_order_.begin(), in_order_.begin() + old, in_order_.end(), by_key);
}

// One-to-one between exactly two batches; finds them and the alignment.
template <class G>
typename Selector<G>::Examined Selector<G>::examined(const FactStore<G>& store, const std::vector<Pairing>& pairings) {
  Examined result;
  Hypothesis<G>& h = result.hypothesis;
  const auto ends = [&](HypothesisState state) {
    result.hypothesis.state = state;
    return result;
  };
  if (static_cast<int>(pairings.size()) < params_.min_pairings) return ends(HypothesisState::malformed);
  Batch<G> a, b;
  std::vector<IndexPairing> pairs;
  std::set<Key> seen;
  for (const auto& [ka, kb] : pairings) {
    const LandmarkFact<G>*la = store.landmark(ka), *lb = store.landmark(kb);
    if (la == nullptr || lb == nullptr) return ends(HypothesisState::waiting);
    if (lb->anchor_key() < la->anchor_key()) std::swap(la, lb);
    if (pairs.empty()) {
      h.batch_a = a.anchor = la->anchor_key();
      h.batch_b = b.anchor = lb->anchor_key();
    }
    const bool fits = la->anchor_key() == a.anchor && lb->anchor_key() == b.anchor && a.anchor != b.anchor;
    if (!fits || !seen.insert(ka).second || !seen.insert(kb).second) return ends(HypothesisState::malformed);
    pairs.emplace_back(static_cast<int>(pairs.size()), static_cast<int>(pairs.size()));
    a.landmarks.push_back(*la);
    b.landmarks.push_back(*lb);
  }
  for (const Key& anchor : {a.anchor, b.anchor})
    if (store.anchor(anchor) == nullptr || store.prior(anchor.chain) == nullptr) return ends(HypothesisState::waiting);
  for (Batch<G>* batch : {&a, &b}) add_scale_error(batch->landmarks, landmark_scale_sigma(store, batch->anchor.chain));
  const auto alignment = align(a, b, pairs);
  if (!alignment || alignment->chi2 > chi2_quantile(params_.residual, alignment->dof))
    return ends(HypothesisState::geometry);
  h.alignment = {alignment->T_a_b, alignment->covariance()};
  const auto prior = relative_prior(store, a.anchor, b.anchor, params_.slack);
  result.confined = prior && is_confined(*prior, a, b, chi2_quantile(params_.map_residual, G::Dim));
  if (prior && !(prior_chi2(*prior, h.alignment) <= map_residual_chi2_)) return ends(HypothesisState::prior);
  for (const auto& [ka, kb] : pairings) result.pairs.emplace_back(number(store, ka), number(store, kb));
  return ends(HypothesisState::accepted);
}

// Both between the same two chains. Of two that pair a landmark differently one is wrong, however near they are.
template <class G>
bool Selector<G>::hold_together(const FactStore<G>& store, const Examined& h, const Examined& k) const {
  const Hypothesis<G>&x = h.hypothesis, &y = k.hypothesis;
  if (x.batch_a == y.batch_a && x.batch_b == y.batch_b)
    for (const auto& [a, b] : h.pairs)
      for (const auto& [c, d] : k.pairs)
        if ((a == c) != (b == d)) return false;
  return loop_chi2(store, x, y, params_.slack) < map_residual_chi2_;
}

// Its number among the hypotheses between its two chains.
template <class G>
std::size_t Selector<G>::join_group(const FactStore<G>& store, Hash id, const Examined& fresh) {
  Group& group = groups_[{fresh.hypothesis.batch_a.chain, fresh.hypothesis.batch_b.chain}];
  std::vector<bool> together;
  for (const Hash other :
       group.members) {  // in the order of their ids: the test is symmetric but for rounding and first order
    const Examined& member = examined_.at(other);
    together.push_back(other < id ? hold_together(store, member, fresh) : hold_together(store, fresh, member));
  }
  group.members.push_back(id);
  group.together.add(std::move(together));
  return group.members.size() - 1;
}

// The heaviest set stands. Each set that contradicts it is weighed against the part of it that it contradicts; if it
// comes near that, neither is to be trusted, and if that part is most of what stands, nothing is.
template <class G>
void Selector<G>::decide(Group& group, const std::vector<int>& weights) const {
  std::vector<int> weight_of(group.members.size(), 0);
  for (std::size_t k = 0; k < group.active.size(); ++k) weight_of[group.active[k]] = weights[k];
  const auto weight = [&](const std::vector<std::size_t>& set) {
    int sum = 0;
    for (const std::size_t member : set) sum += weight_of[member];
    return sum;
  };
  const std::vector<std::size_t> standing = heaviest_clique(group.together, group.active, weights);
  group.state_of.assign(group.members.size(), HypothesisState::outvoted);
  for (const std::size_t member : standing) group.state_of[member] = HypothesisState::accepted;
  std::vector<std::size_t> others;
  for (const std::size_t member : group.active)
    if (group.state_of[member] == HypothesisState::outvoted) others.push_back(member);
  while (!others.empty()) {
    std::vector<int> other_weights;
    for (const std::size_t member : others) other_weights.push_back(weight_of[member]);
    const std::vector<std::size_t> rivals = heaviest_clique(group.together, others, other_weights);
    std::vector<std::size_t> contradicted;
    for (const std::size_t member : standing)
      if (std::any_of(rivals.begin(), rivals.end(), [&](std::size_t rival) { return !group.together(member, rival); }))
        contradicted.push_back(member);
    if (weight(rivals) > params_.max_runner_up_share * weight(contradicted)) {
      const std::vector<std::size_t>& lost = 2 * weight(contradicted) > weight(standing) ? standing : contradicted;
      for (const std::size_t member : rivals) group.state_of[member] = HypothesisState::ambiguous;
      for (const std::size_t member : lost) group.state_of[member] = HypothesisState::ambiguous;
    }
    std::erase_if(others, [&](std::size_t member) { return std::binary_search(rivals.begin(), rivals.end(), member); });
  }
}

// Pairings; those of several statements about the same two batches, which hold together, count once between them.
template <class G>
std::vector<int> Selector<G>::weights_of(const Group& group, const std::vector<Hypothesis<G>*>& members) const {
  constexpr int unit = 60;  // whole numbers: divisible by what there may be of them
  std::vector<int> weights;
  for (std::size_t k = 0; k < members.size(); ++k) {
    int statements = 0;
    for (std::size_t m = 0; m < members.size(); ++m)
      statements +=
          k == m || (members[k]->batch_a == members[m]->batch_a && members[k]->batch_b == members[m]->batch_b &&
                     group.together(group.active[k], group.active[m]));
    weights.push_back(std::max(1, unit * static_cast<int>(members[k]->pairings->size()) / statements));
  }
  return weights;
}

// Of the hypotheses between two chains those stand that hold together (DESIGN B5, T3).
template <class G>
void Selector<G>::find_consensus(std::vector<Hypothesis<G>>& hypotheses) {
  ByChains active;
  for (Hypothesis<G>& h : hypotheses)
    if (h.state == HypothesisState::accepted) active[{h.batch_a.chain, h.batch_b.chain}].push_back(&h);
  for (const auto& [chains, members] : active) {
    Group& group = groups_.at(chains);
    std::vector<std::size_t> numbers;
    for (const Hypothesis<G>* h : members) numbers.push_back(examined_.at(h->id).member);
    if (numbers != group.active) {
      group.active = std::move(numbers);
      decide(group, weights_of(group, members));
    }
    for (std::size_t k = 0; k < members.size(); ++k) members[k]->state = group.state_of[group.active[k]];
  }
}

// Hypotheses between different batches that hold together confirm each other, even by landmarks that are doubtful one
// by one. A single one stands if nothing could pass for what it has found, or if its chains are linked without it: then
// the map has its say.
template <class G>
void Selector<G>::demand_confirmation(std::vector<Hypothesis<G>>& hypotheses) const {
  ByChains standing;
  for (Hypothesis<G>& h : hypotheses)
    if (h.state == HypothesisState::accepted || h.state == HypothesisState::doubtful)
      standing[{h.batch_a.chain, h.batch_b.chain}].push_back(&h);
  const auto accepted = [](const Hypothesis<G>* h) { return h->state == HypothesisState::accepted; };
  std::map<ChainId, ChainId> parent;
  const auto root = [&](ChainId id) {
    for (auto it = parent.find(id); it != parent.end() && it->second != id; it = parent.find(id)) id = it->second;
    return id;
  };
  std::vector<const typename ByChains::value_type*> single;
  for (const auto& group : standing) {
    const auto& [chains, members] = group;
    if (std::none_of(members.begin(), members.end(), accepted)) continue;
    std::set<std::pair<Key, Key>> places;
    for (const Hypothesis<G>* h : members) places.insert({h->batch_a, h->batch_b});
    const bool sure =
        static_cast<int>(places.size()) >= params_.min_confirmed ||
        std::any_of(members.begin(), members.end(), [&](const auto* h) { return examined_.at(h->id).confined; });
    if (!sure) single.push_back(&group);
    else parent[std::max(root(chains.first), root(chains.second))] = std::min(root(chains.first), root(chains.second));
  }
  for (const auto* group : single) {
    const auto& [chains, members] = *group;
    if (chains.first != chains.second && root(chains.first) == root(chains.second)) continue;
    for (Hypothesis<G>* h : members)
      if (accepted(h)) h->state = HypothesisState::unconfirmed;
  }
}

template <class G>
const typename Selector<G>::Examined& Selector<G>::examine(const FactStore<G>& store, const Hypothesis<G>& h) {
  Examined& known = examined_[h.id];
  if (known.hypothesis.state != HypothesisState::waiting) return known;
  known = examined(store, *h.pairings);
  if (known.hypothesis.state == HypothesisState::accepted) known.member = join_group(store, h.id, known);
  return known;
}

// What has been stated since the last look, sorted in: most pairings first, then by id.
template <class G>
void Selector<G>::read_associations(const FactStore<G>& store) {
  std::vector<Hypothesis<G>> fresh;
  for (const auto& [chain_id, chain] : store.chains()) {
    std::set<std::uint32_t>& known = read_associations_[chain_id];
    if (known.size() == chain.associations.size()) continue;
    for (const auto& [index, fact] : chain.associations) {
      if (!known.insert(index).second) continue;
      const Hash id = hypothesis_id(fact.pairings);
      const auto [author, first] = author_of_.try_emplace(id, chain_id);
      author->second = std::min(author->second, chain_id);
      if (first)
        fresh.push_back({id,
                         std::make_shared<const std::vector<Pairing>>(fact.pairings),
                         chain_id,
                         HypothesisState::waiting,
                         {},
                         {},
                         {}});
    }
  }
  if (fresh.empty()) return;
  const auto comes_before = [](const Hypothesis<G>& a, const Hypothesis<G>& b) {
    return a.pairings->size() != b.pairings->size() ? a.pairings->size() > b.pairings->size() : a.id < b.id;
  };
  std::sort(fresh.begin(), fresh.end(), comes_before);
  const auto old = static_cast<std::ptrdiff_t>(stated_.size());
  stated_.insert(stated_.end(), std::make_move_iterator(fresh.begin()), std::make_move_iterator(fresh.end()));
  std::inplace_merge(stated_.begin(), stated_.begin() + old, stated_.end(), comes_before);
}

template <class G>
void Selector<G>::read(const FactStore<G>& store) {
  if (read_ && store.revision() == revision_) return;
  read_associations(store);
  for (Hypothesis<G>& h : stated_) h.author = author_of_.at(h.id);
  vetoed_ = vetoed(store);
  revision_ = store.revision();
  read_ = true;
}

template <class G>
Selection<G> Selector<G>::select(const FactStore<G>& store, const Exclusions& excluded) {
  read(store);
  Selection<G> selection;
  selection.hypotheses = stated_;
  for (Hypothesis<G>& h : selection.hypotheses) {
    if (vetoed_.count(h.id)) {
      h.state = HypothesisState::vetoed;
      continue;
    }
    const Hypothesis<G>& known = examine(store, h).hypothesis;
    h.state = known.state;
    h.batch_a = known.batch_a;
    h.batch_b = known.batch_b;
    h.alignment = known.alignment;
  }
  find_consensus(selection.hypotheses);  // what the map excludes has its vote: leaving it out lets nothing else in
  std::vector<bool> left_out(landmarks_.size(), false);
  for (const Key& key : excluded.landmarks)
    if (const auto it = landmark_number_.find(key); it != landmark_number_.end())
      left_out[static_cast<std::size_t>(it->second)] = true;
  for (Hypothesis<G>& h : selection.hypotheses) {
    if (h.state != HypothesisState::accepted) continue;
    const auto& pairs = examined_.at(h.id).pairs;
    const auto fitting = std::count_if(pairs.begin(), pairs.end(),
                                       [&](const auto& p) { return !is_left_out(left_out, p.first, p.second); });
    if (excluded.hypotheses.count(h.id)) h.state = HypothesisState::map_residual;
    else if (fitting < G::Dim) h.state = HypothesisState::doubtful;  // fixes no motion any more
  }
  demand_confirmation(selection.hypotheses);
  Classes classes(batch_of_);
  for (Hypothesis<G>& h : selection.hypotheses)
    if (h.state == HypothesisState::accepted && !classes.join(examined_.at(h.id).pairs, left_out))
      h.state = HypothesisState::class_conflict;
  put_in_order();
  std::tie(selection.classes, selection.landmarks) = classes.listed(in_order_, keys_, landmarks_);
  selection.fixes = thinned_fixes(store, params_, excluded);
  selection.encounters = answered_encounters(store, excluded);
  return selection;
}

template <class G>
Hash Selection<G>::digest() const {
  ContentHash hash;
  for (const auto& members : classes) {
    hash.add(static_cast<std::uint64_t>(members.size()), 4);
    for (const Key& key : members) add_key(hash, key);
  }
  for (const Key& key : fixes) add_key(hash, key);
  for (const SelectedEncounter& e : encounters) {
    add_key(hash, e.encounter);
    add_key(hash, e.waypoint);
  }
  return hash.value();
}

template <class G>
Selection<G> select(const FactStore<G>& store, const SelectionParams& params, const Exclusions& excluded) {
  return Selector<G>(params).select(store, excluded);
}

#define CONVOY_INSTANTIATE(G)   \
  template struct Selection<G>; \
  template class Selector<G>;   \
  template Selection<G> select(const FactStore<G>&, const SelectionParams&, const Exclusions&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
