#include <convoy/components/association_component.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <utility>

namespace convoy {

template <class G>
AssociationComponent<G>::AssociationComponent(SubmapManager<G>& manager, const AssociationParams& params,
                                              LooksAlike<G> looks_alike)
    : manager_(manager), params_(params), looks_alike_(std::move(looks_alike)) {
  validate(params);
}

template <class G>
int AssociationComponent<G>::step(int max_searches, std::uint64_t max_nodes) {
  find_new_batches();
  const std::uint64_t before = counters_.search_nodes;
  int done = 0;
  for (; done < max_searches && counters_.search_nodes - before < max_nodes; ++done) {
    std::optional<Work> work = begin();
    if (!work) break;
    search(*work);
    finish(*work);
  }
  return done;
}

template <class G>
auto AssociationComponent<G>::begin() -> std::optional<Work> {
  const std::optional<Search> due = next();
  if (!due) return std::nullopt;
  return Work{*due, reached_pair(manager_.store(), due->a, due->b, due->reach, params_)};
}

template <class G>
void AssociationComponent<G>::find_new_batches() {
  const FactStore<G>& store = manager_.store();
  if (store.revision() == revision_) return;
  revision_ = store.revision();
  for (const auto& [id, chain] : store.chains())
    for (const auto& [index, anchor] : chain.anchors) {
      const Key batch{id, index};
      if (known_.count(batch) || !complete(store, batch)) continue;
      known_.insert(batch);
      if (static_cast<int>(anchor.landmark_count) >= params_.min_pairings) {
        rounds_.push_back({batch, searched_.size()});
        searched_.push_back(batch);
      }
      if (const auto ready = waiting_.extract(batch))
        for (const Search& search : ready.mapped()) {
          --counters_.waiting;
          queue(search);
        }
    }
}

// Every vehicle answers for its own batches, of earlier epochs too.
template <class G>
auto AssociationComponent<G>::next() -> std::optional<Search> {
  if (!queue_.empty()) {
    const Search search = queue_.back();
    queue_.pop_back();
    return search;
  }
  const VehicleId self = manager_.self().vehicle;
  while (!rounds_.empty()) {
    auto& [batch, left] = rounds_.back();
    while (left > 0) {
      const Key& other = searched_[--left];
      if (batch.chain.vehicle == self || other.chain.vehicle == self)
        return Search{std::min(batch, other), std::max(batch, other)};
    }
    rounds_.pop_back();
  }
  return std::nullopt;
}

// Or lets it wait for the first batch that it lacks.
template <class G>
void AssociationComponent<G>::queue(const Search& search) {
  for (const Key& anchor : {search.a, search.b})
    for (const Key& batch : batches_within(anchor, search.reach))
      if (known_.count(batch) == 0) {
        waiting_[batch].push_back(search);
        ++counters_.waiting;
        return;
      }
  queue_.push_back(search);
}

template <class G>
void AssociationComponent<G>::finish(const Work& work) {
  const auto& [a, b, reach] = work.search;
  const AssociationResult<G>& result = work.result;
  ++counters_.searches;
  counters_.search_nodes += result.nodes;
  if (result.decision == Decision::accepted) ++counters_.accepted;
  else ++counters_.rejected[static_cast<std::size_t>(result.rejection)];
  if (const auto next = next_reach(result, a, b, reach)) return queue({a, b, *next});
  for (const std::vector<Pairing>& pairings : result.statements())
    if (!manager_.publish_association(pairings)) ++counters_.already_stated;
}

#define CONVOY_INSTANTIATE(G) template class AssociationComponent<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
