#include <convoy/association/baselines.hpp>

#include <algorithm>
#include <numeric>
#include <random>
#include <tuple>

#include "configuration.hpp"

namespace convoy {
namespace {

using namespace baseline;

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

template <class G>
Measure height(const Batch<G>& batch, int k, int l) {
  Gradient<G, 2> gradient = Gradient<G, 2>::Zero();
  gradient.template bottomRows<1>() << -1.0, 1.0;
  const Vertices<2> vertices{k, l};
  const Gradient<G, 2> p = positions(batch, vertices);
  return {p(G::Dim - 1, 1) - p(G::Dim - 1, 0), variance(batch, vertices, gradient)};
}

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
bool same_heights(const Batch<G>& a, const Vertices<3>& in_a, const Batch<G>& b, const Vertices<3>& in_b,
                  double limit) {
  if (G::Dim == 2) return true;
  for (std::size_t v = 0; v < 3; ++v) {
    const std::size_t w = (v + 1) % 3;
    if (!same(height(a, in_a[v], in_a[w]), height(b, in_b[v], in_b[w]), limit)) return false;
  }
  return true;
}

// Both are counter-clockwise: sides of the same lengths pair the vertices by one of three turns, never a mirror image.
template <class G>
void add_matches(const Batch<G>& a, const DescribedTriangle& ta, const Batch<G>& b, const DescribedTriangle& tb,
                 double limit, Consensus<G>& consensus) {
  Vertices<3> in_b = tb.vertices;
  for (int turn = 0; turn < 3; ++turn) {
    std::rotate(in_b.begin(), in_b.begin() + 1, in_b.end());
    if (same_distances(a, ta.vertices, b, in_b, limit) && same_heights(a, ta.vertices, b, in_b, limit))
      consensus.add(ta.vertices, in_b);
  }
}

template <class G>
void find_matches(const Batch<G>& a, const Batch<G>& b, double limit, Consensus<G>& consensus) {
  const std::vector<DescribedTriangle> in_a = triangles_of(a, limit);
  double widest = 0.0;
  for (const auto& t : in_a) widest = std::max(widest, t.perimeter.variance);
  for (const auto& tb : triangles_of(b, limit)) {
    const double window_m = std::sqrt(limit * (widest + tb.perimeter.variance));
    auto ta = std::lower_bound(in_a.begin(), in_a.end(), tb.perimeter.value - window_m,
                               [](const DescribedTriangle& t, double p_m) { return t.perimeter.value < p_m; });
    for (; ta != in_a.end() && ta->perimeter.value <= tb.perimeter.value + window_m; ++ta)
      if (same(ta->perimeter, tb.perimeter, limit) && same(ta->area, tb.area, limit))
        add_matches(a, *ta, b, tb, limit, consensus);
  }
}

}  // namespace

template <class G>
SearchResult delaunay(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior,
                      double confidence, const ConfigurationParams& params) {
  return in_order_of_keys(a, b, prior, confidence, [&](const Batch<G>& near, const Batch<G>& fresh) {
    Consensus<G> consensus(near, fresh, prior, confidence, params);
    find_matches(near, fresh, chi2_quantile(params.gate, 1), consensus);
    return consensus.largest(3);
  });
}

std::vector<std::array<int, 3>> delaunay_triangulation(const std::vector<Eigen::Vector2d>& points) {
  if (points.size() < 3) return {};
  return BowyerWatson(points).run();
}

#define CONVOY_INSTANTIATE(G)                                                                                      \
  template SearchResult delaunay(const Batch<G>&, const Batch<G>&, const std::optional<RelativePrior<G>>&, double, \
                                 const ConfigurationParams&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
