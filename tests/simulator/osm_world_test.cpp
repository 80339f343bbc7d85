#include "osm_world.hpp"

#include "../support/data_folder.hpp"
#include "world_checks.hpp"

#include <gmock/gmock.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>

namespace convoy::simulator {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class OsmFile : public ::testing::Test {
 protected:
  std::string write(const std::string& text) {
    const auto* test = ::testing::UnitTest::GetInstance()->current_test_info();
    path_ = std::filesystem::path(::testing::TempDir()) / (std::string("convoy_") + test->name() + ".osm");
    std::ofstream(path_) << text;
    return path_.string();
  }
  ~OsmFile() override {
    if (!path_.empty()) std::filesystem::remove(path_);
  }

  /// The message that refuses the map.
  std::string refusal(const std::string& text, const OsmParams& params = {}) {
    try {
      OsmReport report;
      plan_osm(write(text), params, report);
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "(accepted)";
  }

 private:
  std::filesystem::path path_;
};

std::string node(int id, double east_m, double north_m) {
  std::ostringstream text;
  text.precision(12);
  text << "<node id=\"" << id << "\" lat=\"" << 48.0 + north_m / 111194.9 << "\" lon=\"" << 11.0 + east_m / 74403.0
       << "\"/>\n";
  return text.str();
}

std::string way(int id, const std::vector<int>& nodes, const std::string& tags) {
  std::string text = "<way id=\"" + std::to_string(id) + "\">";
  for (const int n : nodes) text += "<nd ref=\"" + std::to_string(n) + "\"/>";
  return text + tags + "</way>\n";
}

std::string tag(const std::string& key, const std::string& value) {
  return "<tag k=\"" + key + "\" v=\"" + value + "\"/>";
}

/// Four streets about a block of 130 x 80 m.
std::string block(const std::string& more = {}, const std::string& tags = tag("highway", "residential")) {
  return "<osm>\n" + node(1, 0, 0) + node(2, 130, 0) + node(3, 130, 80) + node(4, 0, 80) + way(1, {1, 2}, tags) +
         way(2, {2, 3}, tags) + way(3, {3, 4}, tags) + way(4, {4, 1}, tags) + more + "</osm>\n";
}

std::string house(int id, double east_m, double north_m, const std::string& tags) {
  const int n = 100 * id;
  return node(n, east_m, north_m) + node(n + 1, east_m, north_m + 12) + node(n + 2, east_m + 15, north_m + 12) +
         node(n + 3, east_m + 15, north_m) + way(1000 + id, {n, n + 1, n + 2, n + 3, n}, tag("building", "yes") + tags);
}

TEST_F(OsmFile, BlockBecomesAWorld) {
  OsmReport report;
  const std::string file =
      write(block(house(1, 40, 14, tag("building:levels", "5")) + house(2, 70, 14, tag("height", "9.5 m"))));
  const World world = load_osm(file, {}, &report);
  expect_sound(world.scene);
  EXPECT_EQ(world.attribution, "(c) OpenStreetMap contributors, ODbL 1.0");
  EXPECT_EQ(report.buildings, 2);
  EXPECT_EQ(report.streets, 4);
  EXPECT_FALSE(report.against_oneway);
  ASSERT_EQ(world.routes.size(), 3U);
  EXPECT_TRUE(world.routes[0].closed);
  EXPECT_NEAR(length_m(world.routes[0].points, true), 405.0, 25.0);
  EXPECT_EQ(hash_of(load_osm(file).scene), hash_of(world.scene));
  const StreetPlan plan = plan_osm(file, {}, report);
  for (const Route& route : plan.routes) expect_drivable(route, StreetNetwork(plan.streets), plan.footprints, 4.0);
  ASSERT_EQ(plan.footprints.size(), 2U);
  EXPECT_NEAR(plan.footprints[0].height_m, 17.2, 1e-9);
  EXPECT_NEAR(plan.footprints[1].height_m, 9.5, 1e-9);
  EXPECT_NEAR(signed_area_m2(plan.footprints[0].corners), 180.0, 1.0);  // clockwise in the file
}

TEST_F(OsmFile, OneWayStreetsAreKeptWhereTheyCanBe) {
  OsmReport report;
  const std::string one_way = tag("highway", "residential") + tag("oneway", "yes");
  plan_osm(write(block({}, one_way)), {}, report);
  EXPECT_FALSE(report.against_oneway);
  OsmReport other;
  plan_osm(write("<osm>" + node(1, 0, 0) + node(2, 130, 0) + node(3, 130, 80) + node(4, 0, 80) +
                 way(1, {1, 2, 3}, one_way) + way(2, {1, 4, 3}, one_way) + "</osm>"),
           {}, other);
  EXPECT_TRUE(other.against_oneway);
  EXPECT_THAT(what_is_missing(other), ElementsAre(HasSubstr("against one-way streets")));
}

TEST_F(OsmFile, NoBuildingsAreAllowedAndReported) {
  OsmReport report;
  plan_osm(write(block()), {}, report);
  EXPECT_EQ(report.buildings, 0);
}

TEST_F(OsmFile, DrivesAlongGivenNodes) {
  OsmReport report;
  OsmParams params;
  params.along = {1, 3};
  const StreetPlan plan = plan_osm(write(block()), params, report);
  EXPECT_EQ(plan.routes[0].name, "along");
  EXPECT_FALSE(plan.routes[0].closed);
  EXPECT_NEAR(length_m(plan.routes[0].points), 210.0, 10.0);
  params.along = {1, 77};
  EXPECT_THAT(refusal(block(), params), HasSubstr("node 77"));
}

TEST_F(OsmFile, CountsWhatItLeavesOut) {
  OsmReport report;
  const std::string crossed = node(10, 40, 14) + node(11, 60, 30) + node(12, 60, 14) + node(13, 40, 30) +
                              way(50, {10, 11, 12, 13, 10}, tag("building", "yes"));
  const std::string open = way(51, {10, 11, 12}, tag("building", "yes"));
  const std::string missing = way(52, {10, 99999, 12, 10}, tag("building", "yes"));
  const std::string above = house(3, 50, -6, {});
  const std::string strange = house(4, 40, 40, tag("height", "tall") + tag("building:levels", "nan"));
  const std::string flat = way(53, {10, 11, 10, 13, 10}, tag("building", "yes"));
  const std::string gone = way(54, {1, 99999}, tag("highway", "residential"));
  const StreetPlan plan = plan_osm(write(block(crossed + open + missing + flat + gone + above + strange)), {}, report);
  EXPECT_EQ(report.buildings_crossing.count, 1);
  EXPECT_EQ(report.buildings_not_closed.count, 1);
  EXPECT_EQ(report.buildings_without_area.count, 1);
  EXPECT_EQ(report.buildings_without_nodes.count, 1);
  EXPECT_EQ(report.streets_without_nodes.count, 1);
  EXPECT_EQ(report.buildings_in_streets, 1);
  EXPECT_THAT(
      what_is_missing(report),
      ElementsAre("5 buildings left out: self-crossing 1, without area 1, not closed 1, nodes missing 1, in the "
                  "middle of a street 1 (first: way 50, line 14)",
                  "1 street left out: nodes missing 1 (first: way 54, line 18)",
                  "2 heights or levels are no numbers: they are guessed"));
  EXPECT_EQ(report.tags_not_understood, 2);
  EXPECT_EQ(plan.footprints.size(), 1U);
}

TEST_F(OsmFile, OuterRingsOfMultipolygonsAreBuildings) {
  OsmReport report;
  const std::string ring =
      node(10, 40, 14) + node(11, 60, 14) + node(12, 60, 30) + node(13, 40, 30) + way(50, {10, 11, 12, 13, 10}, {}) +
      "<relation id=\"7\"><member type=\"way\" ref=\"50\" role=\"outer\"/>" + tag("type", "multipolygon") +
      tag("building", "yes") + tag("building:levels", "3") + "</relation>";
  const StreetPlan plan = plan_osm(write(block(ring)), {}, report);
  ASSERT_EQ(plan.footprints.size(), 1U);
  EXPECT_NEAR(plan.footprints[0].height_m, 10.8, 1e-9);
}

TEST_F(OsmFile, RefusesBadFilesWithFileWhatAndMend) {
  EXPECT_THAT(refusal(""), HasSubstr("is empty; export"));
  EXPECT_THAT(refusal("PK\x03\x04 no map at all"), HasSubstr("; export"));
  EXPECT_THAT(refusal("<osm>\n<node id=\"1\" lat=\"1\"\n"), HasSubstr("is cut off or damaged"));
  EXPECT_THAT(refusal("<gpx></gpx>"), HasSubstr("has no <osm> element"));
  EXPECT_THAT(refusal("<osm></osm>"), HasSubstr("has no streets"));
  EXPECT_THAT(refusal("<osm>" + house(1, 0, 0, {}) + "</osm>"), HasSubstr("has no streets"));
  EXPECT_THAT(refusal("<osm>" + node(1, 0, 0) + node(2, 90, 0) + way(1, {1, 2}, tag("highway", "footway")) + "</osm>"),
              HasSubstr("no streets a car can drive"));
  EXPECT_THAT(
      refusal("<osm>" + node(1, 0, 0) + node(2, 40, 0) + way(1, {1, 2}, tag("highway", "residential")) + "</osm>"),
      HasSubstr("no way of 50 m or more that a car can drive"));
  try {
    OsmReport report;
    plan_osm("/nowhere/at_all.osm", {}, report);
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), HasSubstr("/nowhere/at_all.osm: cannot be read"));
  }
}

