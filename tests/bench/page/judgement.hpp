// What was measured, held against what is asked.
#pragma once

#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "page/demands.hpp"
#include "page/results.hpp"

namespace convoy::bench {

/// Median over the repetitions.
struct Figure {
  double median = 0.0, low = 0.0, high = 0.0;
  std::size_t repetitions = 0;
  std::string why_not;  ///< measured; empty: it was
  std::string label;    ///< what its benchmark says of itself
  bool measured() const { return why_not.empty(); }
};

struct Compared {
  Baseline baseline;
  Figure figure;
  /// Of the measured figure to that of the baseline; for costs, which have to be equal, the relative difference.
  std::optional<double> ratio;
};

enum class Verdict { met, met_within_tolerance, miss, not_measured, not_asked };
const char* to_string(Verdict verdict);

struct Row {
  Demand demand;
  Figure figure;
  Verdict verdict = Verdict::not_measured;
  std::vector<Compared> baselines;
};

using Results = std::map<std::string, BenchResults>;  ///< of each bench

Figure figure_of(const Source& source, const Results& results);

struct Judgement {
  Results results;
  std::vector<Row> rows;
  std::size_t count(Verdict verdict) const;
};

/// NAME.json for each convoy_bench_NAME, all that the folder holds. Throws ConfigError.
Results read_all_results(const std::filesystem::path& folder);

Judgement judge(const std::vector<Demand>& demands, Results results);

nlohmann::ordered_json to_json(const Judgement& judgement);

}  // namespace convoy::bench
