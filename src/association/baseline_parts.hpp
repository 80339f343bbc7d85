// What the baselines have in common, and nothing else uses: where new landmarks are seen given an alignment, what pairs
// say of that alignment, and landmarks in an order that does not depend on how they are given.
#pragma once

#include <convoy/association/constraints.hpp>
#include <convoy/association/search.hpp>
#include <convoy/association/strip_index.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

namespace convoy::baseline {

inline std::size_t at(int i) { return static_cast<std::size_t>(i); }

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

/// search(near, fresh): landmarks of a within reach of b, and those of b, in the order of their keys. Pairings are of
/// the batches as given.
template <class G, class Search>
SearchResult in_order_of_keys(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior,
                              double confidence, const Search& search) {
  const Ordered<G> fresh = in_order(b), near = within_reach(a, fresh.batch, prior, confidence);
  return as_given(search(near.batch, fresh.batch), near, fresh);
}

}  // namespace convoy::baseline
