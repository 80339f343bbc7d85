// Seeded noise, points and batches for tests.
#pragma once

#include <convoy/association/constraints.hpp>
#include <convoy/geometry/se2.hpp>
#include <convoy/geometry/se3.hpp>
#include <convoy/submap/facts.hpp>

#include <Eigen/Cholesky>
#include <cstdint>
#include <random>
#include <vector>

namespace convoy::test {

template <class G>
using PointsOf = std::vector<typename G::Point>;
using Points = PointsOf<SE2>;

class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  double uniform(double low, double high) { return std::uniform_real_distribution<double>(low, high)(engine_); }
  int integer(int low, int high) { return std::uniform_int_distribution<int>(low, high)(engine_); }
  double normal(double sigma = 1.0) { return sigma * std::normal_distribution<double>()(engine_); }
  template <int N>
  Eigen::Matrix<double, N, 1> unit_normal() {
    Eigen::Matrix<double, N, 1> v;
    for (int i = 0; i < N; ++i) v[i] = normal();
    return v;
  }
  /// From N(0, P), P positive definite.
  template <int N>
  Eigen::Matrix<double, N, 1> draw(const Eigen::Matrix<double, N, N>& P) {
    return Eigen::Matrix<double, N, N>(P.llt().matrixL()) * unit_normal<N>();
  }
  SE2 pose(double half_size_m) {
    return {uniform(-half_size_m, half_size_m), uniform(-half_size_m, half_size_m), uniform(-3.1, 3.1)};
  }
  /// As pose(), of either group; in space, turned about any axis.
  template <class G>
  G pose_of(double half_size_m) {
    if constexpr (G::Dim == 2) {
      return pose(half_size_m);
    } else {
      typename G::Tangent d = G::Tangent::NullaryExpr([&] { return uniform(-1.0, 1.0); });
      d.template tail<3>() *= uniform(0.0, 3.1) / d.template tail<3>().norm();
      return G::from_rotation(G::Exp(d).rotation(), half_size_m * d.template head<3>());
    }
  }
  std::mt19937_64& engine() { return engine_; }

 private:
  std::mt19937_64 engine_;
};

/// `count` points in the square of this half size (in space, 6 m up and down), no two closer than `apart_m`.
template <class G = SE2>
PointsOf<G> scattered(Random& random, std::size_t count, double half_size_m, double apart_m = 1.5) {
  PointsOf<G> points;
  while (points.size() < count) {
    typename G::Point p;
    const auto metres = [&] { return random.uniform(-half_size_m, half_size_m); };
    p.template head<2>() = SE2::Point(metres(), metres());
    if constexpr (G::Dim == 3) p[2] = random.uniform(-6.0, 6.0);
    bool free = true;
    for (const auto& q : points) free = free && (p - q).norm() >= apart_m;
    if (free) points.push_back(p);
  }
  return points;
}

struct BatchNoise {
  double own_m = 0.1;     ///< sigma of each landmark's own error
  double shared_m = 0.1;  ///< sigma of the error that the whole batch shares
  double scale = 1.0;     ///< of the errors drawn, not of the covariances stated
};

/// A shift, a turn and a scale of the whole batch.
template <class G>
typename G::Loading shared_error(const typename G::Point& p, double shared_m) {
  typename G::Loading L = G::Loading::Zero();
  const typename G::PointJacobian motion = G().act_jacobian(p);  // [I, how p turns]
  L.template leftCols<G::Dim>() = shared_m * motion.template leftCols<G::Dim>();
  L.template middleCols<G::Dof - G::Dim>(G::Dim) = 0.05 * shared_m * motion.template rightCols<G::Dof - G::Dim>();
  L.col(G::Dof) = 0.05 * shared_m * p;
  return L;
}

template <class G>
typename G::PointCovariance own_covariance(double own_m) {
  typename G::PointCovariance own = G::PointCovariance::Identity();
  own.template topLeftCorner<2, 2>() << 1.0, 0.3, 0.3, 0.7;
  return own * (own_m * own_m);
}

/// What a vehicle at T_world_anchor freezes of these points: a common shift, turn and scale, and an error of their
/// own. Indices count from `first`.
template <class G>
Batch<G> frozen_batch(Random& random, const Key& anchor, const G& T_world_anchor, const PointsOf<G>& points,
                      const BatchNoise& noise, std::uint32_t first = 0) {
  Batch<G> batch{anchor, {}};
  const typename G::SharedVector u = random.unit_normal<G::Shared>();
  for (const typename G::Point& p : points) {
    LandmarkFact<G> l;
    l.key = {anchor.chain, first++};
    l.anchor = anchor.index;
    const typename G::Point truth = T_world_anchor.inverse() * p;
    l.loading = shared_error<G>(truth, noise.shared_m);
    const typename G::PointCovariance own = own_covariance<G>(noise.own_m);
    l.covariance = own + l.loading * l.loading.transpose();
    l.position = truth + noise.scale * (l.loading * u + random.draw<G::Dim>(own));
    batch.landmarks.push_back(l);
  }
  return batch;
}

}  // namespace convoy::test
