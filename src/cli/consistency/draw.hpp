// The random numbers of one run, in the order in which they are asked for.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "scenario/counter_rng.hpp"

namespace convoy::cli::consistency {

/// One source per run: what another run or thread draws does not matter.
class Draw {
 public:
  Draw(std::uint64_t seed, std::uint32_t run, std::uint32_t purpose) : rng_(seed, run, purpose) {}
  double uniform() { return rng_.uniform(next_++, 0); }
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  double normal() { return rng_.normal(next_++, 1); }
  template <int N>
  Eigen::Matrix<double, N, 1> unit_normal() {
    Eigen::Matrix<double, N, 1> x;
    for (int i = 0; i < N; ++i) x[i] = normal();
    return x;
  }

 private:
  CounterRng rng_;
  std::uint32_t next_ = 0;
};

}  // namespace convoy::cli::consistency
