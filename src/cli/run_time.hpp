// When it is in a run of `convoy vehicle`, and when the run is over.
#pragma once

#include <chrono>
#include <optional>

namespace convoy::cli {

/// Seconds since 1970 as of the start, and from there by a clock that nobody sets: time must not go back under a
/// vehicle.
template <class System = std::chrono::system_clock, class Steady = std::chrono::steady_clock>
class UnixTime {
 public:
  double operator()() const {
    const std::chrono::duration<double> began = began_.time_since_epoch(), passed = Steady::now() - steady_;
    return began.count() + passed.count();
  }

 private:
  typename System::time_point began_ = System::now();
  typename Steady::time_point steady_ = Steady::now();
};

/// Who has settled stays until the others hold the same: they may lack what only this vehicle has. Not for ever: a peer
/// may refuse what this one takes.
class FleetEnd {
 public:
  static constexpr double patience_s = 30.0;

  /// `settled`, `peers_agree`: of VehicleSnapshot. `wall_s` does not decrease.
  bool reached(bool settled, bool peers_agree, double wall_s) {
    if (!settled) return false;
    if (!settled_s_) settled_s_ = wall_s;
    return peers_agree || wall_s >= *settled_s_ + patience_s;
  }

 private:
  std::optional<double> settled_s_;
};

}  // namespace convoy::cli
