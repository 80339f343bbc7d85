#include "dds_testing.hpp"

#include <convoy/components/vehicle_config.hpp>
#include <convoy/dds/profile_file.hpp>

#include <gmock/gmock.h>

#include <filesystem>
#include <fstream>
#include <sstream>

namespace convoy::dds::testing {
namespace {

using ::testing::HasSubstr;

std::string text_of(const std::string& path) {
  std::ostringstream text;
  text << std::ifstream(path).rdbuf();
  return text.str();
}

/// The loopback profile with one text replaced by another, in a file of its own.
class ChangedProfile {
 public:
  ChangedProfile(const std::string& from, const std::string& to) {
    std::string text = text_of(loopback_profile());
    const auto at = text.find(from);
    if (at == std::string::npos) throw std::logic_error("the loopback profile has no " + from);
    std::ofstream(path) << text.replace(at, from.size(), to);
  }
  ~ChangedProfile() { std::filesystem::remove(path); }
  std::string path = ::testing::TempDir() + "convoy_profile_" +
                     ::testing::UnitTest::GetInstance()->current_test_info()->name() + ".xml";
};

std::string refusal(const DdsConfig& config) {
  try {
    DdsExchange<SE2> exchange(config);
  } catch (const ConfigError& error) {
    return error.what();
  }
  return "accepted";
}

std::string refusal(const std::string& from, const std::string& to) {
  const ChangedProfile changed(from, to);
  DdsConfig config = config_of_this_test();
  config.profile_file = changed.path;
  return refusal(config);
}

TEST(ProfileFile, MissingFileIsNamed) {
  DdsConfig config = config_of_this_test();
  config.profile_file = "/nowhere/qos.xml";
  EXPECT_THAT(refusal(config), HasSubstr("/nowhere/qos.xml: cannot read"));
}

TEST(ProfileFile, MissingParticipantProfileIsNamed) {
  DdsConfig config = config_of_this_test();
  config.participant_profile = "bus";
  EXPECT_THAT(refusal(config), HasSubstr("no participant profile 'bus'"));
}

TEST(ProfileFile, MissingWriterProfileIsNamed) {
  EXPECT_THAT(
      refusal("data_writer profile_name=\"convoy/v1/Verdict\"", "data_writer profile_name=\"convoy/v1/Verdikt\""),
      HasSubstr("no data_writer profile 'convoy/v1/Verdict'"));
}

TEST(ProfileFile, MissingReaderProfileIsNamed) {
  EXPECT_THAT(refusal("data_reader profile_name=\"convoy/v1/Digest\"", "data_reader profile_name=\"x\""),
              HasSubstr("no data_reader profile 'convoy/v1/Digest'"));
}

TEST(ProfileFile, DoubledProfileHasALine) {
  const std::string refused =
      refusal("data_writer profile_name=\"convoy/v1/Landmark\"", "data_writer profile_name=\"convoy/v1/Bias\"");
  EXPECT_THAT(refused, HasSubstr("a second data_writer profile 'convoy/v1/Bias'"));
  EXPECT_THAT(refused, ::testing::ContainsRegex("\\.xml:[0-9]+: "));
}

TEST(ProfileFile, MalformedXmlHasALine) {
  EXPECT_THAT(refusal("</userTransports>", "</users>"), ::testing::ContainsRegex("\\.xml:[0-9]+: not well-formed"));
}

TEST(ProfileFile, WhatFastDdsRefusesIsAnError) {
  EXPECT_THAT(refusal("<kind>KEEP_ALL</kind>", "<kind>KEEP_SOME</kind>"), HasSubstr("Fast DDS refuses"));
}

TEST(ProfileFile, ProcessWideSettingsAreRefused) {
  EXPECT_THAT(refusal("<participant profile_name", "<participant is_default_profile=\"true\" profile_name"),
              HasSubstr("would change the whole process"));
}

TEST(ProfileFile, BuiltInTransportsAreRefused) {
  EXPECT_THAT(refusal("<useBuiltinTransports>false", "<useBuiltinTransports>true"),
              ::testing::ContainsRegex("\\.xml:[0-9]+: participant"));
  EXPECT_THAT(refusal("<useBuiltinTransports>false", "<useBuiltinTransports>true"), HasSubstr("useBuiltinTransports"));
}

TEST(ProfileFile, ATransportWithoutInterfacesIsRefused) {
  DdsConfig config = config_of_this_test();
  config.profile_file = CONVOY_QOS_PROFILES "/lan.xml";
  EXPECT_THAT(refusal(config), HasSubstr("no <interfaceWhiteList>"));
  EXPECT_THAT(refusal(config), ::testing::ContainsRegex("lan\\.xml:[0-9]+: participant profile 'convoy': "));
  config.origin = "vehicle.xml:3";
  EXPECT_THAT(refusal(config), HasSubstr("or in vehicle.xml:3 (<dds interfaces=\"...\">)"));
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
