// Vehicles that find each other on a LAN: by multicast, by initial peers, through a Discovery Server. Each is a process
// in a network namespace of its own, with a cable to a bridge.
#include "bridged_lan.hpp"

#include <arpa/inet.h>
#include <net/if.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <random>
#include <set>
#include <string>
#include <thread>

namespace convoy::dds::testing {
namespace {

constexpr std::size_t vehicles = 3, stranger = 3, server_host = 3;

std::set<std::string> interfaces_here() {
  std::set<std::string> names;
  struct if_nameindex* all = if_nameindex();
  for (auto* i = all; i != nullptr && i->if_index != 0; ++i) names.insert(i->if_name);
  if_freenameindex(all);
  return names;
}

/// Three vehicles and a fourth host. Whatever a test does, nothing of it is seen on the interfaces of this host.
class LanTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (const std::string why = why_no_namespaces(); !why.empty()) GTEST_SKIP() << "SKIPPED ALOUD: " << why;
    interfaces_ = interfaces_here();
    lan_ = std::make_unique<BridgedLan>(4);
    outside_ = std::make_unique<Sniffer>(this_namespace, lan_->subnet());
    inside_ = std::make_unique<Sniffer>(lan_->bridge_namespace(), lan_->subnet());
  }
  void TearDown() override {
    if (!lan_ || IsSkipped()) return;
    EXPECT_EQ(outside_->packets(), 0U) << "packets of the LAN were seen on interfaces of this host";
    EXPECT_GT(inside_->packets(), 100U) << "the sniffer is deaf";
    EXPECT_EQ(interfaces_here(), interfaces_);
  }

  Child& add(const std::string& profile, const std::vector<std::string>& options = {}) {
    const std::size_t host = children_.size();
    auto command = peer_command(static_cast<VehicleId>(host + 1), profile_named(profile));
    command.push_back(lan_->address(host));
    command.insert(command.end(), options.begin(), options.end());
    children_.push_back(std::make_unique<Child>(lan_->on(host, command)));
    return *children_.back();
  }
  void expect_all(const std::string& told, const std::string& heard) {
    for (auto& child : children_) child->tell(told);
    for (auto& child : children_) EXPECT_EQ(child->hear(), heard);
  }
  /// Every vehicle finds the others, and everything that each of them says.
  void exchange_everything() {
    for (auto& child : children_) ASSERT_EQ(child->hear(), "ready");
    expect_all("peers 2", "peers 2");
    expect_all("send 0 200", "sent 200");
    expect_all("expect 400", "held 400");
  }
  void finish_all() {
    for (auto& child : children_) EXPECT_EQ(child->finish(), 0);
  }
  DiscoveryServer server_on_the_lan() const {
    return {lan_->address(server_host), 11811, 0, [&](const auto& command) { return lan_->on(server_host, command); }};
  }
  void pull_a_cable_and_put_it_back();

  std::unique_ptr<BridgedLan> lan_;
  std::unique_ptr<Sniffer> outside_, inside_;
  std::vector<std::unique_ptr<Child>> children_;
  std::set<std::string> interfaces_;
};

/// The last vehicle is alone for 6 s, well within the lease: what was written meanwhile on both sides arrives.
void LanTest::pull_a_cable_and_put_it_back() {
  lan_->plug(2, false);
  expect_all("send 200 50", "sent 50");
  for (std::size_t i : {0U, 1U}) children_[i]->tell("expect 450");
  for (std::size_t i : {0U, 1U}) EXPECT_EQ(children_[i]->hear(), "held 450");
  std::this_thread::sleep_for(std::chrono::seconds(6));  // how long the cable is out, not how long something takes
  children_[2]->tell("take");
  EXPECT_EQ(children_[2]->hear(), "held 400") << "the cable was not out";
  lan_->plug(2, true);
  expect_all("expect 500", "held 500");
}

TEST_F(LanTest, ByMulticastAndACableIsPulledAndPutBack) {
  for (std::size_t i = 0; i < vehicles; ++i) add("lan");
  exchange_everything();
  for (std::size_t i = 0; i < vehicles; ++i) EXPECT_GT(lan_->multicast_sent(i), 0U);
  pull_a_cable_and_put_it_back();
  finish_all();
}

