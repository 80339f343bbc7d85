// Convoy's topics on another DDS: a subscriber on Cyclone DDS, made from idl/convoy.idl and nothing of ours, in a
// process of its own (cyclone_peer.c). It prints every field of what it gets, and that is compared to the bit with what
// was sent.
#include "../dds/dds_testing.hpp"

#include <convoy/dds/convert.hpp>
#include <convoy/submap/rounding.hpp>

#include <gmock/gmock.h>

#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdio>
#include <random>
#include <span>
#include <sstream>
#include <thread>

namespace convoy::dds::testing {
namespace {

using ::testing::Each;
using ::testing::StartsWith;

using Lines = std::vector<std::string>;

// ---- text, as cyclone_peer.c prints it -------------------------------------------------------------------------

class Line {
 public:
  explicit Line(const std::string& topic) : text_(topic) {}
  template <std::integral T>
  Line& operator<<(T value) {
    return append(std::to_string(value));
  }
  Line& operator<<(double value) { return bits<16>(std::bit_cast<std::uint64_t>(value)); }
  Line& operator<<(float value) { return bits<8>(std::bit_cast<std::uint32_t>(value)); }
  template <class T>
  Line& operator<<(const std::vector<T>& sequence) {
    *this << sequence.size();
    for (const T& value : sequence) *this << value;
    return *this;
  }
  Line& operator<<(const v1::Chain& chain) { return *this << chain.epoch() << chain.vehicle(); }
  Line& operator<<(const v1::ChainState& state) {
    return *this << state.stamp_s() << state.abscissa_m() << state.pose() << state.drift() << state.heading_lever();
  }
  const std::string& text() const { return text_; }

 private:
  template <int Digits>
  Line& bits(std::uint64_t value) {
    char digits[17];
    std::snprintf(digits, sizeof digits, "%0*llx", Digits, static_cast<unsigned long long>(value));
    return append(digits);
  }
  Line& append(const std::string& word) {
    text_ += ' ' + word;
    return *this;
  }
  std::string text_;
};

std::string line_of(const v1::Bias& b) {
  Line line("Bias");
  line << b.sender() << b.vehicle() << b.epoch() << b.index() << b.dimension() << b.state();
  line << b.first_landmark() << b.landmark_count();
  return line.text();
}

std::string line_of(const v1::Landmark& l) {
  Line line("Landmark");
  line << l.sender() << l.vehicle() << l.epoch() << l.anchor() << l.dimension();
  line << l.index() << l.kind() << l.descriptor_kind() << l.descriptor();
  line << l.position() << l.covariance() << l.loading();
  return line.text();
}

std::string line_of(const v1::Pose& p) {
  Line line("Pose");
  line << p.sender() << p.vehicle() << p.epoch() << p.anchor() << p.dimension();
  line << static_cast<int>(p.integrity()) << p.reasons() << p.state();
  line << p.remembered() << p.remembered_points() << p.remembered_shared();
  return line.text();
}

template <class Sample, class G, class Part>
std::string line_of(const ChainId& sender, const Part& part) {
  Sample sample;
  const WireStatus status = to_wire<G>(sender, part, sample);
  return status == WireStatus::ok ? line_of(sample) : std::string("not to be sent: ") + to_string(status);
}

// ---- what is sent ----------------------------------------------------------------------------------------------

/// Facts of one vehicle with no field at its default, and what a subscriber should print of them. Seeded by the
/// vehicle.
template <class G>
class Facts {
 public:
  Facts(VehicleId vehicle, std::uint32_t anchors, std::uint32_t landmarks_each)
      : chain_{vehicle, 0x1122334455667788ULL + vehicle}, engine_(vehicle) {
    for (std::uint32_t a = 0; a < anchors; ++a) {
      AnchorFact<G> anchor{{chain_, a}, state(), a * landmarks_each, landmarks_each};
      LandmarkBatch<G> batch;
      for (std::uint32_t i = 0; i < landmarks_each; ++i) batch.landmarks.push_back(landmark(a * landmarks_each + i, a));
      lines_.push_back(line_of<v1::Bias, G>(chain_, anchor));
      for (const auto part : split(std::span<const LandmarkFact<G>>(batch.landmarks)))
        lines_.push_back(line_of<v1::Landmark, G>(chain_, part));
      messages_.push_back({chain_, anchor});
      messages_.push_back({chain_, std::move(batch)});
    }
    std::sort(lines_.begin(), lines_.end());
  }
  const std::vector<Message<G>>& messages() const { return messages_; }
  const Lines& lines() const { return lines_; }  ///< sorted
  const ChainId& chain() const { return chain_; }

