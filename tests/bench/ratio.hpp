// Time of something against the time of its baseline, both measured in the same run of the bench.
#pragma once

#include <benchmark/benchmark.h>

#include <time.h>

#include <string>

namespace convoy::bench {

/// What this thread has computed so far: other load on the machine does not count. [s]
inline double cpu_s() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

/// Mean CPU time of one call, repeated for at least `for_s` seconds (once, if it takes longer). [s]
template <class Call>
double seconds_per_call(const Call& call, double for_s) {
  const double start_s = cpu_s();
  for (int calls = 1;; ++calls) {
    call();
    const double elapsed_s = cpu_s() - start_s;
    if (elapsed_s >= for_s) return elapsed_s / calls;
  }
}

/// Runs the loop of `state` on `subject`. Counters: ratio_to_baseline, time of the subject over time of the baseline
/// (below 1: the subject is quicker), and baseline_s, CPU time of one call of the baseline. The label names it.
template <class Subject, class Baseline>
void against(benchmark::State& state, const std::string& baseline_name, const Subject& subject,
             const Baseline& baseline, double baseline_for_s = 0.02) {
  const double baseline_s = seconds_per_call(baseline, baseline_for_s);
  const double start_s = cpu_s();
  for (auto _ : state) subject();
  const double elapsed_s = cpu_s() - start_s;
  state.counters["ratio_to_baseline"] = elapsed_s / static_cast<double>(state.iterations()) / baseline_s;
  state.counters["baseline_s"] = baseline_s;
  state.SetLabel("baseline: " + baseline_name);
}

}  // namespace convoy::bench
