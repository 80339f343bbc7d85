// What leaves the process: on which sockets, how much, and how much it is said to be.
#include "../support/exchange_contract.hpp"
#include "dds_testing.hpp"

#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <gmock/gmock.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>

#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <map>
#include <set>
#include <sstream>

namespace convoy::dds::testing {
namespace {

using convoy::testing::anchor_message;
using convoy::testing::landmark_message;

/// Inodes of the sockets this process holds.
std::set<std::string> own_sockets() {
  std::set<std::string> inodes;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd")) {
    std::error_code gone;
    const std::string target = std::filesystem::read_symlink(entry.path(), gone).string();
    if (target.starts_with("socket:[")) inodes.insert(target.substr(8, target.size() - 9));
  }
  return inodes;
}

/// Local addresses (as /proc/net/udp writes them: hexadecimal, network order read as little endian) of this process's
/// UDP sockets.
std::vector<std::string> own_udp_addresses() {
  const auto inodes = own_sockets();
  std::vector<std::string> addresses;
  std::ifstream file("/proc/net/udp");
  std::string line;
  std::getline(file, line);
  while (std::getline(file, line)) {
    std::istringstream words(line);
    std::string word[10];
    for (auto& w : word) words >> w;
    if (inodes.contains(word[9])) addresses.push_back(word[1].substr(0, 8));
  }
  return addresses;
}

/// Interface -> group -> number of memberships on this machine.
std::map<std::string, std::map<std::string, int>> memberships() {
  std::map<std::string, std::map<std::string, int>> all;
  std::ifstream file("/proc/net/igmp");
  std::string line, interface;
  std::getline(file, line);
  while (std::getline(file, line)) {
    std::istringstream words(line);
    std::string first, second, third;
    words >> first >> second >> third;
    if (line[0] != '\t') interface = second;
    else all[interface][first] = std::stoi(second);
  }
  return all;
}

TEST(Loopback, OnlyLoopbackIsBoundAndJoined) {
  const auto before = memberships();
  DdsExchange<SE2> a(config_of_this_test()), b(config_of_this_test());
  ASSERT_TRUE(all_connected({&a, &b}));
  const auto addresses = own_udp_addresses();
  ASSERT_GE(addresses.size(), 6U) << "the sockets of two participants were expected here";
  for (const std::string& address : addresses)
    EXPECT_THAT(address, ::testing::AnyOf("0100007F", "0100FFEF")) << "neither 127.0.0.1 nor 239.255.0.1";
  auto after = memberships();
  EXPECT_TRUE(after["lo"].contains("0100FFEF"));
  for (const auto& [interface, groups] : after) {
    if (interface == "lo") continue;
    for (const auto& [group, members] : groups) {
      const auto it = before.find(interface);
      const int were = it != before.end() && it->second.contains(group) ? it->second.at(group) : 0;
      EXPECT_LE(members, were) << "group " << group << " was joined on " << interface;
    }
  }
}

struct Device {
  std::uint64_t bytes = 0, packets = 0;
};

std::map<std::string, Device> devices(Child& child) {
  child.tell("dev");
  std::map<std::string, Device> all;
  for (std::string line = child.hear(); !line.empty() && line != "end"; line = child.hear()) {
    std::istringstream words(line);
    std::string name;
    words >> name;
    words >> all[name].bytes >> all[name].packets;
  }
  return all;
}

// In a network namespace with a second, live interface: that one stays silent, and the bytes we say we send are those
// that the kernel sees.
TEST(Loopback, NothingLeavesAndTheByteCountIsTheKernels) {
  if (geteuid() != 0) GTEST_SKIP() << "SKIPPED ALOUD: needs root to make a network namespace";
  std::string both;
  for (const int vehicle : {1, 2}) {
    for (const std::string& word : peer_command(static_cast<VehicleId>(vehicle))) both += "'" + word + "' ";
    if (vehicle == 1) both += "< \"$d/1\" & exec ";
  }
  // Two vehicles in one namespace; lines for the first one go through a named pipe, lines for the second one directly.
  const std::string directory = ::testing::TempDir() + "convoy_netns_" + std::to_string(getpid());
  std::filesystem::create_directories(directory);
  const std::string script = "set -e; d=" + directory +
                             "; mkfifo $d/1; ip link set lo up; ip link add veth0 type veth peer name veth1;"
                             "for i in veth0 veth1; do sysctl -qw net.ipv6.conf.$i.disable_ipv6=1 2>/dev/null || true; "
                             "ip link set $i up; done;"
                             "ip addr add 10.99.0.1/24 dev veth0; ip route add 224.0.0.0/4 dev veth0; "
                             "echo namespace; " +
                             both;
  Child second({"unshare", "-n", "sh", "-c", script});
  const std::string first_line = second.hear();
  if (first_line != "namespace") {
    std::filesystem::remove_all(directory);
    GTEST_SKIP() << "SKIPPED ALOUD: this machine makes no network namespace";
  }
  std::ofstream first(directory + "/1");  // opens once the first vehicle reads it
  ASSERT_EQ(second.hear(), "ready");
  ASSERT_EQ(second.hear(), "ready");
  const auto quiet = devices(second).at("veth0");
  second.tell("peers 1");
  ASSERT_EQ(second.hear(), "peers 1");
  first << "peers 1\nsend 0 300\n" << std::flush;
  ASSERT_EQ(second.hear(), "peers 1");
  ASSERT_EQ(second.hear(), "sent 300");
  second.tell("expect 300");
  ASSERT_EQ(second.hear(), "held 300");
  // The figures are read one after the other while announcements go on; what the kernel saw lies between two readings.
  const auto ask_first = [&] {
    first << "bytes\n" << std::flush;
    std::istringstream words(second.hear());
    std::string word;
    Sent sent;
    words >> word >> sent.rtps >> sent.headers >> sent.datagrams;
    return sent;
  };
  const Sent low1 = ask_first(), low2 = sent_by(second);
  const auto seen = devices(second);
  Sent high1 = ask_first(), high2 = sent_by(second);
  // Whoever was interrupted between sending and counting has not counted yet.
  for (int again = 0; again < 10 && seen.at("udp").packets > high1.datagrams + high2.datagrams; ++again) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    high1 = ask_first();
    high2 = sent_by(second);
  }
  EXPECT_EQ(seen.at("veth0").packets, quiet.packets);
  EXPECT_EQ(seen.at("veth0").bytes, quiet.bytes);
  // The loopback device counts IP packets without a link header. The kernel's own reports of the multicast membership
  // (IGMPv3, 40 bytes each) are among them and are nobody's datagrams.
  const std::uint64_t packets = seen.at("udp").packets;
  const std::uint64_t reports = seen.at("lo").packets - packets;
  const std::uint64_t bytes = seen.at("lo").bytes - 40 * reports;
  EXPECT_LE(reports, 8U);
  EXPECT_GE(packets, low1.datagrams + low2.datagrams);
  EXPECT_LE(packets, high1.datagrams + high2.datagrams);
  EXPECT_GE(bytes, low1.rtps + low1.headers + low2.rtps + low2.headers);
  EXPECT_LE(bytes, high1.rtps + high1.headers + high2.rtps + high2.headers);
  EXPECT_GT(low1.datagrams, 300U);
  first.close();
  EXPECT_EQ(second.finish(), 0);
  std::filesystem::remove_all(directory);
}