  /// The next live pose; none is like another.
  LivePose<G> pose() {
    LivePose<G> pose{chain_, 3, state(), Integrity::suspect, reason_innovation | reason_ambiguous, {}};
    for (std::uint32_t i = 0; i < LivePose<G>::max_remembered; ++i)
      pose.remembered.push_back({i, point(), covariance<G::Dim>()});
    pose.shared = covariance<G::Dof>();
    return pose;
  }

 private:
  double any() { return std::normal_distribution<double>(0.0, 50.0)(engine_); }
  typename G::Point point() {
    return G::Point::NullaryExpr([this] { return any(); });
  }
  template <int N>
  Eigen::Matrix<double, N, N> covariance() {
    const Eigen::Matrix<double, N, N> A = Eigen::Matrix<double, N, N>::NullaryExpr([this] { return any(); });
    const Eigen::Matrix<double, N, N> P = A * A.transpose();
    return 0.5 * (P + P.transpose());  // symmetric to the bit
  }
  ChainState<G> state() {
    const auto tangent = [this] { return typename G::Tangent(G::Tangent::NullaryExpr([this] { return any(); })); };
    ChainState<G> state{any(), std::abs(any()), G::Exp(tangent()), covariance<G::Dof>()};
    state.heading_lever = tangent();
    return state;
  }
  LandmarkFact<G> landmark(std::uint32_t index, std::uint32_t anchor) {
    LandmarkFact<G> fact{{chain_, index}, anchor, point(), covariance<G::Dim>(), G::Loading::Zero(), {}};
    if (index % 2 == 0) return rounded(fact);
    fact.loading = G::Loading::NullaryExpr([this] { return any(); });
    fact.kind = 7;
    fact.descriptor.kind = Descriptor::Kind::patch_8x8_4bit;
    for (auto& byte : fact.descriptor.bytes) byte = static_cast<std::uint8_t>(engine_());
    return rounded(fact);
  }

  ChainId chain_;
  std::mt19937_64 engine_;
  std::vector<Message<G>> messages_;
  Lines lines_;
};

template <class G>
void send_all(DdsExchange<G>& exchange, const std::vector<Message<G>>& messages) {
  for (const auto& message : messages) EXPECT_EQ(exchange.send(message), SendStatus::sent);
}

// ---- who listens -----------------------------------------------------------------------------------------------

/// A subscriber on Cyclone DDS in the domain of this test, and all it has printed.
class Subscriber {
 public:
  explicit Subscriber(std::vector<std::string> command = {}) : child_(with_peer(std::move(command))) {
    EXPECT_EQ(child_.hear(), "ready");
  }
  const Lines& poses() const { return poses_; }
  Lines facts() const {
    Lines sorted = facts_;
    std::sort(sorted.begin(), sorted.end());
    return sorted;
  }
  /// Listens until there are so many, or nothing has come for `timeout_s`.
  bool hears_facts(std::size_t count, double timeout_s = deadline_s) { return hears(facts_, count, timeout_s); }
  bool hears_poses(std::size_t count, double timeout_s = deadline_s) { return hears(poses_, count, timeout_s); }
  void tell(const std::string& line) { child_.tell(line); }
  /// Listens to the rest of what it has to say, and lets it go.
  void leave() {
    child_.tell("end");
    while (hear(deadline_s)) {
    }
    EXPECT_TRUE(ended_);
    EXPECT_EQ(child_.finish(), 0);
  }

 private:
  static std::vector<std::string> with_peer(std::vector<std::string> command) {
    for (const std::string& word : {std::string("env"), std::string("CYCLONEDDS_URI=file://" CONVOY_CYCLONE_CONFIG),
                                    std::string(CONVOY_CYCLONE_PEER), std::to_string(domain_of_this_test())})
      command.push_back(word);
    return command;
  }
  bool hears(const Lines& lines, std::size_t count, double timeout_s) {
    while (lines.size() < count && hear(timeout_s)) {
    }
    return lines.size() >= count;
  }
  bool hear(double timeout_s) {
    std::string line = child_.hear(timeout_s);
    ended_ = line == "end";
    if (line.empty() || ended_) return false;
    (line.starts_with("Pose ") ? poses_ : facts_).push_back(std::move(line));
    return true;
  }

