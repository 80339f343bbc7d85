#include <convoy/map/drift_check.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <cstdio>

namespace convoy {
namespace {

using test::chain_of;
using test::key_of;

constexpr int stops = 24;  // 15 m apart, along a circle of 240 m: a lap and a half

/// One vehicle drives a circle; its anchors and what it drifts are drawn anew. `kappa`: scale error of its odometer,
/// which its covariances know nothing of. Landmarks and associations are exact enough to leave the drift in view.
struct Driven {
  FactStore<SE2> store;
  Selection<SE2> selection;
};

Driven drive(std::uint64_t seed, double kappa) {
  test::Random random(seed);
  Driven d;
  const SE2::Covariance Q = Eigen::Vector3d(2e-3, 2e-3, 2e-6).asDiagonal();
  std::vector<SE2> truth{SE2()};
  AnchorFact<SE2> anchor{key_of(1, 0), {}};
  d.store.insert(anchor);
  const SE2 U = SE2::Exp({15.0, 0.0, 2.0 * M_PI / 16.0});
  for (int k = 1; k < stops * 2; ++k) {
    anchor.key.index = static_cast<std::uint32_t>(k);
    anchor.state.stamp_s += 5.0;
    anchor.state.abscissa_m += 15.0;
    anchor.state.pose = anchor.state.pose * U;
    const SE2::Adjoint Ad = anchor.state.pose.adjoint();
    anchor.state.drift += Ad * Q * Ad.transpose();
    d.store.insert(anchor);
    SE2::Tangent eta = random.draw<3>(Q);
    eta[0] += kappa * 15.0;
    truth.push_back(truth.back() * U * SE2::Exp(eta));
  }
  // Every anchor against the start of its stretch: closures that each see new road.
  const SE2::Covariance Z = Eigen::Vector3d(1e-4, 1e-4, 1e-8).asDiagonal();
  for (std::uint32_t k = 1; k < static_cast<std::uint32_t>(truth.size()); ++k) {
    Hypothesis<SE2> h;
    h.state = HypothesisState::accepted;
    h.batch_a = key_of(1, k - 1);
    h.batch_b = key_of(1, k);
    h.alignment.T_a_b = truth[k - 1].inverse() * truth[k] * SE2::Exp(random.draw<3>(Z));
    h.alignment.P = Z;
    d.selection.hypotheses.push_back(h);
  }
  return d;
}

TEST(DriftCorrelation, RaisesTheAlarmForAnOdometerScaleAndNotForWhiteDrift) {
  int alarms = 0, false_alarms = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    const Driven good = drive(seed, 0.0), bad = drive(seed, 0.01);
    false_alarms += drift_correlation(good.store, good.selection, chain_of(1)).alarm();
    alarms += drift_correlation(bad.store, bad.selection, chain_of(1)).alarm();
  }
  std::printf("  %d of 40 alarms for a scale error of 1 %%, %d of 40 for white drift\n", alarms, false_alarms);
  EXPECT_GE(alarms, 36);
  EXPECT_LE(false_alarms, 3);
}

TEST(DriftCorrelation, CountsEachClosingBatchOnceAndOnlyTheLatest) {
  Driven d = drive(1, 0.0);
  const int pairs = drift_correlation(d.store, d.selection, chain_of(1)).pairs;
  EXPECT_EQ(pairs, stops * 2 - 2);
  const auto once = d.selection.hypotheses;
  d.selection.hypotheses.insert(d.selection.hypotheses.end(), once.begin(), once.end());
  EXPECT_EQ(drift_correlation(d.store, d.selection, chain_of(1)).pairs, pairs);
  EXPECT_EQ(drift_correlation(d.store, d.selection, chain_of(1), 10).pairs, 9);
}

TEST(DriftCorrelation, HearsOnlyAcceptedHypothesesOfTheChain) {
  Driven d = drive(1, 0.01);
  EXPECT_EQ(drift_correlation(d.store, d.selection, chain_of(2)).pairs, 0);
  for (auto& h : d.selection.hypotheses) h.state = HypothesisState::vetoed;
  EXPECT_EQ(drift_correlation(d.store, d.selection, chain_of(1)).pairs, 0);
  EXPECT_FALSE(drift_correlation(d.store, d.selection, chain_of(1)).alarm());
}

}  // namespace
}  // namespace convoy
