// Facts with contents drawn at random: whatever the wire can carry.
#pragma once

#include <convoy/geometry/groups.hpp>
#include <convoy/submap/facts.hpp>
#include <convoy/submap/rounding.hpp>

#include <cmath>
#include <random>

namespace convoy::dds::testing {

inline constexpr ChainId sender{7, 0x1122334455667788ULL};
inline constexpr ChainId author{0xfffffffe, 3};
inline std::mt19937_64 engine(20240611);

inline double any() { return std::normal_distribution<double>(0.0, 50.0)(engine); }

template <int N>
Eigen::Matrix<double, N, N> any_covariance() {
  const Eigen::Matrix<double, N, N> A = Eigen::Matrix<double, N, N>::NullaryExpr([] { return any(); });
  const Eigen::Matrix<double, N, N> P = A * A.transpose();
  return 0.5 * (P + P.transpose());
}

inline ChainState<SE2> any_state() { return {any(), std::abs(any()), SE2(any(), any(), any()), any_covariance<3>()}; }

inline LandmarkFact<SE2> any_landmark(std::uint32_t index, bool described) {
  LandmarkFact<SE2> fact{{author, index}, 4, {any(), any()}, any_covariance<2>(), SE2::Loading::Zero(), {}};
  if (described) {
    fact.loading = SE2::Loading::NullaryExpr([] { return any(); });
    fact.kind = 7;
    fact.descriptor.kind = Descriptor::Kind::patch_8x8_4bit;
    for (auto& byte : fact.descriptor.bytes) byte = static_cast<std::uint8_t>(engine());
  }
  return rounded(fact);
}

template <class G>
AbsoluteFixFact<G> any_fix(const ChainState<G>& state) {
  AbsoluteFixFact<G> fact{{author, 6}, 4, state};
  fact.lever = G::Point::NullaryExpr([] { return any(); });
  fact.position = G::Point::NullaryExpr([] { return any(); });
  fact.covariance = any_covariance<G::Dim>();
  return fact;
}

template <class G>
EncounterFact<G> any_encounter(const ChainState<G>& state) {
  EncounterFact<G> fact{{author, 6}, 4, state, 77};
  fact.position = G::Point::NullaryExpr([] { return any(); });
  fact.covariance = any_covariance<G::Dim>();
  return fact;
}

template <class G>
WaypointFact<G> any_waypoint(const ChainState<G>& state) {
  WaypointFact<G> fact{{author, 6}, 4, state, {{78, 9}, 5}};
  fact.mark = G::Point::NullaryExpr([] { return any(); });
  return fact;
}

}  // namespace convoy::dds::testing
