#include <convoy/geometry/groups.hpp>
#include <convoy/map/drift_check.hpp>
#include <convoy/submap/content_hash.hpp>

#include <algorithm>
#include <vector>

namespace convoy {
namespace {

constexpr std::size_t latest = 60;  // closures of a chain that are judged together

// Accepted hypotheses of one chain, in the order of driving; of each closing batch the strongest.
template <class G>
class Closures {
 public:
  Closures(const FactStore<G>& store, const Selection<G>& selection) : store_(store) {
    // Hypotheses come strongest first, so the first of a closing batch is the one to keep.
    for (const Hypothesis<G>& h : selection.hypotheses) {
      const AnchorFact<G>*a = store.anchor(h.batch_a), *b = store.anchor(h.batch_b);
      const bool stands = h.state == HypothesisState::accepted || h.state == HypothesisState::doubtful;
      if (!stands || a == nullptr || b == nullptr) continue;
      // Of a closure within the chain the later batch closed it; between chains, the one of this chain counts.
      of_[h.batch_b.chain].try_emplace({b->state.abscissa_m, h.batch_b}, &h);
      if (h.batch_a.chain != h.batch_b.chain) of_[h.batch_a.chain].try_emplace({a->state.abscissa_m, h.batch_a}, &h);
    }
  }

  std::vector<ChainId> chains() const {
    std::vector<ChainId> all;
    for (const auto& [chain, closures] : of_) all.push_back(chain);
    return all;
  }

  /// The latest `most` of them.
  std::vector<const Hypothesis<G>*> of(const ChainId& chain, std::size_t most) const {
    std::vector<const Hypothesis<G>*> list;
    if (const auto it = of_.find(chain); it != of_.end())
      for (const auto& [place, h] : it->second) list.push_back(h);
    list.erase(list.begin(), list.end() - static_cast<std::ptrdiff_t>(std::min(most, list.size())));
    return list;
  }

  Lag1 correlation(const std::vector<const Hypothesis<G>*>& list) const {
    std::map<ChainId, std::map<std::uint32_t, int>> places;  // chain -> anchor -> number of the state on its path
    for (const Hypothesis<G>* h : list)
      for (const Key& key : {h->batch_a, h->batch_b}) places[key.chain].insert({{0, 0}, {key.index, 0}});
    // `drift` is all that its author states, so that gamma = 1 is the whole model.
    std::vector<DrivenPath<G>> paths;
    std::map<ChainId, int> path_of;
    for (auto& [chain, states] : places) {
      path_of[chain] = static_cast<int>(paths.size());
      DrivenPath<G>& path = paths.emplace_back();
      for (auto& [index, number] : states) {
        number = static_cast<int>(path.states.size());
        const AnchorFact<G>* anchor = store_.anchor({chain, index});
        path.states.push_back(anchor != nullptr ? anchor->state : ChainState<G>{});  // index 0: the start
      }
    }
    std::vector<Closure<G>> closures;
    for (const Hypothesis<G>* h : list) {
      const auto state = [&](const Key& key) { return places.at(key.chain).at(key.index); };
      closures.push_back({path_of.at(h->batch_a.chain), state(h->batch_a), path_of.at(h->batch_b.chain),
                          state(h->batch_b), h->alignment.T_a_b, h->alignment.covariance()});
    }
    ResidualGroup group = closure_residuals(paths, closures);
    for (const auto& [chain, path] : path_of) hold_constants(chain, path, group);
    return lag1_correlation({group}, {1.0, 0.0, 0.0, 0.0, 0.0});
  }

 private:
  // What a chain states of its odometer's constants is no surprise, and the map estimates it (F5).
  void hold_constants(const ChainId& chain, int path, ResidualGroup& group) const {
    const PriorFact<G>* prior = store_.prior(chain);
    if (prior == nullptr || group.constants.empty()) return;
    const Eigen::MatrixXd& U = group.constants[static_cast<std::size_t>(path)];
    const Eigen::Vector2d sigma(prior->persistent.scale, prior->persistent.heading_rad_per_m);
    group.fixed += U * sigma.cwiseAbs2().asDiagonal() * U.transpose();
  }

  const FactStore<G>& store_;
  std::map<ChainId, std::map<std::pair<double, Key>, const Hypothesis<G>*>> of_;
};

}  // namespace

template <class G>
Lag1 drift_correlation(const FactStore<G>& store, const Selection<G>& selection, const ChainId& chain,
                       std::size_t most) {
  const Closures<G> closures(store, selection);
  return closures.correlation(closures.of(chain, most));
}

template <class G>
std::set<ChainId> DriftCheck<G>::alarms(const FactStore<G>& store, const Selection<G>& selection) {
  std::set<ChainId> result;
  const Closures<G> closures(store, selection);
  for (const ChainId& chain : closures.chains()) {
    const auto list = closures.of(chain, latest);
    ContentHash hash;
    for (const Hypothesis<G>* h : list) hash.add(h->id);
    const auto [it, fresh] = judged_.try_emplace(chain, hash.value(), false);
    if (fresh || it->second.first != hash.value()) it->second = {hash.value(), closures.correlation(list).alarm()};
    if (it->second.second) result.insert(chain);
  }
  return result;
}

#define CONVOY_INSTANTIATE(G)                                                                             \
  template Lag1 drift_correlation(const FactStore<G>&, const Selection<G>&, const ChainId&, std::size_t); \
  template class DriftCheck<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
