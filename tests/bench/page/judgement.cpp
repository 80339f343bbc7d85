#include "page/judgement.hpp"

#include <convoy/config_error.hpp>

#include <algorithm>
#include <cmath>

namespace convoy::bench {
namespace {

using json = nlohmann::ordered_json;

Figure unmeasured(std::string why) {
  Figure figure;
  figure.why_not = std::move(why);
  return figure;
}

/// What is not built is no fault of the run.
std::string absence(const Source& source, const std::string& fault) {
  for (const OptionalBench& optional : optional_benches())
    if (optional.bench == source.bench) return "baseline not installed (" + optional.packages + ")";
  return fault;
}

Figure summary(std::vector<double> values, const std::string& label) {
  std::sort(values.begin(), values.end());
  const std::size_t n = values.size();
  return {0.5 * (values[(n - 1) / 2] + values[n / 2]), values.front(), values.back(), n, {}, label};
}

Verdict verdict_of(const Asked& asked, const Figure& figure) {
  if (asked.kind == Asked::Kind::nothing) return Verdict::not_asked;
  if (!figure.measured()) return Verdict::not_measured;
  if (asked.kind == Asked::Kind::equal)
    return std::abs(figure.median / asked.figure - 1.0) <= asked.tolerance ? Verdict::met : Verdict::miss;
  if (figure.median <= asked.figure) return Verdict::met;
  return figure.median <= (1.0 + asked.tolerance) * asked.figure ? Verdict::met_within_tolerance : Verdict::miss;
}

Compared compared(const Demand& demand, const Figure& ours, const Baseline& baseline, const Results& results) {
  Compared row{baseline, figure_of(baseline.source, results), {}};
  if (!ours.measured() || !row.figure.measured() || row.figure.median == 0.0) return row;
  const double ratio = ours.median / row.figure.median;
  row.ratio = demand.asked.kind == Asked::Kind::equal ? std::abs(ratio - 1.0) : ratio;
  return row;
}

json to_json(const Figure& figure) {
  if (!figure.measured()) return {{"not_measured", figure.why_not}};
  return {{"median", figure.median},
          {"low", figure.low},
          {"high", figure.high},
          {"repetitions", figure.repetitions},
          {"label", figure.label}};
}

json to_json(const Asked& asked) {
  switch (asked.kind) {
    case Asked::Kind::at_most: return {{"at_most", asked.figure}, {"relative_tolerance", asked.tolerance}};
    case Asked::Kind::equal: return {{"equal", asked.figure}, {"relative_tolerance", asked.tolerance}};
    case Asked::Kind::nothing: break;
  }
  return nullptr;
}

json to_json(const Source& source) {
  return {{"bench", "convoy_bench_" + source.bench}, {"benchmark", source.benchmark}, {"value", source.value}};
}

json to_json(const Row& row) {
  json out{
      {"section", row.demand.section},        {"what", row.demand.what},         {"unit", row.demand.unit},
      {"asked", to_json(row.demand.asked)},   {"measured", to_json(row.figure)}, {"verdict", to_string(row.verdict)},
      {"source", to_json(row.demand.source)}, {"baselines", json::array()}};
  for (const Compared& c : row.baselines) {
    json baseline{{"what", c.baseline.what}, {"measured", to_json(c.figure)}, {"source", to_json(c.baseline.source)}};
    if (c.ratio) baseline[row.demand.asked.kind == Asked::Kind::equal ? "relative_difference" : "ratio"] = *c.ratio;
    out["baselines"].push_back(std::move(baseline));
  }
  return out;
}

}  // namespace

const char* to_string(Verdict verdict) {
  switch (verdict) {
    case Verdict::met: return "met";
    case Verdict::met_within_tolerance: return "met within the 30 %";
    case Verdict::miss: return "MISS";
    case Verdict::not_measured: return "not measured";
    case Verdict::not_asked: break;
  }
  return "";
}

Figure figure_of(const Source& source, const Results& results) {
  const auto bench = results.find(source.bench);
  if (bench == results.end()) return unmeasured(absence(source, "convoy_bench_" + source.bench + " was not run"));
  if (!bench->second.fault.empty()) return unmeasured(bench->second.fault);
  const auto found = bench->second.by_name.find(source.benchmark);
  if (found == bench->second.by_name.end()) return unmeasured(source.benchmark + " is not among the results");
  const Measured& measured = found->second;
  if (!measured.fault.empty()) return unmeasured(measured.fault);
  const auto values = measured.values.find(source.value);
  if (values == measured.values.end()) return unmeasured(source.benchmark + " has no value " + source.value);
  return summary(values->second, measured.label);
}

std::size_t Judgement::count(Verdict verdict) const {
  return static_cast<std::size_t>(
      std::count_if(rows.begin(), rows.end(), [&](const Row& row) { return row.verdict == verdict; }));
}

Results read_all_results(const std::filesystem::path& folder) {
  if (!std::filesystem::is_directory(folder))
    throw ConfigError(folder.string() + ": no such folder; scripts/bench makes one and fills it");
  Results results;
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    if (entry.path().extension() == ".json") results[entry.path().stem().string()] = read_results(entry.path());
  if (results.empty()) throw ConfigError(folder.string() + ": no bench has left results (*.json); run scripts/bench");
  return results;
}

Judgement judge(const std::vector<Demand>& demands, Results results) {
  Judgement judgement;
  for (const Demand& demand : demands) {
    Row row{demand, figure_of(demand.source, results), {}, {}};
    row.verdict = verdict_of(demand.asked, row.figure);
    for (const Baseline& baseline : demand.baselines)
      row.baselines.push_back(compared(demand, row.figure, baseline, results));
    judgement.rows.push_back(std::move(row));
  }
  judgement.results = std::move(results);
  return judgement;
}

json to_json(const Judgement& judgement) {
  json out{{"met", judgement.count(Verdict::met)},
           {"met_within_tolerance", judgement.count(Verdict::met_within_tolerance)},
           {"missed", judgement.count(Verdict::miss)},
           {"not_measured", judgement.count(Verdict::not_measured)},
           {"rows", json::array()}};
  for (const Row& row : judgement.rows) out["rows"].push_back(to_json(row));
  return out;
}

}  // namespace convoy::bench
