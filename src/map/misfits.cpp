#include <convoy/association/alignment.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/misfits.hpp>

#include <Eigen/LU>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>
#include <vector>

namespace convoy {
namespace {

std::size_t index(int i) { return static_cast<std::size_t>(i); }

// What landmarks say of the point of their class, common frame, information form.
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

template <class G>
class MisfitSearch {
 public:
  MisfitSearch(const FactStore<G>& store, const Map<G>& map, const SelectionParams& params)
      : store_(store),
        map_(map),
        params_(params),
        margin_(chi2_quantile(params.separation, G::Dim)),
        far_(chi2_quantile(0.9999, G::Dim)),
        number_of_(map.points().size(), -1) {
    const auto& landmarks = map.problem().landmarks;
    for (std::size_t l = 0; l < landmarks.size(); ++l) {
      if (l == 0 || landmarks[l].point != landmarks[l - 1].point) first_member_.push_back(l);
      widest_ = std::max(widest_, landmarks[l].covariance.trace());
    }
    first_member_.push_back(landmarks.size());
  }

  std::set<Key> run(const std::set<Key>* batches) {
    const std::vector<Node<G>>& nodes = map_.problem().nodes;
    std::vector<bool> judged(nodes.size());
    for (std::size_t n = 0; n < nodes.size(); ++n)
      judged[n] = batches == nullptr || batches->count(nodes[n].anchor) != 0;
    FactorsOfNode factors_of;
    for (const LandmarkFactor<G>& f : map_.problem().landmarks)
      if (judged[index(f.node)]) factors_of[f.node].push_back(&f);
    sort_points(factors_of, batches == nullptr);
    for (const auto& [node, factors] : factors_of) {
      if (static_cast<int>(factors.size()) <= params_.min_pairings) continue;
      const Laid laid = lay(nodes[index(node)].anchor, factors);
      for (const LandmarkFactor<G>* f : factors) {
        const std::size_t c = index(look_at(f->point));
        looked_at_.landmarks[c] = without(evidence_[c], *f).point();
      }
      judge(laid);
      for (const LandmarkFactor<G>* f : factors) {
        const std::size_t c = index(look_at(f->point));
        looked_at_.landmarks[c] = evidence_[c].point();
      }
    }
    return std::move(misfits_);
  }

 private:
  using FactorsOfNode = std::map<int, std::vector<const LandmarkFactor<G>*>>;

  // All, or those around some batches, as the map lays them: of what is farther away nothing can be conceivable.
  void sort_points(const FactorsOfNode& factors_of, bool all) {
    const double margin = 4.0 * std::sqrt(reach_squared(2.0 * widest_));
    typename G::Point low = G::Point::Constant(std::numeric_limits<double>::infinity()), high = -low;
    for (const auto& [node, factors] : factors_of)
      for (const LandmarkFactor<G>* f : factors) {
        const typename G::Point p = map_.poses()[index(node)] * f->position;
        low = low.cwiseMin(p);
        high = high.cwiseMax(p);
      }
    for (int c = 0; c < static_cast<int>(map_.points().size()); ++c) {
      const typename G::Point& p = map_.points()[index(c)];
      if (all || ((p - low).minCoeff() >= -margin && (high - p).minCoeff() >= -margin)) by_x_.emplace_back(p.x(), c);
    }
    std::sort(by_x_.begin(), by_x_.end());
  }

  struct Laid {
    Batch<G> batch;
    std::vector<IndexPairing> pairs;  // (class, landmark)
    std::vector<int> unpaired;        // landmarks in no class
  };

  Laid lay(const Key& anchor, const std::vector<const LandmarkFactor<G>*>& factors) {
    Laid laid{batch_of(store_, anchor), {}, {}};
    std::map<Key, int> class_of;
    for (const LandmarkFactor<G>* f : factors) class_of[f->landmark] = f->point;
    for (int l = 0; l < static_cast<int>(laid.batch.landmarks.size()); ++l) {
      const auto found = class_of.find(at(laid.batch, l).key);
      if (found == class_of.end()) laid.unpaired.push_back(l);
      else laid.pairs.emplace_back(look_at(found->second), l);
    }
    return laid;
  }

  Evidence<G> evidence_of(const LandmarkFactor<G>& f) const {
    const G& T = map_.poses()[index(f.node)];
    const typename G::PointCovariance R = T.rotation();
    Evidence<G> e;
    e.information = R * f.covariance.inverse() * R.transpose();
    e.weighted = e.information * (T * typename G::Point(map_.landmark_scale(f.landmark.chain) * f.position));
    return e;
  }

  // Its number among the classes that are looked at; all of its members have their say.
  int look_at(int point) {
    int& number = number_of_[index(point)];
    if (number >= 0) return number;
    number = static_cast<int>(point_of_.size());
    Evidence<G> sum;
    for (std::size_t l = first_member_[index(point)]; l < first_member_[index(point) + 1]; ++l) {
      const Evidence<G> e = evidence_of(map_.problem().landmarks[l]);
      sum.information += e.information;
      sum.weighted += e.weighted;
    }
    point_of_.push_back(point);
    evidence_.push_back(sum);
    looked_at_.landmarks.push_back(sum.point());
    return number;
  }

