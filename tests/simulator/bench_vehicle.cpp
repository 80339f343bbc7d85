// How many times faster than real time a vehicle is driven: physics alone, with its driver, and with its odometer and
// both kinds of GPS. The counter x_real_time is driven time over the CPU time of this thread.
#include "gps.hpp"
#include "odometer.hpp"
#include "route_follower.hpp"

#include <benchmark/benchmark.h>

#include <cmath>

namespace {

using namespace convoy::simulator;

constexpr int steps_per_call = 240;

struct Uneven final : Ground {
  double height_m(double x_m, double y_m) const override {
    return 0.02 * x_m + 0.02 * std::sin(2.0 * x_m) * std::sin(1.7 * y_m);
  }
};

Route circle(double radius_m) {
  Route route{"circle", {}, true};
  for (double way = 0.0; way < 2.0 * M_PI * radius_m; way += 0.5)
    route.points.emplace_back(radius_m * std::cos(way / radius_m), radius_m * std::sin(way / radius_m));
  return route;
}

VehicleParams kind(const benchmark::State& state) { return state.range(0) == 0 ? VehicleParams{} : robot_params(); }

void count(benchmark::State& state) {
  state.counters["x_real_time"] =
      benchmark::Counter(static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}

void BM_physics(benchmark::State& state) {
  const Uneven ground;
  VehiclePhysics vehicle(kind(state), ground, 0.0, 0.0, 0.0);
  DriveCommand command;
  command.steering_rad = command.yaw_rate_radps = 0.05;
  for (auto _ : state)
    for (int i = 0; i < steps_per_call; ++i) {
      command.drive_mps2 = 3.0 - vehicle.state().speed_mps;
      vehicle.step(command);
    }
  count(state);
}

void BM_vehicle(benchmark::State& state) {
  const Uneven ground;
  RouteFollowerParams params;
  params.speed_mps = 5.0;
  RouteFollower follower(circle(80.0), params, kind(state));
  const RouteFollower::Start start = follower.start();
  VehiclePhysics vehicle(kind(state), ground, start.x_m, start.y_m, start.yaw_rad);
  Odometer odometer({}, kind(state), 1, 1);
  Gps standard(standard_gps(), 1, 1), rtk(rtk_gps(), 1, 1);
  for (auto _ : state)
    for (int i = 0; i < steps_per_call; ++i) {
      vehicle.step(follower.step(vehicle.state()));
      benchmark::DoNotOptimize(odometer.step(vehicle.state()));
      benchmark::DoNotOptimize(standard.step(vehicle.state()));
      benchmark::DoNotOptimize(rtk.step(vehicle.state()));
    }
  count(state);
}

BENCHMARK(BM_physics)->ArgName("robot")->Arg(0)->Arg(1);
BENCHMARK(BM_vehicle)->ArgName("robot")->Arg(0)->Arg(1);

}  // namespace
