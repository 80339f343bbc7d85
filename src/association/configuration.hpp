// What closest neighbours and Delaunay triangles have in common, and nothing else uses: configurations of landmarks are
// matched by measures that do not depend on the frame, and the alignment that the most pairs fit wins.
#pragma once

#include <convoy/association/alignment.hpp>
#include <convoy/association/baselines.hpp>
#include <convoy/geometry/groups.hpp>

#include <array>
#include <cmath>
#include <random>

#include "baseline_parts.hpp"

namespace convoy::baseline {

struct Measure {
  double value, variance;
};

inline bool same(const Measure& a, const Measure& b, double limit) {
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

template <class G, std::size_t N>
bool same_distances(const Batch<G>& a, const Vertices<N>& in_a, const Batch<G>& b, const Vertices<N>& in_b,
                    double limit) {
  for (std::size_t v = 0; v < N; ++v)
    for (std::size_t w = v + 1; w < N; ++w)
      if (!same(distance(a, in_a[v], in_a[w]), distance(b, in_b[v], in_b[w]), limit)) return false;
  return true;
}
/// Landmarks that correspond if two configurations are the same one.
using Match = std::vector<IndexPairing>;

/// Matches of configurations, and the largest set of pairings that fits the alignment of one of them.
template <class G>
class Consensus {
 public:
  Consensus(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior, double confidence,
            const ConfigurationParams& params)
      : a_(a),
        b_(b),
        prior_(prior),
        compatible_(prior, confidence),
        prior_limit_(chi2_quantile(confidence, G::Dof)),
        fits_limit_(chi2_quantile(params.gate, G::Dim)),
        max_alignments_(params.max_alignments),
        middle_m_(middle_abscissa(b)),
        used_a_(a.landmarks.size(), false),
        used_b_(b.landmarks.size(), false) {}

  /// The same configuration in both batches, vertex by vertex, if every pair is individually compatible.
  template <std::size_t N>
  void add(const Vertices<N>& in_a, const Vertices<N>& in_b) {
    Match match;
    for (std::size_t v = 0; v < N; ++v) {
      if (!compatible_(a_.landmarks[at(in_a[v])], b_.landmarks[at(in_b[v])])) return;
      match.emplace_back(in_a[v], in_b[v]);
    }
    matches_.push_back(std::move(match));
  }

  /// Tries the alignments of matches on the first `candidates_each` pairs of all of them, in an order that favours
  /// none.
  SearchResult largest(std::ptrdiff_t candidates_each) {
    const std::vector<IndexPairing> candidates = first_pairs(candidates_each);
    shuffle(matches_);
    SearchResult result;
    for (const Match& match : matches_) {
      result.cut_off = result.nodes == max_alignments_;
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

  std::vector<IndexPairing> first_pairs(std::ptrdiff_t of_each) const {
    std::vector<IndexPairing> pairs;
    for (const Match& match : matches_) pairs.insert(pairs.end(), match.begin(), match.begin() + of_each);
    std::sort(pairs.begin(), pairs.end());
    pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
    return pairs;
  }

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
  std::uint64_t max_alignments_;
  double middle_m_;
  std::vector<bool> used_a_, used_b_;
  std::vector<Match> matches_;
};

}  // namespace convoy::baseline
