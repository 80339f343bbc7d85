#include <convoy/association/alignment.hpp>
#include <convoy/association/baselines.hpp>
#include <convoy/association/strip_index.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>
#include <tuple>

namespace convoy {
namespace {

std::size_t at(int i) { return static_cast<std::size_t>(i); }

template <class G>
std::vector<Eigen::Vector2d> on_the_ground(const Batch<G>& batch) {
  std::vector<Eigen::Vector2d> points;
  for (const auto& l : batch.landmarks) points.push_back(l.position.template head<2>());
  return points;
}

template <class G>
double middle_abscissa(const Batch<G>& batch) {
  return std::accumulate(batch.abscissa_m.begin(), batch.abscissa_m.end(), 0.0) /
         static_cast<double>(std::max<std::size_t>(1, batch.abscissa_m.size()));
}

// Where a landmark of b is seen from a: p + H d for a right perturbation d of T_a_b.
template <class G>
struct Prediction {
  typename G::Point p;
  typename G::PointJacobian H;
  typename G::PointCovariance noise;  // its own, and what drift adds as seen from the middle of its batch
};

template <class G>
Prediction<G> predict(const G& T_a_b, const Batch<G>& b, int j, double middle_m) {
  const LandmarkFact<G>& l = b.landmarks[at(j)];
  const typename G::PointCovariance R = T_a_b.rotation();
  const double apart_m = b.abscissa_m.empty() ? 0.0 : std::abs(b.abscissa_m[at(j)] - middle_m);
  return {T_a_b * l.position, T_a_b.act_jacobian(l.position),
          R * l.covariance * R.transpose() + b.drift_m2_per_m * apart_m * G::PointCovariance::Identity()};
}

// What is known of the perturbation d, by a Kalman filter of pairs.
template <class G>
struct Belief {
  typename G::Tangent d = G::Tangent::Zero();
  typename G::Covariance P = G::Covariance::Zero();

  typename G::PointCovariance innovation_covariance(const LandmarkFact<G>& i, const Prediction<G>& j) const {
    return i.covariance + j.noise + j.H * P * j.H.transpose();
  }
  typename G::Point innovation(const LandmarkFact<G>& i, const Prediction<G>& j) const {
    return i.position - j.p - j.H * d;
  }
  double chi2(const LandmarkFact<G>& i, const Prediction<G>& j) const {
    return squared_mahalanobis(innovation(i, j), innovation_covariance(i, j));
  }
  void update(const LandmarkFact<G>& i, const Prediction<G>& j) {
    const typename G::PointJacobian HP = j.H * P;
    const Eigen::LLT<typename G::PointCovariance> S(innovation_covariance(i, j));
    d += HP.transpose() * S.solve(innovation(i, j));
    P = symmetrised(typename G::Covariance(P - HP.transpose() * S.solve(HP)));
  }
};

// Landmarks of a batch in the order of their keys, and where they were.
template <class G>
struct Ordered {
  Batch<G> batch;
  std::vector<int> place;
};

template <class G>
Ordered<G> in_order(const Batch<G>& batch, std::vector<int> chosen) {
  std::sort(chosen.begin(), chosen.end(), [&](int k, int l) {
    return std::tie(batch.landmarks[at(k)].key, k) < std::tie(batch.landmarks[at(l)].key, l);
  });
  Ordered<G> ordered{{batch.anchor, {}}, chosen};
  ordered.batch.drift_m2_per_m = batch.drift_m2_per_m;
  for (const int k : chosen) {
    ordered.batch.landmarks.push_back(batch.landmarks[at(k)]);
    if (!batch.abscissa_m.empty()) ordered.batch.abscissa_m.push_back(batch.abscissa_m[at(k)]);
  }
  return ordered;
}

template <class G>
Ordered<G> in_order(const Batch<G>& batch) {
  std::vector<int> all(batch.landmarks.size());
  std::iota(all.begin(), all.end(), 0);
  return in_order(batch, std::move(all));
}

// Landmarks of a around those places where the prior allows b to be.
template <class G>
Ordered<G> within_reach(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior,
                        double confidence) {
  if (!prior) return in_order(a);
  double largest_variance = 0.0;
  for (const auto& l : a.landmarks) largest_variance = std::max(largest_variance, l.covariance.trace());
  constexpr double strip_m = 10.0;
  const StripIndex index(on_the_ground(a), strip_m);
  const double limit = chi2_quantile(confidence, G::Dim), middle_m = middle_abscissa(b);
  std::vector<bool> near(a.landmarks.size(), false);
  for (int j = 0; j < static_cast<int>(b.landmarks.size()); ++j) {
    const Prediction<G> seen = predict(prior->mean, b, j, middle_m);
    const typename G::PointCovariance S = seen.noise + seen.H * prior->covariance * seen.H.transpose();
    const double reach_m = std::sqrt(limit * (S.trace() + largest_variance));
    index.each_near(seen.p.template head<2>(), reach_m, [&](int i) { near[at(i)] = true; });
  }
  std::vector<int> chosen;
  for (int i = 0; i < static_cast<int>(near.size()); ++i)
    if (near[at(i)]) chosen.push_back(i);
  return in_order(a, std::move(chosen));
}

template <class G>
SearchResult as_given(SearchResult result, const Ordered<G>& a, const Ordered<G>& b) {
  for (auto& [i, j] : result.pairings) {
    i = a.place[at(i)];
    j = b.place[at(j)];
  }
  std::sort(result.pairings.begin(), result.pairings.end());
  return result;
}

// ---------------------------------------------------------------- joint compatibility

template <class G>
class JointSearch {
 public:
  JointSearch(const Batch<G>& a, const Batch<G>& b, const RelativePrior<G>& prior, double confidence,
              std::uint64_t max_nodes)
      : a_(a), max_nodes_(max_nodes), used_(a.landmarks.size(), false), limit_{0.0} {
    start_.P = prior.covariance;
    const double middle_m = middle_abscissa(b);
    const IndividualCompatibility<G> compatible(prior, confidence);
    for (int j = 0; j < static_cast<int>(b.landmarks.size()); ++j) {
      Fresh fresh{j, predict(prior.mean, b, j, middle_m), {}};
      for (int i = 0; i < static_cast<int>(a.landmarks.size()); ++i)
        if (compatible(a.landmarks[at(i)], b.landmarks[at(j)])) fresh.compatible.push_back(i);
      if (fresh.compatible.empty()) continue;
      fresh_.push_back(std::move(fresh));
      limit_.push_back(chi2_quantile(confidence, static_cast<double>(G::Dim * fresh_.size())));
    }
  }