TEST_F(OsmFile, RefusesCoordinatesWithTheirLine) {
  for (const char* bad : {"lat=\"nan\" lon=\"11\"", "lat=\"48\" lon=\"inf\"", "lat=\"1e30\" lon=\"11\"",
                          "lat=\"48.17abc\" lon=\"11\"", "lat=\"48\" lon=\"11 x\"", "lat=\"89.9\" lon=\"11\"",
                          "lat=\"48\" lon=\"200\"", "lat=\"x\" lon=\"11\"", "lat=\"48\""}) {
    const std::string message = refusal(block("<node id=\"9\" " + std::string(bad) + "/>\n"));
    EXPECT_THAT(message, HasSubstr(".osm:10: ")) << bad;
  }
  EXPECT_THAT(refusal(block("<way id=\"x\"/>")), HasSubstr(".osm:10: <way> has no number id"));
}

TEST_F(OsmFile, RefusesWhatIsThereTwice) {
  EXPECT_THAT(refusal(block(node(2, 5, 5))), HasSubstr(".osm:10: node 2 was on line 3 already; keep one of them"));
  EXPECT_THAT(refusal(block(way(3, {1, 3}, {}))), HasSubstr(".osm:10: way 3 was on line 8 already"));
}

TEST_F(OsmFile, WithoutALoopARouteIsOpen) {
  const std::string street = tag("highway", "residential");
  OsmReport report;
  const StreetPlan plan =
      plan_osm(write("<osm>" + node(1, 0, 0) + node(2, 90, 0) + node(3, 180, 20) + node(4, 90, 60) +
                     way(1, {1, 2}, street) + way(2, {2, 3}, street) + way(3, {2, 4}, street) + "</osm>"),
               {}, report);
  ASSERT_EQ(plan.routes.size(), 3U);
  EXPECT_EQ(plan.routes[0].name, "way");
  EXPECT_FALSE(plan.routes[0].closed);
  EXPECT_NEAR(length_m(plan.routes[0].points), 182.0, 5.0);
  for (const Route& route : plan.routes) expect_drivable(route, StreetNetwork(plan.streets), plan.footprints, 4.0);
  EXPECT_THAT(what_is_missing(report), ElementsAre(HasSubstr("its route is open")));
}

