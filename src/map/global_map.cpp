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

// What one landmark says of the point of its class, common frame, information form.
template <class G>
struct Evidence {
  typename G::PointCovariance information = G::PointCovariance::Zero();
  typename G::Point weighted = G::Point::Zero();  // information * position
};

// Landmarks that could as well be of another class, or be exchanged, judged by a map that has not heard of their batch: a map
// of many batches tells neighbours apart that two batches cannot.
template <class G>
class MisfitSearch {
 public:
  MisfitSearch(const FactStore<G>& store, const Selection<G>& selection, const Map<G>& map, const SelectionParams& params)
      : params_(params), margin_(chi2_quantile(params.separation, G::Dim)), classes_(selection.classes.size()) {
    std::map<Key, std::vector<IndexPairing>> pairs_of;  // anchor -> (class, landmark index)
    for (std::size_t c = 0; c < selection.classes.size(); ++c)
      for (const Key& key : selection.classes[c])
        pairs_of[store.landmark(key)->anchor_key()].emplace_back(static_cast<int>(c), static_cast<int>(key.index));
    for (auto& [anchor, pairs] : pairs_of) {
      Laid& laid = batches_[anchor];
      laid.batch = batch_of(store, anchor);
      for (int l = 0; l < static_cast<int>(laid.batch.landmarks.size()); ++l) {
        const auto index = static_cast<int>(at(laid.batch, l).key.index);
        const auto pair = std::find_if(pairs.begin(), pairs.end(), [&](const IndexPairing& p) { return p.second == index; });
        if (pair == pairs.end()) laid.unpaired.push_back(l);
        else laid.pairs.emplace_back(pair->first, l);
      }
    }
    for (const LandmarkFactor<G>& f : map.problem().landmarks) {
      const G& T = map.poses()[static_cast<std::size_t>(f.node)];
      const typename G::PointCovariance R = T.rotation();
      Evidence<G> e;
      e.information = R * f.covariance.inverse() * R.transpose();
      e.weighted = e.information * (T * f.position);
      Evidence<G>& sum = classes_[static_cast<std::size_t>(f.point)];
      sum.information += e.information;
      sum.weighted += e.weighted;
      evidence_[f.landmark] = e;
    }
  }

  std::set<Key> run() {
    for (const auto& [anchor, laid] : batches_)
      if (static_cast<int>(laid.pairs.size()) > params_.min_pairings) judge(laid);
    return std::move(misfits_);
  }

 private:
  struct Laid {
    Batch<G> batch;
    std::vector<IndexPairing> pairs;  // (class, landmark)
    std::vector<int> unpaired;        // landmarks in no class
  };

  Batch<G> classes_without(const Laid& laid) const {
    std::vector<Evidence<G>> evidence = classes_;
    for (const auto& [c, l] : laid.pairs) {
      const Evidence<G>& own = evidence_.at(laid.batch.landmarks[static_cast<std::size_t>(l)].key);
      evidence[static_cast<std::size_t>(c)].information -= own.information;
      evidence[static_cast<std::size_t>(c)].weighted -= own.weighted;
    }
    Batch<G> classes;
    for (const Evidence<G>& e : evidence) {
      LandmarkFact<G> point;
      point.covariance = symmetrised(typename G::PointCovariance(e.information.inverse()));
      point.position = point.covariance * e.weighted;
      classes.landmarks.push_back(point);
    }
    return classes;
  }