  SearchResult run() {
    recurse(0, start_, 0.0);
    return {best_, cut_off_, nodes_};
  }

 private:
  struct Fresh {  // a new landmark and those that eq. 5 allows it to be
    int j;
    Prediction<G> seen;
    std::vector<int> compatible;
  };

  bool better(std::size_t pairings, double chi2) const {
    return pairings > best_.size() || (pairings == best_.size() && chi2 < best_chi2_);
  }

  // Hypothesis H_ on the first k new landmarks, what it says of the alignment, and its joint chi-square.
  void recurse(std::size_t k, const Belief<G>& belief, double chi2) {
    if (nodes_ == max_nodes_) cut_off_ = true;
    if (cut_off_) return;
    ++nodes_;
    if (better(H_.size(), chi2)) {
      best_ = H_;
      best_chi2_ = chi2;
    }
    if (k == fresh_.size()) return;
    const std::size_t left = fresh_.size() - k - 1;
    for (const auto& [increase, i] : jointly_compatible(fresh_[k], belief, chi2)) {
      if (!better(H_.size() + 1 + left, chi2 + increase)) break;
      Belief<G> updated = belief;
      updated.update(a_.landmarks[at(i)], fresh_[k].seen);
      used_[at(i)] = true;
      H_.emplace_back(i, fresh_[k].j);
      recurse(k + 1, updated, chi2 + increase);
      H_.pop_back();
      used_[at(i)] = false;
    }
    if (better(H_.size() + left, chi2)) recurse(k + 1, belief, chi2);  // paired with none
  }

  // (what it adds to the joint chi-square, i), the least first: a good hypothesis found early bounds the rest.
  std::vector<std::pair<double, int>> jointly_compatible(const Fresh& fresh, const Belief<G>& belief,
                                                         double chi2) const {
    std::vector<std::pair<double, int>> found;
    for (const int i : fresh.compatible) {
      if (used_[at(i)]) continue;
      const double increase = belief.chi2(a_.landmarks[at(i)], fresh.seen);
      if (chi2 + increase < limit_[H_.size() + 1]) found.emplace_back(increase, i);
    }
    std::sort(found.begin(), found.end());
    return found;
  }

