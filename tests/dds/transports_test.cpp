// Which participant is whose, and what a profile may name as a transport.
#include "dds_testing.hpp"

#include <convoy/dds/counting_transport.hpp>
#include <convoy/dds/profile_file.hpp>

#include <fastdds/rtps/participant/ParticipantDiscoveryInfo.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>

#include <mutex>
#include <set>
#include <string>

namespace convoy::dds::testing {
namespace {

namespace edds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;

/// A participant that only listens who else is there.
class Onlooker : public edds::DomainParticipantListener {
 public:
  Onlooker() {
    const ProfileFile profiles(loopback_profile());
    participant_ = factory_->create_participant(domain_of_this_test(), profiles.participant("convoy"), this,
                                                edds::StatusMask::none());
  }
  ~Onlooker() override { factory_->delete_participant(participant_); }

  void on_participant_discovery(edds::DomainParticipant*, rtps::ParticipantDiscoveryInfo&& found) override {
    const std::lock_guard lock(mutex_);
    prefixes_.insert(found.info.m_guid.guidPrefix);
  }
  std::set<rtps::GuidPrefix_t> prefixes() {
    const std::lock_guard lock(mutex_);
    return prefixes_;
  }

 private:
  edds::DomainParticipantFactory* factory_ = edds::DomainParticipantFactory::get_instance();
  edds::DomainParticipant* participant_ = nullptr;
  std::mutex mutex_;
  std::set<rtps::GuidPrefix_t> prefixes_;
};

TEST(GuidPrefix, SaysWhichVehicleOnWhichMachineAndIsNoOtherProcesss) {
  Onlooker onlooker;
  DdsConfig config = config_of_this_test();
  config.vehicle = 0x01020304;
  const DdsExchange<SE2> a(config), b(config);  // of one vehicle, in one process
  config.vehicle = 7;
  const DdsExchange<SE2> c(config);
  Child elsewhere(peer_command(9));
  ASSERT_TRUE(eventually([&] { return onlooker.prefixes().size() == 4; }));
  std::multiset<std::uint32_t> vehicles;
  std::set<std::string> machines, processes;
  for (const auto& prefix : onlooker.prefixes()) {
    EXPECT_EQ(prefix.value[0], 0x01);
    EXPECT_EQ(prefix.value[1], 0x0f);
    vehicles.insert(std::uint32_t{prefix.value[8]} << 24 | std::uint32_t{prefix.value[9]} << 16 |
                    std::uint32_t{prefix.value[10]} << 8 | prefix.value[11]);
    machines.emplace(prefix.value, prefix.value + 4);
    processes.emplace(prefix.value, prefix.value + 8);
  }
  EXPECT_EQ(vehicles, (std::multiset<std::uint32_t>{7, 9, 0x01020304, 0x01020304}));
  EXPECT_EQ(machines.size(), 1U);
  EXPECT_EQ(processes.size(), 4U);
}

TEST(WireCounters, HeadersAreThoseOfWhatCarriesTheMessage) {
  EXPECT_EQ(header_bytes_of(LOCATOR_KIND_UDPv4), 28U);
  EXPECT_EQ(header_bytes_of(LOCATOR_KIND_TCPv4), 66U);
  EXPECT_EQ(header_bytes_of(LOCATOR_KIND_SHM), 0U);
}

}  // namespace
}  // namespace convoy::dds::testing
