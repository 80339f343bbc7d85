// Cars that drive along routes, as a disturbance: where they are is a function of time.
#pragma once

#include "world.hpp"

#include <cstdint>
#include <string>
#include <vector>

namespace convoy::simulator {

struct TrafficParams {
  int cars = 4;  ///< >= 0; 0: none
  double slowest_mps = 5.0, fastest_mps = 9.0;
  std::vector<std::string> on{};  ///< names of closed routes; empty: those whose name ends in "opposite"
};

/// Adds its cars to a world's objects. The world must outlive it, and keep its objects.
class Traffic {
 public:
  /// @throws std::runtime_error for parameters out of range or routes that are not there or not closed.
  Traffic(World& world, std::uint32_t seed, const TrafficParams& params = {});

  /// Places the cars as they are at time t [s], any t in any order.
  void set(double time_s);
  std::size_t size() const { return cars_.size(); }

 private:
  struct Car {
    std::size_t object, route;
    double start_m, speed_mps;
  };
  World& world_;
  std::vector<Car> cars_;
  std::vector<double> lengths_;
};

}  // namespace convoy::simulator