  const Batch<G>& a_;
  std::uint64_t max_nodes_;
  Belief<G> start_;
  std::vector<Fresh> fresh_;
  std::vector<bool> used_;
  std::vector<double> limit_;  // of the joint chi-square, by the number of pairings
  std::vector<IndexPairing> H_, best_;
  double best_chi2_ = std::numeric_limits<double>::infinity();
  std::uint64_t nodes_ = 0;
  bool cut_off_ = false;
};

// ---------------------------------------------------------------- measures of a configuration

struct Measure {
  double value, variance;
};

bool same(const Measure& a, const Measure& b, double limit) {
  return std::pow(a.value - b.value, 2) < limit * (a.variance + b.variance);
}

template <std::size_t N>
using Vertices = std::array<int, N>;

template <class G, std::size_t N>
using Gradient = Eigen::Matrix<double, G::Dim, static_cast<int>(N)>;

template <class G, std::size_t N>
Gradient<G, N> positions(const Batch<G>& batch, const Vertices<N>& vertices) {
  Gradient<G, N> p;
  for (std::size_t v = 0; v < N; ++v) p.col(static_cast<int>(v)) = batch.landmarks[at(vertices[v])].position;
  return p;
}

// First-order variance of a measure of landmarks of one batch; what they share moves all of them.
template <class G, std::size_t N>
double variance(const Batch<G>& batch, const Vertices<N>& vertices, const Gradient<G, N>& gradient) {
  double own = 0.0, middle_m = 0.0;
  typename G::SharedVector shared = G::SharedVector::Zero();
  if (!batch.abscissa_m.empty())
    for (const int v : vertices) middle_m += batch.abscissa_m[at(v)] / static_cast<double>(N);
  for (std::size_t v = 0; v < N; ++v) {
    const typename G::Point g = gradient.col(static_cast<int>(v));
    const LandmarkFact<G>& l = batch.landmarks[at(vertices[v])];
    const typename G::SharedVector part = l.loading.transpose() * g;
    own += g.dot(l.covariance * g) - part.squaredNorm();
    shared += part;
    if (!batch.abscissa_m.empty())
      own += batch.drift_m2_per_m * std::abs(batch.abscissa_m[at(vertices[v])] - middle_m) * g.squaredNorm();
  }
  return own + shared.squaredNorm();
}

template <class G>
Measure distance(const Batch<G>& batch, int k, int l) {
  const Vertices<2> vertices{k, l};
  const Gradient<G, 2> p = positions(batch, vertices);
  const typename G::Point between = p.col(1) - p.col(0);
  Gradient<G, 2> gradient;
  gradient << -between.normalized(), between.normalized();
  return {between.norm(), variance(batch, vertices, gradient)};
}

template <class G>
Measure perimeter(const Batch<G>& batch, const Vertices<3>& vertices) {
  const Gradient<G, 3> p = positions(batch, vertices);
  Gradient<G, 3> gradient = Gradient<G, 3>::Zero();
  double sum = 0.0;
  for (int v = 0; v < 3; ++v) {
    const int w = (v + 1) % 3;
    const typename G::Point side = p.col(w) - p.col(v);
    sum += side.norm();
    gradient.col(w) += side.normalized();
    gradient.col(v) -= side.normalized();
  }
  return {sum, variance(batch, vertices, gradient)};
}

// In x and y, positive if counter-clockwise.
template <class G>
Measure signed_area(const Batch<G>& batch, const Vertices<3>& vertices) {
  const Gradient<G, 3> p = positions(batch, vertices);
  Gradient<G, 3> gradient = Gradient<G, 3>::Zero();
  double twice = 0.0;
  for (int v = 0; v < 3; ++v) {
    const int next = (v + 1) % 3, last = (v + 2) % 3;
    twice += p(0, v) * (p(1, next) - p(1, last));
    gradient.col(v).template head<2>() << 0.5 * (p(1, next) - p(1, last)), 0.5 * (p(0, last) - p(0, next));
  }
  return {0.5 * twice, variance(batch, vertices, gradient)};
}

Measure signed_volume(const Batch<SE3>& batch, const Vertices<4>& vertices) {
  const Gradient<SE3, 4> p = positions(batch, vertices);
  const Eigen::Vector3d u = p.col(1) - p.col(0), v = p.col(2) - p.col(0), w = p.col(3) - p.col(0);
  Gradient<SE3, 4> gradient;
  gradient.rightCols<3>() << v.cross(w) / 6.0, w.cross(u) / 6.0, u.cross(v) / 6.0;
  gradient.col(0) = -gradient.rightCols<3>().rowwise().sum();
  return {u.dot(v.cross(w)) / 6.0, variance(batch, vertices, gradient)};
}

template <class G>
Measure height(const Batch<G>& batch, int k, int l) {
  Gradient<G, 2> gradient = Gradient<G, 2>::Zero();
  gradient.template bottomRows<1>() << -1.0, 1.0;
  const Vertices<2> vertices{k, l};
  const Gradient<G, 2> p = positions(batch, vertices);
  return {p(G::Dim - 1, 1) - p(G::Dim - 1, 0), variance(batch, vertices, gradient)};
}

template <class G, std::size_t N>
bool same_distances(const Batch<G>& a, const Vertices<N>& in_a, const Batch<G>& b, const Vertices<N>& in_b,
                    double limit) {
  for (std::size_t v = 0; v < N; ++v)
    for (std::size_t w = v + 1; w < N; ++w)
      if (!same(distance(a, in_a[v], in_a[w]), distance(b, in_b[v], in_b[w]), limit)) return false;
  return true;
}

// ---------------------------------------------------------------- the largest set that fits one alignment

using Match = std::vector<IndexPairing>;  // landmarks that correspond if two configurations are the same one

template <std::size_t N>
Match match_of(const Vertices<N>& in_a, const Vertices<N>& in_b) {
  Match match;
  for (std::size_t v = 0; v < N; ++v) match.emplace_back(in_a[v], in_b[v]);
  return match;
}

template <class G>
class Consensus {
 public:
  Consensus(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior, double confidence,
            double gate)
      : a_(a),
        b_(b),
        prior_(prior),
        compatible_(prior, confidence),
        prior_limit_(chi2_quantile(confidence, G::Dof)),
        fits_limit_(chi2_quantile(gate, G::Dim)),
        middle_m_(middle_abscissa(b)),
        used_a_(a.landmarks.size(), false),
        used_b_(b.landmarks.size(), false) {}

