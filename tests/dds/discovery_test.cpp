// Three ways to find each other, on this machine: what a configuration must say for each, and what happens when a
// Discovery Server dies. The same on a LAN: tests/netns.
#include "dds_testing.hpp"

#include <gmock/gmock.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <thread>

namespace convoy::dds::testing {
namespace {

using ::testing::HasSubstr;

constexpr const char* here = "127.0.0.1";

DdsConfig config_with(const std::string& profile) {
  DdsConfig config = config_of_this_test();
  config.profile_file = profile_named(profile);
  config.interface_whitelist = {here};
  return config;
}

/// Of this test alone, above the ports of all domains of tests.
std::uint16_t server_port(int place = 0) {
  return static_cast<std::uint16_t>(11811 + 2 * (domain_of_this_test() - 100) + static_cast<std::uint32_t>(place));
}

class Fleet {
 public:
  Fleet(std::string profile, std::vector<std::string> options) : profile_(std::move(profile)), options_(options) {}
  void add(std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) {
      auto command = peer_command(static_cast<VehicleId>(children_.size() + 1), profile_);
      command.push_back(here);
      command.insert(command.end(), options_.begin(), options_.end());
      children_.push_back(std::make_unique<Child>(command));
    }
    for (std::size_t i = children_.size() - count; i < children_.size(); ++i) EXPECT_EQ(children_[i]->hear(), "ready");
  }
  void expect_all(const std::string& told, const std::string& heard, std::size_t first = 0) {
    for (std::size_t i = first; i < children_.size(); ++i) children_[i]->tell(told);
    for (std::size_t i = first; i < children_.size(); ++i) EXPECT_EQ(children_[i]->hear(), heard);
  }
  /// Everybody finds everybody, and then says `each` facts more than the `before` that it has said.
  void meet_and_send(std::size_t before, std::size_t each) {
    const std::size_t others = children_.size() - 1;
    expect_all("peers " + std::to_string(others), "peers " + std::to_string(others));
    expect_all("send " + std::to_string(before) + " " + std::to_string(each), "sent " + std::to_string(each));
  }
  Child& operator[](std::size_t i) { return *children_[i]; }
  void finish() {
    for (auto& child : children_) EXPECT_EQ(child->finish(), 0);
  }

 private:
  std::string profile_;
  std::vector<std::string> options_;
  std::vector<std::unique_ptr<Child>> children_;
};

TEST(Discovery, AddressesThatTheProfileHasNoUseForAreRefused) {
  DdsConfig config = config_with("loopback_udp");
  config.initial_peers = {here};
  config.origin = "vehicle.xml:3";
  EXPECT_THAT(refusal(config),
              HasSubstr("vehicle.xml:3: initial peers are of no use to this profile; it finds vehicles "
                        "by multicast: take them out, or take unicast_peers.xml"));
  config.initial_peers.clear();
  config.discovery_servers = {"127.0.0.1:11811"};
  EXPECT_THAT(refusal(config), HasSubstr("discovery servers are of no use"));
  EXPECT_THAT(refusal(config), HasSubstr("loopback_udp.xml:"));
  config = config_with("unicast_peers");
  config.initial_peers = {here};
  config.discovery_servers = {"127.0.0.1:11811"};
  EXPECT_THAT(refusal(config), HasSubstr("take large_fleet.xml"));
  config = config_with("large_fleet");
  config.initial_peers = {here};
  config.discovery_servers = {"127.0.0.1:11811"};
  EXPECT_THAT(refusal(config), HasSubstr("take unicast_peers.xml"));
}

TEST(Discovery, AddressesThatTheProfileNeedsAreAskedFor) {
  EXPECT_THAT(refusal(config_with("unicast_peers")),
              ::testing::ContainsRegex("unicast_peers\\.xml:[0-9]+: participant profile 'convoy': no initial peers"));
  DdsConfig config = config_with("large_fleet");
  config.origin = "vehicle.xml:3";
  EXPECT_THAT(refusal(config), HasSubstr("no discovery servers"));
  EXPECT_THAT(refusal(config), HasSubstr("in vehicle.xml:3 (<dds discovery_servers=\"...\">)"));
}

TEST(Discovery, MalformedAddressesAreRefusedBeforeAnybodyIsAskedForThem) {
  DdsConfig config = config_with("unicast_peers");
  config.initial_peers = {"localhost"};
  EXPECT_THAT(refusal(config), HasSubstr("the configuration: initial peers: 'localhost' is no IPv4 address (a name "
                                         "would have to be looked up on the network); write ADDRESS or ADDRESS:PORT"));
  config = config_with("large_fleet");
  config.discovery_servers = {here};
  EXPECT_THAT(refusal(config), HasSubstr("discovery servers: '127.0.0.1' has no port"));
  config = config_with("wan_tcp");
  config.initial_peers = {here};
  EXPECT_THAT(refusal(config), HasSubstr("initial peers over TCP: '127.0.0.1' has no port"));
}

// Others answer a newcomer's first announcement at once, and no later one: it must hear them by then. Otherwise they
// are found by their next announcement, which with this profile comes after 40 s.
TEST(Discovery, WhoComesLateHearsTheAnswersToItsAnnouncement) {
  const std::string profile = profile_named("low_bandwidth");
  Fleet fleet(profile, {});
  fleet.add(2);
  fleet.expect_all("peers 1", "peers 1");
  std::this_thread::sleep_for(std::chrono::seconds(5));  // all initial announcements have been made
  for (VehicleId late_id = 11; late_id <= 14; ++late_id) {
    auto command = peer_command(late_id, profile);
    command.push_back(here);
    Child late(command);
    ASSERT_EQ(late.hear(), "ready");
    late.tell("peers 2");
    ASSERT_EQ(late.hear(), "peers 2") << late_id;
    EXPECT_EQ(late.finish(), 0);
  }
  fleet.finish();
}

TEST(Discovery, SixOnOneHostFindEachOtherByInitialPeers) {
  Fleet fleet(profile_named("unicast_peers"), {std::string("peer=") + here});
  fleet.add(6);
  fleet.meet_and_send(0, 50);
  fleet.expect_all("expect 250", "held 250");
  fleet.finish();
}

/// unicast_peers.xml with Fast DDS's own maxInitialPeersRange.
class NarrowProfile {
 public:
  NarrowProfile() {
    std::ostringstream text;
    text << std::ifstream(profile_named("unicast_peers")).rdbuf();
    std::string profile = text.str();
    const std::string range = "<maxInitialPeersRange>40</maxInitialPeersRange>";
    profile.erase(profile.find(range), range.size());
    std::ofstream(path) << profile;
  }
  ~NarrowProfile() { std::filesystem::remove(path); }
  const std::string path = ::testing::TempDir() + "convoy_narrow_" + std::to_string(getpid()) + ".xml";
};

TEST(Discovery, WithoutARangeTheFifthOnAHostIsNotFoundByTheSixth) {
  const NarrowProfile narrow;
  Fleet fleet(narrow.path, {std::string("peer=") + here});
  fleet.add(4);
  fleet.meet_and_send(0, 1);
  fleet.add(2);  // both find the four whose ports they ask, and not each other
  for (const std::size_t late : {4U, 5U}) {
    fleet[late].tell("peers 4");
    EXPECT_EQ(fleet[late].hear(), "peers 4");
  }
  std::this_thread::sleep_for(std::chrono::seconds(2));  // all initial announcements have been made
  for (const std::size_t late : {4U, 5U}) {
    fleet[late].tell("now 5");
    EXPECT_EQ(fleet[late].hear(), "no peers");
  }
  fleet.finish();
}

class DiscoveryServers : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!DiscoveryServer::installed())
      GTEST_SKIP() << "SKIPPED ALOUD: fast-discovery-server (Debian's fastdds-tools) is missing";
  }
  std::string profile_ = profile_named("large_fleet");
};

