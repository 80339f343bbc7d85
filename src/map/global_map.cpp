#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/global_map.hpp>

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

}  // namespace

template <class G>
GlobalMap<G> build_global_map(const FactStore<G>& store, const SelectionParams& params, const Backend<G>& backend) {
  const double limit = chi2_quantile(params.map_residual, G::Dof);
  std::set<Hash> excluded;
  while (true) {
    GlobalMap<G> result;
    result.facts = store.digest();
    result.selection = select(store, params, excluded);
    result.map = backend.solve(build_problem(store, result.selection, params.reference));
    const Hypothesis<G>* worst = nullptr;
    double worst_contradiction = limit;
    for (const Hypothesis<G>& h : result.selection.hypotheses) {
      if (h.state != HypothesisState::accepted) continue;
      const double c = contradiction(*result.map, h);
      if (c > worst_contradiction) {
        worst = &h;
        worst_contradiction = c;
      }
    }
    if (worst == nullptr) return result;
    excluded.insert(worst->id);
  }
}

#define CONVOY_INSTANTIATE(G) \
  template GlobalMap<G> build_global_map(const FactStore<G>&, const SelectionParams&, const Backend<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
