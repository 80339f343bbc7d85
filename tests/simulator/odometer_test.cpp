#include "odometer.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <stdexcept>
#include <vector>

namespace convoy::simulator {
namespace {

OdometerParams exact() {
  OdometerParams p;
  p.wheel_radius_sigma = p.track_sigma = p.slip_per_force = p.slip_per_lateral_force = 0.0;
  p.slip_events_per_km = 0.0;
  p.ticks_per_turn = 0;
  p.gyro_noise_radps = p.gyro_bias_radps = p.gyro_bias_walk_radps_sqrts = p.gyro_scale_sigma = 0.0;
  p.time_jitter_s = 0.0;
  return p;
}

/// States of a vehicle that moves evenly, every twelfth step (20 Hz).
struct Motion {
  double speed_mps = 2.0, yaw_rate_radps = 0.0, longitudinal = 0.0, lateral = 0.0;  // forces / load
  static constexpr std::uint64_t stride = 12;
  VehicleState state;

  const VehicleState& next() {
    const VehicleParams p;
    state.step += stride;
    state.time_s = static_cast<double>(state.step) / 240.0;
    state.turn_body_radps.z() = yaw_rate_radps;
    for (std::size_t i = 0; i < 4; ++i) {
      WheelState& wheel = state.wheels[i];
      const double side = (i % 2 == 0 ? -0.5 : 0.5) * p.track_m;
      wheel.angle_rad += (speed_mps + side * yaw_rate_radps) / p.wheel_radius_m * stride / 240.0;
      wheel.normal_n = 3000.0;
      wheel.longitudinal_n = 3000.0 * longitudinal;
      wheel.lateral_n = 3000.0 * lateral;
    }
    return state;
  }
};

std::vector<OdometerReading> readings(Odometer& odometer, Motion motion, int count) {
  odometer.step(motion.state);
  std::vector<OdometerReading> all;
  while (static_cast<int>(all.size()) < count)
    if (const auto reading = odometer.step(motion.next())) all.push_back(*reading);
  return all;
}

/// Mean of what run(seed) squares up to, which has to be 1: a chi-square of that many degrees, within 4 sigma.
void expect_unit_variance(int runs, const std::function<double(std::uint32_t)>& run) {
  double sum = 0.0;
  for (int seed = 0; seed < runs; ++seed) sum += std::pow(run(static_cast<std::uint32_t>(seed)), 2);
  EXPECT_NEAR(sum / runs, 1.0, 4.0 * std::sqrt(2.0 / runs));
}

TEST(Odometer, TellsTheWayIfNothingIsWrong) {
  Odometer odometer(exact(), {}, 1, 1);
  Motion motion;
  motion.yaw_rate_radps = 0.3;
  for (const OdometerReading& reading : readings(odometer, motion, 100)) {
    EXPECT_NEAR(reading.distance_m, 0.1, 1e-9);
    EXPECT_NEAR(reading.speed_mps, 2.0, 1e-8);
    EXPECT_NEAR(reading.wheels_yaw_rate_radps, 0.3, 1e-9);
    EXPECT_NEAR(reading.gyro_yaw_rate_radps, 0.3, 1e-9);
    EXPECT_DOUBLE_EQ(reading.stamp_s, reading.frame / 20.0);
  }
}

TEST(Odometer, DistanceErrsAsStated) {
  OdometerParams params = exact();
  params.wheel_radius_sigma = 0.01;
  params.ticks_per_turn = 2048;
  expect_unit_variance(3000, [&](std::uint32_t seed) {
    Odometer odometer(params, {}, seed, 3);
    Motion motion;
    motion.speed_mps = 2.0 + 0.001 * seed;
    const OdometerReading reading = readings(odometer, motion, 7).back();
    return (reading.distance_m - motion.speed_mps / 20.0) / reading.sigma_distance_m;
  });
}

// Over a long way, ticks do not matter: half the sum of two wheels' errors.
TEST(Odometer, WheelRadiiStayTheSameForARun) {
  OdometerParams params = exact();
  params.wheel_radius_sigma = 0.005;
  params.ticks_per_turn = 512;
  expect_unit_variance(1000, [&](std::uint32_t seed) {
    Odometer odometer(params, {}, seed, 3);
    double sum = 0.0;
    for (const OdometerReading& reading : readings(odometer, {}, 400)) sum += reading.distance_m;
    return (sum / 40.0 - 1.0) / (0.005 / std::sqrt(2.0));
  });
}

TEST(Odometer, YawRatesErrAsStated) {
  OdometerParams params;
  params.slip_events_per_km = params.slip_per_force = params.slip_per_lateral_force = 0.0;
  Motion motion;
  motion.yaw_rate_radps = 0.4;
  for (int count : {1, 200}) {
    expect_unit_variance(2000, [&](std::uint32_t seed) {
      Odometer odometer(params, {}, seed, 3);
      const OdometerReading reading = readings(odometer, motion, count).back();
      return (reading.wheels_yaw_rate_radps - 0.4) / reading.sigma_wheels_yaw_rate_radps;
    });
    expect_unit_variance(2000, [&](std::uint32_t seed) {
      Odometer odometer(params, {}, seed, 3);
      const OdometerReading reading = readings(odometer, motion, count).back();
      return (reading.gyro_yaw_rate_radps - 0.4) / reading.sigma_gyro_yaw_rate_radps;
    });
  }
}

TEST(Odometer, GyroBiasWalks) {
  OdometerParams params = exact();
  params.gyro_bias_walk_radps_sqrts = 1e-3;
  for (int seconds : {1, 25}) {
    expect_unit_variance(2000, [&](std::uint32_t seed) {
      Odometer odometer(params, {}, seed, 2);
      const OdometerReading reading = readings(odometer, {}, 20 * seconds).back();
      EXPECT_NEAR(reading.gyro_yaw_rate_radps, odometer.truth().gyro_bias_radps, 1e-12);
      return reading.gyro_yaw_rate_radps / (1e-3 * std::sqrt(seconds));
    });
  }
  // Steps of it are independent of one another: what is walked in a second says nothing of the next.
  double product = 0.0;
  for (std::uint32_t seed = 0; seed < 2000; ++seed) {
    Odometer odometer(params, {}, seed, 2);
    const auto all = readings(odometer, {}, 40);
    product += all[19].gyro_yaw_rate_radps * (all[39].gyro_yaw_rate_radps - all[19].gyro_yaw_rate_radps);
  }
  EXPECT_NEAR(product / 2000 / 1e-6, 0.0, 4.0 / std::sqrt(2000.0));
}

TEST(Odometer, SlipsInProportionToForce) {
  OdometerParams params = exact();
  params.slip_per_force = 0.03;
  params.slip_per_lateral_force = 0.02;
  const auto ratio = [&](double speed_mps, double longitudinal, double lateral) {
    Odometer odometer(params, {}, 1, 1);
    Motion motion;
    motion.speed_mps = speed_mps;
    motion.longitudinal = longitudinal;
    motion.lateral = lateral;
    return readings(odometer, motion, 1)[0].distance_m * 20.0 / speed_mps;
  };
  EXPECT_NEAR(ratio(2.0, 0.2, 0.0), 1.006, 1e-9) << "drive: the wheel turns more than the way";
  EXPECT_NEAR(ratio(2.0, -0.5, 0.0), 0.985, 1e-9) << "brakes: less";
  EXPECT_NEAR(ratio(-2.0, -0.2, 0.0), 1.006, 1e-9) << "drive in reverse";
  EXPECT_NEAR(ratio(2.0, 0.0, 0.5), 1.005, 1e-9);
  EXPECT_NEAR(ratio(2.0, 0.0, -0.5), 1.005, 1e-9);
}

TEST(Odometer, SlipEventsComeAsOftenAsStated) {
  OdometerParams params = exact();
  params.slip_events_per_km = 2.0;
  params.slip_event_share = 0.2;
  params.slip_event_s = 2.0;
  double events = 0.0, slipped_m = 0.0, slipping_s = 0.0;
  constexpr int runs = 200;
  for (std::uint32_t seed = 0; seed < runs; ++seed) {
    Odometer odometer(params, {}, seed, 1);
    Motion motion;
    motion.speed_mps = 10.0;
    odometer.step(motion.state);
    for (int i = 0; i < 20 * 500; ++i) {  // 5 km
      slipped_m += odometer.step(motion.next())->distance_m - 0.5;
      slipping_s += odometer.truth().slipping ? 0.05 : 0.0;
    }
    events += odometer.truth().slip_events;
  }
  const double expected = 2.0 * 5.0 * runs;
  EXPECT_NEAR(events, expected, 4.0 * std::sqrt(expected));
  EXPECT_NEAR(slipping_s / events, 2.0, 0.1);
  EXPECT_NEAR(slipped_m / events, 0.2 * 20.0 * (2.0 / 3.0), 0.15) << "two wheels in one of three, one in the others";
}

TEST(Odometer, WheelsThatLockTurnLess) {
  OdometerParams params = exact();
  params.slip_events_per_km = 100.0;
  for (double force : {0.2, -0.2})
    for (double speed_mps : {10.0, -10.0}) {
      Odometer odometer(params, {}, 2, 1);
      Motion motion;
      motion.speed_mps = speed_mps;
      motion.longitudinal = force;
      double ratio = 0.0;
      for (const OdometerReading& reading : readings(odometer, motion, 2000))
        ratio += reading.distance_m * 20.0 / speed_mps / 2000;
      EXPECT_GT((ratio - 1.0) * force * speed_mps, 0.01) << force << ' ' << speed_mps;
    }
}

TEST(Odometer, CountsWholeTicks) {
  OdometerParams params = exact();
  params.ticks_per_turn = 100;
  Odometer odometer(params, {}, 1, 1);
  Motion motion;
  motion.yaw_rate_radps = 0.2;
  const double tick_m = 2.0 * M_PI * 0.3 / 100;
  const double phase = odometer.truth().tick_phase[0];
  std::int64_t left = 0;
  int count = 0;
  for (const OdometerReading& reading : readings(odometer, motion, 500)) {
    left += reading.left_ticks;
    ++count;
    EXPECT_EQ(left, static_cast<std::int64_t>(std::floor(phase + count * (2.0 - 0.15) / 20.0 / tick_m)));
    EXPECT_NEAR(reading.distance_m, 0.5 * tick_m * static_cast<double>(reading.left_ticks + reading.right_ticks),
                1e-12);
  }
}

TEST(Odometer, CountsTicksBackwards) {
  OdometerParams params = exact();
  params.ticks_per_turn = 100;
  Odometer odometer(params, {}, 1, 1);
  Motion motion;
  motion.speed_mps = -1.0;
  std::int64_t left = 0;
  for (const OdometerReading& reading : readings(odometer, motion, 100)) left += reading.left_ticks;
  EXPECT_EQ(left,
            static_cast<std::int64_t>(std::floor(odometer.truth().tick_phase[0] - 5.0 / (2.0 * M_PI * 0.3 / 100))));
}

TEST(Odometer, StampsJitterInOrder) {
  OdometerParams params = exact();
  params.time_jitter_s = 0.004;
  Odometer odometer(params, {}, 1, 1);
  double squares = 0.0, last = -1.0;
  for (const OdometerReading& reading : readings(odometer, {}, 5000)) {
    squares += std::pow(reading.stamp_s - reading.frame / 20.0, 2);
    EXPECT_GT(reading.stamp_s, last);
    last = reading.stamp_s;
  }
  EXPECT_NEAR(std::sqrt(squares / 5000), 0.004, 4.0 * 0.004 / std::sqrt(2.0 * 5000));
}

TEST(Odometer, DependsOnSeedAndVehicleAlone) {
  Odometer a({}, {}, 5, 1), again({}, {}, 5, 1), vehicle({}, {}, 5, 2), seed({}, {}, 6, 1);
  const auto first = readings(a, {}, 50), second = readings(again, {}, 50);
  const auto third = readings(vehicle, {}, 50), fourth = readings(seed, {}, 50);
  for (std::size_t i = 0; i < first.size(); ++i) {
    EXPECT_EQ(first[i].gyro_yaw_rate_radps, second[i].gyro_yaw_rate_radps);
    EXPECT_EQ(first[i].stamp_s, second[i].stamp_s);
    EXPECT_NE(first[i].stamp_s, third[i].stamp_s);
    EXPECT_NE(first[i].gyro_yaw_rate_radps, third[i].gyro_yaw_rate_radps);
    EXPECT_NE(first[i].gyro_yaw_rate_radps, fourth[i].gyro_yaw_rate_radps);
  }
}

struct Level final : Ground {
  double height_m(double, double) const override { return 0.0; }
};

// Dead reckoning of a real drive: without errors it ends within 1 % of the way, with them it does not, by not much.
TEST(Odometer, ReckonsADrive) {
  const auto miss_m = [](const OdometerParams& params) {
    const Level level;
    VehiclePhysics vehicle({}, level, 0.0, 0.0, 0.0);
    Odometer odometer(params, {}, 4, 1);
    odometer.step(vehicle.state());
    double yaw = 0.0;
    Eigen::Vector2d reckoned = Eigen::Vector2d::Zero();
    for (int i = 0; i < 240 * 60; ++i) {
      DriveCommand command;
      command.drive_mps2 = 2.0 * (4.0 - vehicle.state().speed_mps) + 0.12;
      command.steering_rad = 0.15 * std::sin(0.3 * vehicle.state().time_s) + 0.02;
      vehicle.step(command);
      const auto reading = odometer.step(vehicle.state());
      if (!reading) continue;
      const double middle = yaw + 0.5 * reading->gyro_yaw_rate_radps / 20.0;
      reckoned += reading->distance_m * Eigen::Vector2d(std::cos(middle), std::sin(middle));
      yaw += reading->gyro_yaw_rate_radps / 20.0;
    }
    return (reckoned - vehicle.state().T_world_body.translation().head<2>()).norm();
  };
  EXPECT_LT(miss_m(exact()), 0.01 * 240.0);
  EXPECT_GT(miss_m({}), miss_m(exact()));
  EXPECT_LT(miss_m({}), 0.1 * 240.0);
}

TEST(Odometer, RefusesWhatIsOutOfRange) {
  OdometerParams params;
  params.rate_hz = 7.0;
  EXPECT_THROW(Odometer(params, {}, 1, 1), std::invalid_argument);
  params = {};
  params.wheel_radius_sigma = std::nan("");
  try {
    params.validate();
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find("OdometerParams.wheel_radius_sigma is nan"), std::string::npos);
  }
  Odometer odometer({}, {}, 1, 1);
  Motion motion;
  odometer.step(motion.next());
  EXPECT_THROW(odometer.step(motion.state), std::invalid_argument);
}

}  // namespace
}  // namespace convoy::simulator
