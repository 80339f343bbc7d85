#include "vehicle_physics.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

namespace convoy::simulator {
namespace {

struct Slope final : Ground {
  double east = 0.0, north = 0.0, waves_m = 0.0;
  double height_m(double x_m, double y_m) const override {
    return east * x_m + north * y_m + waves_m * std::sin(2.0 * x_m) * std::sin(1.7 * y_m);
  }
};

constexpr double g = VehiclePhysics::gravity_mps2;
constexpr int per_second = 240;

void run(VehiclePhysics& vehicle, const DriveCommand& command, double seconds) {
  for (int i = 0; i < static_cast<int>(seconds * per_second); ++i) vehicle.step(command);
}

/// Holds the speed about as a driver does.
DriveCommand at_speed(const VehiclePhysics& vehicle, double speed_mps, double steering_rad = 0.0) {
  DriveCommand command;
  command.drive_mps2 = 2.0 * (speed_mps - vehicle.state().speed_mps) + 0.012 * g;
  command.steering_rad = steering_rad;
  return command;
}

void hold_speed(VehiclePhysics& vehicle, double speed_mps, double seconds, double steering_rad = 0.0) {
  for (int i = 0; i < static_cast<int>(seconds * per_second); ++i)
    vehicle.step(at_speed(vehicle, speed_mps, steering_rad));
}

Eigen::Vector3d position(const VehiclePhysics& vehicle) { return vehicle.state().T_world_body.translation(); }

void hash_bytes(std::uint64_t& hash, double value) {
  std::uint64_t bits = 0;
  std::memcpy(&bits, &value, sizeof bits);
  hash = (hash ^ bits) * 0x100000001b3ULL;
}

/// Of poses, velocities and wheels.
std::uint64_t hash_of(const VehicleState& state, std::uint64_t hash = 0xcbf29ce484222325ULL) {
  for (int i = 0; i < 12; ++i) hash_bytes(hash, state.T_world_body.matrix()(i % 3, i / 3));
  for (int i = 0; i < 3; ++i) {
    hash_bytes(hash, state.velocity_world_mps[i]);
    hash_bytes(hash, state.turn_body_radps[i]);
  }
  for (const WheelState& wheel : state.wheels)
    for (double value : {wheel.angle_rad, wheel.normal_n, wheel.longitudinal_n, wheel.lateral_n})
      hash_bytes(hash, value);
  return hash;
}

TEST(VehiclePhysics, StandsOnTheGroundFromTheStart) {
  for (const VehicleParams& params : {VehicleParams{}, robot_params()}) {
    const Slope level;
    VehiclePhysics vehicle(params, level, 3.0, -4.0, 2.0);
    const VehicleState& state = vehicle.state();
    EXPECT_NEAR((position(vehicle) - Eigen::Vector3d(3.0, -4.0, 0.0)).norm(), 0.0, 1e-6);
    EXPECT_NEAR(state.yaw_rad(), 2.0, 1e-9);
    EXPECT_NEAR(state.pitch_rad(), 0.0, 1e-9);
    EXPECT_NEAR(state.roll_rad(), 0.0, 1e-9);
    double load_n = 0.0;
    for (const WheelState& wheel : state.wheels) {
      load_n += wheel.normal_n;
      EXPECT_EQ(wheel.angle_rad, 0.0);
      EXPECT_NEAR(wheel.spring_m, 0.0, 1e-6);
    }
    EXPECT_NEAR(load_n, params.mass_kg * g, 1e-3 * load_n);
    EXPECT_EQ(state.step, 0U);
  }
}

TEST(VehiclePhysics, DoesNotMoveUnlessDriven) {
  for (const VehicleParams& params : {VehicleParams{}, robot_params()}) {
    const Slope level;
    VehiclePhysics vehicle(params, level, 0.0, 0.0, 0.3);
    const Eigen::Vector3d before = position(vehicle);
    run(vehicle, {}, 30.0);
    EXPECT_LT((position(vehicle) - before).norm(), 1e-6);
    for (const WheelState& wheel : vehicle.state().wheels) EXPECT_NEAR(wheel.angle_rad, 0.0, 1e-6);
  }
}

// 18 %, across and along: friction holds, and nothing creeps.
TEST(VehiclePhysics, RestsOnASlopeWithItsBrakesOn) {
  for (const VehicleParams& params : {VehicleParams{}, robot_params()}) {
    Slope slope;
    slope.east = 0.1;
    slope.north = 0.15;
    VehiclePhysics vehicle(params, slope, 5.0, 5.0, 0.4);
    DriveCommand brakes;
    brakes.brake_mps2 = params.max_brake_mps2;
    const Eigen::Vector3d before = position(vehicle);
    run(vehicle, brakes, 30.0);
    EXPECT_LT((position(vehicle) - before).norm(), 1e-6);
    if (params.kind == VehicleKind::Robot) continue;  // its motor holds it
    run(vehicle, {}, 3.0);
    EXPECT_GT((position(vehicle) - before).norm(), 1.0) << "without brakes it rolls";
  }
}

TEST(VehiclePhysics, SlidesWhereFrictionDoesNotHold) {
  Slope slope;
  slope.north = 0.2;
  VehicleParams ice;
  ice.friction = 0.1;
  EXPECT_THROW(VehiclePhysics(ice, slope, 0.0, 0.0, 0.0), std::invalid_argument);
}

// v^2 / (2 mu g): within 5 %, which is what the springs store and give back.
TEST(VehiclePhysics, BrakesInTheDistanceThatFrictionAllows) {
  for (double friction : {0.5, 0.9})
    for (double speed_mps : {5.0, 10.0, 15.0}) {
      const Slope level;
      VehicleParams params;
      params.friction = friction;
      VehiclePhysics vehicle(params, level, 0.0, 0.0, 0.0);
      hold_speed(vehicle, speed_mps, 12.0);
      const double speed = vehicle.state().speed_mps, from = position(vehicle).x();
      DriveCommand brakes;
      brakes.brake_mps2 = params.max_brake_mps2;
      run(vehicle, brakes, 6.0);
      EXPECT_NEAR(vehicle.state().speed_mps, 0.0, 1e-6);
      const double model = speed * speed / (2.0 * friction * g);
      EXPECT_NEAR(position(vehicle).x() - from, model, 0.05 * model) << friction << ' ' << speed_mps;
    }
}

TEST(VehiclePhysics, BrakesAsHardAsItIsTold) {
  const Slope level;
  VehiclePhysics vehicle({}, level, 0.0, 0.0, 0.0);
  hold_speed(vehicle, 8.0, 8.0);
  const double speed = vehicle.state().speed_mps, from = position(vehicle).x();
  DriveCommand brakes;
  brakes.brake_mps2 = 3.0;
  run(vehicle, brakes, 5.0);
  const double model = speed * speed / (2.0 * (3.0 + 0.012 * g));
  EXPECT_NEAR(position(vehicle).x() - from, model, 0.05 * model);
}

// wheelbase / tan(steering), at a walking pace: within 1 %.
TEST(VehiclePhysics, TurnsInTheCircleOfItsSteering) {
  for (double steering_rad : {-0.5, -0.2, 0.1, 0.3, 0.6}) {
    const Slope level;
    VehiclePhysics vehicle({}, level, 0.0, 0.0, 0.0);
    hold_speed(vehicle, 1.5, 8.0, steering_rad);
    const double radius_m = vehicle.state().speed_mps / vehicle.state().turn_body_radps.z();
    const double model = vehicle.params().wheelbase_m / std::tan(steering_rad);
    EXPECT_NEAR(radius_m, model, 0.01 * std::abs(model)) << steering_rad;
  }
}

TEST(VehiclePhysics, SteeringLagsAndIsLimitedInRate) {
  const Slope level;
  VehiclePhysics vehicle({}, level, 0.0, 0.0, 0.0);
  DriveCommand command;
  command.steering_rad = 2.0;
  double before = 0.0;
  for (int i = 0; i < 2 * per_second; ++i) {
    vehicle.step(command);
    EXPECT_LE(vehicle.state().steering_rad - before, 0.8 / per_second + 1e-12);
    before = vehicle.state().steering_rad;
    if (i == per_second / 4) {
      EXPECT_NEAR(before, 0.2, 0.01);
    }
  }
  EXPECT_NEAR(before, vehicle.params().max_steering_rad, 1e-3);
  EXPECT_GT(vehicle.state().wheels[FrontLeft].steering_rad, vehicle.state().wheels[FrontRight].steering_rad);
}

TEST(VehiclePhysics, BodyRollsOutwardsAndPitchesAsItBrakes) {
  const Slope level;
  VehiclePhysics vehicle({}, level, 0.0, 0.0, 0.0);
  hold_speed(vehicle, 7.0, 8.0);
  hold_speed(vehicle, 7.0, 3.0, 0.15);  // to the left, 2.9 m/s^2
  EXPECT_GT(vehicle.state().roll_rad(), 0.005);
  EXPECT_LT(vehicle.state().roll_rad(), 0.05);
  EXPECT_GT(vehicle.state().wheels[RearRight].normal_n, 1.2 * vehicle.state().wheels[RearLeft].normal_n);
  hold_speed(vehicle, 7.0, 3.0, -0.15);
  EXPECT_LT(vehicle.state().roll_rad(), -0.005);
  hold_speed(vehicle, 7.0, 3.0);
  EXPECT_NEAR(vehicle.state().roll_rad(), 0.0, 1e-3);
  EXPECT_NEAR(vehicle.state().pitch_rad(), 0.0, 1e-3);
  DriveCommand brakes;
  brakes.brake_mps2 = 4.0;
  run(vehicle, brakes, 0.5);
  EXPECT_GT(vehicle.state().pitch_rad(), 0.005);
  EXPECT_GT(vehicle.state().wheels[FrontLeft].spring_m, vehicle.state().wheels[RearLeft].spring_m);
}

// Lateral forces add up to mass times v^2 / r, of the centre of mass.
TEST(VehiclePhysics, TyreForcesAreThoseOfTheMotion) {
  const Slope level;
  VehiclePhysics vehicle({}, level, 0.0, 0.0, 0.0);
  hold_speed(vehicle, 6.0, 12.0, 0.15);
  const VehicleState& state = vehicle.state();
  double lateral_n = 0.0, load_n = 0.0;
  for (const WheelState& wheel : state.wheels) {
    lateral_n += wheel.lateral_n;
    load_n += wheel.normal_n;
    EXPECT_LE(std::hypot(wheel.lateral_n, wheel.longitudinal_n), 0.9 * wheel.normal_n * 1.0001);
  }
  const double model = vehicle.params().mass_kg * state.speed_mps * state.turn_body_radps.z();
  EXPECT_NEAR(lateral_n, model, 0.03 * model);
  EXPECT_NEAR(load_n, vehicle.params().mass_kg * g, 20.0);
}

TEST(VehiclePhysics, WheelsTurnByTheWayTheyGo) {
  const Slope level;
  VehiclePhysics vehicle({}, level, 0.0, 0.0, 0.7);
  hold_speed(vehicle, 5.0, 20.0);
  DriveCommand brakes;
  brakes.brake_mps2 = 2.0;
  run(vehicle, brakes, 5.0);
  for (const WheelState& wheel : vehicle.state().wheels)
    EXPECT_NEAR(wheel.angle_rad * vehicle.params().wheel_radius_m, position(vehicle).head<2>().norm(), 0.005);
}

TEST(VehiclePhysics, UnevenRoadMovesTheBody) {
  const auto unrest_of = [](const Ground& ground) {
    VehiclePhysics vehicle({}, ground, 0.0, 0.2, 0.0);
    double sum = 0.0;
    for (int i = 0; i < 20 * per_second; ++i) {
      vehicle.step(at_speed(vehicle, 5.0));
      if (i > 10 * per_second)
        sum += std::pow(vehicle.state().turn_body_radps.x(), 2) + std::pow(vehicle.state().turn_body_radps.y(), 2);
    }
    return std::sqrt(sum / (10.0 * per_second));
  };
  Slope uneven;
  uneven.waves_m = 0.02;
  EXPECT_GT(unrest_of(uneven), 0.02);
  EXPECT_LT(unrest_of(Slope()), 1e-3);
}

struct Kerb final : Ground {
  double height_m(double x_m, double) const override { return x_m < 6.0 ? 0.0 : 0.12; }
};

TEST(VehiclePhysics, ClimbsAKerb) {
  const Kerb kerb;
  VehiclePhysics vehicle({}, kerb, 0.0, 0.0, 0.0);
  double highest = 0.0;
  for (int i = 0; i < 10 * per_second; ++i) {
    vehicle.step(at_speed(vehicle, 3.0));
    highest = std::max(highest, std::abs(vehicle.state().pitch_rad()));
  }
  EXPECT_GT(position(vehicle).x(), 20.0);
  EXPECT_NEAR(position(vehicle).z(), 0.12, 0.005);
  EXPECT_GT(highest, 0.02);
  EXPECT_LT(highest, 0.15);
}

struct Hole final : Ground {
  double height_m(double x_m, double) const override { return x_m < 10.0 ? 0.0 : -1.0; }
};

// Off a ledge of a metre: springs go to their stops, the body does not go through the ground.
TEST(VehiclePhysics, FallsOnTheGroundNotThroughIt) {
  const Hole hole;
  VehiclePhysics vehicle({}, hole, 0.0, 0.0, 0.0);
  for (int i = 0; i < 10 * per_second; ++i) {
    vehicle.step(at_speed(vehicle, 8.0));
    const VehicleState& state = vehicle.state();
    const Eigen::Vector3d middle = state.T_world_body * Eigen::Vector3d(1.3, 0.0, 0.55);
    ASSERT_GT(middle.z() - hole.height_m(middle.x(), 0.0), 0.1) << state.time_s;
  }
  EXPECT_GT(position(vehicle).x(), 20.0);
}

TEST(VehiclePhysics, RobotTurnsOnTheSpot) {
  const Slope level;
  VehiclePhysics robot(robot_params(), level, 1.0, 2.0, 0.0);
  DriveCommand turn;
  turn.yaw_rate_radps = 1.0;
  run(robot, turn, 10.0);
  EXPECT_LT((position(robot).head<2>() - Eigen::Vector2d(1.0, 2.0)).norm(), 0.02);
  EXPECT_NEAR(robot.state().turn_body_radps.z(), 1.0, 0.01);
  const double half = 0.5 * robot.params().track_m / robot.params().wheel_radius_m;
  EXPECT_NEAR(robot.state().wheels[RearRight].speed_radps, half, 0.05 * half);
  EXPECT_NEAR(robot.state().wheels[RearLeft].speed_radps, -half, 0.05 * half);
}

/// A drive with everything in it; the hash of all its states.
std::uint64_t drive(VehiclePhysics& vehicle, int steps, VehiclePhysics* other = nullptr) {
  std::uint64_t hash = hash_of(vehicle.state());
  for (int i = 0; i < steps; ++i) {
    DriveCommand command;
    command.steering_rad = 0.3 * std::sin(0.01 * i);
    command.yaw_rate_radps = std::cos(0.01 * i);
    command.drive_mps2 = i % 1000 < 600 ? 1.0 : 0.0;
    command.brake_mps2 = i % 1000 < 600 ? 0.0 : 2.0;
    vehicle.step(command);
    if (other) other->step({0.5, 0.0, -0.2, -1.0});
    hash = hash_of(vehicle.state(), hash);
  }
  return hash;
}

TEST(VehiclePhysics, SameInputsSameStatesWhoeverElseDrives) {
  for (const VehicleParams& params : {VehicleParams{}, robot_params()}) {
    Slope uneven;
    uneven.waves_m = 0.02;
    VehiclePhysics alone(params, uneven, 0.0, 0.0, 0.1), again(params, uneven, 0.0, 0.0, 0.1);
    VehiclePhysics near(params, uneven, 0.0, 0.5, 0.1);  // would touch, if vehicles did
    const std::uint64_t hash = drive(alone, 3000);
    EXPECT_EQ(drive(again, 3000, &near), hash);
    VehiclePhysics moved = std::move(again);
    EXPECT_EQ(hash_of(moved.state()), hash_of(alone.state()));
    RecordProperty("hash", std::to_string(hash));
  }
}

std::uint64_t hash_of_a_drive() {
  Slope uneven;
  uneven.waves_m = 0.02;
  VehiclePhysics vehicle({}, uneven, 7.0, 0.0, 0.1);
  return drive(vehicle, 3000);
}

// The process that it starts runs this test again, and only tells its hash.
TEST(VehiclePhysics, SameStatesInAnotherProcess) {
  const std::string hash = "hash " + std::to_string(hash_of_a_drive()) + "\n";
  if (std::getenv("CONVOY_TELL_HASH")) {
    std::cout << hash;
    return;
  }
  const std::string self = std::filesystem::read_symlink("/proc/self/exe");
  const std::string command =
      "CONVOY_TELL_HASH=1 \"" + self + "\" --gtest_filter=VehiclePhysics.SameStatesInAnotherProcess";
  FILE* pipe = popen(command.c_str(), "r");
  ASSERT_NE(pipe, nullptr);
  std::string output;
  for (int c = std::fgetc(pipe); c != EOF; c = std::fgetc(pipe)) output += static_cast<char>(c);
  EXPECT_EQ(pclose(pipe), 0);
  EXPECT_NE(output.find(hash), std::string::npos) << output;
}

// Far from the origin nothing is lost that matters: Bullet's numbers are of double precision.
TEST(VehiclePhysics, IsTheSameFarFromTheOrigin) {
  const Slope level;
  VehiclePhysics near({}, level, 0.0, 0.0, 0.1), far({}, level, 5e5, -5e6, 0.1);
  drive(near, 2400);
  drive(far, 2400);
  EXPECT_LT((position(far) - Eigen::Vector3d(5e5, -5e6, 0.0) - position(near)).norm(), 1e-4);
}

struct Broken final : Ground {
  double from_m, value;
  Broken(double from, double height) : from_m(from), value(height) {}
  double height_m(double x_m, double) const override { return x_m < from_m ? 0.0 : value; }
};

std::string message_of(const auto& call) {
  try {
    call();
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}

TEST(VehiclePhysics, SaysWhereTheGroundIsNoNumber) {
  for (double value : {std::nan(""), std::numeric_limits<double>::infinity()}) {
    const Broken at_start(-100.0, value), later(8.0, value);
    EXPECT_NE(message_of([&] { VehiclePhysics({}, at_start, 0.0, 0.0, 0.0); }).find("Ground::height_m("),
              std::string::npos);
    VehiclePhysics vehicle({}, later, 0.0, 0.0, 0.0);
    EXPECT_NE(message_of([&] { hold_speed(vehicle, 5.0, 5.0); }).find("Ground::height_m(8"), std::string::npos);
  }
}

TEST(VehiclePhysics, RefusesWhatIsOutOfRange) {
  const Slope level;
  VehicleParams heavy;
  heavy.mass_kg = -3.0;
  const std::string text = message_of([&] { VehiclePhysics(heavy, level, 0.0, 0.0, 0.0); });
  EXPECT_NE(text.find("VehicleParams.mass_kg is -3"), std::string::npos) << text;
  EXPECT_NE(text.find("1 to 40000"), std::string::npos) << text;
  VehicleParams odd;
  odd.centre_ahead_m = std::nan("");
  EXPECT_THROW(odd.validate(), std::invalid_argument);
  EXPECT_THROW(VehiclePhysics({}, level, std::nan(""), 0.0, 0.0), std::invalid_argument);
  VehiclePhysics vehicle({}, level, 0.0, 0.0, 0.0);
  DriveCommand command;
  command.steering_rad = std::nan("");
  EXPECT_THROW(vehicle.step(command), std::invalid_argument);
}

}  // namespace
}  // namespace convoy::simulator