  bool compatible(const Match& match) const {
    return std::all_of(match.begin(), match.end(), [&](const IndexPairing& p) {
      return compatible_(a_.landmarks[at(p.first)], b_.landmarks[at(p.second)]);
    });
  }

  // Tries the alignments of matches on candidates, in an order that favours none of them.
  SearchResult largest(std::vector<Match> matches, const std::vector<IndexPairing>& candidates,
                       std::uint64_t max_alignments) {
    shuffle(matches);
    SearchResult result;
    for (const Match& match : matches) {
      result.cut_off = result.nodes == max_alignments;
      if (result.cut_off) break;
      ++result.nodes;
      std::vector<IndexPairing> set = agreeing(match, candidates);
      if (set.size() > result.pairings.size()) result.pairings = std::move(set);
    }
    std::sort(result.pairings.begin(), result.pairings.end());
    return result;
  }

 private:
  struct Agreement {
    double spread_m2;  // by what the alignment leaves open
    double chi2;
    IndexPairing pairing;
    auto operator<=>(const Agreement&) const = default;
  };

  // Not by std::shuffle, whose result is up to the library.
  static void shuffle(std::vector<Match>& matches) {
    std::mt19937_64 engine(1);
    for (std::size_t k = matches.size(); k > 1; --k) std::swap(matches[k - 1], matches[engine() % k]);
  }

  const LandmarkFact<G>& in_a(const IndexPairing& p) const { return a_.landmarks[at(p.first)]; }

  bool take(const IndexPairing& p, std::vector<IndexPairing>& set) {
    if (used_a_[at(p.first)] || used_b_[at(p.second)]) return false;
    used_a_[at(p.first)] = used_b_[at(p.second)] = true;
    set.push_back(p);
    return true;
  }

