#include <convoy/association/alignment.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/global_map.hpp>

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

// What one landmark says of the point of its class, common frame, information form.
template <class G>
struct Evidence {
  typename G::PointCovariance information = G::PointCovariance::Zero();
  typename G::Point weighted = G::Point::Zero();  // information * position

  LandmarkFact<G> point() const {
    LandmarkFact<G> point;
    point.covariance = symmetrised(typename G::PointCovariance(information.inverse()));
    point.position = point.covariance * weighted;
    return point;
  }
};

// Landmarks that could as well be of another class, or be exchanged, judged by a map that has not heard of their batch:
// a map of many batches tells neighbours apart that two batches cannot.
template <class G>
class MisfitSearch {
 public:
  MisfitSearch(const FactStore<G>& store, const Selection<G>& selection, const Map<G>& map,
               const SelectionParams& params)
      : params_(params),
        margin_(chi2_quantile(params.separation, G::Dim)),
        far_(chi2_quantile(0.9999, G::Dim)),
        evidence_of_(selection.classes.size()) {
    lay_batches(store, selection);
    for (const LandmarkFactor<G>& f : map.problem().landmarks) {
      const G& T = map.poses()[static_cast<std::size_t>(f.node)];
      const typename G::PointCovariance R = T.rotation();
      Evidence<G> e;
      e.information = R * f.covariance.inverse() * R.transpose();
      e.weighted = e.information * (T * f.position);
      Evidence<G>& sum = evidence_of_[static_cast<std::size_t>(f.point)];
      sum.information += e.information;
      sum.weighted += e.weighted;
      own_evidence_[f.landmark] = e;
    }
    for (const Evidence<G>& e : evidence_of_) {
      const double x = e.point().position.x();
      if (std::isfinite(x)) by_x_.emplace_back(x, static_cast<int>(classes_.landmarks.size()));
      classes_.landmarks.push_back(e.point());
      widest_class_ = std::max(widest_class_, classes_.landmarks.back().covariance.trace());
    }
    std::sort(by_x_.begin(), by_x_.end());
  }

  std::set<Key> run() {
    for (const auto& [anchor, laid] : batches_) {
      if (static_cast<int>(laid.pairs.size()) <= params_.min_pairings) continue;
      for (const auto& [c, l] : laid.pairs) at(classes_, c) = without(laid, c, l).point();
      judge(laid);
      for (const auto& [c, l] : laid.pairs) at(classes_, c) = evidence_of_[static_cast<std::size_t>(c)].point();
    }
    return std::move(misfits_);
  }

 private:
  struct Laid {
    Batch<G> batch;
    std::vector<IndexPairing> pairs;  // (class, landmark)
    std::vector<int> unpaired;        // landmarks in no class
  };

  void lay_batches(const FactStore<G>& store, const Selection<G>& selection) {
    std::map<Key, std::vector<IndexPairing>> pairs_of;  // anchor -> (class, landmark index)
    for (std::size_t c = 0; c < selection.classes.size(); ++c)
      for (const Key& key : selection.classes[c])
        pairs_of[store.landmark(key)->anchor_key()].emplace_back(static_cast<int>(c), static_cast<int>(key.index));
    for (auto& [anchor, pairs] : pairs_of) {
      Laid& laid = batches_[anchor];
      laid.batch = batch_of(store, anchor);
      for (int l = 0; l < static_cast<int>(laid.batch.landmarks.size()); ++l) {
        const auto index = static_cast<int>(at(laid.batch, l).key.index);
        const auto pair =
            std::find_if(pairs.begin(), pairs.end(), [&](const IndexPairing& p) { return p.second == index; });
        if (pair == pairs.end()) laid.unpaired.push_back(l);
        else laid.pairs.emplace_back(pair->first, l);
      }
    }
  }

  Evidence<G> without(const Laid& laid, int c, int l) const {
    Evidence<G> rest = evidence_of_[static_cast<std::size_t>(c)];
    const Evidence<G>& own = own_evidence_.at(at(laid.batch, l).key);
    rest.information -= own.information;
    rest.weighted -= own.weighted;
    return rest;
  }

  // A covariance has no eigenvalue beyond its trace: what lies farther than this needs no closer look.
  double reach_squared(double trace) const { return far_ * trace * (1.0 + 1e-6); }

