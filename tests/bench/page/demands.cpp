#include "page/demands.hpp"

namespace convoy::bench {
namespace {

Asked time_at_most(double figure) { return {Asked::Kind::at_most, figure, tolerance_of_times}; }
Asked size_at_most(double figure) { return {Asked::Kind::at_most, figure}; }
Asked equal(double figure) { return {Asked::Kind::equal, figure, 1e-6}; }
constexpr Asked nothing{};

// The benches, by what they measure. Links: 20000 or 68000.
Source factor(int dof, int links, const char* value) {
  return {"solver", "BM_fleet_factor<" + std::to_string(dof) + ">/" + std::to_string(links), value};
}
Source cholmod(int dof, int links, const char* value) {
  return {"cholmod", "BM_cholmod_factor<" + std::to_string(dof) + ">/" + std::to_string(links), value};
}
Source order(int links, const char* value) { return {"solver", "BM_fleet_order/" + std::to_string(links), value}; }
Source cold_fleet(int links, const char* value) {
  return {"solver", "BM_fleet_cold_solve/" + std::to_string(links), value};
}
Source grown(const char* how, const char* group, const char* fleet, const char* value) {
  return {"map", std::string("BM_") + how + "<" + group + ">/" + fleet, value};
}
Source million(const char* group, const char* value) {
  return {"store", "BM_hold_a_million<" + std::string(group) + ">", value};
}

enum Graph { M3500, kitti_05, kitti_06, kitti_07, kitti_09 };  // of public_graphs.hpp
Source graph(const char* what, Graph number, const char* value) {
  return {"solver", std::string("BM_public_") + what + "/" + std::to_string(number), value};
}
Source ceres(Graph number, const char* value) {
  return {"ceres", "BM_ceres_cold_solve/" + std::to_string(number), value};
}

Baseline eigen(Source source) { return {"Eigen SimplicialLDLT, scalar AMD", std::move(source)}; }
Baseline supernodal(Source source) { return {"CHOLMOD supernodal, same order of blocks", std::move(source)}; }
Baseline of_ceres(Graph number, const char* value) { return {"Ceres", ceres(number, value)}; }

// Rows of one kind.
Demand factor_time(const char* what, int dof, int links, double limit_s) {
  return {"Fleet on a street grid, 100 vehicles with 1000 nodes each: numeric factorisation",
          what,
          time_at_most(limit_s),
          "s",
          factor(dof, links, "cpu_s"),
          {eigen(factor(dof, links, "baseline_s")), supernodal(cholmod(dof, links, "cpu_s"))}};
}
Demand factor_memory(const char* what, int dof, int links, double limit_MB) {
  return {"Fleet on a street grid: memory held by the factorisation",
          what,
          size_at_most(limit_MB),
          "MB",
          factor(dof, links, "held_MB"),
          {eigen(factor(dof, links, "baseline_MB")), supernodal(cholmod(dof, links, "held_MB"))}};
}
Demand order_time(const char* what, int links, double limit_s) {
  return {
      "Fleet on a street grid, SE(2): ordering on blocks",   what, time_at_most(limit_s), "s", order(links, "cpu_s"),
      {{"Eigen AMD on scalars", order(links, "baseline_s")}}};
}
Demand fleet_time(const char* what, int links, double limit_s) {
  return {"Fleet on a street grid, SE(2): cold solution to convergence",
          what,
          time_at_most(limit_s),
          "s",
          cold_fleet(links, "cpu_s"),
          {{"as many iterations with Eigen SimplicialLDLT", cold_fleet(links, "baseline_s")}}};
}
Demand update_time(const char* what, const char* group, const char* fleet, const char* value, Asked asked) {
  return {"One new batch with one hypothesis, from facts to map (the hypothesis comes in, its landmarks are held)",
          what,
          asked,
          "ms",
          grown("update", group, fleet, value),
          {{"the map made anew (median)", grown("rebuild", group, fleet, "p50_ms")}}};
}
Demand iteration_time(const char* what, Graph number, double limit_ms) {
  return {"Public pose graphs: a full iteration",
          what,
          time_at_most(limit_ms),
          "ms",
          graph("iteration", number, "cpu_ms"),
          {eigen(graph("iteration", number, "baseline_ms")), of_ceres(number, "ms_per_iteration")}};
}
Demand cold_cost(const char* what, Graph number, double cost) {
  return {"Public pose graphs: final cost of the cold solution (half chi-square, residual of g2o)",
          what,
          equal(cost),
          "",
          graph("cold_solve", number, "final_cost"),
          {of_ceres(number, "final_cost")}};
}
constexpr const char* growing = "M3500, poses in order";
Demand growing_time(const char* what, Asked asked, const char* value) {
  return {growing,
          what,
          asked,
          "ms",
          graph("incremental", M3500, value),
          {{"a full iteration of all poses", graph("iteration", M3500, "cpu_ms")}}};
}
constexpr const char* keeping = "A landmark that nobody has associated, of a million";
Demand keeping_time(const char* what, const char* group) {
  return {keeping, what, time_at_most(2), "x", million(group, "ratio_to_baseline"), {}};
}
Demand keeping_memory(const char* what, const char* group) {
  return {keeping,
          what,
          size_at_most(400),
          "bytes",
          million(group, "bytes_each"),
          {{"std::unordered_map, no check, no index", million(group, "baseline_bytes")}}};
}
// Recorded association problems. Methods by their numbers: 0 alignment, 1 gcbb; signatures: 0 unused, 1 used.
constexpr const char* recorded = "Association: 40 recorded problems, 29 of them with something in common";
Source associated(int method, int signatures, const char* value) {
  return {"association", "BM_recorded/" + std::to_string(method) + "/" + std::to_string(signatures), value};
}
Baseline reference(const char* name, int number, const char* value) {
  return {name, {"association", "BM_references/" + std::to_string(number), value}};
}
Demand association_count(const char* what, Asked asked, int signatures, const char* value) {
  return {recorded,
          what,
          asked,
          "",
          associated(0, signatures, value),
          {{"gcbb", associated(1, signatures, value)},
           reference("JCBB, 10 k nodes", 0, value),
           reference("closest neighbours", 1, value),
           reference("Delaunay triangles", 2, value)}};
}
Demand association_time(const char* what, Asked asked, int signatures, const char* value) {
  return {recorded, what, asked, "ms", associated(0, signatures, value), {{"gcbb", associated(1, signatures, value)}}};
}

// Problems on made-up streets.
constexpr const char* joined = "Association: 38 problems on made-up streets, 29 with something in common";
Source of_joined(const char* batches, int signatures, const char* value) {
  return {"association", std::string("BM_joined/") + batches + "/" + std::to_string(signatures), value};
}
Demand joined_row(const char* what, Asked asked, const char* unit, const char* batches, int signatures,
                  const char* value) {
  return {joined,
          what,
          asked,
          unit,
          of_joined(batches, signatures, value),
          {{"one batch", of_joined("1", signatures, value)}}};
}

// The association in the chain.
constexpr const char* in_chain = "Association in the chain: a recorded drive at 10 Hz, steps that search";
Source chain(const char* recording, const char* value) {
  return {"chain", std::string("BM_chain_") + recording, value};
}
Demand chain_step(const char* what, Asked asked, const char* recording, const char* value, const char* of_gcbb) {
  return {in_chain, what, asked, "ms", chain(recording, value), {{"gcbb", chain(recording, of_gcbb)}}};
}
Demand chain_total(const char* what, const char* recording) {
  return {in_chain, what, nothing, "s", chain(recording, "total_s"), {{"gcbb", chain(recording, "gcbb_total_s")}}};
}

Demand cold_time(const char* what, Graph number) {
  return {"Public pose graphs: the cold solution",
          what,
          nothing,
          "ms",
          graph("cold_solve", number, "cpu_ms"),
          {of_ceres(number, "cpu_ms")}};
}

Demand vision_time(const char* what, const char* benchmark, double limit_s, const char* baseline) {
  return {"Images of 640 x 480",          what,
          time_at_most(limit_s),          "s",
          {"vision", benchmark, "cpu_s"}, {{baseline, {"vision", benchmark, "baseline_s"}}}};
}

}  // namespace

const std::vector<Demand>& demands() {
  static const std::vector<Demand> table = {
      factor_time("SE(2), 20 k links", 3, 20000, 0.30),
      factor_time("SE(2), 68 k links", 3, 68000, 0.35),
      factor_time("SE(3), 20 k links", 6, 20000, 0.90),
      factor_time("SE(3), 68 k links", 6, 68000, 1.30),
      factor_memory("SE(2), 20 k links", 3, 20000, 300),
      factor_memory("SE(2), 68 k links", 3, 68000, 300),
      factor_memory("SE(3), 20 k links", 6, 20000, 300),
      factor_memory("SE(3), 68 k links", 6, 68000, 300),
      order_time("20 k links", 20000, 0.06),
      order_time("68 k links", 68000, 0.06),
      fleet_time("20 k links", 20000, 2),
      fleet_time("68 k links", 68000, 2),
      update_time("SE(2), 10 vehicles with 1000 anchors, median", "SE2", "10/1000", "p50_ms", time_at_most(20)),
      update_time("SE(2), 10 vehicles with 1000 anchors, 99 %", "SE2", "10/1000", "p99_ms", time_at_most(200)),
      update_time("SE(2), 100 vehicles with 1000 anchors, median", "SE2", "100/1000", "p50_ms", time_at_most(100)),
      update_time("SE(2), 100 vehicles with 1000 anchors, 99 %", "SE2", "100/1000", "p99_ms", time_at_most(1000)),
      update_time("SE(3), 10 vehicles with 1000 anchors, median", "SE3", "10/1000", "p50_ms", nothing),
      update_time("SE(3), 10 vehicles with 1000 anchors, 99 %", "SE3", "10/1000", "p99_ms", nothing),
      update_time("SE(3), 100 vehicles with 1000 anchors, median", "SE3", "100/1000", "p50_ms", nothing),
      update_time("SE(3), 100 vehicles with 1000 anchors, 99 %", "SE3", "100/1000", "p99_ms", nothing),
      iteration_time("M3500", M3500, 5),
      iteration_time("KITTI 05", kitti_05, 1.5),
      {"M3500: all pose marginals",
       "with factorisation",
       time_at_most(40),
       "ms",
       graph("marginals", M3500, "cpu_ms"),
       {{"Eigen SimplicialLDLT, solved for every column", graph("marginals", M3500, "baseline_ms")}}},
      growing_time("an update, median", time_at_most(0.1), "p50_ms"),
      growing_time("an update, 99 %", time_at_most(5), "p99_ms"),
      growing_time("an update, the longest", time_at_most(10), "max_ms"),
      growing_time("an update that factors anything, median", nothing, "p50_working_ms"),
      growing_time("the last full solution", nothing, "finish_ms"),
      {growing,
       "final cost, after the last full solution",
       equal(68.95647547),
       "",
       graph("incremental", M3500, "final_cost"),
       {of_ceres(M3500, "final_cost")}},
      cold_cost("M3500", M3500, 68.95647547),
      cold_cost("KITTI 05", kitti_05, 78.55218254),
      cold_cost("KITTI 06", kitti_06, 12.97354256),
      cold_cost("KITTI 07", kitti_07, 6.33051813),
      cold_cost("KITTI 09", kitti_09, 17.19141398),
      association_count("not right, by geometry", size_at_most(7), 0, "not_right"),
      association_count("not right, with signatures", size_at_most(3), 1, "not_right"),
      association_count("accepted where nothing is in common, by geometry", size_at_most(0), 0, "false_accepts"),
      association_count("accepted where nothing is in common, with signatures", size_at_most(0), 1, "false_accepts"),
      association_count("accepted and wrong, with signatures", size_at_most(0), 1, "accepted_wrong"),
      {recorded,
       "distance from the truth, median, by geometry",
       size_at_most(0.06),
       "m",
       associated(0, 0, "median_m"),
       {}},
      association_time("by geometry, 90 %", nothing, 0, "p90_ms"),
      association_time("with signatures, 90 %", nothing, 1, "p90_ms"),
      {"Association: Fig. 5 as written, 50 new landmarks",
       "gcbb, time to that of Fig. 5",
       time_at_most(0.03),
       "x",
       {"association", "BM_recorded_gcbb", "ratio_to_baseline"},
       {}},
      {"Association: Fig. 5 as written, 50 new landmarks",
       "gcbb, problems with fewer pairings than Fig. 5",
       size_at_most(0),
       "",
       {"association", "BM_recorded_gcbb", "fewer_pairings"},
       {}},
      {"Association: a large map",
       "50 new landmarks on 100 000, start within 22 m",
       time_at_most(50),
       "ms",
       {"association", "BM_large_map/100000", "cpu_ms"},
       {}},
      joined_row("two batches in a row, not right", size_at_most(2), "", "2", 1, "not_right"),
      joined_row("three batches in a row, not right", size_at_most(2), "", "3", 1, "not_right"),
      joined_row("two batches, accepted where nothing is in common", size_at_most(0), "", "2", 1, "false_accepts"),
      joined_row("three batches, accepted where nothing is in common", size_at_most(0), "", "3", 1, "false_accepts"),
      joined_row("two batches, by geometry alone, not right", nothing, "", "2", 0, "not_right"),
      joined_row("three batches, by geometry alone, not right", nothing, "", "3", 0, "not_right"),
      joined_row("two batches, 90 %", nothing, "ms", "2", 1, "p90_ms"),
      joined_row("three batches, 90 %", nothing, "ms", "3", 1, "p90_ms"),
      chain_step("MR.CLAM set 6, 99 %", time_at_most(50), "mrclam", "step_p99_ms", "gcbb_step_p99_ms"),
      chain_step("Victoria Park, 99 %", time_at_most(50), "victoria_park", "step_p99_ms", "gcbb_step_p99_ms"),
      chain_total("MR.CLAM set 6, all steps together", "mrclam"),
      chain_total("Victoria Park, all steps together", "victoria_park"),
      {in_chain,
       "MR.CLAM set 6, classes of the map that join different landmarks",
       size_at_most(0),
       "",
       chain("mrclam", "false_fusions"),
       {{"gcbb", chain("mrclam", "gcbb_false_fusions")}}},
      {in_chain,
       "MR.CLAM set 6, hypotheses stated with a pairing of two different landmarks",
       nothing,
       "",
       chain("mrclam", "wrong"),
       {{"gcbb", chain("mrclam", "gcbb_wrong")}}},
      keeping_time("SE(2), time of the last tenth to that of the first", "SE2"),
      keeping_time("SE(3), time of the last tenth to that of the first", "SE3"),
      keeping_memory("SE(2), memory of each", "SE2"),
      keeping_memory("SE(3), memory of each", "SE3"),
      cold_time("M3500", M3500),
      cold_time("KITTI 05", kitti_05),
      cold_time("KITTI 06", kitti_06),
      cold_time("KITTI 07", kitti_07),
      cold_time("KITTI 09", kitti_09),
      vision_time("a corner in each of 80 cells", "BM_detect/80", 0.0014, "cv::goodFeaturesToTrack"),
      vision_time("60 features, gate of 6 px", "BM_search/6", 0.0015, "cv::matchTemplate, whole pixels, no warp"),
      vision_time("60 features, gate of 16 px", "BM_search/16", 0.009, "cv::matchTemplate, whole pixels, no warp"),
  };
  return table;
}

const std::vector<OptionalBench>& optional_benches() {
  static const std::vector<OptionalBench> benches = {
      {"cholmod", "CHOLMOD", "libsuitesparse-dev libopenblas0-serial"},
      {"ceres", "Ceres", "libceres-dev"},
  };
  return benches;
}

}  // namespace convoy::bench
