#include "report/report.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <tinyxml2.h>
#include <convoy/config_error.hpp>

#include <set>

#include "fake_run.hpp"
#include "report/figures.hpp"
#include "scenario/street.hpp"

namespace convoy::cli {
namespace {

using testing::HasSubstr;
using testing::Not;

Scenario<SE2> street() {
  StreetParams params;
  params.distance_m = 150.0;
  return make_street<SE2>(params, 5);
}

/// Five vehicles without priors: the street's two and three more on its course.
Scenario<SE2> fleet_of_five() {
  Scenario<SE2> scenario = street();
  scenario.name = "mrclam";
  for (const VehicleId id : {3U, 4U, 5U}) {
    scenario.vehicles.push_back(scenario.vehicles[id % 2]);
    scenario.vehicles.back().id = id;
  }
  for (VehicleLog<SE2>& vehicle : scenario.vehicles) vehicle.prior.reset();
  return scenario;
}

struct Page {
  RunRecord<SE2> run;
  Evaluation<SE2> evaluation;
  std::string text;
};

Page page_of(const std::filesystem::path& folder) {
  Page page{read_run<SE2>(folder), {}, {}};
  page.evaluation = evaluate(page.run);
  write_report(page.run, page.evaluation);
  page.text = test::read(folder / "report.html");
  return page;
}

Page page_of(const Scenario<SE2>& scenario) {
  const test::TemporaryFolder folder;
  test::FakeRun<SE2>(scenario, folder.path()).write_all();
  return page_of(folder.path());
}

/// The caption of the paper's figure `number`.
std::string caption(const Page& page, int number) {
  for (const Figure& figure : make_figures(page.run, page.evaluation))
    if (figure.title.find("(paper, Fig. " + std::to_string(number) + ")") != std::string::npos) return figure.caption;
  ADD_FAILURE() << "no figure " << number;
  return {};
}

int count(const tinyxml2::XMLNode& node, const std::string& name) {
  int sum = node.ToElement() && node.Value() == name;
  for (const auto* child = node.FirstChild(); child; child = child->NextSibling()) sum += count(*child, name);
  return sum;
}

void expect_well_formed(const std::string& text) {
  tinyxml2::XMLDocument document;
  ASSERT_EQ(document.Parse(text.c_str()), tinyxml2::XML_SUCCESS) << document.ErrorStr();
}

class Reports : public testing::TestWithParam<bool> {};

TEST_P(Reports, ShowThePapersFiguresInOneWellFormedPage) {
  const Page page = page_of(GetParam() ? street() : fleet_of_five());
  tinyxml2::XMLDocument document;
  ASSERT_EQ(document.Parse(page.text.c_str()), tinyxml2::XML_SUCCESS) << document.ErrorStr();
  for (int figure = 9; figure <= 14; ++figure)
    EXPECT_THAT(page.text, HasSubstr("(paper, Fig. " + std::to_string(figure) + ")"));
  EXPECT_EQ(count(document, "figcaption"), 7);
  EXPECT_EQ(count(document, "table"), 3);
  EXPECT_EQ(count(document, "script"), 0);
  EXPECT_LT(page.text.size(), 3U << 20);
  for (const char* text : {"x [m]", "y [m]", "time [s]", "distance [m]", "[byte]", "ground truth", "95 %"})
    EXPECT_THAT(page.text, HasSubstr(text));
  EXPECT_THAT(page.text, Not(HasSubstr("nan")));
  // Self-contained: nothing is fetched.
  EXPECT_THAT(page.text, Not(HasSubstr("src=")));
  EXPECT_THAT(page.text, Not(HasSubstr("href=")));
  EXPECT_THAT(page.text, Not(HasSubstr("url(")));
}

INSTANTIATE_TEST_SUITE_P(StreetAndFleet, Reports, testing::Bool());

TEST(Report, HeadlineSaysWhatTheMetricsSay) {
  Page page = page_of(street());
  const std::string good = headline(page.run, page.evaluation.metrics);
  EXPECT_THAT(good, HasSubstr("Two vehicles that did not know where the others started share one map"));
  EXPECT_THAT(good, HasSubstr("none is false"));
  EXPECT_THAT(page.text, HasSubstr(good));
  nlohmann::json bad = page.evaluation.metrics;
  bad["all_aligned"] = bad["all_in_common_frame"] = false;
  bad["associations"]["between_vehicles_false"] = 2;
  bad["lost_vehicles"] = {2};
  EXPECT_THAT(headline(page.run, bad), HasSubstr("have not all found one common frame"));
  EXPECT_THAT(headline(page.run, bad), HasSubstr("2 are false"));
  EXPECT_THAT(headline(page.run, bad), HasSubstr("Lost on the way: back vehicle"));
}

TEST(Report, HeadlineSaysSharedOnlyWhenItIsSo) {
  const Page page = page_of(street());
  const auto of = [&](const auto& change) {
    nlohmann::json m = page.evaluation.metrics;
    change(m);
    const std::string text = headline(page.run, m);
    EXPECT_THAT(text, Not(HasSubstr("share one map:")));
    EXPECT_THAT(text, Not(HasSubstr("started share one map")));
    return text;
  };
  using Json = nlohmann::json;
  EXPECT_THAT(of([](Json& m) { m["all_aligned"] = m["map_digests_equal"] = false; }),
              HasSubstr("do not hold the same map"));
  EXPECT_THAT(of([](Json& m) { m["all_aligned"] = m["all_linked"] = false; }),
              HasSubstr("have not all found landmarks in common"));
  EXPECT_THAT(of([](Json& m) { m["vehicles"][1]["landmarks_exported"] = 0; }),
              HasSubstr("not all of them mapped anything (back vehicle)"));
  EXPECT_THAT(of([](Json& m) { m["all_aligned"] = m["map_digests_equal"] = nullptr; }),
              HasSubstr("left too little to judge their map by"));
}

TEST(Report, HeadlineNamesVehiclesThatAreSuspect) {
  const Page page = page_of(street());
  nlohmann::json m = page.evaluation.metrics;
  EXPECT_THAT(headline(page.run, m), Not(HasSubstr("SUSPECT")));
  m["vehicles"][1]["integrity"] = "SUSPECT";
  m["vehicles"][1]["reasons"] = {"impersonated", "innovation"};
  EXPECT_THAT(headline(page.run, m), HasSubstr("Back vehicle is SUSPECT: impersonated, innovation."));
}

TEST(Report, HeadlineSaysWhatTheDistancesRestOn) {
  const Page page = page_of(street());
  nlohmann::json m = page.evaluation.metrics;
  nlohmann::json& pair = m["pairs"][0];
  EXPECT_THAT(headline(page.run, m), HasSubstr("; " + pair["distance_samples_settled"].dump() + " samples)"));
  pair["distance_samples_settled"] = 9;
  EXPECT_THAT(headline(page.run, m), HasSubstr("live distances are not judged"));
  EXPECT_THAT(headline(page.run, m), HasSubstr("there are at most 9 samples of a pair, and it takes 10"));
  EXPECT_THAT(headline(page.run, m), HasSubstr("; landmarks are "));
  EXPECT_THAT(headline(page.run, m), Not(HasSubstr("is known to")));
  pair["first_association_s"] = nullptr;
  EXPECT_THAT(headline(page.run, m), HasSubstr("no two vehicles were associated"));
  pair["distance_samples_raw"] = 0;
  EXPECT_THAT(headline(page.run, m), HasSubstr("no live distance between vehicles could be compared with a truth"));
}

TEST(Report, TooFewDistancesAreNamedInTileTableAndCaption) {
  const test::TemporaryFolder folder;
  test::FakeRun<SE2>(street(), folder.path()).write_all();
  Page page = page_of(folder.path());
  const std::string samples = page.evaluation.metrics["pairs"][0]["distance_samples_settled"].dump();
  EXPECT_THAT(page.text, HasSubstr("(" + samples + ")</td>"));
  EXPECT_THAT(page.text, Not(HasSubstr("too few")));
  const double last_s = *page.evaluation.pairs[0].first_association_s + 12.0;
  for (VehicleRecord<SE2>& vehicle : page.run.vehicles)
    std::erase_if(vehicle.live, [&](const PoseRow<SE2>& row) { return row.t_s > last_s; });
  page.evaluation = evaluate(page.run);
  EXPECT_THAT(make_report(page.run, page.evaluation), HasSubstr("distance RMSE: too few samples"));
  EXPECT_THAT(
      caption(page, 14),
      HasSubstr("Of 1 pair there are fewer than 10 samples from ten seconds after the first association on, too few"));
}

TEST(Report, HeadlineCountsPairingsWithinAVehicleApart) {
  const Page page = page_of(street());
  nlohmann::json m = page.evaluation.metrics;
  m["associations"]["between_vehicles"] = 12;
  m["associations"]["within_a_vehicle"] = 30;
  m["associations"]["within_a_vehicle_false"] = 1;
  EXPECT_THAT(headline(page.run, m),
              HasSubstr("Of 12 landmark pairings between vehicles none is false, of 30 within a vehicle 1 is false"));
}

TEST(Report, ACoarseTruthIsNamedAndJudgesHypothesesAlone) {
  Scenario<SE2> scenario = street();
  scenario.pose_tolerance = PoseTolerance{6.0, 0.25};
  const Page page = page_of(scenario);
  EXPECT_THAT(headline(page.run, page.evaluation.metrics),
              HasSubstr("accepted hypotheses none is false by the measured"));
  EXPECT_THAT(page.text, HasSubstr("hypotheses accepted / false by the poses"));
  EXPECT_THAT(page.text, HasSubstr("may contradict each other by 6.0 m and 0.25 rad"));
  for (const int number : {10, 11})
    EXPECT_THAT(caption(page, number), HasSubstr("too coarse to judge the ellipses by"));
}

TEST(Report, DriftCaptionsCountWhichEllipsesHoldTheTruth) {
  for (const bool on_the_street : {true, false}) {
    Page page = page_of(on_the_street ? street() : fleet_of_five());
    for (const int number : {10, 11}) {
      EXPECT_THAT(caption(page, number), HasSubstr("true positions lie within the ellipse of the drift model"));
      EXPECT_THAT(caption(page, number), Not(HasSubstr("segments, none of ")));
    }
    for (VehicleRecord<SE2>& vehicle : page.run.vehicles) {
      vehicle.prior.reset();
      for (MapAnchor<SE2>& anchor : vehicle.map->anchors) anchor.drift *= 1e-9;  // surer than any SLAM may be
    }
    for (const int number : {10, 11}) EXPECT_THAT(caption(page, number), HasSubstr("segments, none of "));
  }
}

TEST(Report, TheMapCaptionCountsThePairings) {
  Page page = page_of(street());
  std::size_t pairings = 0;
  for (const MapAssociation& association : page.run.vehicles[0].map->associations)
    pairings += association.pairings.size();
  ASSERT_GT(pairings, 10U);
  EXPECT_THAT(caption(page, 12), HasSubstr(" in " + std::to_string(pairings) + " pairings found"));
  for (MapAssociation& association : page.run.vehicles[0].map->associations) association.accepted = false;
  EXPECT_THAT(caption(page, 12), HasSubstr("No landmark has been found common yet."));
}

TEST(Report, TheTrafficCaptionTellsTheStartFromTheRest) {
  Page page = page_of(street());
  for (auto& [id, seconds] : page.evaluation.bytes_per_s) {
    for (TimedValue& second : seconds) second.value = 400.0;
    seconds.front().value = 31000.0;
    seconds.back().value = 1234.0;
  }
  EXPECT_THAT(caption(page, 13), HasSubstr("first second holds up to 31.0 KB"));
  EXPECT_THAT(caption(page, 13), HasSubstr("one second of this replay lasted 0.050 s"));
  EXPECT_THAT(caption(page, 13), HasSubstr("Later it is at most 1.2 KB"));
  page.run.info["rate"] = 1.0;
  EXPECT_THAT(caption(page, 13), Not(HasSubstr("replay")));
}

TEST(Report, TheDistanceCaptionNamesTheReasonsOfGaps) {
  const test::TemporaryFolder folder;
  test::FakeRun<SE2>(street(), folder.path()).write_all();
  Page page = page_of(folder.path());
  EXPECT_THAT(caption(page, 14), Not(HasSubstr("has a gap")));
  EXPECT_THAT(caption(page, 14), HasSubstr("From ten seconds after the first association on, blue is off by 0."));
  EXPECT_THAT(caption(page, 14),
              HasSubstr(" m RMSE (" + page.evaluation.metrics["pairs"][0]["distance_samples_settled"].dump() +
                        " samples of a pair)"));
  std::erase_if(page.run.vehicles[1].truth,
                [](const TruthPose<SE2>& pose) { return pose.t_s > 50.0 && pose.t_s < 60.0; });
  for (PoseRow<SE2>& row : page.run.vehicles[0].live)
    if (row.vehicle == 2 && row.t_s > 61.5 && row.t_s < 64.5) row.common.reset();
  page.evaluation = evaluate(page.run);
  EXPECT_THAT(caption(page, 14), HasSubstr("the truth has a gap at 9 poses"));
  EXPECT_THAT(caption(page, 14),
              HasSubstr("Blue has a gap where the vehicle did not hold both poses in the common frame: 3 of the "));
}

TEST(Report, BothGaugesAreShownAndAFittedOneIsExplained) {
  Page page = page_of(fleet_of_five());
  for (const char* text :
       {"live ANEES, gauge fit / start", "live within 95 %, gauge fit / start", "judged in gauge fit",
        "Judged in gauge fit", "corrected, whole run [m]", "Live is what the vehicles knew at that moment"})
    EXPECT_THAT(page.text, HasSubstr(text));
  nlohmann::json m = page.evaluation.metrics;
  m["gauge_shift_m"] = 0.16;
  m["gauge_turn_rad"] = 0.021;
  m["vehicles"][0]["pose_anees_fit"] = 6171.724;
  m["vehicles"][0]["pose_coverage95_fit"] = 0.957;
  m["vehicles"][0]["pose_anees_start"] = 0.998;
  m["vehicles"][0]["pose_coverage95_start"] = 0.976;
  EXPECT_THAT(gauge_note(page.run, m), HasSubstr("the two lie 0.160 m and 1.2 degrees apart. The start of robot 1 is"));
  EXPECT_THAT(
      gauge_note(page.run, m),
      HasSubstr("its ANEES is 6171.72 (95.7 % within the bound) in gauge fit and 1.00 (97.6 % within the bound)"));
  EXPECT_THAT(page_of(street()).text, HasSubstr("judged in gauge start"));
  EXPECT_THAT(page_of(street()).text, Not(HasSubstr("Judged in gauge fit")));
  m["vehicles"][0]["pose_anees_start"] = nullptr;
  EXPECT_EQ(gauge_note(page.run, m), "");
}

TEST(Report, WithoutTruthIsStillAPage) {
  const test::TemporaryFolder folder;
  test::FakeRun<SE2>(fleet_of_five(), folder.path()).write_all();
  for (const VehicleId id : {1U, 2U, 3U, 4U, 5U}) std::filesystem::remove(truth_file(folder.path(), id));
  const Page page = page_of(folder.path());
  expect_well_formed(page.text);
  EXPECT_THAT(page.text, HasSubstr("There is no pose truth to judge the live poses by."));
  EXPECT_THAT(page.text, HasSubstr("m RMSE from the truth"));
}

TEST(Report, OfARunThatLeftNothingIsStillAPage) {
  const test::TemporaryFolder folder;
  test::write(folder / "run.json",
              R"({"scenario":"street","common_frame_vehicle":1,"vehicles":[1,2],"source":"a & b <c>"})");
  const Page page = page_of(folder.path());
  expect_well_formed(page.text);
  EXPECT_THAT(page.text, HasSubstr("a &amp; b &lt;c&gt;"));
  EXPECT_THAT(page.text, HasSubstr("No vehicle left a map."));
}

}  // namespace
}  // namespace convoy::cli
