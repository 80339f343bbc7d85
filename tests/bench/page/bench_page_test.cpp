// The page of scripts/bench, from runs that are made up.
#include <convoy/config_error.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <tinyxml2.h>

#include <set>

#include "page/page.hpp"
#include "scenario/table_file.hpp"

namespace convoy::bench {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

std::string run(const std::string& entries) { return "{\"context\": {}, \"benchmarks\": [" + entries + "]}"; }

std::string entry(const std::string& name, double cpu_ms, const std::string& more = {}) {
  return "{\"name\": \"" + name + "\", \"run_name\": \"" + name +
         "\", \"run_type\": \"iteration\", \"iterations\": 1, \"cpu_time\": " + std::to_string(cpu_ms) +
         ", \"time_unit\": \"ms\"" + more + "}";
}

Results of(const std::string& text) { return {{"made", parse_results(text, "made.json")}}; }

Demand at_most(double figure, const std::string& benchmark = "BM_made", const std::string& value = "cpu_ms") {
  return {"Section", "what", {Asked::Kind::at_most, figure}, "ms", {"made", benchmark, value}, {}};
}

Row judged(const Demand& demand, const Results& results) { return judge({demand}, results).rows.at(0); }

const Machine idle_machine{"Made-up CPU", 2, 0.1, 1.0};

TEST(BenchPage, TheMedianOfTheRepetitionsIsJudged) {
  const auto results = of(run(entry("BM_made", 9) + "," + entry("BM_made", 2) + "," + entry("BM_made", 3)));
  const Row row = judged(at_most(3), results);
  EXPECT_EQ(row.verdict, Verdict::met);
  EXPECT_DOUBLE_EQ(row.figure.median, 3.0);
  EXPECT_DOUBLE_EQ(row.figure.low, 2.0);
  EXPECT_DOUBLE_EQ(row.figure.high, 9.0);
  EXPECT_EQ(judged(at_most(2.9), results).verdict, Verdict::miss);
}

TEST(BenchPage, ATimeAboveWhatIsAskedByNoMoreThanItsToleranceIsToldApart) {
  Demand demand = at_most(10);
  demand.asked.tolerance = tolerance_of_times;
  const auto verdict = [&](double ms) { return judged(demand, of(run(entry("BM_made", ms)))).verdict; };
  EXPECT_EQ(verdict(10.0), Verdict::met);
  EXPECT_EQ(verdict(10.1), Verdict::met_within_tolerance);
  EXPECT_EQ(verdict(12.9), Verdict::met_within_tolerance);
  EXPECT_EQ(verdict(13.1), Verdict::miss);
  EXPECT_THAT(headline(judge({demand}, of(run(entry("BM_made", 11))))),
              HasSubstr("1 of 1 demands met (1 of them within the 30 %), 0 missed"));
}

TEST(BenchPage, AggregatesOfTheLibraryAreNotCountedTwice) {
  const std::string aggregate =
      R"({"name": "BM_made_median", "run_name": "BM_made", "run_type": "aggregate", "cpu_time": 100, "time_unit": "ms"})";
  EXPECT_EQ(judged(at_most(3), of(run(entry("BM_made", 2) + "," + aggregate))).figure.repetitions, 1U);
}

TEST(BenchPage, ACountIsFoundWhateverTheIterations) {
  const auto results = of(run(entry("BM_made/7/iterations:1", 9, ", \"p50_ms\": 4")));
  EXPECT_EQ(judged(at_most(5, "BM_made/7", "p50_ms"), results).verdict, Verdict::met);
}

TEST(BenchPage, WhatIsThereInSecondsIsThereInMilliseconds) {
  const auto results = of(run(entry("BM_made", 9, ", \"baseline_s\": 0.25")));
  EXPECT_DOUBLE_EQ(judged(at_most(1, "BM_made", "baseline_ms"), results).figure.median, 250.0);
  EXPECT_DOUBLE_EQ(judged(at_most(1, "BM_made", "cpu_s"), results).figure.median, 0.009);
}

TEST(BenchPage, CostsAreEqualToOneInAMillion) {
  Demand demand = at_most(0, "BM_made", "final_cost");
  demand.asked = {Asked::Kind::equal, 100.0, 1e-6};
  const auto cost = [&](const char* value) {
    return judged(demand, of(run(entry("BM_made", 1, std::string(", \"final_cost\": ") + value)))).verdict;
  };
  EXPECT_EQ(cost("100.00009"), Verdict::met);
  EXPECT_EQ(cost("99.99991"), Verdict::met);
  EXPECT_EQ(cost("100.00011"), Verdict::miss);
  EXPECT_EQ(cost("99.9"), Verdict::miss);
}

TEST(BenchPage, WhatWasNotMeasuredIsNotMet) {
  const auto why = [](const Demand& demand, const Results& results) {
    const Row row = judged(demand, results);
    EXPECT_EQ(row.verdict, Verdict::not_measured);
    return row.figure.why_not;
  };
  const Demand demand = at_most(1000);
  EXPECT_EQ(why(demand, {}), "convoy_bench_made was not run");
  EXPECT_EQ(why(demand, of(R"({"failed": "ended with exit status 139"})")), "ended with exit status 139");
  EXPECT_EQ(why(demand, of(run(""))), "BM_made is not among the results");
  EXPECT_EQ(why(demand, of(run(entry("BM_made", 0, ", \"label\": \"skipped: no data\"")))), "no data");
  EXPECT_EQ(why(demand, of(run(entry("BM_made", 0, ", \"error_occurred\": true, \"error_message\": \"diverged\"")))),
            "diverged");
  EXPECT_EQ(why(at_most(9, "BM_made", "p50_ms"), of(run(entry("BM_made", 1)))), "BM_made has no value p50_ms");
}

TEST(BenchPage, WhatIsNoNumberIsNoValue) {
  const auto results = of(run(entry("BM_made", 2, ", \"none\": NaN, \"endless\": -Infinity")));
  EXPECT_EQ(judged(at_most(3), results).verdict, Verdict::met);
  EXPECT_EQ(judged(at_most(3, "BM_made", "none"), results).verdict, Verdict::not_measured);
  EXPECT_EQ(judged(at_most(3, "BM_made", "endless"), results).verdict, Verdict::not_measured);
}

TEST(BenchPage, OneBadRepetitionSpoilsItsBenchmark) {
  const std::string bad = entry("BM_made", 0, ", \"error_occurred\": true, \"error_message\": \"diverged\"");
  EXPECT_EQ(judged(at_most(9), of(run(entry("BM_made", 1) + "," + bad))).verdict, Verdict::not_measured);
  EXPECT_EQ(judged(at_most(9), of(run(bad + "," + entry("BM_made", 1)))).verdict, Verdict::not_measured);
}

TEST(BenchPage, ABaselineHasARatioOrAReason) {
  Demand demand = at_most(9);
  demand.baselines = {{"other", {"made", "BM_made", "baseline_ms"}}, {"CHOLMOD", {"cholmod", "BM_cholmod", "cpu_ms"}}};
  const Row row = judged(demand, of(run(entry("BM_made", 2, ", \"baseline_s\": 0.008"))));
  EXPECT_DOUBLE_EQ(row.baselines.at(0).ratio.value(), 0.25);
  EXPECT_FALSE(row.baselines.at(1).ratio);
  EXPECT_THAT(row.baselines.at(1).figure.why_not, HasSubstr("not installed"));
  EXPECT_EQ(row.verdict, Verdict::met);
}

std::string refusal(const std::string& text) {
  try {
    parse_results(text, "made.json");
  } catch (const ConfigError& error) {
    return error.what();
  }
  return "accepted";
}

TEST(BenchPage, MalformedResultsAreRefusedInPlainWords) {
  EXPECT_THAT(refusal("{\"benchmarks\": [\n"),
              AllOf(HasSubstr("made.json: "), HasSubstr("no JSON"), HasSubstr("scripts/bench")));
  EXPECT_THAT(refusal(""), HasSubstr("no JSON"));
  EXPECT_THAT(refusal("{}"), HasSubstr("the entry 'benchmarks' is missing"));
  EXPECT_THAT(refusal("[]"), AllOf(HasSubstr("made.json: "), HasSubstr("array")));
  EXPECT_THAT(refusal(run(R"({"run_type": "iteration"})")), HasSubstr("the entry 'run_name' is missing"));
  EXPECT_THAT(refusal(run(R"({"run_type": "iteration", "run_name": "x", "cpu_time": "1", "time_unit": "ms"})")),
              HasSubstr("kind string"));
  EXPECT_THAT(refusal(run(R"({"run_type": "iteration", "run_name": "x", "cpu_time": 1, "time_unit": "h"})")),
              HasSubstr("time_unit 'h'"));
}

TEST(BenchPage, AFolderWithoutResultsIsRefused) {
  const std::filesystem::path folder = std::filesystem::path(::testing::TempDir()) / "convoy_bench_page_test";
  std::filesystem::remove_all(folder);
  EXPECT_THROW(read_all_results(folder), ConfigError);
  std::filesystem::create_directories(folder);
  EXPECT_THROW(read_all_results(folder), ConfigError);
  cli::write_text_file(folder / "made.json", run(entry("BM_made", 2)));
  EXPECT_TRUE(read_all_results(folder).at("made").by_name.contains("BM_made"));
  std::filesystem::remove_all(folder);
}

Judgement one_of_each() {
  return judge({at_most(3), at_most(1), at_most(5, "BM_absent")}, of(run(entry("BM_made", 2))));
}

TEST(BenchPage, ThePageNamesEveryMissAndIsWellFormed) {
  const std::string page = bench_page(one_of_each(), idle_machine);
  tinyxml2::XMLDocument document;
  EXPECT_EQ(document.Parse(page.c_str()), tinyxml2::XML_SUCCESS) << document.ErrorStr();
  EXPECT_THAT(
      page,
      AllOf(HasSubstr("1 of 3 demands met, 1 missed, 1 not measured"), HasSubstr("MISS</span>: Section: what: 2.00 ms"),
            HasSubstr("BM_absent is not among the results"), HasSubstr("Made-up CPU, 2 cores"), HasSubstr("30 %")));
}

TEST(BenchPage, AMachineThatIsNotIdleIsAWarning) {
  EXPECT_THAT(bench_page(one_of_each(), idle_machine), Not(HasSubstr("Warning")));
  EXPECT_THAT(bench_page(one_of_each(), {"CPU", 2, 0.51, 1.0}), HasSubstr("Warning"));
  EXPECT_THAT(bench_page(one_of_each(), {"CPU", 2, 0.1, 2.0}), HasSubstr("Warning"));
}

TEST(BenchPage, TheNameOfTheProcessorIsRead) {
  EXPECT_EQ(this_machine("processor\t: 0\nmodel name\t: A CPU\nstepping\t: 1\n", 0, 0).cpu, "A CPU");
  EXPECT_EQ(this_machine("nothing of the kind: at all", 0, 0).cpu, "unknown CPU");
}

TEST(BenchPage, TheJsonSaysTheSame) {
  const auto json = bench_json(one_of_each(), idle_machine);
  EXPECT_EQ(json.at("met"), 1);
  EXPECT_EQ(json.at("missed"), 1);
  EXPECT_EQ(json.at("not_measured"), 1);
  EXPECT_EQ(json.at("rows").at(0).at("measured").at("median"), 2.0);
  EXPECT_EQ(json.at("rows").at(1).at("verdict"), "MISS");
  EXPECT_EQ(json.at("rows").at(2).at("measured").at("not_measured"), "BM_absent is not among the results");
}

TEST(Demands, TimesHaveAToleranceAndSizesHaveNone) {
  for (const Demand& demand : demands()) {
    if (demand.asked.kind != Asked::Kind::at_most) continue;
    const bool size = demand.unit == "MB" || demand.unit == "bytes" || demand.unit == "m" || demand.unit.empty();
    EXPECT_EQ(demand.asked.tolerance, size ? 0.0 : tolerance_of_times) << demand.section << ": " << demand.what;
  }
}

TEST(Demands, AreNamedOnceAndMetByNobodyWithoutAMeasurement) {
  std::set<std::string> names;
  for (const Demand& demand : demands())
    EXPECT_TRUE(names.insert(demand.section + ": " + demand.what).second) << demand.what;
  const Judgement judgement = judge(demands(), {});
  EXPECT_EQ(judgement.count(Verdict::met), 0U);
  EXPECT_EQ(judgement.count(Verdict::miss), 0U);
}

}  // namespace
}  // namespace convoy::bench
