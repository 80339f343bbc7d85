// What is asked of the speed of this project: one table, demands.cpp.
#pragma once

#include <string>
#include <vector>

namespace convoy::bench {

/// Where a figure stands in the results.
struct Source {
  std::string bench;      ///< convoy_bench_NAME
  std::string benchmark;  ///< "BM_fleet_factor<3>/20000", without "/iterations:N"
  std::string value;      ///< "cpu_s", "cpu_ms" or a counter, in the unit of the demand
};

struct Asked {
  enum class Kind {
    at_most,
    equal,   ///< to `tolerance`
    nothing  ///< compared with its baselines, and judged by nobody
  };
  Kind kind = Kind::nothing;
  double figure = 0.0;
  double tolerance = 0.0;  ///< relative
};

/// Times, and ratios of times, are asked for within this, because they repeat to no less; sizes do repeat.
constexpr double tolerance_of_times = 0.3;

/// What the figure is compared with, measured in the same run.
struct Baseline {
  std::string what;
  Source source;
};

struct Demand {
  std::string section, what;
  Asked asked;
  std::string unit;
  Source source;
  std::vector<Baseline> baselines;
};

const std::vector<Demand>& demands();

/// A bench that is built only where its library is.
struct OptionalBench {
  std::string bench, library, packages;
};
const std::vector<OptionalBench>& optional_benches();

}  // namespace convoy::bench
