// What the benches wrote: google-benchmark's JSON, one file RESULTS/NAME.json for each convoy_bench_NAME.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace convoy::bench {

/// One benchmark, all of its repetitions.
struct Measured {
  std::string label;
  std::string fault;  ///< why nothing was measured; empty: it was
  /// "cpu_s" (CPU time of one iteration) and every number beside it, counters among them; one value for each
  /// repetition. What is there in seconds (X_s) is there in milliseconds as well (X_ms).
  std::map<std::string, std::vector<double>> values;
};

struct BenchResults {
  std::string fault;                        ///< why there are none; empty: there are
  std::map<std::string, Measured> by_name;  ///< without "/iterations:N"
};

/// {"failed": "why"} instead of a run is a fault of the results; what is no such JSON throws ConfigError.
BenchResults read_results(const std::filesystem::path& file);

/// The same from the text; `source` is named in errors.
BenchResults parse_results(std::string_view text, const std::string& source);

}  // namespace convoy::bench