TEST_F(LanTest, ByInitialPeersWithoutAnyMulticastAndACableIsPulledAndPutBack) {
  // Of every two, one names the other; nobody names the last one.
  add("unicast_peers", {"peer=" + lan_->address(1)});
  add("unicast_peers", {"peer=" + lan_->address(0) + ":" + std::to_string(7410 + 250 * domain_of_this_test())});
  add("unicast_peers", {"peer=" + lan_->address(0), "peer=" + lan_->address(1)});
  exchange_everything();
  pull_a_cable_and_put_it_back();
  for (std::size_t i = 0; i < vehicles; ++i) {
    EXPECT_EQ(lan_->multicast_sent(i), 0U);
    EXPECT_EQ(lan_->multicast_received(i), 0U);
  }
  finish_all();
}

TEST_F(LanTest, ThroughADiscoveryServerAndACableIsPulledAndPutBack) {
  if (!DiscoveryServer::installed()) GTEST_SKIP() << "SKIPPED ALOUD: fast-discovery-server (fastdds-tools) is missing";
  const DiscoveryServer server = server_on_the_lan();
  for (std::size_t i = 0; i < vehicles; ++i) add("large_fleet", {server.option()});
  exchange_everything();
  pull_a_cable_and_put_it_back();
  for (std::size_t i = 0; i < vehicles; ++i) EXPECT_EQ(lan_->multicast_sent(i), 0U);
  finish_all();
}

/// What begins like an RTPS message and goes on with nonsense: any submessages, lengths that lie, cut anywhere.
std::string malformed(std::mt19937& random) {
  const auto byte = [&] { return static_cast<char>(random() & 0xff); };
  std::string text = random() % 8 == 0 ? "RTPX" : "RTPS";
  text += {2, static_cast<char>(random() % 8 == 0 ? byte() : 3), 1, 15};
  for (int i = 0; i < 12; ++i) text += byte();
  constexpr std::array kinds{0x01, 0x06, 0x07, 0x08, 0x09, 0x0c, 0x0d, 0x0e, 0x0f, 0x12, 0x13, 0x15, 0x16, 0x30, 0x80};
  for (std::size_t submessages = random() % 4; submessages-- > 0;) {
    const std::size_t size = random() % 200;
    const std::size_t said = random() % 4 == 0 ? random() % 65536 : size;
    text += static_cast<char>(random() % 8 == 0 ? byte() : kinds[random() % kinds.size()]);
    text += byte();  // flags
    text += {static_cast<char>(said & 0xff), static_cast<char>(said >> 8)};
    for (std::size_t i = 0; i < size; ++i) text += random() % 3 == 0 ? byte() : '\0';
  }
  if (random() % 4 == 0) text.resize(random() % (text.size() + 1));
  return text;
}

/// Sends nonsense from the fourth host to where the vehicles of this domain listen: the group, and two ports each.
std::size_t send_malformed(const BridgedLan& lan, std::size_t rounds) {
  const int out = namespace_socket(lan.host_namespace(stranger), AF_INET, SOCK_DGRAM, 0);
  const auto base = static_cast<std::uint16_t>(7400 + 250 * domain_of_this_test());
  std::mt19937 random(20240501);
  std::size_t sent = 0;
  const auto send_to = [&](const std::string& address, int offset) {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<std::uint16_t>(base + offset));
    inet_pton(AF_INET, address.c_str(), &to.sin_addr);
    const std::string text = malformed(random);
    if (sendto(out, text.data(), text.size(), 0, reinterpret_cast<const sockaddr*>(&to), sizeof to) >= 0) ++sent;
  };
  for (std::size_t round = 0; round < rounds; ++round) {
    send_to("239.255.0.1", 0);
    for (std::size_t i = 0; i < vehicles; ++i)
      for (const int offset : {10, 11}) send_to(lan.address(i), offset);
  }
  close(out);
  return sent;
}

TEST_F(LanTest, AStrangersMalformedDatagramsDoNoHarm) {
  for (std::size_t i = 0; i < vehicles; ++i) add("lan");
  exchange_everything();
  std::size_t sent = 0;
  for (std::uint32_t part = 0; part < 4; ++part) {
    sent += send_malformed(*lan_, 200);
    expect_all("send " + std::to_string(200 + 25 * part) + " 25", "sent 25");
    expect_all("expect " + std::to_string(450 + 50 * part), "held " + std::to_string(450 + 50 * part));
  }
  EXPECT_GT(sent, 4000U);
  EXPECT_GT(lan_->multicast_received(0), 600U) << "the vehicles did not hear the stranger";
  expect_all("now 2", "peers 2");
  finish_all();
}

}  // namespace
}  // namespace convoy::dds::testing