  // The match and what fits its alignment, from near to far, so that the heading is known by the time it matters: each
  // that fits improves the alignment, which is linearised anew.
  std::vector<IndexPairing> agreeing(const Match& match, const std::vector<IndexPairing>& candidates) {
    G T = closed_form_alignment(a_, b_, match);
    Belief<G> belief;
    if (!covariance_of(match, T, belief.P) || !allowed(T, belief.P)) return {};
    std::vector<IndexPairing> set;
    for (const IndexPairing& p : match) take(p, set);
    for (const Agreement& next : fitting(candidates, T, belief)) {
      const Prediction<G> seen = predict(T, b_, next.pairing.second, middle_m_);
      if (!(belief.chi2(in_a(next.pairing), seen) < fits_limit_) || !take(next.pairing, set)) continue;
      belief.update(in_a(next.pairing), seen);
      T = T * G::Exp(belief.d);
      belief.d.setZero();
    }
    for (const auto& [i, j] : set) used_a_[at(i)] = used_b_[at(j)] = false;
    return set;
  }

  std::vector<Agreement> fitting(const std::vector<IndexPairing>& candidates, const G& T, const Belief<G>& belief) {
    std::vector<Prediction<G>> seen;
    for (int j = 0; j < static_cast<int>(b_.landmarks.size()); ++j) seen.push_back(predict(T, b_, j, middle_m_));
    std::vector<Agreement> found;
    for (const IndexPairing& p : candidates) {
      const Prediction<G>& s = seen[at(p.second)];
      const double chi2 = belief.chi2(in_a(p), s);
      if (chi2 < fits_limit_) found.push_back({(s.H * belief.P * s.H.transpose()).trace(), chi2, p});
    }
    std::sort(found.begin(), found.end());
    return found;
  }

  // False if the match does not fix the motion.
  bool covariance_of(const Match& match, const G& T, typename G::Covariance& P) const {
    typename G::Covariance information = G::Covariance::Zero();
    for (const IndexPairing& p : match) {
      const Prediction<G> seen = predict(T, b_, p.second, middle_m_);
      const Eigen::LLT<typename G::PointCovariance> noise(in_a(p).covariance + seen.noise);
      information += seen.H.transpose() * noise.solve(seen.H);
    }
    const Eigen::LDLT<typename G::Covariance> ldlt(information);
    if (ldlt.info() != Eigen::Success || !(ldlt.rcond() > 1e-12)) return false;
    P = symmetrised(typename G::Covariance(ldlt.solve(G::Covariance::Identity())));
    return true;
  }

  bool allowed(const G& T, const typename G::Covariance& P) const {
    if (!prior_) return true;
    const typename G::Tangent d = (prior_->mean.inverse() * T).Log();
    return squared_mahalanobis(d, typename G::Covariance(prior_->covariance + P)) < prior_limit_;
  }

  const Batch<G>& a_;
  const Batch<G>& b_;
  const std::optional<RelativePrior<G>>& prior_;
  IndividualCompatibility<G> compatible_;
  double prior_limit_, fits_limit_;
  double middle_m_;
  std::vector<bool> used_a_, used_b_;
};

void sort_unique(std::vector<IndexPairing>& pairings) {
  std::sort(pairings.begin(), pairings.end());
  pairings.erase(std::unique(pairings.begin(), pairings.end()), pairings.end());
}

// ---------------------------------------------------------------- three closest neighbours

struct Triplet {
  Vertices<4> vertices;             // a landmark, then its neighbours, the closest first
  std::array<Measure, 3> distance;  // to them
};

template <class G>
std::vector<Triplet> triplets_of(const Batch<G>& batch) {
  std::vector<Triplet> result;
  const int n = static_cast<int>(batch.landmarks.size());
  if (n < 4) return result;
  for (int k = 0; k < n; ++k) {
    constexpr std::pair<double, int> none{std::numeric_limits<double>::infinity(), -1};
    std::array<std::pair<double, int>, 4> closest{none, none, none, none};  // the last one is where the next goes
    for (int l = 0; l < n; ++l) {
      if (l == k) continue;
      closest[3] = {(batch.landmarks[at(l)].position - batch.landmarks[at(k)].position).squaredNorm(), l};
      for (std::size_t c = 3; c > 0 && closest[c] < closest[c - 1]; --c) std::swap(closest[c], closest[c - 1]);
    }
    Triplet t{{k, closest[0].second, closest[1].second, closest[2].second}, {}};
    for (std::size_t c = 0; c < 3; ++c) t.distance[c] = distance(batch, k, t.vertices[c + 1]);
    result.push_back(t);
  }
  return result;
}

// No mirror images: signed areas, in space signed volumes, are the same.
template <class G>
bool same_hand(const Batch<G>& a, const Vertices<4>& in_a, const Batch<G>& b, const Vertices<4>& in_b, double limit) {
  if constexpr (G::Dim == 3) return same(signed_volume(a, in_a), signed_volume(b, in_b), limit);
  for (const auto& [v, w] : {std::pair{1U, 2U}, {1U, 3U}, {2U, 3U}})
    if (!same(signed_area(a, {in_a[0], in_a[v], in_a[w]}), signed_area(b, {in_b[0], in_b[v], in_b[w]}), limit))
      return false;
  return true;
}

template <class G>
class TripletSearch {
 public:
  TripletSearch(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior, double confidence,
                const ConfigurationParams& params)
      : a_(a),
        b_(b),
        max_alignments_(params.max_alignments),
        limit_(chi2_quantile(params.gate, 1)),
        consensus_(a, b, prior, confidence, params.gate) {}