  Child child_;
  Lines facts_, poses_;
  bool ended_ = false;
};

/// Sends poses, as a vehicle does time and again, until one arrives: the ones before spoke to nobody yet, any after it
/// must arrive too. What was sent from that one on, as lines.
template <class G>
Lines send_poses_until_one_arrives(DdsExchange<G>& exchange, Facts<G>& facts, Subscriber& subscriber) {
  Lines sent;
  for (double left_s = deadline_s; left_s > 0.0 && subscriber.poses().empty(); left_s -= 0.1) {
    const LivePose<G> pose = facts.pose();
    sent.push_back(line_of<v1::Pose, G>(facts.chain(), pose));
    EXPECT_EQ(exchange.send({facts.chain(), pose}), SendStatus::sent);
    subscriber.hears_poses(1, 0.1);
  }
  if (subscriber.poses().empty()) {
    ADD_FAILURE() << "no pose has arrived";
    return {};
  }
  sent.erase(sent.begin(), std::find(sent.begin(), sent.end(), subscriber.poses().front()));
  EXPECT_TRUE(subscriber.hears_poses(sent.size()));
  return sent;
}

// ---- tests -----------------------------------------------------------------------------------------------------

template <class G>
class Cyclone : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(Cyclone, Groups);

TYPED_TEST(Cyclone, SubscriberThatIsThereGetsEverySample) {
  Facts<TypeParam> facts(1, 20, 10);
  DdsExchange<TypeParam> exchange(config_of_this_test());
  Subscriber subscriber;
  Lines poses = send_poses_until_one_arrives(exchange, facts, subscriber);

  send_all(exchange, facts.messages());
  EXPECT_TRUE(subscriber.hears_facts(facts.lines().size()));
  for (int i = 0; i < 20; ++i) {  // one after the other: nothing repeats a pose, so none is sent into a full socket
    const LivePose<TypeParam> pose = facts.pose();
    poses.push_back(line_of<v1::Pose, TypeParam>(facts.chain(), pose));
    ASSERT_EQ(exchange.send({facts.chain(), pose}), SendStatus::sent);
    ASSERT_TRUE(subscriber.hears_poses(poses.size()));
  }
  subscriber.leave();
  EXPECT_EQ(subscriber.facts(), facts.lines());
  EXPECT_EQ(subscriber.poses(), poses);
}

TYPED_TEST(Cyclone, SubscriberThatComesLateGetsAllFactsAndTheNextPose) {
  Facts<TypeParam> facts(1, 20, 10);
  DdsExchange<TypeParam> exchange(config_of_this_test());
  send_all(exchange, facts.messages());
  {
    Subscriber first;  // whose acknowledgement of everything, and whose leaving, take nothing from the next one
    EXPECT_TRUE(first.hears_facts(facts.lines().size()));
    send_poses_until_one_arrives(exchange, facts, first);
    first.leave();
    EXPECT_EQ(first.facts(), facts.lines());
  }
  Subscriber late;
  EXPECT_TRUE(late.hears_facts(facts.lines().size()));
  EXPECT_TRUE(late.poses().empty()) << "a pose of the past";
  const Lines poses = send_poses_until_one_arrives(exchange, facts, late);
  late.leave();
  EXPECT_EQ(late.facts(), facts.lines());
  EXPECT_EQ(late.poses(), poses);
}

TYPED_TEST(Cyclone, NothingIsLostOfTwoVehiclesThatSendAsFastAsTheyCan) {
  constexpr std::uint32_t landmarks_each = 1000;  // of 2000; one landmark, one anchor and one pose at a time
  Facts<TypeParam> one(1, landmarks_each, 1), two(2, landmarks_each, 1);
  DdsExchange<TypeParam> a(config_of_this_test()), b(config_of_this_test());
  ASSERT_TRUE(all_connected<TypeParam>({&a, &b}));
  Subscriber there;
  send_poses_until_one_arrives(a, one, there);
  const auto drive = [](DdsExchange<TypeParam>& exchange, Facts<TypeParam>& facts) {
    for (const auto& message : facts.messages()) {
      EXPECT_EQ(exchange.send(message), SendStatus::sent);
      EXPECT_EQ(exchange.send({facts.chain(), facts.pose()}), SendStatus::sent);
    }
  };
  std::thread driver_a(drive, std::ref(a), std::ref(one)), driver_b(drive, std::ref(b), std::ref(two));
  EXPECT_TRUE(there.hears_facts(landmarks_each / 10));
  Subscriber in_between;
  driver_a.join();
  driver_b.join();

  Lines all = one.lines();
  all.insert(all.end(), two.lines().begin(), two.lines().end());
  std::sort(all.begin(), all.end());
  for (Subscriber* subscriber : {&there, &in_between}) {
    EXPECT_TRUE(subscriber->hears_facts(all.size()));
    subscriber->leave();
    EXPECT_EQ(subscriber->facts().size(), all.size());
    EXPECT_TRUE(subscriber->facts() == all) << "other contents";
  }
}

// The other way round, as whoever holds a fact repeats it: the facts go to Cyclone DDS, through its memory and back.
TYPED_TEST(Cyclone, WhatItWritesIsTaken) {
  constexpr VehicleId repeater = 77;
  const Facts<TypeParam> facts(1, 20, 10);
  DdsExchange<TypeParam> exchange(config_of_this_test());
  Subscriber subscriber;
  send_all(exchange, facts.messages());
  ASSERT_TRUE(subscriber.hears_facts(facts.lines().size()));
  subscriber.tell("repeat " + std::to_string(repeater));

  ChainId sender = facts.chain();
  sender.vehicle = repeater;
  Lines taken;  // as if their author had sent them, for comparison
  const bool all = eventually([&] {
    for (const auto& message : exchange.take(0.0)) {
      EXPECT_EQ(message.sender, sender);
      if (const auto* anchor = std::get_if<AnchorFact<TypeParam>>(&message.payload))
        taken.push_back(line_of<v1::Bias, TypeParam>(facts.chain(), *anchor));
      if (const auto* batch = std::get_if<LandmarkBatch<TypeParam>>(&message.payload))
        taken.push_back(line_of<v1::Landmark, TypeParam>(facts.chain(),
                                                         std::span<const LandmarkFact<TypeParam>>(batch->landmarks)));
    }
    return taken.size() >= facts.lines().size();
  });
  EXPECT_TRUE(all);
  subscriber.leave();
  std::sort(taken.begin(), taken.end());
  EXPECT_EQ(taken, facts.lines());
  EXPECT_EQ(exchange.counters().undecodable + exchange.counters().hostile, 0U);
  EXPECT_EQ(exchange.counters().incompatible_peers, 0U);
}

/// A network namespace with a loopback device and a second, live interface; gone with the test.
class Host {
 public:
  Host() : name_("convoy" + std::to_string(getpid()) + "c") {
    const std::string script =
        "exec 2>/dev/null; set -e; ip netns add " + name_ + "; ip netns exec " + name_ +
        " sh -c 'set -e; sysctl -qw net.ipv6.conf.default.disable_ipv6=1 || true; ip link set lo up;"
        "ip link add v0 type veth peer name v1; ip link set v0 up; ip link set v1 up;"
        "ip addr add 10.97.0.1/24 dev v0; ip route add 224.0.0.0/4 dev v0'";
    made_ = Child({"sh", "-c", script}).finish() == 0;
  }
  ~Host() { Child({"sh", "-c", "ip netns del " + name_ + " 2>/dev/null"}).finish(); }
  bool made() const { return made_; }
  std::vector<std::string> command(const std::vector<std::string>& what = {}) const {
    std::vector<std::string> words{"ip", "netns", "exec", name_};
    words.insert(words.end(), what.begin(), what.end());
    return words;
  }
  std::uint64_t packets_sent(const std::string& interface) const {
    return std::stoull(Child(command({"cat", "/sys/class/net/" + interface + "/statistics/tx_packets"})).hear());
  }

 private:
  std::string name_;
  bool made_ = false;
};

TEST(CycloneOnLoopback, NothingLeaves) {
  if (geteuid() != 0) GTEST_SKIP() << "SKIPPED ALOUD: needs root to make a network namespace";
  const Host host;
  if (!host.made()) GTEST_SKIP() << "SKIPPED ALOUD: this machine makes no network namespace";
  const std::uint64_t before = host.packets_sent("v0");
  Child vehicle(host.command(peer_command(1)));
  ASSERT_EQ(vehicle.hear(), "ready");
  vehicle.tell("send 0 300");
  ASSERT_EQ(vehicle.hear(), "sent 300");
  Subscriber subscriber(host.command());
  EXPECT_TRUE(subscriber.hears_facts(300));
  subscriber.leave();
  EXPECT_THAT(subscriber.facts(), Each(StartsWith("Bias 1 1 1 1 ")));
  EXPECT_EQ(vehicle.finish(), 0);
  EXPECT_EQ(host.packets_sent("v0"), before);
  EXPECT_GT(host.packets_sent("lo"), 0U);
}

}  // namespace
}  // namespace convoy::dds::testing
