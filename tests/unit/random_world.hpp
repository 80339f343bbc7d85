// Seeded noise, points and batches for tests.
#pragma once

#include <convoy/association/constraints.hpp>
#include <convoy/geometry/se2.hpp>
#include <convoy/submap/facts.hpp>

#include <Eigen/Cholesky>
#include <cstdint>
#include <random>
#include <vector>

namespace convoy::test {

using Points = std::vector<SE2::Point>;

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
  std::mt19937_64& engine() { return engine_; }

 private:
  std::mt19937_64 engine_;
};

/// `count` points in the square of this half size, no two closer than `apart_m`.
inline Points scattered(Random& random, std::size_t count, double half_size_m, double apart_m = 1.5) {
  Points points;
  while (points.size() < count) {
    const SE2::Point p(random.uniform(-half_size_m, half_size_m), random.uniform(-half_size_m, half_size_m));
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

/// What a vehicle at T_world_anchor freezes of these points: a common shift, turn and scale, and an error of their
/// own. Indices count from `first`.
inline Batch<SE2> frozen_batch(Random& random, const Key& anchor, const SE2& T_world_anchor, const Points& points,
                               const BatchNoise& noise, std::uint32_t first = 0) {
  Batch<SE2> batch{anchor, {}};
  const SE2::SharedVector u = random.unit_normal<SE2::Shared>();
  for (const SE2::Point& p : points) {
    LandmarkFact<SE2> l;
    l.key = {anchor.chain, first++};
    l.anchor = anchor.index;
    const SE2::Point truth = T_world_anchor.inverse() * p;
    l.loading.col(0) << noise.shared_m, 0.0;
    l.loading.col(1) << 0.0, noise.shared_m;
    l.loading.col(2) << -0.05 * noise.shared_m * truth.y(), 0.05 * noise.shared_m * truth.x();
    l.loading.col(3) = 0.05 * noise.shared_m * truth;
    SE2::PointCovariance own;
    own << 1.0, 0.3, 0.3, 0.7;
    own *= noise.own_m * noise.own_m;
    l.covariance = own + l.loading * l.loading.transpose();
    l.position = truth + noise.scale * (l.loading * u + random.draw<2>(own));
    batch.landmarks.push_back(l);
  }
  return batch;
}

}  // namespace convoy::test
