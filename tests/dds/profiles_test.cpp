// Each profile by its name, over real sockets, between processes.
#include "dds_testing.hpp"

#include <convoy/dds/profile_file.hpp>
#include <convoy/submap/rounding.hpp>

#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <gmock/gmock.h>

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <thread>

namespace convoy::dds::testing {
namespace {

constexpr const char* here = "127.0.0.1";  // profiles of networks name no interface

std::vector<std::string> peer(VehicleId vehicle, const std::string& profile, const std::vector<std::string>& more) {
  auto command = peer_command(vehicle, profile);
  command.insert(command.end(), more.begin(), more.end());
  return command;
}

void connect(const std::vector<Child*>& vehicles, double patience_s = deadline_s) {
  const std::string others = std::to_string(vehicles.size() - 1);
  for (Child* vehicle : vehicles) ASSERT_EQ(vehicle->hear(), "ready");
  for (Child* vehicle : vehicles) vehicle->tell("peers " + others);
  for (Child* vehicle : vehicles) ASSERT_EQ(vehicle->hear(patience_s), "peers " + others);
}

void exchange_facts(const std::vector<Child*>& vehicles, std::uint32_t count) {
  const std::string others = std::to_string(count * (vehicles.size() - 1));
  for (Child* vehicle : vehicles) vehicle->tell("send 0 " + std::to_string(count));
  for (Child* vehicle : vehicles) ASSERT_EQ(vehicle->hear(), "sent " + std::to_string(count));
  for (Child* vehicle : vehicles) vehicle->tell("expect " + others);
  for (Child* vehicle : vehicles) EXPECT_EQ(vehicle->hear(), "held " + others);
}

/// Removes segments whose owner was killed, as `fastdds shm clean` does: each has a file that its owner keeps locked.
void sweep_shared_memory() {
  const std::string lock_suffix = "_el";
  for (const auto& entry : std::filesystem::directory_iterator("/dev/shm")) {
    const std::string lock = entry.path();
    if (!entry.path().filename().string().starts_with("fastrtps_") || !lock.ends_with(lock_suffix)) continue;
    if (std::filesystem::file_time_type::clock::now() - entry.last_write_time() < std::chrono::seconds(1)) continue;
    const int file = open(lock.c_str(), O_RDONLY | O_CLOEXEC);
    if (file >= 0 && flock(file, LOCK_EX | LOCK_NB) == 0) {
      std::filesystem::remove(lock.substr(0, lock.size() - lock_suffix.size()));
      std::filesystem::remove(lock);
    }
    if (file >= 0) close(file);
  }
}

TEST(ProfileLoopback, DataGoThroughSharedMemoryAndTheKilledComeBack) {
  const std::string profile = profile_named("loopback");
  Child a(peer_command(1, profile)), b(peer_command(2, profile));
  auto c = std::make_unique<Child>(peer_command(3, profile));
  connect({&a, &b, c.get()});
  const Sent before = sent_by(a);
  exchange_facts({&a, &b, c.get()}, 300);
  const Sent after = sent_by(a);
  EXPECT_GE(after.datagrams - before.datagrams, 600U) << "one to each peer";
  EXPECT_LE(after.headers - before.headers, 28U * 20U) << "announcements alone go through sockets";
  c->kill_hard();
  for (Child* vehicle : {&a, &b}) vehicle->tell("send 300 50");
  for (Child* vehicle : {&a, &b}) ASSERT_EQ(vehicle->hear(), "sent 50");
  for (Child* vehicle : {&a, &b}) vehicle->tell("expect 650");
  for (Child* vehicle : {&a, &b}) EXPECT_EQ(vehicle->hear(), "held 650");  // 350 of the other, 300 of the dead
  c = std::make_unique<Child>(peer_command(3, profile));
  ASSERT_EQ(c->hear(), "ready");
  c->tell("expect 700");
  EXPECT_EQ(c->hear(60.0), "held 700");  // some seconds: the others must find its old port dead
  for (Child* vehicle : {&a, &b, c.get()}) EXPECT_EQ(vehicle->finish(), 0);
  sweep_shared_memory();
}

TEST(ProfileLoopback, MeetsWhoHasSocketsOnly) {
  Child a(peer_command(1, profile_named("loopback"))), b(peer_command(2, profile_named("loopback_udp")));
  connect({&a, &b});
  exchange_facts({&a, &b}, 100);
  for (Child* vehicle : {&a, &b}) EXPECT_EQ(vehicle->finish(), 0);
}

TEST(ProfileLossyRadio, RepeatsWhatIsLostAndKeepsUnderTheMtu) {
  const std::string profile = profile_named("lossy_radio");
  const auto qos = ProfileFile(profile).participant("convoy");
  EXPECT_LE(qos.transport().user_transports.at(0)->max_message_size() + 28, 1400U);
  const std::string radio = "impair=loss=0.3,delay=5ms,jitter=5ms,seed=";
  Child a(peer(1, profile, {here, radio + "1"})), b(peer(2, profile, {here, radio + "2"}));
  connect({&a, &b}, 60.0);  // Fast DDS repeats what discovery loses every few seconds
  a.tell("pair 2000");      // 16 KB in a dozen fragments
  ASSERT_EQ(a.hear(), "paired 2000");
  a.tell("send 0 500");
  ASSERT_EQ(a.hear(), "sent 500");
  b.tell("expect 501");
  EXPECT_EQ(b.hear(60.0), "held 501");
  for (Child* vehicle : {&a, &b}) EXPECT_EQ(vehicle->finish(), 0);
}

/// Bytes that a message of so many landmarks with full loadings takes to one peer: the least of some tries, since
/// discovery may come between.
std::uint64_t bytes_of_landmarks(DdsExchange<SE2>& from, std::uint32_t count) {
  LandmarkBatch<SE2> batch;
  for (std::uint32_t k = 0; k < count; ++k) {
    LandmarkFact<SE2> landmark;
    landmark.key = {{1, 1}, k};
    landmark.anchor = 1;
    landmark.position = {1.0 + k, 2.0};
    landmark.covariance << 0.04, 0.01, 0.01, 0.09;
    for (int i = 0; i < landmark.loading.size(); ++i) landmark.loading(i) = 0.01 + 0.003 * i;
    landmark.covariance += landmark.loading * landmark.loading.transpose();
    batch.landmarks.push_back(rounded(landmark));
  }
  std::uint64_t least = UINT64_MAX;
  for (int k = 0; k < 5; ++k) {
    const std::uint64_t before = from.counters().bytes_sent;
    EXPECT_EQ(from.send({{1, 1}, batch}), SendStatus::sent);
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    least = std::min(least, from.counters().bytes_sent - before);
  }
  return least;
}

// A budget and its batch_limit are chosen by these.
TEST(ProfileLowBandwidth, LandmarksTakeWhatTheReadmeSays) {
  DdsConfig config = config_of_this_test();
  config.profile_file = profile_named("low_bandwidth");
  config.interface_whitelist = {here};
  DdsExchange<SE2> a(config), b(config);
  ASSERT_TRUE(all_connected({&a, &b}));
  const std::uint64_t one = bytes_of_landmarks(a, 1), twenty = bytes_of_landmarks(a, 20);
  RecordProperty("bytes_of_one", std::to_string(one));
  RecordProperty("bytes_of_twenty", std::to_string(twenty));
  EXPECT_LE(one, 225U + 55U);
  EXPECT_LE(twenty, 225U + 20U * 55U);
}

// With a byte budget a profile must not keep them: `convoy vehicle` warns.
TEST(Profiles, ThoseThatKeepHistorySaySo) {
  DdsConfig config = config_of_this_test();
  EXPECT_TRUE(DdsExchange<SE2>(config).keeps_history());
  config.profile_file = profile_named("low_bandwidth");
  config.interface_whitelist = {here};
  EXPECT_FALSE(DdsExchange<SE2>(config).keeps_history());
}

TEST(ProfileLowBandwidth, SendsEverythingOnceAndNothingElse) {
  const std::string profile = profile_named("low_bandwidth");
  Child a(peer(1, profile, {here})), b(peer(2, profile, {here})), c(peer(3, profile, {here}));
  connect({&a, &b, &c});
  // Discovery has its own acknowledgements, which end: two equal readings, and announcements alone are left.
  Sent before_a, before_b;
  ASSERT_TRUE(eventually([&] {
    before_a = sent_by(a);
    before_b = sent_by(b);
    std::this_thread::sleep_for(std::chrono::milliseconds(1500));
    return sent_by(a).datagrams == before_a.datagrams && sent_by(b).datagrams == before_b.datagrams;
  }));
  a.tell("send 0 200");
  ASSERT_EQ(a.hear(), "sent 200");
  for (Child* vehicle : {&b, &c}) vehicle->tell("expect 200");
  for (Child* vehicle : {&b, &c}) EXPECT_EQ(vehicle->hear(), "held 200");
  std::this_thread::sleep_for(std::chrono::seconds(1));  // five heartbeat periods of other profiles
  EXPECT_LE(sent_by(a).datagrams - before_a.datagrams, 400U + 4U) << "two readers, and announcements";
  EXPECT_LE(sent_by(b).datagrams - before_b.datagrams, 4U) << "no acknowledgements";
  Child late(peer(4, profile, {here}));
  ASSERT_EQ(late.hear(), "ready");
  late.tell("peers 3");
  ASSERT_EQ(late.hear(), "peers 3");
  std::this_thread::sleep_for(std::chrono::milliseconds(500));
  late.tell("take");
  EXPECT_EQ(late.hear(), "held 0") << "there is no history but that of the repair protocol";
  for (Child* vehicle : {&a, &b, &c, &late}) EXPECT_EQ(vehicle->finish(), 0);
}

/// wan_tcp.xml for several vehicles on one machine: each listens on a port of its own and knows those before it.
class TcpProfile {
 public:
  explicit TcpProfile(VehicleId vehicle) {
    std::ostringstream text;
    text << std::ifstream(profile_named("wan_tcp")).rdbuf();
    std::string profile = text.str(), peers = "<initialPeersList>";
    for (VehicleId other = 1; other < std::max(vehicle, 2U); ++other)
      peers += "<locator><tcpv4><address>127.0.0.1</address><physical_port>" + std::to_string(port(other)) +
               "</physical_port></tcpv4></locator>";
    put(profile, "<port>17400<", "<port>" + std::to_string(port(vehicle)) + "<");
    put(profile, "</builtin>", peers + "</initialPeersList></builtin>");
    std::ofstream(path) << profile;
  }
  ~TcpProfile() { std::filesystem::remove(path); }

