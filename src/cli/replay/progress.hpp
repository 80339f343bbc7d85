// How far a replay is, on standard error, for what takes longer than two seconds.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdio>

namespace convoy::cli {

class Progress {
 public:
  /// t_s: of the recording.
  void tell(std::size_t frames, double t_s) {
    const double wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - began_).count();
    if (wall_s < next_s_) return;
    next_s_ = wall_s + period_s;
    std::fprintf(stderr, "convoy replay: %zu frames, %.1f s of the recording\n", frames, t_s);
  }

 private:
  static constexpr double period_s = 2.0;
  std::chrono::steady_clock::time_point began_ = std::chrono::steady_clock::now();
  double next_s_ = period_s;
};

}  // namespace convoy::cli
