// Encounters as facts of two vehicles: one says what it saw, the other where it was.
#include <gtest/gtest.h>

#include <algorithm>

#include "scripted_fleet.hpp"

namespace convoy {
namespace {

using test::Member;
using test::ScriptedFleet;

constexpr double sigma_m = 0.1;

/// `a` sees `b`, whose script is as far as its own.
bool sees(Member& a, const Member& b, test::Random& random) {
  const SE2::Point seen = a.truth().inverse() * b.truth().translation() + sigma_m * random.unit_normal<2>();
  return a.manager.publish_encounter(a.front_end_component.exportable_state(), b.chain().vehicle, seen,
                                     sigma_m * sigma_m * SE2::PointCovariance::Identity());
}

/// Two vehicles whose landmarks nobody compares.
struct Meeting {
  explicit Meeting(const Impairment& impairment = {}) : fleet(impairment) {
    test::MemberOptions options;
    options.submaps.selection.min_pairings = 1000;
    fleet.add(1, options);
    fleet.add(2, options);
  }
  Member& one() { return *fleet.members[0]; }
  Member& two() { return *fleet.members[1]; }
  const FactStore<SE2>::Chain& facts_of(const Member& by, VehicleId v) {
    return by.manager.store().chains().at({v, 1});
  }

  ScriptedFleet fleet;
  test::Random random{77};
};

TEST(Encounter, IsAnsweredByTheOneWhoWasSeenAndAlignsBoth) {
  Meeting meeting({.loss = 0.3, .duplicate = 0.2, .jitter_s = 0.4, .seed = 3});
  for (int k = 0; k < 100; ++k) {
    meeting.fleet.drive(1);
    const bool seen = k % 3 != 0 || sees(meeting.one(), meeting.two(), meeting.random);
    EXPECT_TRUE(seen);
  }
  ASSERT_TRUE(meeting.fleet.settle());
  meeting.two().front_end_component.answer_encounters();  // what came in after the last step of its own
  ASSERT_TRUE(meeting.fleet.settle());
  const auto& encounters = meeting.facts_of(meeting.two(), 1).encounters;
  EXPECT_EQ(encounters.size() + meeting.one().manager.counters().encounters_thinned, 34U);
  EXPECT_EQ(meeting.facts_of(meeting.one(), 2).waypoints.size(), encounters.size());
  EXPECT_EQ(meeting.two().front_end_component.encounters_unanswered(), 0U);
  ASSERT_EQ(meeting.one().map_digest(), meeting.two().map_digest());
  const auto& map = *meeting.one().manager.map().map;
  EXPECT_TRUE(map.aligned({1, 1}));
  EXPECT_TRUE(map.aligned({2, 1}));
  EXPECT_GE(map.problem().encounters.size() + 2, encounters.size());
  const auto a = meeting.one().view_of({1, 1}, meeting.fleet.now_s),
             b = meeting.one().view_of({2, 1}, meeting.fleet.now_s);
  ASSERT_TRUE(a.estimate && b.estimate);
  const SE2 said = a.estimate->mean.inverse() * b.estimate->mean;
  const auto then = [&](const Member& member,
                        const VehicleState<SE2>& state) {  // its last live pose may have been lost
    return member.script[static_cast<std::size_t>(2.0 * state.slam.stamp_s)].truth;
  };
  const SE2 truth = then(meeting.one(), a).inverse() * then(meeting.two(), b);
  EXPECT_LT((said.translation() - truth.translation()).norm(), 0.5);
}

TEST(Encounter, StatesWhereTheOtherWasThenAndNotWhereItIsNow) {
  Meeting meeting;
  meeting.fleet.drive(40);
  ASSERT_TRUE(sees(meeting.one(), meeting.two(), meeting.random));
  const double stamp_s = meeting.one().front_end_component.state().stamp_s;
  const SE2 there = meeting.two().front_end_component.state().pose;
  for (int k = 0; k < 10; ++k) meeting.two().drive();  // it drives on before it hears of it
  meeting.fleet.drive(4);
  const auto& waypoints = meeting.facts_of(meeting.one(), 2).waypoints;
  ASSERT_EQ(waypoints.size(), 1U);
  EXPECT_EQ(waypoints.at(0).state.stamp_s, stamp_s);
  EXPECT_LT((waypoints.at(0).state.pose.inverse() * there).Log().norm(), 1e-12);
  const auto& anchors = meeting.facts_of(meeting.one(), 2).anchors;
  EXPECT_LE(anchors.at(waypoints.at(0).anchor).state.stamp_s, stamp_s);
  EXPECT_GT(anchors.at(waypoints.at(0).anchor + 1).state.stamp_s, stamp_s);
}

TEST(Encounter, OfAVehicleThatIsBehindWaitsForItToGetThere) {
  Meeting meeting;
  meeting.fleet.drive(30);
  for (int k = 0; k < 10; ++k) meeting.one().drive();
  ASSERT_TRUE(sees(meeting.one(), meeting.two(), meeting.random));
  meeting.fleet.drive(5);
  EXPECT_TRUE(meeting.facts_of(meeting.one(), 2).waypoints.empty());
  meeting.fleet.drive(10);
  EXPECT_EQ(meeting.facts_of(meeting.one(), 2).waypoints.size(), 1U);
}

TEST(Encounter, BetweenTwoStatesIsOnTheWayBetweenThem) {
  Meeting meeting;
  meeting.fleet.drive(40);
  ChainState<SE2> state = meeting.one().front_end_component.exportable_state();
  state.stamp_s -= 0.2;  // its states are half a second apart
  const SE2 b = meeting.two().front_end_component.state().pose;
  meeting.fleet.drive(1);
  ASSERT_TRUE(meeting.one().manager.publish_encounter(state, 2, {5.0, 0.0}, SE2::PointCovariance::Identity()));
  meeting.fleet.drive(3);
  const auto& waypoints = meeting.facts_of(meeting.one(), 2).waypoints;
  ASSERT_EQ(waypoints.size(), 1U);
  EXPECT_EQ(waypoints.at(0).state.stamp_s, state.stamp_s);
  const double away_m = (b.translation() - waypoints.at(0).state.pose.translation()).norm();
  EXPECT_NEAR(away_m, 0.4, 0.05);  // 1 m in half a second
}

TEST(Encounter, OfAForgottenMomentIsCountedAndLeftAlone) {
  Meeting meeting;
  meeting.fleet.drive(40);
  ChainState<SE2> state = meeting.one().front_end_component.exportable_state();
  state.stamp_s = -500.0;
  ASSERT_TRUE(meeting.one().manager.publish_encounter(state, 2, {5.0, 0.0}, SE2::PointCovariance::Identity()));
  meeting.fleet.drive(5);
  EXPECT_TRUE(meeting.facts_of(meeting.one(), 2).waypoints.empty());
  EXPECT_EQ(meeting.two().front_end_component.encounters_unanswered(), 1U);
  EXPECT_TRUE(meeting.one().manager.map().selection.encounters.empty());
}

TEST(Encounter, WhatIsUnfitIsRefusedAndCounted) {
  Meeting meeting;
  meeting.fleet.drive(10);
  SubmapManager<SE2>& manager = meeting.one().manager;
  const ChainState<SE2> here = meeting.one().front_end_component.exportable_state();
  const SE2::PointCovariance fit = SE2::PointCovariance::Identity();
  EXPECT_FALSE(manager.publish_encounter(here, 1, {5.0, 0.0}, fit)) << "itself";
  EXPECT_FALSE(manager.publish_encounter(here, 0, {5.0, 0.0}, fit)) << "nobody";
  EXPECT_FALSE(manager.publish_encounter(here, 2, {NAN, 0.0}, fit));
  EXPECT_FALSE(manager.publish_encounter(here, 2, {5.0, 0.0}, -fit));
  EXPECT_EQ(manager.counters().facts_unfit, 4U);
  EXPECT_TRUE(manager.publish_encounter(here, 2, {5.0, 0.0}, fit));
  EXPECT_TRUE(manager.publish_encounter(here, 2, {5.0, 0.0}, fit)) << "fit, and not needed";
  EXPECT_TRUE(manager.publish_encounter(here, 3, {5.0, 0.0}, fit)) << "another vehicle";
  EXPECT_EQ(manager.counters().encounters_thinned, 1U);
  EXPECT_EQ(manager.store().chains().at({1, 1}).encounters.size(), 2U);
}

}  // namespace
}  // namespace convoy