/// Two network namespaces with a cable between them; gone with the test.
class TwoHosts {
 public:
  TwoHosts() {
    const std::string id = std::to_string(getpid());
    for (const char side : {'a', 'b'}) names_.push_back("convoy" + id + side);
    const std::string a = names_[0], b = names_[1];
    std::string script = "exec 2>/dev/null; set -e; ip netns add " + a + "; ip netns add " + b +
                         "; ip link add v0 netns " + a + " type veth peer name v0 netns " + b + ";";
    for (std::size_t i = 0; i < 2; ++i)
      script += "ip -n " + names_[i] + " link set lo up; ip -n " + names_[i] + " link set v0 mtu 1400 up;" + "ip -n " +
                names_[i] + " addr add " + address(i) + "/24 dev v0; ip -n " + names_[i] +
                " route add 224.0.0.0/4 dev v0;";
    made_ = Child({"sh", "-c", script}).finish() == 0;
  }
  ~TwoHosts() {
    for (const std::string& name : names_) Child({"sh", "-c", "ip netns del " + name + " 2>/dev/null"}).finish();
  }
  bool made() const { return made_; }
  static std::string address(std::size_t host) { return "10.98.0." + std::to_string(host + 1); }
  std::vector<std::string> command(std::size_t host) const {
    std::vector<std::string> words{"ip", "netns", "exec", names_[host]};
    auto peer = peer_command(static_cast<VehicleId>(host + 1));
    peer[1] = CONVOY_QOS_PROFILES "/lan.xml";
    words.insert(words.end(), peer.begin(), peer.end());
    words.push_back(address(host));
    return words;
  }

