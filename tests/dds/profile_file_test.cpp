#include "dds_testing.hpp"

#include <convoy/components/vehicle_config.hpp>
#include <convoy/dds/profile_file.hpp>

#include <gmock/gmock.h>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>

#include <filesystem>
#include <fstream>
#include <sstream>

namespace convoy::dds::testing {
namespace {

namespace edds = eprosima::fastdds::dds;
using ::testing::HasSubstr;

std::string refusal_after(const std::string& from, const std::string& to) {
  const ChangedProfile changed(from, to);
  DdsConfig config = config_of_this_test();
  config.profile_file = changed.path;
  return refusal(config);
}

/// A publisher to ask for profiles: Fast DDS hands them out through one.
struct SomePublisher {
  explicit SomePublisher(const ProfileFile& profiles)
      : participant(factory->create_participant(domain_of_this_test(), profiles.participant("convoy"))),
        publisher(participant->create_publisher(edds::PUBLISHER_QOS_DEFAULT)) {}
  ~SomePublisher() {
    participant->delete_publisher(publisher);
    factory->delete_participant(participant);
  }
  edds::DomainParticipantFactory* factory = edds::DomainParticipantFactory::get_instance();
  edds::DomainParticipant* participant;
  edds::Publisher* publisher;
};

TEST(ProfileFile, MissingFileIsNamed) {
  DdsConfig config = config_of_this_test();
  config.profile_file = "/nowhere/qos.xml";
  EXPECT_THAT(refusal(config), HasSubstr("/nowhere/qos.xml: cannot read"));
}

TEST(ProfileFile, AnEmptyFileAndAFolderAreToldApart) {
  DdsConfig config = config_of_this_test();
  config.profile_file = ::testing::TempDir() + "convoy_profile_empty.xml";
  std::ofstream(config.profile_file).flush();
  EXPECT_THAT(refusal(config), HasSubstr("convoy_profile_empty.xml:1: this QoS profile file is empty"));
  std::filesystem::remove(config.profile_file);
  config.profile_file = ::testing::TempDir();
  EXPECT_THAT(refusal(config), HasSubstr("cannot read this QoS profile file"));
}

TEST(ProfileFile, MissingParticipantProfileIsNamed) {
  DdsConfig config = config_of_this_test();
  config.participant_profile = "bus";
  EXPECT_THAT(refusal(config), HasSubstr("no participant profile 'bus'"));
}

TEST(ProfileFile, AWriterWithNeitherProfileIsNamedWithBoth) {
  const std::string refused =
      refusal_after("data_writer profile_name=\"convoy/facts\"", "data_writer profile_name=\"convoy/fakts\"");
  EXPECT_THAT(refused, HasSubstr("no data_writer profile 'convoy/v1/Bias' nor one of its class"));
  EXPECT_THAT(refused, HasSubstr("add <data_writer profile_name=\"convoy/facts\">"));
}

TEST(ProfileFile, AReaderWithNeitherProfileIsNamedWithBoth) {
  const std::string refused =
      refusal_after("data_reader profile_name=\"convoy/requests\"", "data_reader profile_name=\"x\"");
  EXPECT_THAT(refused, HasSubstr("no data_reader profile 'convoy/v1/Request' nor one of its class"));
  EXPECT_THAT(refused, HasSubstr("add <data_reader profile_name=\"convoy/requests\">"));
}

TEST(ProfileFile, AProfileOfTheTopicsOwnGoesBeforeThatOfItsClass) {
  const ChangedProfile changed("<data_writer profile_name=\"convoy/values\">",
                               "<data_writer profile_name=\"convoy/v1/Digest\">"
                               "<times><heartbeatPeriod><sec>9</sec></heartbeatPeriod></times></data_writer>"
                               "<data_writer profile_name=\"convoy/values\">");
  const ProfileFile profiles(changed.path);
  const SomePublisher host(profiles);
  const auto period_s = [&](const char* topic) {
    return profiles.writer(*host.publisher, topic).reliable_writer_qos().times.heartbeatPeriod.seconds;
  };
  EXPECT_EQ(period_s("convoy/v1/Digest"), 9);
  EXPECT_EQ(period_s("convoy/v1/Pose"), 3);  // of the class, whose file says nothing: Fast DDS's own
  EXPECT_EQ(profiles.writer(*host.publisher, "convoy/v1/Landmark").reliability().kind, edds::RELIABLE_RELIABILITY_QOS);
  EXPECT_EQ(profiles.writer(*host.publisher, "convoy/v1/Pose").reliability().kind, edds::BEST_EFFORT_RELIABILITY_QOS);
  EXPECT_EQ(profiles.writer(*host.publisher, "convoy/v1/Request").durability().kind, edds::VOLATILE_DURABILITY_QOS);
}

TEST(ProfileFile, DoubledProfileHasALine) {
  const std::string refused =
      refusal_after("data_writer profile_name=\"convoy/values\"", "data_writer profile_name=\"convoy/facts\"");
  EXPECT_THAT(refused, HasSubstr("a second data_writer profile 'convoy/facts'"));
  EXPECT_THAT(refused, ::testing::ContainsRegex("\\.xml:[0-9]+: "));
}

TEST(ProfileFile, MalformedXmlHasALine) {
  EXPECT_THAT(refusal_after("</userTransports>", "</users>"),
              ::testing::ContainsRegex("\\.xml:[0-9]+: not well-formed"));
}

TEST(ProfileFile, WhatFastDdsRefusesIsAnError) {
  EXPECT_THAT(refusal_after("<kind>KEEP_ALL</kind>", "<kind>KEEP_SOME</kind>"), HasSubstr("Fast DDS refuses"));
}

TEST(ProfileFile, ProcessWideSettingsAreRefused) {
  EXPECT_THAT(refusal_after("<participant profile_name", "<participant is_default_profile=\"true\" profile_name"),
              HasSubstr("would change the whole process"));
}

TEST(ProfileFile, BuiltInTransportsAreRefused) {
  EXPECT_THAT(refusal_after("<useBuiltinTransports>false", "<useBuiltinTransports>true"),
              ::testing::ContainsRegex("\\.xml:[0-9]+: participant"));
  EXPECT_THAT(refusal_after("<useBuiltinTransports>false", "<useBuiltinTransports>true"),
              HasSubstr("useBuiltinTransports"));
}

TEST(ProfileFile, ATransportWithoutInterfacesIsRefused) {
  DdsConfig config = config_of_this_test();
  config.profile_file = CONVOY_QOS_PROFILES "/lan.xml";
  EXPECT_THAT(refusal(config), HasSubstr("no <interfaceWhiteList>"));
  EXPECT_THAT(refusal(config), ::testing::ContainsRegex("lan\\.xml:[0-9]+: participant profile 'convoy': "));
  config.origin = "vehicle.xml:3";
  EXPECT_THAT(refusal(config), HasSubstr("or in vehicle.xml:3 (<dds interfaces=\"...\">)"));
}

TEST(ProfileFile, ATransportThatCannotBeCountedIsRefused) {
  EXPECT_THAT(refusal_after("<type>UDPv4</type>", "<type>UDPv6</type>"), HasSubstr("none of UDPv4, TCPv4 and SHM"));
}

TEST(ProfileFile, TheLanProfileSpeaksWhereItIsToldTo) {
  DdsConfig config = config_of_this_test();
  config.profile_file = CONVOY_QOS_PROFILES "/lan.xml";
  config.interface_whitelist = {"192.0.2.7"};  // a documentation address: nobody's
  EXPECT_THAT(refusal(config), HasSubstr("'192.0.2.7' is no IPv4 address of this host; it has 127.0.0.1"));
  config.origin = "vehicle.xml:3";
  EXPECT_EQ(refusal(config).rfind("vehicle.xml:3: interface '192.0.2.7' is no IPv4 address", 0), 0U);
  config.interface_whitelist = {"127.0.0.1"};
  DdsExchange<SE2> a(config), b(config);
  EXPECT_TRUE(all_connected({&a, &b}));
}

TEST(ProfileFile, TheLanVehicleIsWholeButForItsAddress) {
  VehicleConfig<SE2> vehicle = load_vehicle_config<SE2>(CONVOY_QOS_PROFILES "/lan_vehicle.xml");
  EXPECT_EQ(std::filesystem::path(vehicle.dds.profile_file).filename(), "lan.xml");
  vehicle.dds.domain = config_of_this_test().domain;
  EXPECT_THAT(refusal(vehicle.dds),
              ::testing::ContainsRegex("lan_vehicle\\.xml:[0-9]+: interface '192\\.0\\.2\\.1' is no IPv4"));
  vehicle.dds.interface_whitelist = {"127.0.0.1"};
  const auto first = open_exchange(vehicle);
  DdsExchange<SE2> second(vehicle.dds);
  EXPECT_TRUE(second.wait_for_peers(1, 20.0));
}

TEST(ProfileFile, TwoFilesOfEqualNamesDoNotMix) {
  const ProfileFile first(loopback_profile());
  const ChangedProfile changed("<sec>20</sec>", "<sec>23</sec>");
  const ProfileFile second(changed.path);
  EXPECT_EQ(first.participant("convoy").wire_protocol().builtin.discovery_config.leaseDuration.seconds, 20);
  EXPECT_EQ(second.participant("convoy").wire_protocol().builtin.discovery_config.leaseDuration.seconds, 23);
}

TEST(DdsConfig, ImpossibleFiguresAreRefused) {
  DdsConfig config = config_of_this_test();
  config.domain = 233;
  EXPECT_THAT(refusal(config), HasSubstr("233"));
  config = config_of_this_test();
  config.max_queued_messages = 0;
  EXPECT_THAT(refusal(config), HasSubstr("max_queued_messages"));
}

}  // namespace
}  // namespace convoy::dds::testing
