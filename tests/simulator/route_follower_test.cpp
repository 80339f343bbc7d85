#include "route_follower.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

namespace convoy::simulator {
namespace {

struct Level final : Ground {
  double height_m(double, double) const override { return 0.0; }
};
struct Uneven final : Ground {
  double height_m(double x_m, double y_m) const override {
    return 0.03 * x_m + 0.02 * std::sin(2.0 * x_m) * std::sin(1.7 * y_m);
  }
};

/// Straights of 60 m, half circles of 12 m radius, counter-clockwise.
Route oval() {
  Route route{"oval", {}, true};
  for (double x = -30.0; x < 30.0; x += 0.5) route.points.emplace_back(x, -12.0);
  for (double a = -M_PI / 2; a < M_PI / 2; a += 0.04)
    route.points.emplace_back(30 + 12 * std::cos(a), 12 * std::sin(a));
  for (double x = 30.0; x > -30.0; x -= 0.5) route.points.emplace_back(x, 12.0);
  for (double a = M_PI / 2; a < 1.5 * M_PI; a += 0.04)
    route.points.emplace_back(-30 + 12 * std::cos(a), 12 * std::sin(a));
  return route;
}

/// A square of 30 m, its corners of the radius; 0: of four points. Crosses nothing.
Route square(double radius_m) {
  Route route{"square", {}, true};
  const double inner = 15.0 - radius_m;
  for (int corner = 0; corner < 4; ++corner) {
    const double from = -M_PI / 2 + corner * M_PI / 2;
    const Eigen::Vector2d middle(corner == 0 || corner == 1 ? inner : -inner,
                                 corner == 1 || corner == 2 ? inner : -inner);
    for (int i = 0; i <= (radius_m > 0.0 ? 20 : 0); ++i) {
      const double a = from + i * M_PI / 40;
      if (radius_m > 0.0) route.points.push_back(middle + radius_m * Eigen::Vector2d(std::cos(a), std::sin(a)));
      else route.points.push_back(middle);
    }
  }
  return route;
}

/// Crosses itself in the middle.
Route eight() {
  Route route{"eight", {}, true};
  for (int i = 0; i < 400; ++i) {
    const double t = i * 2.0 * M_PI / 400;
    route.points.emplace_back(30.0 * std::sin(t), 15.0 * std::sin(2.0 * t));
  }
  return route;
}

struct Drive {
  double worst_error_m = 0.0, worst_lateral_mps2 = 0.0, top_mps = 0.0, distance_m = 0.0, standing_s = 0.0;
  std::vector<double> stops_m;
  bool finished = false;
};

Drive drive(const Route& route, const RouteFollowerParams& params, double seconds, const VehicleParams& kind = {},
            const Ground& ground = Level(), double start_m = 0.0) {
  RouteFollower follower(route, params, kind);
  const RouteFollower::Start start = follower.start(start_m);
  VehiclePhysics vehicle(kind, ground, start.x_m, start.y_m, start.yaw_rad);
  Drive result;
  bool waited = false;
  for (int i = 0; i < static_cast<int>(240 * seconds) && !follower.finished(); ++i) {
    vehicle.step(follower.step(vehicle.state()));
    const VehicleState& state = vehicle.state();
    result.worst_error_m = std::max(result.worst_error_m, std::abs(follower.lateral_error_m()));
    result.top_mps = std::max(result.top_mps, state.speed_mps);
    result.worst_lateral_mps2 =
        std::max(result.worst_lateral_mps2, std::abs(state.speed_mps * state.turn_body_radps.z()));
    if (std::abs(state.speed_mps) < 0.01) result.standing_s += 1.0 / 240;
    if (follower.waiting() && !waited) result.stops_m.push_back(follower.driven_m());
    waited = follower.waiting();
  }
  result.finished = follower.finished();
  result.distance_m = follower.driven_m();
  return result;
}

TEST(RouteFollower, KeepsToAnOval) {
  for (double speed_mps : {2.0, 5.0, 10.0}) {
    RouteFollowerParams params;
    params.speed_mps = speed_mps;
    params.laps = 2;
    const Drive result = drive(oval(), params, 400.0);
    EXPECT_TRUE(result.finished);
    EXPECT_LT(result.worst_error_m, 0.3) << speed_mps;
    EXPECT_NEAR(result.top_mps, speed_mps, 0.15);
    EXPECT_LT(result.worst_lateral_mps2, 1.25 * params.lateral_acceleration_mps2) << speed_mps;
    EXPECT_NEAR(result.distance_m, 2 * (120.0 + 24.0 * M_PI), 0.5);
    RecordProperty("worst_error_mm_at_" + std::to_string(static_cast<int>(speed_mps)),
                   static_cast<int>(1000.0 * result.worst_error_m));
  }
}

TEST(RouteFollower, KeepsToSharpCornersAndCrossings) {
  for (double speed_mps : {2.0, 6.0}) {
    RouteFollowerParams params;
    params.speed_mps = speed_mps;
    params.laps = 1;
    for (const Route& route : {square(5.0), eight()}) {
      const Drive result = drive(route, params, 300.0);
      EXPECT_TRUE(result.finished) << route.name;
      EXPECT_LT(result.worst_error_m, 0.3) << route.name << ' ' << speed_mps;
    }
  }
}

TEST(RouteFollower, KeepsToTheLineBesideTheRoute) {
  for (double offset_m : {2.0, -2.0}) {
    RouteFollowerParams params;
    params.speed_mps = 4.0;
    params.laps = 1;
    params.offset_m = offset_m;
    for (const Route& route : {oval(), square(8.0), eight()}) {
      const Drive result = drive(route, params, 300.0);
      EXPECT_TRUE(result.finished) << route.name;
      EXPECT_LT(result.worst_error_m, 0.3) << route.name << ' ' << offset_m;
    }
    const RouteLine line(oval(), offset_m);
    EXPECT_NEAR(line.point(line.way_of_abscissa_m(30.0)).y(), -12.0 + offset_m, 1e-9);
    EXPECT_NEAR(line.abscissa_m(line.way_of_abscissa_m(500.0)), 500.0, 1e-6);
    EXPECT_NEAR(line.length_m(), 120.0 + (12.0 - offset_m) * 2.0 * M_PI, 0.1);
  }
}

// Inside of a sharp corner, the line beside the route is cut where its two sides meet.
TEST(RouteFollower, LineInsideOfACornerHasNoLoop) {
  const RouteLine line(square(0.0), 2.0);
  EXPECT_NEAR(line.length_m(), 4 * 26.0, 1.0);
}

TEST(RouteFollower, RobotTurnsOnTheSpotAtCorners) {
  RouteFollowerParams params;
  params.speed_mps = 1.0;
  params.laps = 1;
  const Drive result = drive(square(0.0), params, 400.0, robot_params());
  EXPECT_TRUE(result.finished);
  EXPECT_LT(result.worst_error_m, 0.1);
  EXPECT_GT(result.standing_s, 3.0);
  const Drive bends = drive(oval(), params, 400.0, robot_params());
  EXPECT_TRUE(bends.finished);
  EXPECT_LT(bends.worst_error_m, 0.1);
}

TEST(RouteFollower, RobotTurnsRoundToTheWayItHasToGo) {
  Route line{"line", {{0.0, 0.0}, {20.0, 0.0}}, false};
  RouteFollower follower(line, {}, robot_params());
  const Level level;
  VehiclePhysics robot(robot_params(), level, 1.0, 0.1, 3.0);
  for (int i = 0; i < 240 * 30 && !follower.finished(); ++i) robot.step(follower.step(robot.state()));
  EXPECT_TRUE(follower.finished());
  EXPECT_NEAR(robot.state().T_world_body.translation().x(), 20.0, 0.1);
}

TEST(RouteFollower, StopsAndGoes) {
  RouteFollowerParams params;
  params.speed_mps = 5.0;
  params.laps = 2;
  params.stops = {{20.0, 3.0}, {45.5, 5.0}, {250.0, 2.0}};
  const Drive result = drive(oval(), params, 400.0, {}, Uneven(), 37.0);
  EXPECT_TRUE(result.finished);
  ASSERT_EQ(result.stops_m.size(), params.stops.size());
  for (std::size_t i = 0; i < params.stops.size(); ++i) EXPECT_NEAR(result.stops_m[i], params.stops[i].at_m, 0.1);
  EXPECT_NEAR(result.standing_s, 10.0, 2.0);
  EXPECT_LT(result.worst_error_m, 0.3);
}

TEST(RouteFollower, StopsAtTheEndOfAnOpenRoute) {
  Route line{"line", {}, false};
  for (int i = 0; i <= 100; ++i) line.points.emplace_back(0.6 * i, 3.0 * std::sin(0.03 * i));
  RouteFollowerParams params;
  params.speed_mps = 8.0;
  const Drive result = drive(line, params, 60.0);
  EXPECT_TRUE(result.finished);
  EXPECT_LT(result.worst_error_m, 0.3);
  EXPECT_NEAR(result.distance_m, RouteLine(line, 0.0).length_m(), 0.1);
}

TEST(RouteFollower, TellsTheAbscissaOfTheRoute) {
  RouteFollowerParams params;
  params.speed_mps = 5.0;
  params.offset_m = -2.0;
  RouteFollower follower(oval(), params, {});
  const RouteFollower::Start start = follower.start(10.0);
  const Level level;
  VehiclePhysics vehicle({}, level, start.x_m, start.y_m, start.yaw_rad);
  follower.step(vehicle.state());
  EXPECT_NEAR(follower.abscissa_m(), 10.0, 1e-3);
  const double lap = RouteLine(oval(), 0.0).length_m();
  while (follower.driven_m() < lap) {
    vehicle.step(follower.step(vehicle.state()));
    ASSERT_LT(vehicle.state().time_s, 120.0);
    ASSERT_GE(follower.abscissa_m(), 0.0);
    ASSERT_LE(follower.abscissa_m(), lap);
  }
  EXPECT_NEAR(follower.abscissa_m(), 10.0, 0.1);
}

TEST(RouteFollower, TakesTheWayItHeadsForWhereTwoCross) {
  const RouteLine line(eight(), 0.0);
  const double half = 0.5 * line.length_m();
  for (double way_m : {half - 0.3, half + 0.3, 0.3}) {
    const RouteLine::Place place = line.find(line.point(way_m), line.heading_rad(way_m));
    EXPECT_NEAR(place.way_m, way_m, 0.01);
    EXPECT_NEAR(place.left_m, 0.0, 1e-9);
  }
  // Nearer to the other branch, which leads back.
  Route there_and_back{"there and back", {{0, 0}, {20, 0}, {20, 1}, {0, 1}}, false};
  const RouteLine narrow(there_and_back, 0.0);
  EXPECT_NEAR(narrow.find({5.0, 0.7}, 0.0).way_m, 5.0, 1e-9);
  EXPECT_NEAR(narrow.find({5.0, 0.3}, 3.0).way_m, 36.0, 1e-9);
}

TEST(RouteFollower, RefusesWhatIsNoRoute) {
  const auto text_of = [](const Route& route, double offset_m = 0.0) -> std::string {
    try {
      const RouteLine line(route, offset_m);
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_NE(text_of({"none", {}, false}).find("Route \"none\""), std::string::npos);
  EXPECT_NE(text_of({"one", {{1, 1}, {1, 1}}, false}).find("too few"), std::string::npos);
  EXPECT_NE(text_of({"nan", {{1, 1}, {2, std::nan("")}, {3, 3}}, false}).find("point 1"), std::string::npos);
  Route circle{"circle", {}, true};
  for (int i = 0; i < 20; ++i) circle.points.emplace_back(std::cos(i * M_PI / 10), std::sin(i * M_PI / 10));
  EXPECT_NE(text_of(circle, 2.0).find("offset"), std::string::npos);
  RouteFollowerParams fast;
  fast.speed_mps = 40.0;
  EXPECT_THROW(RouteFollower(oval(), fast, {}), std::invalid_argument);
  RouteFollowerParams disorder;
  disorder.stops = {{20.0, 1.0}, {10.0, 1.0}};
  EXPECT_THROW(disorder.validate(), std::invalid_argument);
}

}  // namespace
}  // namespace convoy::simulator