  // classes_ have not heard of this batch.
  void judge(const Laid& laid) {
    const auto whole = align(classes_, laid.batch, laid.pairs);
    if (!whole) return;
    const typename G::PointCovariance R = whole->T_a_b.rotation();
    const auto conceivable = [&](int c,
                                 int l) {  // by each landmark's own covariance: the shared part may have hidden it
      const LandmarkFact<G>&point = at(classes_, c), &landmark = at(laid.batch, l);
      const typename G::Point apart = point.position - whole->T_a_b * landmark.position;
      if (apart.squaredNorm() > reach_squared(point.covariance.trace() + landmark.covariance.trace())) return false;
      return squared_mahalanobis(
                 apart, typename G::PointCovariance(point.covariance + R * landmark.covariance * R.transpose())) < far_;
    };
    std::set<int> taken;
    for (const auto& [c, l] : laid.pairs) taken.insert(c);
    const auto other_class = [&](const IndexPairing& p) {
      const LandmarkFact<G>& landmark = at(laid.batch, p.second);
      const double x = (whole->T_a_b * landmark.position).x();
      const double reach = std::sqrt(reach_squared(widest_class_ + landmark.covariance.trace()));
      auto near = std::lower_bound(by_x_.begin(), by_x_.end(), std::pair(x - reach, -1));
      for (; near != by_x_.end() && near->first <= x + reach; ++near) {
        const int k = near->second;
        if (!taken.count(k) && conceivable(k, p.second) && could_be(laid, {p}, {{k, p.second}})) return true;
      }
      return false;
    };
    for (const IndexPairing& p : laid.pairs) {
      const Key& key = at(laid.batch, p.second).key;
      if (other_class(p)) misfits_.insert(key);
      for (const int l : laid.unpaired)
        if (!misfits_.count(key) && conceivable(p.first, l) && could_be(laid, {p}, {{p.first, l}}))
          misfits_.insert(key);
      for (const IndexPairing& q : laid.pairs) {
        if (!(p < q && (conceivable(p.first, q.second) || conceivable(q.first, p.second)))) continue;
        if (could_be(laid, {p, q}, {{p.first, q.second}, {q.first, p.second}}))
          misfits_.insert({key, at(laid.batch, q.second).key});
      }
    }
  }

  static const LandmarkFact<G>& at(const Batch<G>& batch, int l) {
    return batch.landmarks[static_cast<std::size_t>(l)];
  }
  static LandmarkFact<G>& at(Batch<G>& batch, int l) { return batch.landmarks[static_cast<std::size_t>(l)]; }

  // Something else is conceivable. True unless, with the rest of the batch laid onto the map, `pairs` fit well, and
  // clearly better than `otherwise`.
  bool could_be(const Laid& laid, const std::vector<IndexPairing>& pairs,
                const std::vector<IndexPairing>& otherwise) const {
    std::vector<IndexPairing> rest;
    for (const IndexPairing& p : laid.pairs)
      if (std::find(pairs.begin(), pairs.end(), p) == pairs.end()) rest.push_back(p);
    const auto alignment = align(classes_, laid.batch, rest);
    if (!alignment) return true;
    const auto fit = [&](const std::vector<IndexPairing>& set) {
      double chi2 = 0.0;
      for (const auto& [c, l] : set) chi2 += residual_chi2(*alignment, at(classes_, c), at(laid.batch, l));
      return chi2;
    };
    const double fitted = fit(pairs);
    return fitted > static_cast<double>(pairs.size()) * margin_ || fit(otherwise) < fitted + margin_;
  }

  const SelectionParams& params_;
  double margin_, far_;
  std::vector<Evidence<G>> evidence_of_;      // of each class
  Batch<G> classes_;                          // their points
  std::vector<std::pair<double, int>> by_x_;  // (x of its point, class)
  double widest_class_ = 0.0;                 // largest trace of a covariance
  std::map<Key, Evidence<G>> own_evidence_;
  std::map<Key, Laid> batches_;
  std::set<Key> misfits_;
};

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
    excluded.landmarks.merge(MisfitSearch<G>(store, result.selection, *result.map, params_).run());
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
