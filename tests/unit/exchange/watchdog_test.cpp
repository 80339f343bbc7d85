#include <convoy/config_error.hpp>
#include <convoy/exchange/watchdog.hpp>

#include <gtest/gtest.h>

namespace convoy {
namespace {

/// A network as the watchdog sees it, once per second.
struct Network {
  Watchdog dog{WatchdogParams{}};
  ExchangeCounters counters;
  std::optional<std::size_t> peers = 2;
  double now_s = 100.0;

  /// How long until it ails, with so many messages taken, sent and rejected per second; 1e9: it does not.
  double healthy_for(double at_most_s, std::uint64_t taken, std::uint64_t sent, std::uint64_t rejected) {
    const double from_s = now_s;
    for (; now_s < from_s + at_most_s; now_s += 1.0) {
      counters.messages_taken += taken;
      counters.messages_sent += sent;
      counters.send_rejected += rejected;
      if (somebody_listens) listened_s = now_s;
      ailment = dog.observe(now_s, peers, counters, listened_s);
      if (ailment != Ailment::none) return now_s - from_s;
    }
    return 1e9;
  }
  Ailment ailment = Ailment::none;
  bool somebody_listens = true;
  double listened_s = 0.0;
};

TEST(Watchdog, ALivelyNetworkIsLeftAlone) {
  Network network;
  EXPECT_EQ(network.healthy_for(1000.0, 1, 1, 0), 1e9);
  EXPECT_EQ(network.healthy_for(1000.0, 1, 1, 5), 1e9);  // a socket that is full now and then
  EXPECT_EQ(network.healthy_for(1000.0, 1, 0, 0), 1e9);  // nothing to say
}

TEST(Watchdog, DeafIsWhoHearsNothingThoughPeersAreThere) {
  Network network;
  EXPECT_NEAR(network.healthy_for(100.0, 0, 1, 0), 20.0, 1.0);
  EXPECT_EQ(network.ailment, Ailment::deaf);
  network.dog.reopened(network.now_s);
  EXPECT_NEAR(network.healthy_for(1000.0, 0, 1, 0), 30.0, 1.0) << "it is given a pause";
  network.dog.reopened(network.now_s);
  EXPECT_NEAR(network.healthy_for(1000.0, 0, 1, 0), 60.0, 1.0) << "and a longer one";
  network.dog.reopened(network.now_s);
  EXPECT_EQ(network.healthy_for(200.0, 1, 1, 0), 1e9);  // that helped
  EXPECT_NEAR(network.healthy_for(1000.0, 0, 1, 0), 20.0, 1.0);
  network.dog.reopened(network.now_s);
  EXPECT_NEAR(network.healthy_for(1000.0, 0, 1, 0), 30.0, 1.0) << "so the pauses begin anew";
}

TEST(Watchdog, PeersThatNeverSpeakAreLeftAloneInTheEnd) {
  Network network;  // with a monitor, or a vehicle that was refused
  for (int k = 0; k < 3; ++k) {
    EXPECT_LT(network.healthy_for(1000.0, 0, 1, 0), 1e9) << k;
    network.dog.reopened(network.now_s);
  }
  EXPECT_EQ(network.healthy_for(20000.0, 0, 1, 0), 1e9);
  network.peers = 3;  // somebody came, and should be heard
  EXPECT_LT(network.healthy_for(1000.0, 0, 1, 0), 1e9);
  EXPECT_EQ(network.ailment, Ailment::deaf);
  network.dog.reopened(network.now_s);
  EXPECT_EQ(network.healthy_for(10.0, 1, 1, 0), 1e9);  // and was
  EXPECT_LT(network.healthy_for(1000.0, 0, 1, 0), 1e9);
}

TEST(Watchdog, WhereNobodyListensNothingIsHeard) {
  Network network;
  network.somebody_listens = false;  // the host is inactive
  EXPECT_EQ(network.healthy_for(1000.0, 0, 1, 0), 1e9);
  network.somebody_listens = true;
  EXPECT_EQ(network.healthy_for(1000.0, 1, 1, 0), 1e9);
  network.somebody_listens = false;
  EXPECT_EQ(network.healthy_for(1000.0, 0, 1, 0), 1e9);
  network.somebody_listens = true;  // and there is nothing: that it is deaf is known at once
  EXPECT_EQ(network.healthy_for(1000.0, 0, 1, 0), 0.0);
  EXPECT_EQ(network.ailment, Ailment::deaf);
}

TEST(Watchdog, SilenceWithoutPeersIsNoAilment) {
  Network network;
  network.peers = 0;
  EXPECT_EQ(network.healthy_for(1000.0, 0, 1, 0), 1e9);
  network.peers = std::nullopt;  // a network that cannot tell
  EXPECT_EQ(network.healthy_for(1000.0, 0, 1, 0), 1e9);
}

TEST(Watchdog, MuteIsWhoseSendsAreAllRefused) {
  Network network;
  EXPECT_NEAR(network.healthy_for(100.0, 1, 0, 3), 10.0, 1.0);
  EXPECT_EQ(network.ailment, Ailment::mute);
}

TEST(Watchdog, LonelyIsWhoHadPeersAndHasNone) {
  Network network;
  EXPECT_EQ(network.healthy_for(100.0, 1, 1, 0), 1e9);
  network.peers = 0;
  EXPECT_NEAR(network.healthy_for(100.0, 0, 1, 0), 60.0, 1.0);
  EXPECT_EQ(network.ailment, Ailment::lonely);
}

TEST(Watchdog, RefusesParametersOutOfRange) {
  for (const auto& bad : {WatchdogParams{.deaf_s = 0.0}, WatchdogParams{.mute_s = 0.0}, WatchdogParams{.lonely_s = 0.0},
                          WatchdogParams{.pause_s = 0.0}, WatchdogParams{.pause_s = 10.0, .max_pause_s = 5.0}})
    EXPECT_THROW(Watchdog{bad}, RangeError);
}

}  // namespace
}  // namespace convoy
