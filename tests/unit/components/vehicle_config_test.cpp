#include <convoy/components/vehicle_config.hpp>
#include <convoy/config_error.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <unistd.h>

#include <fstream>
#include <iterator>
#include <limits>

namespace convoy {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class VehicleConfigTest : public testing::Test {
 protected:
  VehicleConfigTest() : file_(fs::temp_directory_path() / ("convoy_config_" + std::to_string(::getpid()) + ".xml")) {}
  ~VehicleConfigTest() override { fs::remove(file_); }

  VehicleConfig<SE2> load(const std::string& text) {
    std::ofstream(file_, std::ios::trunc) << text;
    return load_vehicle_config<SE2>(file_);
  }
  /// What is said of `text`, without the path: "line: what".
  std::string refusal(const std::string& text) {
    try {
      load(text);
    } catch (const ConfigError& error) {
      const std::string what = error.what(), path = file_.string() + ":";
      EXPECT_EQ(what.substr(0, path.size()), path);
      EXPECT_EQ(what.find('\n'), std::string::npos);
      return what.substr(std::min(what.size(), path.size()));
    }
    return "accepted";
  }
  /// Of an entry that stands alone on line 4.
  std::string refusal_of(const std::string& element, const std::string& attribute) {
    return refusal("<convoy version=\"1\">\n  <!-- one -->\n" +
                   (element == "vehicle" ? "  <vehicle id=\"1\"\n   " + attribute + "/>\n"
                                         : "  <vehicle id=\"1\"/><" + element + "\n   " + attribute + "/>\n") +
                   "</convoy>\n");
  }

