#include "vehicle_physics.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "vehicle_test_support.hpp"

namespace convoy::simulator {
namespace {

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

// Slip angle of the rear axle: lateral force / load over the cornering stiffness, outwards. The velocity is that before
// the step's own turn.
TEST(VehiclePhysics, TyresDriftOutwardsInABend) {
  const Slope level;
  VehiclePhysics vehicle({}, level, 0.0, 0.0, 0.0);
  hold_speed(vehicle, 6.0, 12.0, 0.15);
  const VehicleState& state = vehicle.state();
  const Eigen::Vector3d velocity = state.T_world_body.linear().transpose() * state.velocity_world_mps;
  const double yaw_rate = state.turn_body_radps.z();
  const double model = state.speed_mps * yaw_rate / g / vehicle.params().cornering_stiffness;
  EXPECT_NEAR(-velocity.y() / velocity.x() - yaw_rate / per_second, model, 0.05 * model);
}

// Mass times lateral acceleration times lever, over the stiffness of springs and bars: within 10 %.
TEST(VehiclePhysics, RollsAsFarAsSpringsAndBarsAllow) {
  for (double anti_roll_npm : {0.0, 12000.0, 40000.0}) {
    const Slope level;
    VehicleParams p;
    p.anti_roll_npm = anti_roll_npm;
    VehiclePhysics vehicle(p, level, 0.0, 0.0, 0.0);
    hold_speed(vehicle, 6.0, 15.0, 0.15);
    const double acceleration = vehicle.state().speed_mps * vehicle.state().turn_body_radps.z();
    const double spring_npm = 0.25 * p.mass_kg * g / p.deflection_m;
    const double stiffness = spring_npm * p.track_m * p.track_m + 2.0 * anti_roll_npm * p.track_m * p.track_m;
    const double model = p.mass_kg * acceleration * p.centre_height_m / (stiffness - p.mass_kg * g * p.centre_height_m);
    EXPECT_NEAR(vehicle.state().roll_rad(), model, 0.1 * model) << anti_roll_npm;
  }
}

TEST(VehiclePhysics, CoastsToAStandBySlowDegrees) {
  const Slope level;
  VehiclePhysics vehicle({}, level, 0.0, 0.0, 0.0);
  hold_speed(vehicle, 5.0, 10.0);
  const double speed = vehicle.state().speed_mps;
  run(vehicle, {}, 10.0);
  EXPECT_NEAR(vehicle.state().speed_mps, speed - 10.0 * 0.012 * g, 0.02);
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

TEST(VehiclePhysics, DrivesBackwards) {
  for (const VehicleParams& params : {VehicleParams{}, robot_params()}) {
    const Slope level;
    VehiclePhysics vehicle(params, level, 0.0, 0.0, 0.0);
    DriveCommand back;
    back.drive_mps2 = -1.0;
    run(vehicle, back, 2.0);
    EXPECT_NEAR(vehicle.state().speed_mps, -2.0, 0.3);
    back.drive_mps2 = 0.0;
    back.brake_mps2 = 2.0;
    run(vehicle, back, 2.0);
    EXPECT_NEAR(vehicle.state().speed_mps, 0.0, 1e-6);
    EXPECT_LT(position(vehicle).x(), -2.0);
    EXPECT_NEAR(vehicle.state().wheels[RearLeft].angle_rad * params.wheel_radius_m, position(vehicle).x(), 0.01);
  }
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

struct Ledge final : Ground {
  double height_m(double x_m, double) const override { return x_m < 10.0 ? 0.0 : -3.0; }
};

// Off a ledge of three metres: springs go to their stops, and no corner of the body goes into the ground.
TEST(VehiclePhysics, FallsOnTheGroundNotThroughIt) {
  for (const VehicleParams& p : {VehicleParams{}, robot_params()}) {
    const Ledge ledge;
    VehiclePhysics vehicle(p, ledge, 0.0, 0.0, 0.0);
    double lowest_m = 1.0, deepest_m = 0.0;
    for (int i = 0; i < 10 * per_second; ++i) {
      vehicle.step(at_speed(vehicle, 8.0));
      if (position(vehicle).x() < 10.0 + p.length_m) continue;
      for (int corner = 0; corner < 8; ++corner) {
        const Eigen::Vector3d at =
            vehicle.state().T_world_body * Eigen::Vector3d(0.5 * p.wheelbase_m + (corner & 1 ? 0.5 : -0.5) * p.length_m,
                                                           (corner & 2 ? 0.5 : -0.5) * p.width_m,
                                                           corner & 4 ? p.height_m : p.clearance_m);
        const Eigen::Vector3d foot =
            vehicle.state().T_world_body *
            Eigen::Vector3d(corner & 1 ? p.wheelbase_m : 0.0, (corner & 2 ? 0.5 : -0.5) * p.track_m, 0.0);
        lowest_m = std::min(lowest_m, at.z() + 3.0);
        deepest_m = std::max(deepest_m, -3.0 - foot.z());
      }
    }
    EXPECT_GT(position(vehicle).x(), 20.0);
    EXPECT_GT(lowest_m, -0.05);
    EXPECT_LT(deepest_m, p.travel_m + 0.02);
    EXPECT_NEAR(vehicle.state().roll_rad(), 0.0, 0.05);
  }
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

}  // namespace
}  // namespace convoy::simulator
