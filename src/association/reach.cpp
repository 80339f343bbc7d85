#include <convoy/association/reach.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>

namespace convoy {
namespace {

template <class G>
LandmarkFact<G> seen_from(const RelativePrior<G>& T, LandmarkFact<G> landmark) {
  const typename G::PointCovariance R = T.mean.rotation();
  const typename G::PointJacobian H = T.mean.act_jacobian(landmark.position);
  landmark.covariance = symmetrised(
      typename G::PointCovariance(R * landmark.covariance * R.transpose() + H * T.covariance * H.transpose()));
  landmark.position = T.mean * landmark.position;
  landmark.loading.setZero();
  return landmark;
}

template <class G>
bool all_complete(const FactStore<G>& store, const Key& anchor, Reach reach) {
  const std::vector<Key> batches = batches_within(anchor, reach);
  return std::all_of(batches.begin(), batches.end(), [&](const Key& batch) { return complete(store, batch); });
}

template <class G>
std::size_t size_of(const FactStore<G>& store, const Key& anchor, Reach reach) {
  std::size_t size = 0;
  for (const Key& key : batches_within(anchor, reach)) size += store.anchor(key)->landmark_count;
  return size;
}

// Those between the two batches alone; none if they are too few.
template <class G>
std::vector<Pairing> between(const ReachedPair<G>& pair, std::vector<Pairing> pairings, int at_least) {
  const auto is_of = [](const Batch<G>& joined, const Key& key) {
    return std::any_of(joined.landmarks.begin(), joined.landmarks.end(),
                       [&](const LandmarkFact<G>& l) { return l.key == key && l.anchor_key() == joined.anchor; });
  };
  std::erase_if(pairings, [&](const Pairing& p) {
    return !(is_of(pair.a, p.first) && is_of(pair.b, p.second)) && !(is_of(pair.b, p.first) && is_of(pair.a, p.second));
  });
  if (static_cast<int>(pairings.size()) < at_least) pairings.clear();
  return pairings;
}

// Those that its anchor counts: a stray one that names the anchor may come at any time, or never.
template <class G>
std::vector<LandmarkFact<G>> counted_landmarks(const FactStore<G>& store, const Key& anchor) {
  const AnchorFact<G>& fact = *store.anchor(anchor);
  std::vector<LandmarkFact<G>> landmarks = batch_of(store, anchor).landmarks;
  std::erase_if(landmarks,
                [&](const LandmarkFact<G>& l) { return l.key.index - fact.first_landmark >= fact.landmark_count; });
  return landmarks;
}

}  // namespace

std::vector<Key> batches_within(const Key& anchor, Reach reach) {
  std::vector<Key> keys;
  if (reach != Reach::alone && anchor.index > 0) keys.push_back({anchor.chain, anchor.index - 1});
  keys.push_back(anchor);
  if (reach == Reach::with_both) keys.push_back({anchor.chain, anchor.index + 1});
  return keys;
}

template <class G>
Batch<G> joined_batch(const FactStore<G>& store, const Key& anchor, Reach reach) {
  Batch<G> joined{anchor, {}};
  for (const Key& key : batches_within(anchor, reach))
    for (const LandmarkFact<G>& landmark : counted_landmarks(store, key))
      joined.landmarks.push_back(key == anchor ? landmark
                                               : seen_from(relative_prior(store, anchor, key).value(), landmark));
  return joined;
}

bool apart(const Key& a, const Key& b, Reach reach) {
  if (a.chain != b.chain) return true;
  return batches_within(a, reach).back() < batches_within(b, reach).front();
}

template <class G>
ReachedPair<G> reached_pair(const FactStore<G>& store, const Key& a, const Key& b, Reach reach,
                            const AssociationParams& params) {
  if (b < a) return reached_pair(store, b, a, reach, params);
  ReachedPair<G> pair{reach, {a, {}}, {b, {}}};
  if (!all_complete(store, a, reach) || !all_complete(store, b, reach)) {
    pair.rejection = Rejection::unfit;
  } else if (std::max(size_of(store, a, reach), size_of(store, b, reach)) > params.max_landmarks) {
    pair.rejection = Rejection::search_cut_off;
  } else {
    pair.a = joined_batch(store, a, reach);
    pair.b = joined_batch(store, b, reach);
    pair.prior = relative_prior(store, a, b);
  }
  return pair;
}

template <class G>
AssociationResult<G> associate(const ReachedPair<G>& pair, const AssociationParams& params,
                               const LooksAlike<G>& looks_alike) {
  AssociationResult<G> result;
  if (pair.rejection) {
    result.rejection = *pair.rejection;
    return result;
  }
  result = associate(pair.a, pair.b, pair.prior, params, looks_alike);
  if (pair.reach == Reach::alone) return result;
  result.pairings = between(pair, std::move(result.pairings), params.min_pairings);
  result.runner_up_pairings = between(pair, std::move(result.runner_up_pairings), params.min_pairings);
  const bool too_few =
      result.pairings.empty() || (result.decision == Decision::ambiguous && result.runner_up_pairings.empty());
  if (result.decision != Decision::none && too_few) {
    result.decision = Decision::none;
    result.rejection = Rejection::too_few_pairings;
  }
  return result;
}

template <class G>
AssociationResult<G> associate(const FactStore<G>& store, const Key& a, const Key& b, Reach reach,
                               const AssociationParams& params, const LooksAlike<G>& looks_alike) {
  return associate(reached_pair(store, a, b, reach, params), params, looks_alike);
}

template <class G>
std::optional<Reach> next_reach(const AssociationResult<G>& result, const Key& a, const Key& b, Reach reach) {
  const bool weak = result.rejection == Rejection::chance || result.rejection == Rejection::runner_up ||
                    result.rejection == Rejection::geometry;
  if (!weak || reach == Reach::with_both) return std::nullopt;
  const bool first = a.index == 0 && b.index == 0;  // nothing lies before them
  const Reach next = reach == Reach::alone && !first ? Reach::with_previous : Reach::with_both;
  return apart(a, b, next) ? std::optional(next) : std::nullopt;
}

#define CONVOY_INSTANTIATE(G)                                                                                         \
  template Batch<G> joined_batch(const FactStore<G>&, const Key&, Reach);                                             \
  template ReachedPair<G> reached_pair(const FactStore<G>&, const Key&, const Key&, Reach, const AssociationParams&); \
  template AssociationResult<G> associate(const ReachedPair<G>&, const AssociationParams&, const LooksAlike<G>&);     \
  template AssociationResult<G> associate(const FactStore<G>&, const Key&, const Key&, Reach,                         \
                                          const AssociationParams&, const LooksAlike<G>&);                            \
  template std::optional<Reach> next_reach(const AssociationResult<G>&, const Key&, const Key&, Reach);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
