#include <convoy/geometry/groups.hpp>
#include <convoy/map/drift_check.hpp>

#include <algorithm>
#include <map>

namespace convoy {
namespace {

// The anchors of a chain as a driven path; `drift` is all that its author states, so that gamma = 1 is the whole model.
template <class G>
class Paths {
 public:
  explicit Paths(const FactStore<G>& store) : store_(store) {}

  std::pair<int, int> state_of(const Key& anchor) {
    const auto [it, fresh] = path_of_.try_emplace(anchor.chain, static_cast<int>(paths.size()));
    const auto& anchors = store_.chains().at(anchor.chain).anchors;
    if (fresh) {
      paths.emplace_back();
      for (const auto& [index, fact] : anchors) paths.back().states.push_back(fact.state);
    }
    return {it->second, static_cast<int>(std::distance(anchors.begin(), anchors.find(anchor.index)))};
  }

  std::vector<DrivenPath<G>> paths;

 private:
  const FactStore<G>& store_;
  std::map<ChainId, int> path_of_;
};

}  // namespace

template <class G>
Lag1 drift_correlation(const FactStore<G>& store, const Selection<G>& selection, const ChainId& chain,
                       std::size_t most) {
  // Hypotheses come strongest first, so the first of a closing batch is the one to keep.
  std::map<std::pair<double, Key>, const Hypothesis<G>*> by_closing;  // in the order of driving
  for (const Hypothesis<G>& h : selection.hypotheses) {
    if (h.state != HypothesisState::accepted || (h.batch_a.chain != chain && h.batch_b.chain != chain)) continue;
    const AnchorFact<G>*a = store.anchor(h.batch_a), *b = store.anchor(h.batch_b);
    if (a == nullptr || b == nullptr) continue;
    // Of a closure within the chain the later batch closed it; between chains, the one of this chain counts.
    const bool first = h.batch_b.chain != chain;
    by_closing.try_emplace({(first ? a : b)->state.abscissa_m, first ? h.batch_a : h.batch_b}, &h);
  }
  while (by_closing.size() > most) by_closing.erase(by_closing.begin());
  Paths<G> paths(store);
  std::vector<Closure<G>> closures;
  for (const auto& [place, h] : by_closing) {
    const auto [path_a, state_a] = paths.state_of(h->batch_a);
    const auto [path_b, state_b] = paths.state_of(h->batch_b);
    closures.push_back({path_a, state_a, path_b, state_b, h->alignment.T_a_b, h->alignment.covariance()});
  }
  return lag1_correlation({closure_residuals(paths.paths, closures)}, {1.0, 0.0, 0.0, 0.0, 0.0});
}

#define CONVOY_INSTANTIATE(G) \
  template Lag1 drift_correlation(const FactStore<G>&, const Selection<G>&, const ChainId&, std::size_t);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
