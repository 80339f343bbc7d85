// A line that tells how far a run is, for whoever waits for more than two seconds.
#pragma once

#include <chrono>
#include <string>

namespace convoy::simulator {

class Progress {
 public:
  explicit Progress(double duration_s);
  ~Progress();  ///< ends the line
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  /// On a terminal the line is written over and over; in a file there is one every ten seconds.
  void tell(double time_s, const std::string& what = {});

 private:
  using Clock = std::chrono::steady_clock;
  const double duration_s_;
  const bool terminal_;
  const Clock::time_point start_ = Clock::now();
  Clock::time_point next_;
  bool open_ = false;
};

}  // namespace convoy::simulator