  void judge(const Laid& laid) {
    const Batch<G> classes = classes_without(laid);
    const auto whole = align(classes, laid.batch, laid.pairs);
    if (!whole) return;
    const double far = chi2_quantile(0.9999, G::Dim);
    const auto conceivable = [&](int c, int l) {  // by each landmark's own covariance: the shared part may have hidden it
      const LandmarkFact<G>&point = at(classes, c), &landmark = at(laid.batch, l);
      const typename G::PointCovariance R = whole->T_a_b.rotation();
      return squared_mahalanobis(typename G::Point(point.position - whole->T_a_b * landmark.position),
                                 typename G::PointCovariance(point.covariance + R * landmark.covariance * R.transpose())) < far;
    };
    std::set<int> taken;
    for (const auto& [c, l] : laid.pairs) taken.insert(c);
    for (const IndexPairing& p : laid.pairs) {
      for (int k = 0; k < static_cast<int>(classes.landmarks.size()); ++k)
        if (!taken.count(k) && conceivable(k, p.second) && could_be(classes, laid, {p}, {{k, p.second}}))
          misfits_.insert(at(laid.batch, p.second).key);
      for (const int l : laid.unpaired)
        if (conceivable(p.first, l) && could_be(classes, laid, {p}, {{p.first, l}})) misfits_.insert(at(laid.batch, p.second).key);
      for (const IndexPairing& q : laid.pairs) {
        if (!(p < q && (conceivable(p.first, q.second) || conceivable(q.first, p.second)))) continue;
        if (could_be(classes, laid, {p, q}, {{p.first, q.second}, {q.first, p.second}}))
          misfits_.insert({at(laid.batch, p.second).key, at(laid.batch, q.second).key});
      }
    }
  }

  static const LandmarkFact<G>& at(const Batch<G>& batch, int l) { return batch.landmarks[static_cast<std::size_t>(l)]; }

  // Something else is conceivable. True unless, with the rest of the batch laid onto the map, `pairs` fit well, and clearly
  // better than `otherwise`.
  bool could_be(const Batch<G>& classes, const Laid& laid, const std::vector<IndexPairing>& pairs,
                  const std::vector<IndexPairing>& otherwise) const {
    std::vector<IndexPairing> rest;
    for (const IndexPairing& p : laid.pairs)
      if (std::find(pairs.begin(), pairs.end(), p) == pairs.end()) rest.push_back(p);
    const auto alignment = align(classes, laid.batch, rest);
    if (!alignment) return true;
    const auto fit = [&](const std::vector<IndexPairing>& set) {
      double chi2 = 0.0;
      for (const auto& [c, l] : set) chi2 += residual_chi2(*alignment, at(classes, c), at(laid.batch, l));
      return chi2;
    };
    const double fitted = fit(pairs);
    return fitted > static_cast<double>(pairs.size()) * margin_ || fit(otherwise) < fitted + margin_;
  }

  const SelectionParams& params_;
  double margin_;
  std::vector<Evidence<G>> classes_;
  std::map<Key, Evidence<G>> evidence_;
  std::map<Key, Laid> batches_;
  std::set<Key> misfits_;
};

}  // namespace

template <class G>
GlobalMap<G> build_global_map(const FactStore<G>& store, const SelectionParams& params, const Backend<G>& backend) {
  const double limit = chi2_quantile(params.map_residual, G::Dof);
  Exclusions excluded;
  while (true) {
    GlobalMap<G> result;
    result.facts = store.digest();
    result.selection = select(store, params, excluded);
    result.map = backend.solve(build_problem(store, result.selection, params.reference, params.common_frame_is_enu));
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
    const AbsoluteFixFactor<G>* worst_fix = nullptr;
    double worst_excess = std::max(1.0, worst_contradiction / limit);  // of the gate
    for (const AbsoluteFixFactor<G>& f : result.map->problem().fixes) {
      const auto [chi2, dof] = result.map->contradiction(f);
      const double excess = dof > 0 ? chi2 / chi2_quantile(params.fix_residual, dof) : 0.0;
      if (excess > worst_excess) {
        worst_fix = &f;
        worst_excess = excess;
      }
    }
    if (worst_fix != nullptr) {
      excluded.fixes.insert(worst_fix->fix);
      continue;
    }
    if (worst != nullptr) {
      excluded.hypotheses.insert(worst->id);
      continue;
    }
    const std::size_t before = excluded.size();
    excluded.landmarks.merge(MisfitSearch<G>(store, result.selection, *result.map, params).run());
    if (excluded.size() == before) return result;
  }
}

#define CONVOY_INSTANTIATE(G) \
  template GlobalMap<G> build_global_map(const FactStore<G>&, const SelectionParams&, const Backend<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