 private:
  static unsigned port(VehicleId vehicle) { return 17400 + 5 * (domain_of_this_test() - 100) + vehicle; }
  static void put(std::string& text, const std::string& from, const std::string& to) {
    const auto at = text.find(from);
    if (at == std::string::npos) throw std::logic_error("wan_tcp.xml has no " + from);
    text.replace(at, from.size(), to);
  }
  static inline int made_ = 0;

 public:
  const std::string path =
      ::testing::TempDir() + "convoy_tcp_" + std::to_string(getpid()) + "_" + std::to_string(made_++) + ".xml";
};

/// TCP in Debian's build of Fast DDS frees by delete what its asio took from aligned_alloc: that is not ours to mend.
std::vector<std::string> tcp_peer(VehicleId vehicle, const std::string& profile) {
  const char* options = std::getenv("ASAN_OPTIONS");
  std::vector<std::string> command{
      "env", "ASAN_OPTIONS=" + std::string(options != nullptr ? options : "") + ":alloc_dealloc_mismatch=0"};
  for (const std::string& word : peer(vehicle, profile, {here})) command.push_back(word);
  return command;
}

/// A vehicle that has found `others`. Fast DDS 2.9.1 now and then loses a race when it connects over the loopback
/// device, and never tries again: then the vehicle starts again.
std::unique_ptr<Child> connected(VehicleId vehicle, const std::string& profile, std::size_t others) {
  for (int attempt = 0; attempt < 8; ++attempt) {
    auto child = std::make_unique<Child>(tcp_peer(vehicle, profile));
    if (child->hear() != "ready") break;
    std::this_thread::sleep_for(std::chrono::milliseconds(others == 0 ? 0 : 1500));
    child->tell("now " + std::to_string(others));
    if (child->hear() == "peers " + std::to_string(others)) return child;
    child->kill_hard();
  }
  return nullptr;
}

TEST(ProfileWanTcp, FindsTheNamedPeersAndCountsWhatGoesThroughTheConnections) {
  const TcpProfile profile_a(1), profile_b(2), profile_c(3);
  const auto a = connected(1, profile_a.path, 0);
  ASSERT_TRUE(a);
  const auto b = connected(2, profile_b.path, 1);
  ASSERT_TRUE(b);
  const auto c = connected(3, profile_c.path, 2);
  ASSERT_TRUE(c);
  a->tell("pair 2000");
  ASSERT_EQ(a->hear(), "paired 2000");
  const Sent before = sent_by(*a);
  a->tell("send 0 300");
  ASSERT_EQ(a->hear(), "sent 300");
  for (Child* vehicle : {b.get(), c.get()}) vehicle->tell("expect 301");
  for (Child* vehicle : {b.get(), c.get()}) EXPECT_EQ(vehicle->hear(), "held 301");
  const Sent after = sent_by(*a);
  // A sample is some 250 bytes, and several share a message. One copy goes to each peer, and not one for each endpoint.
  EXPECT_GE(after.rtps - before.rtps, 2U * 300U * 150U);
  EXPECT_LE(after.rtps - before.rtps, 2U * 300U * 450U);
  EXPECT_EQ(after.headers, 66 * after.datagrams);
}

}  // namespace
}  // namespace convoy::dds::testing