TEST_F(DiscoveryServers, ThreeFindEachOtherAndALateOneGetsTheHistory) {
  const DiscoveryServer server(here, server_port());
  Fleet fleet(profile_, {server.option()});
  fleet.add(3);
  fleet.meet_and_send(0, 100);
  fleet.expect_all("expect 200", "held 200");
  fleet.add(1);
  fleet[3].tell("expect 300");
  EXPECT_EQ(fleet[3].hear(), "held 300");
  fleet.finish();
}

// Who has met goes on without the server. Vehicles take one of the same id back once they have forgotten the old one,
// after its lease of 3 s: started sooner, it is never heard again.
TEST_F(DiscoveryServers, TheServerDiesAndComesBack) {
  DiscoveryServer server(here, server_port());
  Fleet fleet(profile_, {server.option()});
  fleet.add(2);
  fleet.meet_and_send(0, 10);
  server.kill_hard();
  fleet.expect_all("send 10 10", "sent 10");
  fleet.expect_all("expect 20", "held 20");
  fleet.add(1);
  std::this_thread::sleep_for(std::chrono::seconds(5));  // longer than the lease
  fleet.expect_all("send 20 10", "sent 10");
  for (const std::size_t old : {0U, 1U}) {
    fleet[old].tell("now 2");
    EXPECT_EQ(fleet[old].hear(), "no peers") << "a new vehicle was found without a server";
  }
  server.start();
  fleet.expect_all("peers 2", "peers 2");
  for (const std::size_t old : {0U, 1U}) fleet[old].tell("expect 40");
  for (const std::size_t old : {0U, 1U}) EXPECT_EQ(fleet[old].hear(), "held 40");
  fleet[2].tell("expect 60");
  EXPECT_EQ(fleet[2].hear(), "held 60");
  fleet.finish();
}

TEST_F(DiscoveryServers, OfTwoServersOneMayDie) {
  DiscoveryServer first(here, server_port(0), 0);
  const DiscoveryServer second(here, server_port(1), 1);
  Fleet fleet(profile_, {first.option(), second.option()});
  fleet.add(2);
  fleet.meet_and_send(0, 10);
  first.kill_hard();
  fleet.add(1);
  fleet.meet_and_send(10, 10);
  for (const std::size_t old : {0U, 1U}) fleet[old].tell("expect 30");
  for (const std::size_t old : {0U, 1U}) EXPECT_EQ(fleet[old].hear(), "held 30");
  fleet[2].tell("expect 40");
  EXPECT_EQ(fleet[2].hear(), "held 40");
  fleet.finish();
}

}  // namespace
}  // namespace convoy::dds::testing
