// What the figures were measured on.
#pragma once

#include <string>

namespace convoy::bench {

struct Machine {
  std::string cpu;  ///< its name, or "unknown CPU"
  unsigned cores = 0;
  double load_at_start = 0.0, load_at_end = 0.0;  ///< one-minute averages around the benches, which are 1 of the second

  /// Nobody else computed, as far as the averages tell.
  bool idle() const { return load_at_start <= 0.5 && load_at_end <= 1.5; }
};

/// This one. `cpuinfo`: the text of /proc/cpuinfo.
Machine this_machine(const std::string& cpuinfo, double load_at_start, double load_at_end);

}  // namespace convoy::bench