  Evidence<G> without(Evidence<G> all, const LandmarkFactor<G>& f) const {
    const Evidence<G> own = evidence_of(f);
    all.information -= own.information;
    all.weighted -= own.weighted;
    return all;
  }

  // A covariance has no eigenvalue beyond its trace: what lies farther than this needs no closer look.
  double reach_squared(double trace) const { return far_ * trace * (1.0 + 1e-6); }

  // looked_at_ has not heard of this batch.
  void judge(const Laid& laid) {
    const auto whole = align(looked_at_, laid.batch, laid.pairs);
    if (!whole) return;
    const G& T = whole->T_a_b;
    const typename G::PointCovariance R = T.rotation();
    const auto conceivable = [&](int c,
                                 int l) {  // by each landmark's own covariance: the shared part may have hidden it
      const LandmarkFact<G>&point = at(looked_at_, c), &landmark = at(laid.batch, l);
      const typename G::Point apart = point.position - T * landmark.position;
      if (apart.squaredNorm() > reach_squared(point.covariance.trace() + landmark.covariance.trace())) return false;
      return squared_mahalanobis(
                 apart, typename G::PointCovariance(point.covariance + R * landmark.covariance * R.transpose())) < far_;
    };
    std::set<int> taken;
    for (const auto& [c, l] : laid.pairs) taken.insert(c);
    const auto other_class = [&](const IndexPairing& p) {
      const LandmarkFact<G>& landmark = at(laid.batch, p.second);
      const typename G::Point p_map = T * landmark.position;
      const double reach =
          2.0 * std::sqrt(reach_squared(widest_ + landmark.covariance.trace()));  // of the solved points
      auto near = std::lower_bound(by_x_.begin(), by_x_.end(), std::pair(p_map.x() - reach, -1));
      for (; near != by_x_.end() && near->first <= p_map.x() + reach; ++near) {
        if ((map_.points()[index(near->second)] - p_map).norm() > reach) continue;
        const int k = look_at(near->second);
        if (taken.count(k) || !conceivable(k, p.second) || !told_apart(k, p.first)) continue;
        if (could_be(laid, {p}, {{k, p.second}})) return true;
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

  // Some batch has seen both: else they may well be one thing, of which not everybody has been told, and which of them
  // a landmark belongs to makes no difference.
  bool told_apart(int c, int k) const {
    const auto members_of = [&](int of) {
      const std::size_t point = index(point_of_[index(of)]);
      return std::pair(first_member_[point], first_member_[point + 1]);
    };
    const auto& landmarks = map_.problem().landmarks;
    for (auto [l, end] = members_of(c); l < end; ++l)
      for (auto [m, other_end] = members_of(k); m < other_end; ++m)
        if (landmarks[l].node == landmarks[m].node) return true;
    return false;
  }

  static const LandmarkFact<G>& at(const Batch<G>& batch, int l) { return batch.landmarks[index(l)]; }

  // Something else is conceivable. True unless, with the rest of the batch laid onto the map, `pairs` fit well, and
  // clearly better than `otherwise`.
  bool could_be(const Laid& laid, const std::vector<IndexPairing>& pairs,
                const std::vector<IndexPairing>& otherwise) const {
    std::vector<IndexPairing> rest;
    for (const IndexPairing& p : laid.pairs)
      if (std::find(pairs.begin(), pairs.end(), p) == pairs.end()) rest.push_back(p);
    const auto alignment = align(looked_at_, laid.batch, rest);
    if (!alignment) return true;
    const auto fit = [&](const std::vector<IndexPairing>& set) {
      double chi2 = 0.0;
      for (const auto& [c, l] : set) chi2 += residual_chi2(*alignment, at(looked_at_, c), at(laid.batch, l));
      return chi2;
    };
    const double fitted = fit(pairs);
    return fitted > static_cast<double>(pairs.size()) * margin_ || fit(otherwise) < fitted + margin_;
  }

  const FactStore<G>& store_;
  const Map<G>& map_;
  const SelectionParams& params_;
  double margin_, far_;
  std::vector<std::size_t> first_member_;     // of each class, among the factors of the problem; one more at the end
  std::vector<int> number_of_;                // of each point, among the classes that are looked at; -1: not yet
  std::vector<int> point_of_;                 // of each class that is looked at
  std::vector<Evidence<G>> evidence_;         // the same
  Batch<G> looked_at_;                        // the same: where they are
  std::vector<std::pair<double, int>> by_x_;  // (x of its solved point, class)
  double widest_ = 0.0;                       // largest trace of a landmark's covariance; that of a class is smaller
  std::set<Key> misfits_;
};

}  // namespace

template <class G>
std::set<Key> misfits(const FactStore<G>& store, const Map<G>& map, const SelectionParams& params,
                      const std::set<Key>* batches) {
  return MisfitSearch<G>(store, map, params).run(batches);
}

#define CONVOY_INSTANTIATE(G) \
  template std::set<Key> misfits(const FactStore<G>&, const Map<G>&, const SelectionParams&, const std::set<Key>*);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