  SearchResult run() {
    const std::vector<Triplet> in_b = triplets_of(b_);
    for (const Triplet& ta : triplets_of(a_))
      for (const Triplet& tb : in_b)
        if (may_match(ta, tb)) add_matches(ta, tb);
    std::vector<IndexPairing> centres;
    for (const Match& match : matches_) centres.push_back(match.front());
    sort_unique(centres);
    return consensus_.largest(matches_, centres, max_alignments_);
  }

 private:
  bool may_match(const Triplet& ta, const Triplet& tb) const {
    for (std::size_t c = 0; c < 3; ++c)
      if (!same(ta.distance[c], tb.distance[c], limit_)) return false;
    return true;
  }

  // In every order of the neighbours that fits: noise may have swapped two at about the same distance.
  void add_matches(const Triplet& ta, const Triplet& tb) {
    std::array<std::size_t, 3> order{1, 2, 3};
    do {
      const Vertices<4> in_b{tb.vertices[0], tb.vertices[order[0]], tb.vertices[order[1]], tb.vertices[order[2]]};
      if (!same_distances(a_, ta.vertices, b_, in_b, limit_)) continue;
      if (!same_hand(a_, ta.vertices, b_, in_b, limit_)) continue;
      Match match = match_of(ta.vertices, in_b);
      if (consensus_.compatible(match)) matches_.push_back(std::move(match));
    } while (std::next_permutation(order.begin(), order.end()));
  }

  const Batch<G>& a_;
  const Batch<G>& b_;
  std::uint64_t max_alignments_;
  double limit_;
  Consensus<G> consensus_;
  std::vector<Match> matches_;
};

// ---------------------------------------------------------------- Delaunay triangles

double cross(const Eigen::Vector2d& u, const Eigen::Vector2d& v) { return u.x() * v.y() - u.y() * v.x(); }

// Points from left to right: a triangle whose circle lies to the left of the next point is finished.
class BowyerWatson {
 public:
  explicit BowyerWatson(const std::vector<Eigen::Vector2d>& points) : n_(static_cast<int>(points.size())), p_(points) {
    Eigen::Vector2d middle = Eigen::Vector2d::Zero();
    for (const auto& p : points) middle += p / static_cast<double>(n_);
    Eigen::Vector2d reach_m = Eigen::Vector2d::Ones();
    for (auto& p : p_) reach_m = reach_m.cwiseMax((p -= middle).cwiseAbs());
    if (reach_m.y() > reach_m.x())  // the long way is the one to sweep
      for (auto& p : p_) p = Eigen::Vector2d(p.y(), -p.x());
    const double extent_m = reach_m.maxCoeff();
    std::mt19937_64 engine(1);
    const auto chance = [&] { return static_cast<double>(engine() >> 11U) * 0x1p-53 - 0.5; };
    // Nothing is then exactly in a row or on a circle, where rounding would contradict itself.
    for (auto& p : p_)
      for (double& x : p) x += 1e-8 * extent_m * chance();
    const double far_m = 1e4 * extent_m;
    p_.insert(p_.end(), {{-2.0 * far_m, -far_m}, {2.0 * far_m, -far_m}, {0.0, 2.0 * far_m}});
    add(n_, n_ + 1, n_ + 2);
  }

  std::vector<std::array<int, 3>> run() {
    for (const int k : left_to_right()) insert(k);
    done_.insert(done_.end(), open_.begin(), open_.end());
    std::vector<std::array<int, 3>> result;
    for (Triangle& t : done_) {
      if (*std::max_element(t.v.begin(), t.v.end()) >= n_) continue;  // has a corner of the first one
      std::rotate(t.v.begin(), std::min_element(t.v.begin(), t.v.end()), t.v.end());
      result.push_back(t.v);
    }
    std::sort(result.begin(), result.end());
    return result;
  }

