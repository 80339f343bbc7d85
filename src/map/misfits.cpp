#include <convoy/association/alignment.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/misfits.hpp>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
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
        evidence_of_(map.points().size()) {
    classes_.landmarks.resize(evidence_of_.size());
    const auto& landmarks = map.problem().landmarks;
    for (std::size_t l = 0; l < landmarks.size(); ++l)
      if (l == 0 || landmarks[l].point != landmarks[l - 1].point) first_member_.push_back(l);
    first_member_.push_back(landmarks.size());
    for (const LandmarkFactor<G>& f : landmarks) widest_ = std::max(widest_, f.covariance.trace());
    for (int c = 0; c < static_cast<int>(map.points().size()); ++c) by_x_.emplace_back(map.points()[index(c)].x(), c);
    std::sort(by_x_.begin(), by_x_.end());
  }

  std::set<Key> run(const std::set<Key>* batches) {
    std::map<Key, std::vector<const LandmarkFactor<G>*>> factors_of;  // by anchor
    for (const LandmarkFactor<G>& f : map_.problem().landmarks) {
      const Key& anchor = map_.problem().nodes[index(f.node)].anchor;
      if (batches == nullptr || batches->count(anchor) != 0) factors_of[anchor].push_back(&f);
    }
    for (const auto& [anchor, factors] : factors_of) {
      if (static_cast<int>(factors.size()) <= params_.min_pairings) continue;
      const Laid laid = lay(anchor, factors);
      for (const LandmarkFactor<G>* f : factors) classes_.landmarks[index(f->point)] = without(*f).point();
      judge(laid);
      for (const LandmarkFactor<G>* f : factors) classes_.landmarks[index(f->point)] = evidence(f->point).point();
    }
    return std::move(misfits_);
  }

 private:
  struct Laid {
    Batch<G> batch;
    std::vector<IndexPairing> pairs;  // (class, landmark)
    std::vector<int> unpaired;        // landmarks in no class
  };

  Laid lay(const Key& anchor, const std::vector<const LandmarkFactor<G>*>& factors) const {
    Laid laid{batch_of(store_, anchor), {}, {}};
    std::map<Key, int> class_of;
    for (const LandmarkFactor<G>* f : factors) class_of[f->landmark] = f->point;
    for (int l = 0; l < static_cast<int>(laid.batch.landmarks.size()); ++l) {
      const auto found = class_of.find(at(laid.batch, l).key);
      if (found == class_of.end()) laid.unpaired.push_back(l);
      else laid.pairs.emplace_back(found->second, l);
    }
    return laid;
  }

  Evidence<G> evidence_of(const LandmarkFactor<G>& f) const {
    const G& T = map_.poses()[index(f.node)];
    const typename G::PointCovariance R = T.rotation();
    Evidence<G> e;
    e.information = R * f.covariance.inverse() * R.transpose();
    e.weighted = e.information * (T * f.position);
    return e;
  }

  // Of all members of a class, when first asked for.
  const Evidence<G>& evidence(int c) {
    std::optional<Evidence<G>>& sum = evidence_of_[index(c)];
    if (sum) return *sum;
    sum.emplace();
    for (std::size_t l = first_member_[index(c)]; l < first_member_[index(c) + 1]; ++l) {
      const Evidence<G> e = evidence_of(map_.problem().landmarks[l]);
      sum->information += e.information;
      sum->weighted += e.weighted;
    }
    classes_.landmarks[index(c)] = sum->point();
    return *sum;
  }

  Evidence<G> without(const LandmarkFactor<G>& f) {
    Evidence<G> rest = evidence(f.point);
    const Evidence<G> own = evidence_of(f);
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
    const G& T = whole->T_a_b;
    const typename G::PointCovariance R = T.rotation();
    const auto conceivable = [&](int c,
                                 int l) {  // by each landmark's own covariance: the shared part may have hidden it
      const LandmarkFact<G>&point = class_point(c), &landmark = at(laid.batch, l);
      const typename G::Point apart = point.position - T * landmark.position;
      if (apart.squaredNorm() > reach_squared(point.covariance.trace() + landmark.covariance.trace())) return false;
      return squared_mahalanobis(
                 apart, typename G::PointCovariance(point.covariance + R * landmark.covariance * R.transpose())) < far_;
    };
    std::set<int> taken;
    for (const auto& [c, l] : laid.pairs) taken.insert(c);
    const auto other_class = [&](const IndexPairing& p) {
      const LandmarkFact<G>& landmark = at(laid.batch, p.second);
      const double x = (T * landmark.position).x();
      const double reach =
          2.0 * std::sqrt(reach_squared(widest_ + landmark.covariance.trace()));  // x is that of the solved point
      auto near = std::lower_bound(by_x_.begin(), by_x_.end(), std::pair(x - reach, -1));
      for (; near != by_x_.end() && near->first <= x + reach; ++near) {
        const int k = near->second;
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
    const auto members_of = [&](int of) { return std::pair(first_member_[index(of)], first_member_[index(of) + 1]); };
    const auto& landmarks = map_.problem().landmarks;
    for (auto [l, end] = members_of(c); l < end; ++l)
      for (auto [m, other_end] = members_of(k); m < other_end; ++m)
        if (landmarks[l].node == landmarks[m].node) return true;
    return false;
  }

  static const LandmarkFact<G>& at(const Batch<G>& batch, int l) { return batch.landmarks[index(l)]; }
  const LandmarkFact<G>& class_point(int c) {
    evidence(c);
    return at(classes_, c);
  }

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

  const FactStore<G>& store_;
  const Map<G>& map_;
  const SelectionParams& params_;
  double margin_, far_;
  std::vector<std::size_t> first_member_;  // of each class, among the factors of the problem; one more at the end
  std::vector<std::optional<Evidence<G>>> evidence_of_;  // of each class that was asked for
  Batch<G> classes_;                                     // their points
  std::vector<std::pair<double, int>> by_x_;             // (x of its solved point, class)
  double widest_ = 0.0;  // largest trace of a landmark's covariance; that of a class is smaller
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
