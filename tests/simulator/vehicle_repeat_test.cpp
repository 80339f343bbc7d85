// That a vehicle does the same again, and says what is wrong with what it is given.
#include "vehicle_physics.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <future>
#include <iostream>
#include <limits>
#include <stdexcept>
#include <string>

#include "vehicle_test_support.hpp"

namespace convoy::simulator {
namespace {

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

TEST(VehiclePhysics, SameStatesOnAnyThread) {
  Slope uneven;
  uneven.waves_m = 0.02;
  const auto hash_from = [&](double x_m) {
    VehiclePhysics vehicle({}, uneven, x_m, 0.0, 0.1);
    return drive(vehicle, 3000);
  };
  auto first = std::async(std::launch::async, hash_from, 0.0), second = std::async(std::launch::async, hash_from, 9.0);
  EXPECT_EQ(first.get(), hash_from(0.0));
  EXPECT_EQ(second.get(), hash_from(9.0));
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