TEST_F(OsmFile, OfAWholeMapNothingIsMissing) {
  OsmReport report;
  plan_osm(write(block(house(1, 40, 14, {}))), {}, report);
  EXPECT_THAT(what_is_missing(report), IsEmpty());
}

TEST_F(OsmFile, RefusesMapsWiderThanTenKilometres) {
  const std::string far = node(20, 30'000, 0) + way(9, {2, 20}, tag("highway", "primary"));
  EXPECT_THAT(refusal(block(far)), HasSubstr("10 km is the most; cut out the district"));
  const std::string turned = "<bounds minlat=\"2\" minlon=\"1\" maxlat=\"1\" maxlon=\"2\"/>";
  EXPECT_THAT(refusal(block(turned)), HasSubstr("has <bounds> whose minimum lies above the maximum"));
  // A street that leads out of what the map says it covers is cut.
  const std::string bounds = "<bounds minlat=\"47.999\" minlon=\"10.999\" maxlat=\"48.001\" maxlon=\"11.002\"/>";
  EXPECT_EQ(refusal(block(far + bounds)), "(accepted)");
}

class RealPlace : public ::testing::TestWithParam<const char*> {};

TEST_P(RealPlace, IsDrivable) {
  const auto file = test::data_folder() / "osm" / GetParam();
  if (!std::filesystem::exists(file)) GTEST_SKIP() << file << " is not there; CONVOY_DATA_DIR says where data is";
  OsmReport report;
  const StreetPlan plan = plan_osm(file.string(), {}, report);
  ASSERT_EQ(plan.routes.size(), 3U);
  EXPECT_TRUE(plan.routes[0].closed);
  EXPECT_GE(length_m(plan.routes[0].points, true), 350.0);
  EXPECT_GT(report.buildings, 50);
  const StreetNetwork network(plan.streets);
  expect_drivable(plan.routes[0], network, plan.footprints);
  expect_drivable(plan.routes[2], network, plan.footprints);
  OsmParams coarse;
  coarse.detail.close_texel_m = 0.05;
  coarse.detail.close_m = 15.0;
  expect_sound(load_osm(file.string(), coarse).scene);
}

INSTANTIATE_TEST_SUITE_P(Osm, RealPlace,
                         ::testing::Values("lisbon_saldanha/map.osm", "helsinki_centre/buildings_highways.osm"),
                         [](const auto& place) {
                           return std::string(place.param).substr(0, std::string(place.param).find('_'));
                         });

}  // namespace
}  // namespace convoy::simulator
