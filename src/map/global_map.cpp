#include <convoy/association/alignment.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/global_map.hpp>
#include <convoy/map/misfits.hpp>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <utility>
#include <vector>

namespace convoy {
namespace {

// Squared distance of what a hypothesis says by itself from what the map says, in units of its own covariance.
template <class G>
double contradiction(const Map<G>& map, const Hypothesis<G>& h) {
  const auto pose_of = [&](const Key& anchor) {
    const auto& nodes = map.problem().nodes;
    const auto it = std::lower_bound(nodes.begin(), nodes.end(), anchor,
                                     [](const Node<G>& node, const Key& key) { return node.anchor < key; });
    return map.poses()[static_cast<std::size_t>(it - nodes.begin())];
  };
  const G T_a_b = pose_of(h.batch_a).inverse() * pose_of(h.batch_b);
  return squared_mahalanobis((h.alignment.T_a_b.inverse() * T_a_b).Log(), h.alignment.covariance());
}

// Of each hypothesis; zero of those that are not accepted.
template <class G>
std::vector<double> contradictions_of(const Map<G>& map, const Selection<G>& selection) {
  std::vector<double> contradictions;
  for (const Hypothesis<G>& h : selection.hypotheses)
    contradictions.push_back(h.state == HypothesisState::accepted ? contradiction(map, h) : 0.0);
  return contradictions;
}

// True if `after`, which does without one hypothesis more, amounts to the problem that `before` did: the same classes,
// the same fixes, and chains placed by the same hypotheses. Its solution is then the same, to the bit.
template <class G>
bool same_problem(const Selection<G>& before, const Selection<G>& after, Hash dropped, const Problem<G>& problem) {
  const auto same_state = [&](const Hypothesis<G>& x, const Hypothesis<G>& y) {
    return x.id == dropped || x.state == y.state;
  };
  return before.digest == after.digest && !problem.placed_by.count(dropped) &&
         std::equal(before.hypotheses.begin(), before.hypotheses.end(), after.hypotheses.begin(),
                    after.hypotheses.end(), same_state);
}

// The absolute fix or encounter that exceeds its gate by most, if by more than `at_least` times: true if there is one.
template <class G>
bool exclude_worst_measurement(Map<G>& map, double confidence, double at_least, Exclusions& excluded) {
  double worst = std::max(1.0, at_least);
  std::pair<std::set<Key>*, Key> found{nullptr, {}};
  const auto weigh = [&](const auto& factor, const Key& key, std::set<Key>& set) {
    const auto [chi2, dof] = map.contradiction(factor);
    const double excess = dof > 0 ? chi2 / chi2_quantile(confidence, dof) : 0.0;
    if (!(excess > worst)) return;
    worst = excess;
    found = {&set, key};
  };
  for (const auto& f : map.problem().fixes) weigh(f, f.fix, excluded.fixes);
  for (const auto& f : map.problem().encounters) weigh(f, f.encounter, excluded.encounters);
  if (found.first != nullptr) found.first->insert(found.second);
  return found.first != nullptr;
}

}  // namespace

template <class G>
GlobalMap<G> MapBuilder<G>::build(const FactStore<G>& store) {
  const double limit = chi2_quantile(params_.map_residual, G::Dof);
  const ProblemOptions options{params_.reference, params_.common_frame_is_enu, !backend_.takes_every_factor()};
  Exclusions excluded;
  GlobalMap<G> result;
  result.facts = store.digest();
  std::optional<Hash> dropped;  // in the round before
  std::vector<double> contradictions;
  while (true) {
    Selection<G> selection = selector_.select(store, excluded);
    const bool solved = dropped && same_problem(result.selection, selection, *dropped, result.map->problem());
    result.selection = std::move(selection);
    if (!solved) {
      result.map =
          backend_.solve(build_problem<G>(store, result.selection, options));
      contradictions = contradictions_of(*result.map, result.selection);
    }
    const Hypothesis<G>* worst = nullptr;
    double worst_contradiction = limit;
    for (std::size_t k = 0; k < contradictions.size(); ++k) {
      const Hypothesis<G>& h = result.selection.hypotheses[k];
      if (h.state != HypothesisState::accepted || !(contradictions[k] > worst_contradiction)) continue;
      worst = &h;
      worst_contradiction = contradictions[k];
    }
    dropped.reset();
    if (exclude_worst_measurement(*result.map, params_.fix_residual, worst_contradiction / limit, excluded)) continue;
    if (worst != nullptr) {
      dropped = worst->id;
      excluded.hypotheses.insert(worst->id);
      continue;
    }
    const std::size_t before = excluded.size();
    excluded.landmarks.merge(misfits(store, result.selection, *result.map, params_));
    if (excluded.size() != before) continue;
    for (const Hypothesis<G>& h : result.selection.hypotheses)
      if (h.state == HypothesisState::ambiguous || h.state == HypothesisState::unconfirmed)
        result.unsettled.insert({h.batch_a.chain, h.batch_b.chain});
    for (std::size_t c = 0; c < result.selection.classes.size(); ++c)
      for (const Key& key : result.selection.classes[c]) result.class_of[key] = static_cast<int>(c);
    result.drift_alarms = drift_check_.alarms(store, result.selection);
    return result;
  }
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
