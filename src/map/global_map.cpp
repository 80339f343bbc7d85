#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/global_map.hpp>
#include <convoy/map/hypothesis_graph.hpp>
#include <convoy/map/incremental_map.hpp>
#include <convoy/map/misfits.hpp>

#include <algorithm>
#include <set>
#include <utility>
#include <vector>

namespace convoy {
namespace {

// True if `after`, which does without some hypotheses more, amounts to the problem that `before` did: the same classes,
// the same fixes, and chains placed by the same hypotheses. Its solution is then the same, to the bit.
template <class G>
bool same_problem(const Selection<G>& before, const Selection<G>& after, const std::set<Hash>& dropped,
                  const Problem<G>& problem) {
  const auto same_state = [&](const Hypothesis<G>& x, const Hypothesis<G>& y) {
    return dropped.count(x.id) != 0 || x.state == y.state;
  };
  return before.classes == after.classes && before.fixes == after.fixes && before.encounters == after.encounters &&
         std::none_of(dropped.begin(), dropped.end(), [&](Hash id) { return problem.placed_by.count(id) != 0; }) &&
         std::equal(before.hypotheses.begin(), before.hypotheses.end(), after.hypotheses.begin(),
                    after.hypotheses.end(), same_state);
}

using Keys = std::unordered_set<Key>;

// The absolute fix or encounter that exceeds its gate by most, if by more than `at_least` times: true if there is one.
// Those that were judged before are passed over. One at a time: a gross one bends the map so far that others contradict
// it, too.
template <class G>
bool exclude_worst_measurement(Map<G>& map, double confidence, double at_least, const Keys& judged_fixes,
                               const Keys& judged_encounters, Exclusions& excluded) {
  double worst = std::max(1.0, at_least);
  std::pair<std::set<Key>*, Key> found{nullptr, {}};
  const auto weigh = [&](const auto& factor, const Key& key, const Keys& judged, std::set<Key>& set) {
    if (judged.count(key) != 0) return;
    const auto [chi2, dof] = map.contradiction(factor);
    const double excess = dof > 0 ? chi2 / chi2_quantile(confidence, dof) : 0.0;
    if (!(excess > worst)) return;
    worst = excess;
    found = {&set, key};
  };
  for (const auto& f : map.problem().fixes) weigh(f, f.fix, judged_fixes, excluded.fixes);
  for (const auto& f : map.problem().encounters) weigh(f, f.encounter, judged_encounters, excluded.encounters);
  if (found.first != nullptr) found.first->insert(found.second);
  return found.first != nullptr;
}

template <class G>
int node_of(const Problem<G>& problem, const Key& anchor) {
  const auto it = std::lower_bound(problem.nodes.begin(), problem.nodes.end(), anchor,
                                   [](const Node<G>& node, const Key& key) { return node.anchor < key; });
  return static_cast<int>(it - problem.nodes.begin());
}

// Squared distance of what a hypothesis says by itself from what a map says that has heard of it.
template <class G>
double contradiction(const Map<G>& map, const Hypothesis<G>& h) {
  const auto pose_of = [&](const Key& anchor) {
    return map.poses()[static_cast<std::size_t>(node_of(map.problem(), anchor))];
  };
  const G T_a_b = pose_of(h.batch_a).inverse() * pose_of(h.batch_b);
  return squared_mahalanobis((h.alignment.T_a_b.inverse() * T_a_b).Log(), h.alignment.covariance());
}

// T5 by the map alone: how many times a hypothesis exceeds its gate before its own share is taken off what the map
// says, or after.
template <class G>
double excess_of_new(Map<G>& map, const Hypothesis<G>& h, double confidence) {
  const DriftFactor<G> motion{node_of(map.problem(), h.batch_a), node_of(map.problem(), h.batch_b), h.alignment.T_a_b,
                              h.alignment.covariance()};
  const auto [chi2, dof] = map.contradiction(motion);
  return std::max(contradiction(map, h) / chi2_quantile(confidence, G::Dof),
                  dof > 0 ? chi2 / chi2_quantile(confidence, dof) : 0.0);
}

// What contradicts the rest most: how many times it exceeds its gate, and which hypothesis it is.
struct Worst {
  double excess = 1.0;
  Hash hypothesis = 0;
};

// By the graph of hypotheses, which leaves each out, or by the map, which does not, but knows what hypotheses share:
// the larger.
template <class G>
Worst worst_hypothesis(const HypothesisGraph<G>& graph, const Map<G>& map, const Selection<G>& selection,
                       double confidence) {
  Worst worst;
  const double limit = chi2_quantile(confidence, G::Dof);
  const auto left_out = graph.leave_one_out();
  for (std::size_t k = 0; k < left_out.size(); ++k) {
    const Hypothesis<G>& h = selection.hypotheses[k];
    if (h.state != HypothesisState::accepted) continue;
    const auto& [chi2, dof] = left_out[k];
    const double excess =
        std::max(contradiction(map, h) / limit, dof > 0 ? chi2 / chi2_quantile(confidence, dof) : 0.0);
    if (excess > worst.excess) worst = {excess, h.id};
  }
  return worst;
}

}  // namespace

ClassIndex::ClassIndex(const ClassList& classes) {
  auto chain = of_chain_.end();
  for (std::size_t c = 0; c < classes.size(); ++c)
    for (const Key& key : classes[c]) {
      if (chain == of_chain_.end() || chain->first != key.chain) chain = of_chain_.try_emplace(key.chain).first;
      chain->second.emplace_back(key.index, static_cast<int>(c));
    }
  for (auto& [id, landmarks] : of_chain_) std::sort(landmarks.begin(), landmarks.end());
}

std::optional<int> ClassIndex::find(const Key& landmark) const {
  const auto chain = of_chain_.find(landmark.chain);
  if (chain == of_chain_.end()) return std::nullopt;
  const auto found = std::lower_bound(chain->second.begin(), chain->second.end(), std::pair(landmark.index, 0));
  if (found == chain->second.end() || found->first != landmark.index) return std::nullopt;
  return found->second;
}

std::size_t ClassIndex::size() const {
  std::size_t sum = 0;
  for (const auto& [id, landmarks] : of_chain_) sum += landmarks.size();
  return sum;
}

template <class G>
GlobalMap<G> MapBuilder<G>::build(const FactStore<G>& store) {
  excluded_ = {};
  GlobalMap<G> result;
  result.facts = store.digest();
  std::set<Hash> dropped;  // in the round before
  bool bent = false;       // a measurement was left out after something else had been, by a map that it had bent
  while (true) {
    Selection<G> selection = selector_.select(store, excluded_);
    const bool solved = !dropped.empty() && same_problem(result.selection, selection, dropped, result.map->problem());
    result.selection = std::move(selection);
    if (!solved) {
      result.map = backend_.solve(problem_of(store, result.selection));
      problem_ = result.map->shared_problem();
    }
    dropped.clear();
    const HypothesisGraph<G> graph(*result.map, result.selection);
    const Worst worst = worst_hypothesis(graph, *result.map, result.selection, params_.map_residual);
    if (exclude_worst_measurement(*result.map, params_.fix_residual, worst.excess, {}, {}, excluded_)) {
      bent = bent || !excluded_.hypotheses.empty() || !excluded_.landmarks.empty();
      continue;
    }
    if (worst.hypothesis != 0) {
      dropped = graph.outliers(params_.map_residual);
      if (dropped.empty()) dropped.insert(worst.hypothesis);
      excluded_.hypotheses.insert(dropped.begin(), dropped.end());
      continue;
    }
    const std::size_t before = excluded_.size();
    excluded_.landmarks.merge(misfits(store, *result.map, params_));
    if (excluded_.size() != before) continue;
    if (!std::exchange(bent, false)) break;
    excluded_.hypotheses.clear();  // another look at all of them
    excluded_.landmarks.clear();
  }
  result.class_of = ClassIndex(result.selection.classes);
  drift_alarms_ = drift_check_.alarms(store, result.selection);
  if (incremental_) incremental_->restart(*result.map);
  finish(result);
  return result;
}

template <class G>
GlobalMap<G> MapBuilder<G>::update(const FactStore<G>& store) {
  if (!incremental_) incremental_ = backend_.incremental();
  if (!incremental_) return build(store);
  GlobalMap<G> result;
  result.facts = store.digest();
  result.exact = false;
  const Exclusions before = excluded_;
  bool bent = false;  // as in build(), by what has come in now
  while (true) {
    result.selection = selector_.select(store, excluded_);
    result.class_of = ClassIndex(result.selection.classes);
    result.map = incremental_->solve(problem_of(store, result.selection));
    problem_ = result.map->shared_problem();
    const std::size_t measurements = excluded_.fixes.size() + excluded_.encounters.size();
    const bool others = excluded_.hypotheses != before.hypotheses || excluded_.landmarks != before.landmarks;
    const bool left_out = exclude_news(result, store);
    bent = bent || (others && excluded_.fixes.size() + excluded_.encounters.size() != measurements);
    if (left_out) continue;
    if (!std::exchange(bent, false)) break;
    excluded_.hypotheses = before.hypotheses;
    excluded_.landmarks = before.landmarks;
  }
  finish(result);
  return result;
}

template <class G>
Problem<G> MapBuilder<G>::problem_of(const FactStore<G>& store, const Selection<G>& selection) const {
  const ProblemOptions options{params_.reference, params_.common_frame_is_enu, !backend_.takes_every_factor()};
  return build_problem<G>(store, selection, options, problem_.get());
}

// Of what was not in the last map. True if something is left out.
template <class G>
bool MapBuilder<G>::exclude_news(const GlobalMap<G>& global, const FactStore<G>& store) {
  const Selection<G>& selection = global.selection;
  Map<G>& map = *global.map;
  const std::size_t before = excluded_.size();
  std::set<int> classes;  // with news in them
  std::set<Hash> contradict;
  for (const Hypothesis<G>& h : selection.hypotheses) {
    if (h.state != HypothesisState::accepted || accepted_.count(h.id) != 0) continue;
    if (excess_of_new(map, h, params_.map_residual) > 1.0) contradict.insert(h.id);
    for (const auto& [a, b] : *h.pairings)
      for (const Key& landmark : {a, b})
        if (const auto known = global.class_of.find(landmark)) classes.insert(*known);
  }
  Keys judged_encounters;  // by the same answer
  for (const SelectedEncounter& e : selection.encounters)
    if (measured_waypoints_.count(e.waypoint) != 0) judged_encounters.insert(e.encounter);
  // What a gross measurement has bent is judged without it.
  if (exclude_worst_measurement(map, params_.fix_residual, 1.0, measured_fixes_, judged_encounters, excluded_))
    return true;
  excluded_.hypotheses.merge(contradict);
  if (excluded_.size() != before) return true;
  std::set<Key> batches;
  for (const int c : classes)
    for (std::size_t l = selection.classes.begin_of(static_cast<std::size_t>(c));
         l < selection.classes.end_of(static_cast<std::size_t>(c)); ++l)
      batches.insert(selection.landmarks[l]->anchor_key());
  if (!batches.empty()) excluded_.landmarks.merge(misfits(store, map, params_, &batches));
  return excluded_.size() != before;
}

template <class G>
void MapBuilder<G>::finish(GlobalMap<G>& global) {
  accepted_.clear();
  for (const Hypothesis<G>& h : global.selection.hypotheses) {
    if (h.state == HypothesisState::accepted) accepted_.insert(h.id);
    if (h.state == HypothesisState::ambiguous || h.state == HypothesisState::unconfirmed)
      global.unsettled.insert({h.batch_a.chain, h.batch_b.chain});
  }
  measured_fixes_ = {global.selection.fixes.begin(), global.selection.fixes.end()};
  measured_waypoints_.clear();
  for (const SelectedEncounter& e : global.selection.encounters) measured_waypoints_.insert(e.waypoint);
  global.drift_alarms = drift_alarms_;
  global.selection.landmarks.clear();  // the map may outlive the store
}

template <class G>
GlobalMap<G> build_global_map(const FactStore<G>& store, const SelectionParams& params, const Backend<G>& backend) {
  return MapBuilder<G>(params, backend).build(store);
}

#define CONVOY_INSTANTIATE(G)   \
  template class MapBuilder<G>; \
  template GlobalMap<G> build_global_map(const FactStore<G>&, const SelectionParams&, const Backend<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
