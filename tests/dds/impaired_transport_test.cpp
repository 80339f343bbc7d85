// Each impairment, measured on datagrams that went over real sockets; and exchanges that live with them.
#include "../support/exchange_contract.hpp"
#include "dds_testing.hpp"

#include <convoy/dds/counting_transport.hpp>
#include <convoy/dds/impaired_transport.hpp>

#include <fastdds/rtps/network/SenderResource.h>
#include <fastdds/rtps/transport/TransportReceiverInterface.h>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>
#include <gmock/gmock.h>
#include <fastdds/rtps/common/LocatorList.hpp>

#include <algorithm>
#include <cstring>
#include <mutex>
#include <thread>
#include <utility>

namespace convoy::dds::testing {
namespace {

using convoy::testing::anchor_message;
using ::testing::HasSubstr;
namespace rtps = eprosima::fastrtps::rtps;
namespace transport = eprosima::fastdds::rtps;

double steady_s() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

/// One end: a UDP transport on 127.0.0.1 with an impaired network above it.
class End : public transport::TransportReceiverInterface {
 public:
  struct Datagram {
    std::uint32_t number = 0;
    double sent_s = 0.0, received_s = 0.0;
  };

  explicit End(const Impairments& impairments) {
    DdsConfig config;
    network = impair(config, impairments);
    auto udp = std::make_shared<transport::UDPv4TransportDescriptor>();
    udp->interfaceWhiteList = {"127.0.0.1"};
    udp->sendBufferSize = udp->receiveBufferSize = 4U << 20;
    transport_.reset(config.wrap_transport(udp, counters)->create_transport());
    if (!transport_->init()) throw std::runtime_error("no UDP transport");
  }
  explicit End(const std::string& text) : End(Impairments::parse(text)) {}
  ~End() override {
    if (listening_) close();
    senders_.clear();
    transport_->shutdown();
  }

  static rtps::Locator_t address() {
    rtps::Locator_t locator(LOCATOR_KIND_UDPv4, 20000 + domain_of_this_test());
    rtps::IPLocator::setIPv4(locator, 127, 0, 0, 1);
    return locator;
  }
  void listen() { listening_ = transport_->OpenInputChannel(address(), this, 65000); }
  void close() {
    transport_->CloseInputChannel(address());
    listening_ = false;
  }
  void send(std::uint32_t number, VehicleId vehicle = 1, std::size_t size = 64) {
    if (senders_.empty()) transport_->OpenOutputChannel(senders_, address());
    std::vector<rtps::octet> bytes(std::max<std::size_t>(size, 36), 0);
    for (int i = 0; i < 4; ++i) bytes[static_cast<std::size_t>(19 - i)] = static_cast<rtps::octet>(vehicle >> (8 * i));
    const double now_s = steady_s();
    std::memcpy(&bytes[20], &now_s, 8);
    std::memcpy(&bytes[28], &number, 4);
    rtps::LocatorList_t list;
    list.push_back(address());
    const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(1);
    for (auto& sender : senders_) {
      transport::Locators begin(list.begin()), end(list.end());
      EXPECT_TRUE(sender->send(bytes.data(), static_cast<std::uint32_t>(bytes.size()), &begin, &end, until));
    }
  }
  void send_all(std::uint32_t count, VehicleId vehicle = 1, std::size_t size = 64) {
    for (std::uint32_t i = 0; i < count; ++i) {
      send(i, vehicle, size);
      if (i % 50 == 49) std::this_thread::sleep_for(std::chrono::milliseconds(1));  // the socket's buffer is finite
    }
  }

  void OnDataReceived(const rtps::octet* data, const std::uint32_t, const rtps::Locator_t&,
                      const rtps::Locator_t&) override {
    Datagram got;
    got.received_s = steady_s();
    std::memcpy(&got.sent_s, data + 20, 8);
    std::memcpy(&got.number, data + 28, 4);
    const std::lock_guard lock(mutex_);
    got_.push_back(got);
  }
  std::vector<Datagram> got() {
    const std::lock_guard lock(mutex_);
    return got_;
  }
  /// What has come, once nothing more has for half a second.
  std::vector<Datagram> settled() {
    std::size_t before = 0;
    EXPECT_TRUE(eventually([&] {
      std::this_thread::sleep_for(std::chrono::milliseconds(500));
      return std::exchange(before, got().size()) == got().size() && before > 0;
    }));
    return got();
  }

  std::shared_ptr<ImpairedNetwork> network;
  std::shared_ptr<WireCounters> counters = std::make_shared<WireCounters>();

