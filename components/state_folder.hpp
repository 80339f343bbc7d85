// StateFolder: what a vehicle keeps on disk between its runs. A lock, so that it runs once at a time, and the last
// epoch, so that no key is ever used twice (DESIGN A2).
#pragma once

#include <convoy/submap/facts.hpp>

#include <filesystem>
#include <functional>

namespace convoy {

/// Microseconds since 1970, then twelve random bits: it grows with the clock, and two vehicles that begin in folders of
/// their own do not begin alike. Good until the year 2112.
Epoch epoch_from_clock();

class StateFolder {
 public:
  /// Makes the folder if it is not there, and locks it; the lock goes with this object or with its process, however
  /// that ends. Throws ConfigError if the folder cannot be written or is locked; the text names the other process.
  explicit StateFolder(std::filesystem::path folder);
  ~StateFolder();
  StateFolder(const StateFolder&) = delete;
  StateFolder& operator=(const StateFolder&) = delete;

  struct NextEpoch {
    Epoch epoch = 0;
    bool first = false;  ///< none was ever taken here
  };
  /// `fresh()`, or one more than the last where that is not higher (a clock that was set back). On disk before it is
  /// returned, so that a crash can only skip numbers. Throws ConfigError, also if the file is damaged in any way.
  NextEpoch next_epoch(const std::function<Epoch()>& fresh);

 private:
  std::filesystem::path folder_;
  int lock_ = -1;
};

}  // namespace convoy
