#include <convoy/components/association_component.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>

namespace convoy {

template <class G>
AssociationComponent<G>::AssociationComponent(SubmapManager<G>& manager, const AssociationParams& params)
    : manager_(manager), params_(params) {
  validate(params);
}

template <class G>
int AssociationComponent<G>::step(int max_searches) {
  queue_new_batches();
  int done = 0;
  for (; done < max_searches && !queue_.empty(); ++done) {
    const auto [a, b] = queue_.back();
    queue_.pop_back();
    search(a, b);
  }
  return done;
}

template <class G>
void AssociationComponent<G>::queue_new_batches() {
  const FactStore<G>& store = manager_.store();
  if (store.revision() == revision_) return;
  revision_ = store.revision();
  const VehicleId self = manager_.self().vehicle;
  for (const auto& [id, chain] : store.chains())
    for (const auto& [anchor, landmarks] : chain.batches) {
      const Key batch{id, anchor};
      if (known_.count(batch) || !complete(store, batch)) continue;
      // Every vehicle answers for its own batches, of earlier epochs too.
      for (const Key& other : known_)
        if (id.vehicle == self || other.chain.vehicle == self) queue_.push_back(std::minmax(batch, other));
      known_.insert(batch);
    }
}

template <class G>
void AssociationComponent<G>::search(const Key& a, const Key& b) {
  const FactStore<G>& store = manager_.store();
  ++counters_.searches;
  const auto result = associate(batch_of(store, a), batch_of(store, b), relative_prior(store, a, b), params_);
  counters_.search_nodes += result.nodes;
  if (result.decision == Decision::accepted) ++counters_.accepted;
  else ++counters_.rejected[static_cast<std::size_t>(result.rejection)];
  for (const std::vector<Pairing>& pairings : result.statements())
    if (!manager_.publish_association(pairings)) ++counters_.already_stated;
}

#define CONVOY_INSTANTIATE(G) template class AssociationComponent<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
