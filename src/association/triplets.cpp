#include <convoy/association/baselines.hpp>

#include <Eigen/Geometry>
#include <algorithm>
#include <limits>

#include "configuration.hpp"

namespace convoy {
namespace {

using namespace baseline;

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

Measure signed_volume(const Batch<SE3>& batch, const Vertices<4>& vertices) {
  const Gradient<SE3, 4> p = positions(batch, vertices);
  const Eigen::Vector3d u = p.col(1) - p.col(0), v = p.col(2) - p.col(0), w = p.col(3) - p.col(0);
  Gradient<SE3, 4> gradient;
  gradient.rightCols<3>() << v.cross(w) / 6.0, w.cross(u) / 6.0, u.cross(v) / 6.0;
  gradient.col(0) = -gradient.rightCols<3>().rowwise().sum();
  return {u.dot(v.cross(w)) / 6.0, variance(batch, vertices, gradient)};
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

bool may_match(const Triplet& ta, const Triplet& tb, double limit) {
  for (std::size_t c = 0; c < 3; ++c)
    if (!same(ta.distance[c], tb.distance[c], limit)) return false;
  return true;
}

// In every order of the neighbours that fits: noise may have swapped two at about the same distance.
template <class G>
void add_matches(const Batch<G>& a, const Triplet& ta, const Batch<G>& b, const Triplet& tb, double limit,
                 Consensus<G>& consensus) {
  std::array<std::size_t, 3> order{1, 2, 3};
  do {
    const Vertices<4> in_b{tb.vertices[0], tb.vertices[order[0]], tb.vertices[order[1]], tb.vertices[order[2]]};
    if (same_distances(a, ta.vertices, b, in_b, limit) && same_hand(a, ta.vertices, b, in_b, limit))
      consensus.add(ta.vertices, in_b);
  } while (std::next_permutation(order.begin(), order.end()));
}

}  // namespace

template <class G>
SearchResult triplets(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior,
                      double confidence, const ConfigurationParams& params) {
  return in_order_of_keys(a, b, prior, confidence, [&](const Batch<G>& near, const Batch<G>& fresh) {
    const double limit = chi2_quantile(params.gate, 1);
    Consensus<G> consensus(near, fresh, prior, confidence, params);
    const std::vector<Triplet> in_b = triplets_of(fresh);
    for (const Triplet& ta : triplets_of(near))
      for (const Triplet& tb : in_b)
        if (may_match(ta, tb, limit)) add_matches(near, ta, fresh, tb, limit, consensus);
    return consensus.largest(1);  // neighbours are those of the first landmark, and no candidates of their own
  });
}

#define CONVOY_INSTANTIATE(G)                                                                                      \
  template SearchResult triplets(const Batch<G>&, const Batch<G>&, const std::optional<RelativePrior<G>>&, double, \
                                 const ConfigurationParams&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