 private:
  struct Triangle {
    std::array<int, 3> v;  // counter-clockwise
    Eigen::Vector2d centre;
    double radius2;
  };

  std::vector<int> left_to_right() const {
    std::vector<int> order(at(n_)), kept;
    std::iota(order.begin(), order.end(), 0);
    const auto less = [&](int k, int l) { return std::tie(p_[at(k)].x(), k) < std::tie(p_[at(l)].x(), l); };
    std::sort(order.begin(), order.end(), less);
    constexpr double same_m = 1e-3;
    for (const int k : order) {
      const auto apart = [&](int l) { return (p_[at(l)] - p_[at(k)]).norm() >= same_m; };
      auto l = kept.rbegin();
      while (l != kept.rend() && p_[at(k)].x() - p_[at(*l)].x() < same_m && apart(*l)) ++l;
      if (l == kept.rend() || apart(*l)) kept.push_back(k);
    }
    return kept;
  }

  void add(int a, int b, int c) {
    const Eigen::Vector2d u = p_[at(b)] - p_[at(a)], v = p_[at(c)] - p_[at(a)];
    const double u2 = u.squaredNorm(), v2 = v.squaredNorm(), d = 2.0 * cross(u, v);
    const Eigen::Vector2d to_centre((v.y() * u2 - u.y() * v2) / d, (u.x() * v2 - v.x() * u2) / d);
    open_.push_back({{a, b, c}, p_[at(a)] + to_centre, to_centre.squaredNorm()});
  }

  // The centre of a flat triangle is far away and inexact: near its circle the determinant decides.
  bool in_circle(const Triangle& t, const Eigen::Vector2d& p) const {
    const double outside = (p - t.centre).squaredNorm() - t.radius2;
    if (std::abs(outside) > margin * t.radius2) return outside < 0.0;
    const Eigen::Vector2d u = p_[at(t.v[0])] - p, v = p_[at(t.v[1])] - p, w = p_[at(t.v[2])] - p;
    return u.squaredNorm() * cross(v, w) + v.squaredNorm() * cross(w, u) + w.squaredNorm() * cross(u, v) > 0.0;
  }

  void insert(int k) {
    std::vector<std::pair<int, int>> edges;  // of the triangles whose circles hold the point
    std::size_t kept = 0;
    for (const Triangle& t : open_) {
      const Eigen::Vector2d from_centre = p_[at(k)] - t.centre;
      if (in_circle(t, p_[at(k)])) {
        for (std::size_t v = 0; v < 3; ++v) edges.emplace_back(t.v[v], t.v[(v + 1) % 3]);
      } else if (from_centre.x() > 0.0 && from_centre.x() * from_centre.x() > (1.0 + margin) * t.radius2) {
        done_.push_back(t);
      } else {
        open_[kept++] = t;
      }
    }
    open_.resize(kept);
    for (const auto& [from, to] : edges)
      if (std::find(edges.begin(), edges.end(), std::pair(to, from)) == edges.end()) add(from, to, k);
  }

  static constexpr double margin = 1e-6;  // of a squared radius

  int n_;
  std::vector<Eigen::Vector2d> p_;
  std::vector<Triangle> open_, done_;
};

struct DescribedTriangle {
  Vertices<3> vertices;
  Measure perimeter, area;
};

// Without those so flat that noise may have turned them over; the smallest perimeter first.
template <class G>
std::vector<DescribedTriangle> triangles_of(const Batch<G>& batch, double limit) {
  std::vector<DescribedTriangle> result;
  for (const Vertices<3>& v : delaunay_triangulation(on_the_ground(batch))) {
    const DescribedTriangle t{v, perimeter(batch, v), signed_area(batch, v)};
    if (!same(t.area, {0.0, 0.0}, limit)) result.push_back(t);
  }
  std::sort(result.begin(), result.end(), [](const auto& s, const auto& t) {
    return std::tie(s.perimeter.value, s.vertices) < std::tie(t.perimeter.value, t.vertices);
  });
  return result;
}

template <class G>
class TriangleSearch {
 public:
  TriangleSearch(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior, double confidence,
                 const ConfigurationParams& params)
      : a_(a),
        b_(b),
        max_alignments_(params.max_alignments),
        limit_(chi2_quantile(params.gate, 1)),
        consensus_(a, b, prior, confidence, params.gate) {}