 private:
  std::unique_ptr<transport::TransportInterface> transport_;
  transport::SendResourceList senders_;
  bool listening_ = false;
  std::mutex mutex_;
  std::vector<Datagram> got_;
};

std::vector<std::uint32_t> numbers(const std::vector<End::Datagram>& datagrams) {
  std::vector<std::uint32_t> list;
  for (const auto& datagram : datagrams) list.push_back(datagram.number);
  return list;
}

/// What arrives of `count` datagrams.
std::vector<End::Datagram> through(const std::string& impairments, std::uint32_t count) {
  End to(impairments), from(impairments);
  to.listen();
  from.send_all(count);
  return to.settled();
}

TEST(ImpairedTransport, NothingIsImpairedUnlessAsked) {
  const auto all = numbers(through("", 1000));
  ASSERT_EQ(all.size(), 1000U);
  EXPECT_TRUE(std::is_sorted(all.begin(), all.end()));
}

TEST(ImpairedTransport, LosesTheShareItIsToldToAndTheSameOnesForTheSameSeed) {
  const auto first = numbers(through("loss=0.3,seed=5", 2000));
  EXPECT_NEAR(static_cast<double>(first.size()), 1400.0, 120.0);
  EXPECT_EQ(numbers(through("loss=0.3,seed=5", 2000)), first);
  EXPECT_NE(numbers(through("loss=0.3,seed=6", 2000)), first);
}

TEST(ImpairedTransport, EachDirectionHasItsOwn) {
  const auto sent = numbers(through("out.loss=0.3,seed=5", 2000));
  EXPECT_NEAR(static_cast<double>(sent.size()), 1400.0, 120.0);
  EXPECT_NE(sent, numbers(through("loss=0.3,seed=5", 2000)));
  const auto both = numbers(through("loss=0.3,out.loss=0.5", 2000));
  EXPECT_NEAR(static_cast<double>(both.size()), 700.0, 120.0);
}

TEST(ImpairedTransport, DoublesTheShareItIsToldTo) {
  for (const char* text : {"duplicate=0.25", "out.duplicate=0.25"}) {
    const auto all = numbers(through(text, 2000));
    EXPECT_NEAR(static_cast<double>(all.size()), 2500.0, 120.0) << text;
    EXPECT_EQ(std::set<std::uint32_t>(all.begin(), all.end()).size(), 2000U) << text;
  }
}

TEST(ImpairedTransport, DelaysAndKeepsOrder) {
  for (const char* text : {"delay=200ms", "out.delay=200ms"}) {
    const auto all = through(text, 500);
    ASSERT_EQ(all.size(), 500U) << text;
    for (const auto& datagram : all) EXPECT_GE(datagram.received_s - datagram.sent_s, 0.2) << text;
    const auto order = numbers(all);
    EXPECT_TRUE(std::is_sorted(order.begin(), order.end())) << text;
  }
}

TEST(ImpairedTransport, JitterIsSpreadOverItsRange) {
  const auto all = through("delay=100ms,jitter=200ms", 1000);
  ASSERT_EQ(all.size(), 1000U);
  std::vector<double> late;
  for (const auto& datagram : all) late.push_back(datagram.received_s - datagram.sent_s);
  std::sort(late.begin(), late.end());
  EXPECT_GE(late.front(), 0.1);
  EXPECT_GT(late.back() - late.front(), 0.15);
  const auto order = numbers(all);
  EXPECT_FALSE(std::is_sorted(order.begin(), order.end()));
}

TEST(ImpairedTransport, LaterOnesOvertakeTheShareThatIsHeldBack) {
  const auto order = numbers(through("reorder=0.1", 1000));
  ASSERT_EQ(order.size(), 1000U);
  int overtaken = 0;
  std::uint32_t highest = 0;
  for (const std::uint32_t number : order) {
    if (number < highest) ++overtaken;
    highest = std::max(highest, number);
  }
  EXPECT_NEAR(overtaken, 100, 50);
}

TEST(ImpairedTransport, CarriesNoMoreThanItsRateAndDropsWhatWouldWaitTooLong) {
  for (const std::string direction : {"", "out."}) {
    End to(direction + "rate=100kB/s," + direction + "queue=5s"),
        from(direction + "rate=100kB/s," + direction + "queue=5s");
    to.listen();
    const double start_s = steady_s();
    from.send_all(60, 1, 1000);
    const auto all = to.settled();
    ASSERT_EQ(all.size(), 60U) << direction;
    EXPECT_GE(all.back().received_s - start_s, 0.59) << direction;
    EXPECT_GE(all[29].received_s - start_s, 0.29) << direction;
  }
  End to("rate=100kB/s,queue=100ms"), from("");
  to.listen();
  for (std::uint32_t i = 0; i < 200; ++i) from.send(i, 1, 1000);
  const std::size_t passed = to.settled().size();
  EXPECT_GE(passed, 10U);
  EXPECT_LE(passed, 100U);  // 11 if the burst takes no time
  EXPECT_EQ(passed + to.counters->dropped, 200U);
}

TEST(ImpairedTransport, APartitionIsOfItsVehiclesAndOfItsTime) {
  Impairments during = Impairments::parse("partition=3+4@100s..200s"), before = during, after = during;
  during.opened -= std::chrono::seconds(150);
  after.opened -= std::chrono::seconds(250);
  for (const auto& [impairments, heard] : {std::pair(before, 4), std::pair(during, 2), std::pair(after, 4)}) {
    End to(impairments), from("");
    to.listen();
    for (const VehicleId vehicle : {1U, 3U, 4U, 5U}) from.send(vehicle, vehicle);
    EXPECT_EQ(to.settled().size(), static_cast<std::size_t>(heard));
  }
}

TEST(ImpairedTransport, IsChangedWhileItRuns) {
  End to(""), from("");
  to.listen();
  to.network->block(1);
  from.send_all(100, 1);
  from.send_all(100, 2);
  ASSERT_EQ(to.settled().size(), 100U);
  to.network->unblock(1);
  from.send_all(100, 1);
  ASSERT_EQ(to.settled().size(), 200U);
  to.network->set_loss_received(0.5);
  from.send_all(1000, 1);
  EXPECT_NEAR(static_cast<double>(to.settled().size()), 700.0, 100.0);
  EXPECT_THROW(to.network->set_loss_received(1.0), ConfigError);
  EXPECT_THROW(from.network->set_loss_sent(-0.1), ConfigError);
  to.network->set_loss_received(0.0);
  from.network->set_loss_sent(0.5);
  const std::size_t before = to.got().size();
  from.send_all(1000, 1);
  EXPECT_NEAR(static_cast<double>(to.settled().size() - before), 500.0, 100.0);
}

TEST(ImpairedTransport, WhatOneTellsOneselfIsLeftAlone) {
  End end("loss=0.9,out.loss=0.9,out.delay=10s,delay=10s");
  end.listen();
  end.send_all(200);
  EXPECT_EQ(end.settled().size(), 200U);
}

TEST(ImpairedTransport, NothingReachesAChannelThatIsClosed) {
  End to("delay=300ms"), from("");
  to.listen();
  from.send_all(200);
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  to.close();
  const std::size_t at_close = to.got().size();
  std::this_thread::sleep_for(std::chrono::milliseconds(600));
  EXPECT_EQ(to.got().size(), at_close);
  End again("delay=1ms");  // and the address is free
  again.listen();
  from.send_all(10);
  EXPECT_EQ(again.settled().size(), 10U);
}

TEST(ImpairedTransport, WhatIsHeldBackIsBounded) {
  End from("out.delay=3600s");
  for (std::uint32_t i = 0; i < 1200; ++i) from.send(i, 1, 60000);
  EXPECT_GE(from.counters->dropped, 1200U - (64U << 20) / 60000 - 1);
  EXPECT_LT(from.counters->dropped, 200U);
}

// ---- exchanges -------------------------------------------------------------------------------------------------

TEST(ImpairedExchange, NothingGoesPastItWithinAProcess) {
  DdsConfig of_a = config_of_this_test(), of_b = config_of_this_test();
  of_a.vehicle = 1;
  of_b.vehicle = 2;
  const auto network_of_b = impair(of_b, {});
  DdsExchange<SE2> a(of_a), b(of_b);
  ASSERT_TRUE(all_connected({&a, &b}));
  network_of_b->block(1);
  for (std::uint32_t i = 0; i < 50; ++i) ASSERT_EQ(a.send(anchor_message<SE2>(1, i)), SendStatus::sent);
  EXPECT_FALSE(b.wait_for_messages(0.5));
  EXPECT_GE(b.counters().dropped, 50U);
  ASSERT_EQ(b.send(anchor_message<SE2>(2, 0)), SendStatus::sent);  // the other way nothing is blocked
  EXPECT_EQ(collect(a, 1).size(), 1U);
  network_of_b->unblock(1);
  EXPECT_EQ(collect(b, 50).size(), 50U);
}

TEST(ImpairedExchange, BytesAreCountedBeforeTheLoss) {
  DdsConfig lossy = config_of_this_test();
  impair(lossy, Impairments::parse("out.loss=0.9"));
  DdsExchange<SE2> a(lossy);
  const auto start = a.dds_counters();
  EXPECT_TRUE(eventually([&] { return a.dds_counters().datagrams_sent >= start.datagrams_sent + 3; }));
  EXPECT_GT(a.counters().dropped, 0U);
}

TEST(ImpairedExchange, AHostsOwnParticipantIsNotOursToImpair) {
  DdsConfig config = config_of_this_test();
  config.participant = reinterpret_cast<eprosima::fastdds::dds::DomainParticipant*>(&config);  // is not looked into
  EXPECT_THROW(impair(config, {}), ConfigError);
  EXPECT_THROW(impair(config = config_of_this_test(), Impairments::parse("out.partition=1@0..1")), ConfigError);
}

TEST(ImpairedExchange, OpensAndClosesWithDatagramsOnTheirWay) {
  for (int round = 0; round < 5; ++round) {
    DdsConfig config = config_of_this_test();
    impair(config, Impairments::parse("loss=0.1,duplicate=0.2,delay=20ms,jitter=50ms,out.delay=20ms,out.jitter=20ms"));
    DdsExchange<SE2> a(config), b(config);
    ASSERT_TRUE(all_connected({&a, &b}));
    for (std::uint32_t i = 0; i < 200; ++i) ASSERT_EQ(a.send(anchor_message<SE2>(1, i)), SendStatus::sent);
  }
}

std::vector<std::string> impaired_peer(VehicleId vehicle, const std::string& impairments,
                                       const std::string& profile = loopback_profile()) {
  auto command = peer_command(vehicle, profile);
  command.insert(command.end(), {"127.0.0.1", "impair=" + impairments});
  return command;
}

TEST(ImpairedProcesses, ReliableTopicsLiveWithEverythingAtOnce) {
  constexpr double patience_s = 60.0;  // discovery is slow when it loses: Fast DDS repeats it every few seconds
  const std::string rough = "loss=0.3,duplicate=0.2,delay=20ms,jitter=30ms,reorder=0.1,rate=1MB/s,seed=";
  std::vector<std::unique_ptr<Child>> vehicles;
  for (VehicleId v = 1; v <= 3; ++v)
    vehicles.push_back(
        std::make_unique<Child>(impaired_peer(v, rough + std::to_string(v), profile_named("lossy_radio"))));
  for (auto& vehicle : vehicles) ASSERT_EQ(vehicle->hear(), "ready");
  for (auto& vehicle : vehicles) vehicle->tell("peers 2");
  for (auto& vehicle : vehicles) ASSERT_EQ(vehicle->hear(patience_s), "peers 2");
  for (auto& vehicle : vehicles) vehicle->tell("send 0 200");
  for (auto& vehicle : vehicles) ASSERT_EQ(vehicle->hear(), "sent 200");
  for (auto& vehicle : vehicles) vehicle->tell("expect 400");
  for (auto& vehicle : vehicles) EXPECT_EQ(vehicle->hear(patience_s), "held 400");
  for (auto& vehicle : vehicles) EXPECT_EQ(vehicle->finish(), 0);
}

TEST(ImpairedProcesses, APartitionBothWaysHeals) {
  Child a(impaired_peer(1, "")), b(impaired_peer(2, "")), c(impaired_peer(3, ""));
  for (Child* vehicle : {&a, &b, &c}) ASSERT_EQ(vehicle->hear(), "ready");
  for (Child* vehicle : {&a, &b, &c}) vehicle->tell("peers 2");
  for (Child* vehicle : {&a, &b, &c}) ASSERT_EQ(vehicle->hear(), "peers 2");
  a.tell("block 2");
  a.tell("block 3");
  for (Child* vehicle : {&b, &c}) vehicle->tell("block 1");
  for (const auto& [vehicle, blocked] :
       {std::pair(&a, "2"), std::pair(&a, "3"), std::pair(&b, "1"), std::pair(&c, "1")})
    ASSERT_EQ(vehicle->hear(), std::string("blocked ") + blocked);
  for (Child* vehicle : {&a, &b, &c}) vehicle->tell("send 0 50");
  for (Child* vehicle : {&a, &b, &c}) ASSERT_EQ(vehicle->hear(), "sent 50");
  for (Child* vehicle : {&b, &c}) vehicle->tell("expect 50");  // of each other
  for (Child* vehicle : {&b, &c}) EXPECT_EQ(vehicle->hear(), "held 50");
  std::this_thread::sleep_for(std::chrono::seconds(1));
  for (Child* vehicle : {&a, &b, &c}) vehicle->tell("take");
  EXPECT_EQ(a.hear(), "held 0");
  for (Child* vehicle : {&b, &c}) EXPECT_EQ(vehicle->hear(), "held 50");
  a.tell("unblock 2");
  a.tell("unblock 3");
  for (Child* vehicle : {&b, &c}) vehicle->tell("unblock 1");
  for (Child* vehicle : {&a, &a, &b, &c}) ASSERT_THAT(vehicle->hear(), HasSubstr("unblocked"));
  for (Child* vehicle : {&a, &b, &c}) vehicle->tell("expect 100");
  for (Child* vehicle : {&a, &b, &c}) EXPECT_EQ(vehicle->hear(), "held 100");
  for (Child* vehicle : {&a, &b, &c}) EXPECT_EQ(vehicle->finish(), 0);
}

}  // namespace
}  // namespace convoy::dds::testing