  fs::path file_;
};

TEST_F(VehicleConfigTest, AWholeFileIsRead) {
  const VehicleConfig<SE2> c = load(
      "<?xml version=\"1.0\"?>\n<!-- a vehicle -->\n<convoy version=\"1\">\n"
      "  <vehicle id=\"2\" state_folder=\"state\" roster=\"1 2\" first_epoch=\"7\"/>\n"
      "  <dds domain=\"232\" max_queued_messages=\"12\" security=\"vehicle_2\"/>\n  <impairment loss=\"0.5\" "
      "seed=\"18446744073709551615\"/>\n"
      "  <sensors file=\"s.csv\" rate=\"1e1\"/>\n</convoy>\n<!-- the end -->\n");
  EXPECT_EQ(c.vehicle.id, 2U);
  EXPECT_EQ(c.vehicle.submaps.limits.roster, (std::vector<VehicleId>{1, 2}));
  EXPECT_EQ(c.vehicle.fresh_epoch(), 7U);
  EXPECT_EQ(c.dds.domain, 232U);
  EXPECT_EQ(c.dds.max_queued_messages, 12U);
  EXPECT_EQ(c.dds.security_folder, (file_.parent_path() / "vehicle_2").string()) << "beside the file";
  EXPECT_EQ(c.impairment.received.seed, std::numeric_limits<std::uint64_t>::max());
  EXPECT_EQ(c.sensors.rate, 10.0);
}

TEST_F(VehicleConfigTest, WhatIsSavedIsReadBack) {
  VehicleConfig<SE2> c;
  c.vehicle.id = 3;
  c.vehicle.state_folder = "/somewhere/state";
  c.first_epoch = 12;
  c.dds.security_folder = "/somewhere/vehicle_3";
  c.impairment.received.jitter_s = 0.1;
  c.impairment.received.partitions = {{{3, 4}, 10.0, 70.5}, {{5}, 0.0, 1.0}};
  c.impairment.sent.rate_bytes_per_s = 5000.0;
  c.vehicle.submaps.map_period_s = 1.0 / 3.0;
  c.vehicle.submaps.selection.common_frame_is_enu = true;
  c.sensors.fix_lever[0] = -1.25;
  c.dds.initial_peers = {"192.0.2.1", "192.0.2.2:7410"};
  c.dds.discovery_servers = {"192.0.2.3:11811"};
  save_vehicle_config(c, file_);
  const VehicleConfig<SE2> back = load_vehicle_config<SE2>(file_);
  EXPECT_EQ(back.first_epoch, 12U);
  EXPECT_EQ(back.impairment.received.jitter_s, 0.1);
  ASSERT_EQ(back.impairment.received.partitions.size(), 2U);
  EXPECT_EQ(back.impairment.received.partitions[0].vehicles, (std::vector<VehicleId>{3, 4}));
  EXPECT_EQ(back.impairment.received.partitions[0].to_s, 70.5);
  EXPECT_EQ(back.impairment.sent.rate_bytes_per_s, 5000.0);
  EXPECT_EQ(back.vehicle.submaps.map_period_s, 1.0 / 3.0);
  EXPECT_TRUE(back.vehicle.submaps.selection.common_frame_is_enu);
  EXPECT_EQ(back.sensors.fix_lever[0], -1.25);
  EXPECT_EQ(back.dds.initial_peers, c.dds.initial_peers);
  EXPECT_EQ(back.dds.discovery_servers, c.dds.discovery_servers);
}

TEST_F(VehicleConfigTest, NumbersAreWrittenToTheBitAndShort) {
  for (const double value : {0.1, 1.0 / 3.0, 1e-300, 5e-324, 123456789.123456789, 3e-7, 0.1 + 0.2}) {
    VehicleConfig<SE2> c;
    c.vehicle.id = 3;
    c.vehicle.drift.gamma = value;
    save_vehicle_config(c, file_);
    EXPECT_EQ(load_vehicle_config<SE2>(file_).vehicle.drift.gamma, value);
  }
  VehicleConfig<SE2> c;
  c.vehicle.id = 3;
  c.vehicle.drift.gamma = 0.1;
  save_vehicle_config(c, file_);
  std::ifstream in(file_);
  const std::string text{std::istreambuf_iterator<char>(in), {}};
  EXPECT_THAT(text, HasSubstr("gamma=\"0.1\""));  // and not 0.10000000000000001
}

// Which entry of an element that spans lines it is.
TEST_F(VehicleConfigTest, AnEntryOutOfRangeIsNamedWithItsOwnLine) {
  EXPECT_THAT(refusal("<convoy version=\"1\">\n<vehicle id=\"1\"/>\n<map period_s=\"1\"\n residual=\"2\"/></convoy>\n"),
              HasSubstr("4: <map residual> must lie in (0, 1) (it is 2)"));
  EXPECT_THAT(
      refusal("<convoy version=\"1\">\n<vehicle id=\"1\"/>\n<repair grace_s=\"1\"\n max_ranges=\"4097\"/></convoy>\n"),
      HasSubstr("4: <repair max_ranges> must lie in 1..4096 (it is 4097)"));
}

TEST_F(VehicleConfigTest, AFleetInSpaceIsSavedAndReadBack) {
  VehicleConfig<SE3> c;
  c.vehicle.id = 3;
  c.front_end.sigma_elevation_rad = 0.004;
  c.vehicle.drift.rate << 1e-5, 2e-5, 3e-5, 4e-7, 5e-7, 6e-7;
  c.vehicle.mark = {1.0, 2.0, 3.0};
  c.sensors.fix_lever = {0.1, 0.2, 1.5};
  SE3::Tangent sigma;
  sigma << 9.0, 8.0, 1.0, 0.05, 0.06, 0.3;
  const SE3 mean = SE3::from_rotation(Eigen::Matrix3d::Identity(), {1.0, 2.0, 3.0}) *
                   SE3::Exp(0.7 * SE3::Tangent::Unit(5)) * SE3::Exp(-0.2 * SE3::Tangent::Unit(4)) *
                   SE3::Exp(0.1 * SE3::Tangent::Unit(3));
  c.vehicle.static_bias = Estimate<SE3>{mean, sigma.cwiseAbs2().asDiagonal()};
  save_vehicle_config(c, file_);
  EXPECT_EQ(fleet_dimension(file_), 3);
  const VehicleConfig<SE3> back = load_vehicle_config<SE3>(file_);
  EXPECT_EQ(back.front_end.sigma_elevation_rad, 0.004);
  EXPECT_EQ(back.vehicle.drift.rate, c.vehicle.drift.rate);
  EXPECT_EQ(back.vehicle.mark, c.vehicle.mark);
  EXPECT_EQ(back.sensors.fix_lever, c.sensors.fix_lever);
  ASSERT_TRUE(back.vehicle.static_bias);
  EXPECT_LT((back.vehicle.static_bias->mean.inverse() * mean).Log().norm(), 1e-14);
  EXPECT_TRUE(back.vehicle.static_bias->covariance.isApprox(c.vehicle.static_bias->covariance, 1e-14));
}

TEST_F(VehicleConfigTest, ACameraIsReadBackInSpace) {
  VehicleConfig<SE3> c;
  c.vehicle.id = 3;
  EXPECT_FALSE(c.camera.given());
  c.camera.domain = 10;
  c.camera.lock_step = c.camera.gps = true;
  c.camera.interfaces = {"127.0.0.1", "192.0.2.1"};
  c.camera.features = 80;
  c.camera.slam.sigma_pixel = 0.8;
  c.camera.slam.min_batch = 9;
  save_vehicle_config(c, file_);
  const CameraConfig back = load_vehicle_config<SE3>(file_).camera;
  EXPECT_TRUE(back.given());
  EXPECT_EQ(back.domain, 10U);
  EXPECT_TRUE(back.lock_step);
  EXPECT_TRUE(back.gps);
  EXPECT_EQ(back.interfaces, c.camera.interfaces);
  EXPECT_EQ(back.features, 80);
  EXPECT_EQ(back.slam.sigma_pixel, 0.8);
  EXPECT_EQ(back.slam.min_batch, 9);
  EXPECT_THAT(back.origin, HasSubstr(file_.string() + ":"));
}

TEST_F(VehicleConfigTest, ABadCameraIsRefusedWithItsLine) {
  const auto refusal_of_camera = [&](const std::string& attributes, const std::string& more = "") {
    std::ofstream(file_, std::ios::trunc)
        << "<convoy version=\"1\">\n<fleet dimension=\"3\"/><vehicle id=\"1\"/>\n<camera\n"
        << attributes << "/>\n" + more + "</convoy>\n";
    try {
      (void)load_vehicle_config<SE3>(file_);
    } catch (const ConfigError& error) {
      return std::string(error.what()).substr(file_.string().size() + 1);
    }
    return std::string("accepted");
  };
  EXPECT_EQ(refusal_of_camera("domain=\"10\""), "accepted");
  EXPECT_THAT(refusal_of_camera(""), HasSubstr("3: <camera domain> must be there, and lie in 0..232"));
  EXPECT_THAT(refusal_of_camera("domain=\"233\""), HasSubstr("4: <camera domain> must be there"));
  EXPECT_THAT(refusal_of_camera("domain=\"7\"", "<dds domain=\"7\"/>"), HasSubstr("4: <camera domain> must differ"));
  EXPECT_THAT(refusal_of_camera("domain=\"10\" lock_step=\"maybe\""), HasSubstr("4: <camera lock_step>: 'maybe'"));
  EXPECT_THAT(refusal_of_camera("domain=\"10\"\ninterfaces=\"\""), HasSubstr("5: <camera interfaces> must name"));
  EXPECT_THAT(refusal_of_camera("domain=\"10\"\nfeatures=\"11\""),
              HasSubstr("5: <camera features> must lie in 12..400"));
  EXPECT_THAT(refusal_of_camera("domain=\"10\"\nnew_features=\"0\""), HasSubstr("5: <camera new_features> must lie"));
  EXPECT_THAT(refusal_of_camera("domain=\"10\"\nwait_s=\"-1\""), HasSubstr("5: <camera wait_s> must lie in 0..86400"));
  EXPECT_THAT(refusal_of_camera("domain=\"10\"\nsigma_pixel=\"0\""),
              HasSubstr("5: <camera sigma_pixel> must be > 0 (it is 0)"));
  EXPECT_THAT(refusal_of_camera("domain=\"10\"\nsigma_scale=\"-0.1\""),
              HasSubstr("5: <camera sigma_scale> must be >= 0"));
  EXPECT_THAT(refusal_of_camera("domain=\"10\"\nmax_segment_length_m=\"5\""),
              HasSubstr("5: <camera max_segment_length_m> must be segment_length_m or more"));
  EXPECT_THAT(refusal_of_camera("domain=\"10\"\nfocus=\"5\""), HasSubstr("5: <camera> has no entry 'focus'"));
  EXPECT_THAT(refusal_of_camera("domain=\"10\"", "<sensors file=\"s.csv\"/>"),
              HasSubstr("5: <sensors file> must not stand beside <camera>"));
  EXPECT_THAT(refusal("<convoy version=\"1\"><vehicle id=\"1\"/>\n<camera domain=\"10\"/></convoy>"),
              HasSubstr("2: <camera> is of a vehicle in space: it needs <fleet dimension=\"3\"/>"));
}

TEST_F(VehicleConfigTest, TheDimensionOfAFleetIsTwoOrThreeAndThatOfTheProgram) {
  const auto with = [](const std::string& fleet, const std::string& more = "") {
    return "<convoy version=\"1\">\n" + fleet + "\n<vehicle id=\"1\"" + more + "/></convoy>\n";
  };
  EXPECT_EQ(refusal(with("<fleet dimension=\"2\"/>")), "accepted");
  EXPECT_EQ(refusal(with("<fleet/>")), "accepted");  // planar by default
  EXPECT_EQ(fleet_dimension(file_), 2);
  EXPECT_THAT(refusal(with("<fleet dimension=\"4\"/>")),
              HasSubstr("2: <fleet dimension> must be 2 (planar) or 3 (in space)"));
  EXPECT_THAT(refusal(with("<fleet dimension=\"two\"/>")), HasSubstr("2: <fleet dimension>: 'two' is no whole number"));
  EXPECT_THAT(refusal(with("<fleet size=\"2\"/>")), HasSubstr("2: <fleet> has no entry 'size'; it has: dimension"));
  EXPECT_THAT(refusal(with("<fleet/>\n<fleet/>")), HasSubstr("3: <fleet> stands here for the second time"));
  EXPECT_THAT(refusal(with("<fleet dimension=\"3\"/>")),
              HasSubstr("2: <fleet dimension> is 3, and a fleet of dimension 2 is driven here"));
  // What only a vehicle in space has is no entry of a planar one.
  EXPECT_THAT(refusal(with("", " mark_z_m=\"1\"")), HasSubstr("3: <vehicle> has no entry 'mark_z_m'"));
  load(with("<fleet dimension=\"2\"/>"));
  EXPECT_THROW(load_vehicle_config<SE3>(file_), ConfigError);
}

TEST_F(VehicleConfigTest, NothingButOneRootIsAccepted) {
  const std::string good = "<convoy version=\"1\">\n  <vehicle id=\"1\"/>\n</convoy>\n";
  EXPECT_EQ(refusal(good), "accepted");
  EXPECT_THAT(refusal("<convoy version=\"1\">\n  <vehicle id=\"1\"/>\n  id 2\n</convoy>\n"),
              HasSubstr("take out the text in it"));
  EXPECT_THAT(refusal("<convoy version=\"1\">text<vehicle id=\"1\"/></convoy>\n"),
              HasSubstr("1: <convoy> holds elements"));
  EXPECT_THAT(refusal("<convoy version=\"1\"><![CDATA[x]]><vehicle id=\"1\"/></convoy>\n"),
              HasSubstr("1: <convoy> holds elements"));
  EXPECT_THAT(refusal(good + good), HasSubstr("4: a second root <convoy>"));
  EXPECT_THAT(refusal(good + "<other/>\n"), HasSubstr("4: a second root <other>"));
  EXPECT_NE(refusal(good + "some text\n"), "accepted");
  EXPECT_NE(refusal("some text\n" + good), "accepted");
  EXPECT_THAT(refusal("<!DOCTYPE convoy>\n" + good), HasSubstr("1: only <convoy version=\"1\"> may stand here"));
  EXPECT_THAT(refusal("<vehicle id=\"1\"/>\n"), HasSubstr("1: the root element must be <convoy version=\"1\">"));
  EXPECT_THAT(refusal(""), HasSubstr("1: not well-formed XML"));
}

TEST_F(VehicleConfigTest, BrokenXmlIsExplainedInWords) {
  const std::pair<const char*, const char*> cases[] = {
      {"", "1: not well-formed XML: the file is empty"},
      {"<convoy", "1: not well-formed XML: an element is cut"},
      {"<convoy version=\"1\">\n<vehicle id=\"1\">\n</convoy>\n", "an element is closed by another name or not at all"},
      {"<convoy version=\"1\"><vehicle id=1/></convoy>\n", "an entry is malformed; write name=\"value\""},
      {"<!-- <convoy version=\"1\">\n", "a comment has no end"}};
  for (const auto& [text, words] : cases) {
    EXPECT_THAT(refusal(text), HasSubstr(words)) << text;
    EXPECT_THAT(refusal(text), testing::Not(HasSubstr("XML_ERROR"))) << text;
  }
}

TEST_F(VehicleConfigTest, TheVersionIsOneAndTheRootHasNothingElse) {
  for (const std::string version : {"1.9", "01", "1 ", "2", "", "one"})
    EXPECT_THAT(refusal("<convoy version=\"" + version + "\">\n<vehicle id=\"1\"/></convoy>\n"),
                HasSubstr("1: <convoy> needs version=\"1\""))
        << version;
  EXPECT_THAT(refusal("<convoy>\n<vehicle id=\"1\"/></convoy>\n"), HasSubstr("1: <convoy> needs version=\"1\""));
  EXPECT_THAT(refusal("<convoy version=\"1\"\n  name=\"x\">\n<vehicle id=\"1\"/></convoy>\n"),
              HasSubstr("2: <convoy> has no entry 'name'; it has: version"));
}

TEST_F(VehicleConfigTest, ElementsStandOnceAndHoldAttributesOnly) {
  EXPECT_THAT(refusal("<convoy version=\"1\">\n<vehicle id=\"1\"/>\n<vehicle id=\"2\"/></convoy>"),
              HasSubstr("3: <vehicle> stands here for the second time"));
  EXPECT_THAT(refusal("<convoy version=\"1\">\n<vehicle id=\"1\">2</vehicle></convoy>"),
              HasSubstr("2: <vehicle> holds attributes only"));
  EXPECT_THAT(refusal("<convoy version=\"1\">\n<vehicle id=\"1\"/>\n<dds domains=\"2\"/></convoy>"),
              HasSubstr("3: <dds> has no entry 'domains'"));
  EXPECT_THAT(refusal("<convoy version=\"1\">\n<dds domain=\"2\"/></convoy>"), HasSubstr("1: <vehicle id=\"N\"/>"));
}

struct OutOfRange {
  const char *element, *attribute, *words;
};
class VehicleConfigRange : public VehicleConfigTest, public testing::WithParamInterface<OutOfRange> {};

TEST_P(VehicleConfigRange, IsRefusedWithItsLineAndTheMend) {
  const auto& [element, attribute, words] = GetParam();
  const std::string text = refusal_of(element, attribute);
  EXPECT_THAT(text, HasSubstr(words));
  // The line of the entry where the loader checks it; of its element where the stage does.
  EXPECT_TRUE(text.rfind("4: ", 0) == 0 || text.rfind("3: ", 0) == 0) << text;
}

INSTANTIATE_TEST_SUITE_P(
    Entries, VehicleConfigRange,
    testing::Values(
        OutOfRange{"dds", "domain=\"233\"", "<dds domain> must lie in 0..232"},
        OutOfRange{"dds", "max_queued_messages=\"0\"", "<dds max_queued_messages> must be 1 or more"},
        OutOfRange{"dds", "peers=\"192.0.2.1 robot.local\"",
                   "<dds peers>: 'robot.local' is no IPv4 address (a name would have to be looked up on the network); "
                   "write ADDRESS or ADDRESS:PORT"},
        OutOfRange{"dds", "peers=\"192.0.2.256\"", "<dds peers>: '192.0.2.256' is no IPv4 address"},
        OutOfRange{"dds", "peers=\"192.0.2.1:\"", "<dds peers>: '192.0.2.1:' has a port that is not in 1..65535"},
        OutOfRange{"dds", "peers=\"192.0.2.1:65536\"", "has a port that is not in 1..65535"},
        OutOfRange{"dds", "peers=\"192.0.2.1:74 10\"", "'10' is no IPv4 address"},
        OutOfRange{"dds", "peers=\"239.255.0.1\"", "'239.255.0.1' is the address of no single host"},
        OutOfRange{"dds", "discovery_servers=\"192.0.2.1\"",
                   "<dds discovery_servers>: '192.0.2.1' has no port; write ADDRESS:PORT"},
        OutOfRange{"dds", "discovery_servers=\"localhost:11811\"", "'localhost:11811' is no IPv4 address"},
        OutOfRange{"dds", "discovery_servers=\"192.0.2.1:0\"", "has a port that is not in 1..65535"},
        OutOfRange{"dds", "discovery_servers=\"192.0.2.1:11811:1\"", "has a port that is not in 1..65535"},
        OutOfRange{"static_bias", "x_m=\"2e6\"", "<static_bias> cannot be told to the other vehicles (out_of_range)"},
        OutOfRange{"static_bias", "sigma_y_m=\"1e200\"", "<static_bias> cannot be told to the other vehicles"},
        OutOfRange{"sensors", "rate=\"0\"", "<sensors rate> must be > 0"},
        OutOfRange{"sensors", "rate=\"-3\"", "<sensors rate> must be > 0"},
        OutOfRange{"sensors", "rate=\"inf\"", "<sensors rate>: 'inf' is no finite number"},
        OutOfRange{"sensors", "start_unix_s=\"-1\"", "must be >= 0"},
        OutOfRange{"sensors", "fix_lever_x_m=\"101\"", "<sensors fix_lever_x_m> must lie in -100..100 m"},
        OutOfRange{"sensors", "fix_lever_y_m=\"-1e9\"", "<sensors fix_lever_y_m> must lie in -100..100 m"},
        OutOfRange{"map", "fix_correlation_s=\"-1\"", "<map fix_correlation_s> must be >= 0"},
        OutOfRange{"map", "fix_residual=\"1\"", "<map fix_residual> must lie in (0, 1)"},
        OutOfRange{"map", "backend=\"ekf\" common_frame_is_enu=\"true\"", "takes no absolute fixes"},
        OutOfRange{"impairment", "loss=\"1\"", "loss is 1; it must lie in [0, 1)"},
        OutOfRange{"impairment", "duplicate=\"-0.5\"", "it must lie in [0, 1]"},
        OutOfRange{"impairment", "partitions=\"3@5..4\"", "the end of a partition is 4"},
        OutOfRange{"impairment", "partitions=\"3@5\"", "'3@5' is no partition like 3+4@10s..70s"},
        OutOfRange{"impairment_sent", "reorder=\"2\"", "reorder is 2; it must lie in [0, 1]"},
        OutOfRange{"impairment", "jitter_s=\"1e9\"", "it must lie in [0, 3600] s"},
        OutOfRange{"vehicle", "roster=\"2 3\"", "<vehicle roster> must name this vehicle, too: 1"},
        OutOfRange{"vehicle", "roster=\"1 1\"", "name each vehicle once"},
        OutOfRange{"vehicle", "roster=\"0 1\"", "name each vehicle once"},
        OutOfRange{"vehicle", "first_epoch=\"4\"", "stand beside a state_folder"},
        OutOfRange{"vehicle", "step_period_s=\"61\"", "lie in (0, 60] s"},
        OutOfRange{"vehicle", "searches_per_step=\"0\"", "be 1 or more"},
        OutOfRange{"vehicle", "live_period_s=\"0\"", "be > 0"},
        OutOfRange{"map", "period_s=\"-1\"", "<map period_s> must be > 0"},
        OutOfRange{"map", "min_pairings=\"2\"",
                   "<map min_pairings> must be 3 or more; two pairs align with anything (it is 2)"},
        OutOfRange{"map", "scale_slack=\"-1\"", "<map scale_slack> must be >= 0 (it is -1)"},
        OutOfRange{"repair", "batch_limit=\"0\"", "<repair batch_limit> must lie in 1..64 (it is 0)"},
        OutOfRange{"map", "residual=\"1\"", "lie in (0, 1)"},
        OutOfRange{"map", "backend=\"paper\"", "'paper' must be sparse or ekf"},
        OutOfRange{"repair", "digest_period_s=\"0\"", "be > 0"},
        OutOfRange{"repair", "max_ranges=\"0\"", "lie in 1..4096"},
        OutOfRange{"repair", "digest_idle_s=\"0.5\"", "be at least digest_period_s"},
        OutOfRange{"repair", "max_chains=\"257\"", "lie in 1..256"},
        OutOfRange{"budget", "bytes_per_s=\"-1\"", "<budget bytes_per_s> must be >= 0"},
        OutOfRange{"peers", "burst=\"0\"", "<peers burst> must be >= 1"},
        OutOfRange{"peers", "rival_s=\"0\"", "<peers rival_s> must be > 0"},
        OutOfRange{"peers", "max_facts_per_vehicle=\"0\"", "<peers max_facts_per_vehicle> must be 1 or more"},
        OutOfRange{"watchdog", "max_pause_s=\"1\"", "<watchdog max_pause_s> must be at least pause_s"},
        OutOfRange{"vehicle", "journal=\"true\"", "<vehicle journal> must stand beside a state_folder"},
        OutOfRange{"repair", "backoff_max_s=\"0.1\"", "be at least backoff_min_s"},
        OutOfRange{"drift", "gamma=\"0\"", "gamma must be > 0"},
        OutOfRange{"front_end", "gate=\"1\"", "confidences must lie in (0, 1)"},
        OutOfRange{"association", "min_pairings=\"2\"", "min_pairings must be >= 3"},
        OutOfRange{"static_bias", "sigma_x_m=\"-1\"", "<static_bias sigma_x_m> must be >= 0"},
        OutOfRange{"drift", "gamma=\" 1\"", "' 1' is no finite number"},
        OutOfRange{"drift", "gamma=\"0x10\"", "is no finite number"},
        OutOfRange{"dds", "domain=\"+5\"", "is no whole number"},
        OutOfRange{"dds", "domain=\"4294967296\"", "is no whole number from 0 to 4294967295"}));

}  // namespace
}  // namespace convoy