 private:
  std::vector<std::string> names_;
  bool made_ = false;
};

TEST(Lan, TwoHostsMeetByMulticastAndLargeSamplesFitTheCable) {
  if (geteuid() != 0) GTEST_SKIP() << "SKIPPED ALOUD: needs root to make network namespaces";
  const TwoHosts hosts;
  if (!hosts.made()) GTEST_SKIP() << "SKIPPED ALOUD: this machine makes no network namespaces";
  Child a(hosts.command(0)), b(hosts.command(1));
  for (Child* vehicle : {&a, &b}) ASSERT_EQ(vehicle->hear(), "ready");
  for (Child* vehicle : {&a, &b}) vehicle->tell("peers 1");
  for (Child* vehicle : {&a, &b}) ASSERT_EQ(vehicle->hear(), "peers 1");
  a.tell("pair 2000");  // one association of 16 KB through an MTU of 1400
  ASSERT_EQ(a.hear(), "paired 2000");
  a.tell("send 0 200");
  ASSERT_EQ(a.hear(), "sent 200");
  b.tell("expect 201");
  EXPECT_EQ(b.hear(), "held 201");
  for (Child* vehicle : {&a, &b}) EXPECT_EQ(vehicle->finish(), 0);
}

TEST(Loopback, OwnSamplesCostNoBytes) {
  DdsExchange<SE2> alone(config_of_this_test());
  const auto before = alone.dds_counters();
  for (std::uint32_t i = 0; i < 1000; ++i) ASSERT_EQ(alone.send(anchor_message<SE2>(1, i)), SendStatus::sent);
  const auto after = alone.dds_counters();
  EXPECT_LT(after.datagrams_sent - before.datagrams_sent, 50U) << "announcements only";
  EXPECT_TRUE(alone.take(0.0).empty());
}

TEST(Loopback, BytesGrowByAtLeastThePayloadWhenSomebodyListens) {
  DdsExchange<SE2> a(config_of_this_test()), b(config_of_this_test());
  ASSERT_TRUE(all_connected({&a, &b}));
  const auto before = a.counters().bytes_sent;
  for (std::uint32_t i = 0; i < 100; ++i) ASSERT_EQ(a.send(landmark_message<SE2>(1, 8 * i, 8)), SendStatus::sent);
  ASSERT_EQ(collect(b, 100).size(), 100U);
  EXPECT_GT(a.counters().bytes_sent - before, 100U * 8U * 24U);
  const auto detail = a.dds_counters();
  EXPECT_GE(a.counters().bytes_sent, detail.rtps_bytes_sent + detail.header_bytes_sent);
  EXPECT_EQ(detail.header_bytes_sent, 28 * detail.datagrams_sent);
}

TEST(DdsExchange, WhoSpeaksByAnotherProfileIsCounted) {
  DdsConfig thin = config_of_this_test();
  thin.profile_file = profile_named("low_bandwidth");
  thin.interface_whitelist = {"127.0.0.1"};
  DdsExchange<SE2> reliable(config_of_this_test()), same(config_of_this_test());
  ASSERT_TRUE(all_connected({&reliable, &same}));
  EXPECT_EQ(reliable.counters().incompatible_peers, 0U);
  DdsExchange<SE2> best_effort(thin);
  EXPECT_TRUE(eventually([&] { return reliable.counters().incompatible_peers > 0; }));
  EXPECT_TRUE(eventually([&] { return best_effort.counters().incompatible_peers > 0; }));
}