  SearchResult run() {
    find_matches();
    std::vector<IndexPairing> vertices;
    for (const Match& match : matches_) vertices.insert(vertices.end(), match.begin(), match.end());
    sort_unique(vertices);
    return consensus_.largest(matches_, vertices, max_alignments_);
  }

 private:
  void find_matches() {
    const std::vector<DescribedTriangle> in_a = triangles_of(a_, limit_);
    double widest = 0.0;
    for (const auto& t : in_a) widest = std::max(widest, t.perimeter.variance);
    for (const auto& tb : triangles_of(b_, limit_)) {
      const double window_m = std::sqrt(limit_ * (widest + tb.perimeter.variance));
      auto ta = std::lower_bound(in_a.begin(), in_a.end(), tb.perimeter.value - window_m,
                                 [](const DescribedTriangle& t, double p_m) { return t.perimeter.value < p_m; });
      for (; ta != in_a.end() && ta->perimeter.value <= tb.perimeter.value + window_m; ++ta)
        if (same(ta->perimeter, tb.perimeter, limit_) && same(ta->area, tb.area, limit_)) add_matches(*ta, tb);
    }
  }

  // Both are counter-clockwise: sides of the same lengths pair the vertices by one of three turns, never a mirror
  // image.
  void add_matches(const DescribedTriangle& ta, const DescribedTriangle& tb) {
    Vertices<3> in_b = tb.vertices;
    for (int turn = 0; turn < 3; ++turn) {
      std::rotate(in_b.begin(), in_b.begin() + 1, in_b.end());
      if (!same_distances(a_, ta.vertices, b_, in_b, limit_) || !same_heights(ta.vertices, in_b)) continue;
      Match match = match_of(ta.vertices, in_b);
      if (consensus_.compatible(match)) matches_.push_back(std::move(match));
    }
  }

  bool same_heights(const Vertices<3>& in_a, const Vertices<3>& in_b) const {
    if (G::Dim == 2) return true;
    for (std::size_t v = 0; v < 3; ++v) {
      const std::size_t w = (v + 1) % 3;
      if (!same(height(a_, in_a[v], in_a[w]), height(b_, in_b[v], in_b[w]), limit_)) return false;
    }
    return true;
  }

  const Batch<G>& a_;
  const Batch<G>& b_;
  std::uint64_t max_alignments_;
  double limit_;
  Consensus<G> consensus_;
  std::vector<Match> matches_;
};

}  // namespace

template <class G>
SearchResult jcbb(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior, double confidence,
                  std::uint64_t max_nodes) {
  if (!prior) return {};
  const Ordered<G> fresh = in_order(b), near = within_reach(a, fresh.batch, prior, confidence);
  return as_given(JointSearch<G>(near.batch, fresh.batch, *prior, confidence, max_nodes).run(), near, fresh);
}

template <class G>
SearchResult triplets(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior,
                      double confidence, const ConfigurationParams& params) {
  const Ordered<G> fresh = in_order(b), near = within_reach(a, fresh.batch, prior, confidence);
  return as_given(TripletSearch<G>(near.batch, fresh.batch, prior, confidence, params).run(), near, fresh);
}

template <class G>
SearchResult delaunay(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior,
                      double confidence, const ConfigurationParams& params) {
  const Ordered<G> fresh = in_order(b), near = within_reach(a, fresh.batch, prior, confidence);
  return as_given(TriangleSearch<G>(near.batch, fresh.batch, prior, confidence, params).run(), near, fresh);
}

std::vector<std::array<int, 3>> delaunay_triangulation(const std::vector<Eigen::Vector2d>& points) {
  if (points.size() < 3) return {};
  return BowyerWatson(points).run();
}

#define CONVOY_INSTANTIATE(G)                                                                                      \
  template SearchResult jcbb(const Batch<G>&, const Batch<G>&, const std::optional<RelativePrior<G>>&, double,     \
                             std::uint64_t);                                                                       \
  template SearchResult triplets(const Batch<G>&, const Batch<G>&, const std::optional<RelativePrior<G>>&, double, \
                                 const ConfigurationParams&);                                                      \
  template SearchResult delaunay(const Batch<G>&, const Batch<G>&, const std::optional<RelativePrior<G>>&, double, \
                                 const ConfigurationParams&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
