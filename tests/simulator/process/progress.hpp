// Lines that tell how far something is, for whoever waits for more than two seconds.
#pragma once

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>

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

/// A line about what one waits for, after two seconds and then again: ten seconds later, on a terminal each second.
class LongWait {
 public:
  ~LongWait();  ///< ends the line
  using Clock = std::chrono::steady_clock;
  Clock::time_point next() const { return start_ + std::chrono::seconds(next_s_); }
  /// "WHAT, for 2 sREST" if it is time for it.
  void tell(const std::string& what, const std::string& rest = {});

 private:
  const Clock::time_point start_ = Clock::now();
  int next_s_ = 2;
  bool open_ = false;
};

/// A line that tells that something still goes on, and for how long, while nothing else can be told of it.
class StillAt {
 public:
  explicit StillAt(std::string what);  ///< says what, at once
  ~StillAt();                          ///< it is done
  StillAt(const StillAt&) = delete;
  StillAt& operator=(const StillAt&) = delete;

 private:
  void tell();

  const std::string what_;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool done_ = false;
  std::thread teller_;
};

}  // namespace convoy::simulator
