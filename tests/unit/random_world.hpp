// Seeded noise, points and batches for tests.
#pragma once

#include <convoy/association/constraints.hpp>
#include <convoy/geometry/se2.hpp>
#include <convoy/geometry/se3.hpp>
#include <convoy/submap/facts.hpp>

#include <Eigen/Core>
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
  Eigen::Matrix<double, N, 1> draw(const Eigen::Matrix<double, N, N>& P);
  SE2 pose(double half_size_m) {
    return {uniform(-half_size_m, half_size_m), uniform(-half_size_m, half_size_m), uniform(-3.1, 3.1)};
  }
  /// As pose(), of either group; in space, turned about any axis.
  template <class G>
  G pose_of(double half_size_m);
  std::mt19937_64& engine() { return engine_; }

 private:
  std::mt19937_64 engine_;
};

/// `count` points in the square of this half size (in space, 6 m up and down), no two closer than `apart_m`.
template <class G = SE2>
PointsOf<G> scattered(Random& random, std::size_t count, double half_size_m, double apart_m = 1.5);

struct BatchNoise {
  double own_m = 0.1;     ///< sigma of each landmark's own error
  double shared_m = 0.1;  ///< sigma of the error that the whole batch shares
  double scale = 1.0;     ///< of the errors drawn, not of the covariances stated
};

/// A shift, a turn and a scale of the whole batch.
template <class G>
typename G::Loading shared_error(const typename G::Point& p, double shared_m);

template <class G>
typename G::PointCovariance own_covariance(double own_m);

/// What a vehicle at T_world_anchor freezes of these points: a common shift, turn and scale, and an error of their
/// own. Indices count from `first`.
template <class G>
Batch<G> frozen_batch(Random& random, const Key& anchor, const G& T_world_anchor, const PointsOf<G>& points,
                      const BatchNoise& noise, std::uint32_t first = 0);

}  // namespace convoy::test