TEST(DdsExchange, AFullQueueDropsAndCounts) {
  DdsConfig small = config_of_this_test();
  small.max_queued_messages = 10;
  DdsExchange<SE2> a(config_of_this_test()), b(small);
  ASSERT_TRUE(all_connected({&a, &b}));
  for (std::uint32_t i = 0; i < 25; ++i) ASSERT_EQ(a.send(anchor_message<SE2>(1, i)), SendStatus::sent);
  EXPECT_TRUE(eventually([&] { return b.counters().dropped == 15; }));
  const auto got = b.take(0.0);
  ASSERT_EQ(got.size(), 10U);
  EXPECT_EQ(std::get<AnchorFact<SE2>>(got[9].payload).key.index, 9U);
  ASSERT_EQ(a.send(anchor_message<SE2>(1, 25)), SendStatus::sent);
  EXPECT_EQ(collect(b, 1).size(), 1U);
}

TEST(DdsExchange, WhatTheWireCannotHoldIsUnfitAndCounted) {
  DdsExchange<SE2> a(config_of_this_test());
  auto message = anchor_message<SE2>(1, 3);
  std::get<AnchorFact<SE2>>(message.payload).state.drift(0, 1) = 1.0;
  EXPECT_EQ(a.send(message), SendStatus::unfit);
  EXPECT_EQ(a.counters().send_rejected, 0U) << "the network is not to blame";
  EXPECT_EQ(a.counters().messages_sent, 0U);
  EXPECT_EQ(a.dds_counters().refused_to_wire, 1U);
}

TEST(DdsExchange, ALargeBatchComesInParts) {
  DdsExchange<SE2> a(config_of_this_test()), b(config_of_this_test());
  ASSERT_TRUE(all_connected({&a, &b}));
  ASSERT_EQ(a.send(landmark_message<SE2>(1, 0, 100)), SendStatus::sent);
  std::uint32_t next = 0;
  while (next < 100) {
    const auto got = collect(b, 1);
    ASSERT_FALSE(got.empty());
    for (const auto& message : got) {
      const auto& part = std::get<LandmarkBatch<SE2>>(message.payload).landmarks;
      EXPECT_LE(part.size(), 64U);
      for (const auto& fact : part) EXPECT_EQ(fact.key.index, next++);
    }
  }
}

std::shared_ptr<eprosima::fastdds::rtps::UDPv4TransportDescriptor> loopback_transport() {
  auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  udp->interfaceWhiteList = {"127.0.0.1"};
  return udp;
}

TEST(DdsExchange, TwoShareTheHostsParticipant) {
  namespace edds = eprosima::fastdds::dds;
  // The host's participant, here one with the transport of the loopback profile.
  DdsConfig config = config_of_this_test();
  DdsExchange<SE2> remote(config);
  auto* factory = edds::DomainParticipantFactory::get_instance();
  edds::DomainParticipantQos qos = edds::PARTICIPANT_QOS_DEFAULT;
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(loopback_transport());
  edds::DomainParticipant* host = factory->create_participant(config.domain, qos);
  ASSERT_NE(host, nullptr);
  config.participant = host;
  {
    DdsExchange<SE2> a(config), b(config);
    ASSERT_TRUE(a.wait_for_peers(1, deadline_s) && b.wait_for_peers(1, deadline_s));
    ASSERT_EQ(a.send(anchor_message<SE2>(1, 0)), SendStatus::sent);
    EXPECT_EQ(collect(b, 1).size(), 1U);
    EXPECT_EQ(collect(remote, 1).size(), 1U);
    EXPECT_TRUE(a.take(0.0).empty());
    EXPECT_EQ(a.counters().bytes_sent, 0U);
  }
  EXPECT_EQ(factory->delete_participant(host), eprosima::fastrtps::types::ReturnCode_t::RETCODE_OK);
}

}  // namespace
}  // namespace convoy::dds::testing
