#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/global_map.hpp>

#include <algorithm>
#include <map>
#include <set>

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

// The classes as one batch: points in the map's frame with the covariance of their members together.
template <class G>
Batch<G> classes_as_batch(const Problem<G>& problem, const Map<G>& map, std::size_t count) {
  std::vector<typename G::PointCovariance> information(count, G::PointCovariance::Zero());
  for (const LandmarkFactor<G>& f : problem.landmarks) {
    const typename G::PointCovariance R = map.poses()[static_cast<std::size_t>(f.node)].rotation();
    information[static_cast<std::size_t>(f.point)] += R * f.covariance.inverse() * R.transpose();
  }
  Batch<G> batch;
  for (std::size_t c = 0; c < count; ++c) {
    LandmarkFact<G> point;
    point.position = map.points()[c];
    point.covariance = information[c].inverse();
    batch.landmarks.push_back(point);
  }
  return batch;
}

// Landmarks of one batch that, with the rest of their batch laid onto the map, agree better with a class that has no
// landmark of this batch than with their own.
template <class G>
void find_misfits(const Batch<G>& classes, const Batch<G>& batch, const std::vector<IndexPairing>& pairs,
                  std::set<Key>& misfits) {
  const auto alignment = align(classes, batch, pairs);
  if (!alignment) return;
  std::set<int> taken;
  for (const auto& [c, l] : pairs) taken.insert(c);
  for (const auto& [c, l] : pairs) {
    const LandmarkFact<G>& landmark = batch.landmarks[static_cast<std::size_t>(l)];
    const auto fit = [&](int k) { return residual_chi2(*alignment, classes.landmarks[static_cast<std::size_t>(k)], landmark); };
    const double own = fit(c);
    for (int k = 0; k < static_cast<int>(classes.landmarks.size()); ++k)
      if (!taken.count(k) && fit(k) < own) misfits.insert(landmark.key);
  }
}

template <class G>
std::set<Key> misfits(const FactStore<G>& store, const Selection<G>& selection, const Map<G>& map, int min_pairings) {
  const Batch<G> classes = classes_as_batch(map.problem(), map, selection.classes.size());
  std::map<Key, Batch<G>> batches;
  std::map<Key, std::vector<IndexPairing>> pairs;
  for (std::size_t c = 0; c < selection.classes.size(); ++c)
    for (const Key& key : selection.classes[c]) {
      const LandmarkFact<G>& landmark = *store.landmark(key);
      Batch<G>& batch = batches[landmark.anchor_key()];
      pairs[landmark.anchor_key()].emplace_back(static_cast<int>(c), static_cast<int>(batch.landmarks.size()));
      batch.landmarks.push_back(landmark);
    }
  std::set<Key> found;
  for (const auto& [anchor, batch] : batches)
    if (static_cast<int>(batch.landmarks.size()) >= min_pairings) find_misfits(classes, batch, pairs[anchor], found);
  return found;
}

}  // namespace

template <class G>
GlobalMap<G> build_global_map(const FactStore<G>& store, const SelectionParams& params, const Backend<G>& backend) {
  const double limit = chi2_quantile(params.map_residual, G::Dof);
  Exclusions excluded;
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
    if (worst != nullptr) {
      excluded.hypotheses.insert(worst->id);
      continue;
    }
    const std::size_t before = excluded.size();
    excluded.landmarks.merge(misfits(store, result.selection, *result.map, params.min_pairings));
    if (excluded.size() == before) return result;
  }
}

#define CONVOY_INSTANTIATE(G) \
  template GlobalMap<G> build_global_map(const FactStore<G>&, const SelectionParams&, const Backend<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
