#include <convoy/map/drift_check.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <map>
#include <set>
#include <variant>

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
    const SE2 true_U((1.0 + kappa) * U.translation(), U.theta());
    truth.push_back(truth.back() * true_U * SE2::Exp(random.draw<3>(Q)));
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

TEST(DriftCorrelation, IsNotAlarmedByAScaleErrorThatTheChainStates) {
  int alarms = 0, too_little = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    for (const double stated : {0.01, 0.001}) {
      Driven d = drive(seed, 0.01);
      PriorFact<SE2> prior;
      prior.key = key_of(1, 0);
      prior.persistent.scale = stated;
      d.store.insert(prior);
      (stated < 0.005 ? too_little : alarms) += drift_correlation(d.store, d.selection, chain_of(1)).alarm();
    }
  }
  std::printf("  %d of 40 alarms for a scale error of 1 %% if 1 %% is stated, %d of 40 if 0.1 %% is\n", alarms,
              too_little);
  EXPECT_LE(alarms, 3);
  EXPECT_GE(too_little, 20);
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

TEST(DriftCheck, IsTheCorrelationOfEachChainWhateverItWasAskedBefore) {
  Driven d = drive(1, 0.01);
  DriftCheck<SE2> check;
  const std::set<ChainId> alarmed{chain_of(1)};
  for (int round = 0; round < 2; ++round) EXPECT_EQ(check.alarms(d.store, d.selection), alarmed);
  const auto all = d.selection.hypotheses;
  d.selection.hypotheses.resize(3);  // too few to tell
  EXPECT_TRUE(check.alarms(d.store, d.selection).empty());
  d.selection.hypotheses = all;
  EXPECT_EQ(check.alarms(d.store, d.selection), alarmed);
  for (auto& h : d.selection.hypotheses) h.state = HypothesisState::vetoed;
  EXPECT_TRUE(check.alarms(d.store, d.selection).empty());
}

// Two vehicles drive a circle, the second one with an odometer that says `kappa` too little of every step, and it meets
// what the first one saw at each of its stops. Either may be the one whose drift is not white.
GlobalMap<SE2> two_on_a_circle(std::uint64_t seed, double kappa) {
  test::SampleFleet fleet(seed);
  const SE2 start(0.0, -70.0, 0.0), step = SE2::Exp({9.0, 0.0, 9.0 / 70.0});
  for (const VehicleId v : {1U, 2U}) {
    fleet.start(v, start, test::known_start);
    SE2 T = start;
    for (std::uint32_t k = 1; k <= 46; ++k) {
      T = T * step;
      const Key here = fleet.stop(v, T);
      if (v == 2) fleet.associate(v, fleet.common(key_of(1, k), here));
    }
  }
  ChainState<SE2> last_said, last;
  for (auto& fact : fleet.facts) {
    auto* a = std::get_if<AnchorFact<SE2>>(&fact);
    if (a == nullptr || a->key != key_of(2, a->key.index) || a->key.index == 0) continue;
    const Increment<SE2> said = increment(last_said, a->state);
    last_said = a->state;
    a->state.pose = last.pose * said.motion * SE2::Exp({-9.0 * kappa, 0.0, 0.0});
    const SE2::Adjoint Ad = a->state.pose.adjoint();
    a->state.drift = last.drift + Ad * said.covariance * Ad.transpose();
    last = a->state;
  }
  GlobalMap<SE2> global = test::built(fleet.store());
  int standing = 0;  // its stops overlap and are not associated with each other: single landmarks are doubtful
  for (const auto& h : global.selection.hypotheses)
    standing += h.state == HypothesisState::accepted || h.state == HypothesisState::doubtful;
  EXPECT_GE(standing, 20);
  return global;
}

TEST(DriftCheck, TheMapTellsWhoseDriftIsNotWhite) {
  EXPECT_EQ(two_on_a_circle(5, 0.02).drift_alarms, (std::set<ChainId>{chain_of(1), chain_of(2)}));
  EXPECT_TRUE(two_on_a_circle(5, 0.0).drift_alarms.empty());
}

}  // namespace
}  // namespace convoy
