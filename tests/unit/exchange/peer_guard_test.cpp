#include <convoy/config_error.hpp>
#include <convoy/exchange/peer_guard.hpp>

#include <gtest/gtest.h>

namespace convoy {
namespace {

constexpr PeerLimits limits{.messages_per_s = 10.0, .burst = 100.0, .quarantine_s = 30.0, .max_peers = 3};

int admitted(PeerGuard& guard, VehicleId vehicle, int messages, double now_s) {
  int count = 0;
  for (int i = 0; i < messages; ++i) count += guard.admit(vehicle, now_s);
  return count;
}

TEST(PeerGuard, AFloodingPeerIsQuarantinedAndTheOthersDoNotNotice) {
  PeerGuard guard(limits);
  EXPECT_EQ(admitted(guard, 1, 5000, 0.0), 100);
  EXPECT_TRUE(guard.quarantined(1, 0.0));
  EXPECT_EQ(guard.counters().quarantines, 1U);
  EXPECT_EQ(guard.counters().last_quarantined, 1U);
  EXPECT_EQ(guard.counters().messages_refused, 4900U);
  EXPECT_EQ(admitted(guard, 2, 100, 0.0), 100);
  EXPECT_FALSE(guard.quarantined(2, 0.0));
  EXPECT_EQ(admitted(guard, 1, 1, 29.9), 0);
  EXPECT_EQ(admitted(guard, 1, 5000, 30.1), 100);  // it may try again
  EXPECT_EQ(guard.counters().quarantines, 2U);
}

TEST(PeerGuard, AHistoryAtOnceAndASteadyStreamAreNoFlood) {
  PeerGuard guard(limits);
  EXPECT_EQ(admitted(guard, 1, 90, 0.0), 90);
  for (double now_s = 0.1; now_s < 1000.0; now_s += 0.1) ASSERT_EQ(admitted(guard, 1, 1, now_s), 1) << now_s;
  EXPECT_EQ(guard.counters().quarantines, 0U);
}

TEST(PeerGuard, MadeUpVehiclesTakeNobodysPlace) {
  PeerGuard guard(limits);
  EXPECT_EQ(admitted(guard, 1, 1, 0.0), 1);
  for (VehicleId v = 100; v < 1000; ++v) guard.admit(v, 1.0);
  EXPECT_EQ(admitted(guard, 1, 1, 2.0), 1);
  EXPECT_EQ(admitted(guard, 2000, 1, 2.0), 0);
  EXPECT_EQ(admitted(guard, 2000, 1, 602.0), 1) << "those that went silent make room";
}

TEST(PeerGuard, RefusesLimitsOutOfRange) {
  for (const auto& bad : {PeerLimits{.messages_per_s = 0.0}, PeerLimits{.burst = 0.5}, PeerLimits{.quarantine_s = -1.0},
                          PeerLimits{.max_peers = 0}, PeerLimits{.forget_after_s = 0.0}})
    EXPECT_THROW(PeerGuard{bad}, RangeError);
}

}  // namespace
}  // namespace convoy
