#include "district.hpp"

#include "polyline.hpp"
#include "traffic.hpp"
#include "world_checks.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace convoy::simulator {
namespace {

DistrictParams coarse() {
  DistrictParams params;
  params.detail.close_texel_m = 0.05;
  return params;
}

const World& district() {
  static const World world = make_district(1, coarse());
  return world;
}

TEST(District, IsTheSameForASeed) {
  EXPECT_EQ(hash_of(make_district(1, coarse()).scene), hash_of(district().scene));
  EXPECT_NE(hash_of(make_district(2, coarse()).scene), hash_of(district().scene));
}

TEST(District, IsSound) { expect_sound(district().scene); }

TEST(District, HasRoutesThatACarCanDrive) {
  for (std::uint32_t seed = 1; seed <= 20; ++seed) {
    const StreetPlan plan = plan_district(seed);
    ASSERT_EQ(plan.routes.size(), 4U);
    const Route& loop = plan.routes[0];
    EXPECT_TRUE(loop.closed);
    EXPECT_GE(length_m(loop.points, true), 400.0) << "seed " << seed;
    EXPECT_LE(length_m(loop.points, true), 600.0) << "seed " << seed;
    const StreetNetwork network(plan.streets);
    for (const Route& route : plan.routes) expect_drivable(route, network, plan.footprints);
    NearLines first(10.0);
    first.add(loop.points, true);
    for (const Eigen::Vector2d& point : plan.routes[1].points) EXPECT_NEAR(first.distance_m(point), 2.0, 0.15);
  }
}

TEST(District, HousesDoNotOverlap) {
  const StreetPlan plan = plan_district(3);
  EXPECT_GT(plan.footprints.size(), 40U);
  for (const Outline& a : plan.footprints) {
    EXPECT_GT(signed_area_m2(a.corners), 0.0);
    EXPECT_FALSE(crosses_itself(a.corners));
  }
}

TEST(District, ParkedThingsKeepOffTheRoutes) {
  // Whatever is solid above the ground stays 1.2 m away from every route; trees and lamps may hang over it.
  const World& world = district();
  NearLines routes(10.0);
  for (const Route& route : world.routes) routes.add(route.points, route.closed);
  for (const Mesh& mesh : world.scene.meshes) {
    for (const Vertex& vertex : mesh.vertices) {
      const Eigen::Vector3d p = vertex.position.cast<double>();
      const double above = p.z() - world.ground->height_m(p.x(), p.y());
      if (above > 0.3 && above < 2.0) {
        EXPECT_GT(routes.distance_m(p.head<2>()), 1.2) << p.transpose();
      }
    }
  }
}

TEST(District, GroundIsUnevenByMillimetresAndKerbsAreAKerbHigh) {
  const World& world = district();
  const Route& loop = world.routes[0];
  double largest = 0.0, steepest = 0.0;
  for (std::size_t i = 10; i + 10 < loop.points.size(); ++i) {
    const auto z = [&](std::size_t k) { return world.ground->height_m(loop.points[k].x(), loop.points[k].y()); };
    largest = std::max(largest, std::abs(z(i) - 0.5 * (z(i - 2) + z(i + 2))));
    steepest = std::max(steepest, std::abs(z(i + 10) - z(i - 10)) / 10.0);
  }
  EXPECT_GT(largest, 0.002);
  EXPECT_LT(largest, 0.03);
  EXPECT_GT(steepest, 0.005);
  EXPECT_LT(steepest, 0.08);
}

TEST(District, DrawnGroundIsTheDrivenOne) {
  const World& world = district();
  const Texture& road = world.scene.textures[0];
  ASSERT_EQ(road.width, 1024);
  int vertices = 0;
  for (const Mesh& mesh : world.scene.meshes) {
    if (mesh.texture != 0) continue;
    for (const Vertex& vertex : mesh.vertices) {
      const Eigen::Vector3d p = vertex.position.cast<double>();
      const double height = world.ground->height_m(p.x(), p.y());
      // On the edge itself the ground is somewhere on the kerb's ramp.
      EXPECT_LT(p.z() - height, 0.02);
      EXPECT_GT(p.z() - height, -0.02 - Terrain::kerb_m);
      ++vertices;
    }
  }
  EXPECT_GT(vertices, 1000);
}

TEST(District, RefusesParametersOutOfRange) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const double value : {0.0, -1.0, 1e9, nan}) {
    for (double DistrictParams::*member :
         {&DistrictParams::width_m, &DistrictParams::depth_m, &DistrictParams::half_width_m}) {
      DistrictParams params;
      params.*member = value;
      EXPECT_THROW(plan_district(1, params), std::runtime_error) << value;
    }
  }
  DistrictParams params;
  params.gap_share = -0.1;
  EXPECT_THROW(plan_district(1, params), std::runtime_error);
}

TEST(Traffic, IsAFunctionOfTimeAndKeepsToItsRoute) {
  World world = make_district(1, coarse()), still = make_district(1, coarse());
  Traffic traffic(world, 5);
  EXPECT_EQ(Traffic(still, 5, {.cars = 0}).size(), 0U);
  EXPECT_EQ(hash_of(still.scene), hash_of(district().scene));
  ASSERT_EQ(traffic.size(), 4U);
  ASSERT_EQ(world.scene.objects.size(), 4U);
  expect_sound(world.scene);
  const auto poses = [&](double time_s) {
    traffic.set(time_s);
    std::vector<Eigen::Matrix4d> all;
    for (const Object& object : world.scene.objects) all.push_back(object.T_world_object.matrix());
    return all;
  };
  const auto at_ten = poses(10.0), at_three = poses(3.0);
  EXPECT_EQ(poses(10.0), at_ten);
  NearLines route(10.0);
  route.add(world.routes[2].points, true);
  for (std::size_t i = 0; i < 4; ++i) {
    const Eigen::Vector3d a = at_three[i].topRightCorner<3, 1>(), b = at_ten[i].topRightCorner<3, 1>();
    EXPECT_LT(route.distance_m(a.head<2>()), 0.5);
    EXPECT_LT((b - a).norm(), 7.0 * 9.0 + 0.1);
    EXPECT_NEAR(a.z(), world.ground->height_m(a.x(), a.y()), 0.05);
    const Eigen::Matrix3d rotation = at_ten[i].topLeftCorner<3, 3>();
    EXPECT_NEAR(rotation.determinant(), 1.0, 1e-9);
    EXPECT_GT(rotation(2, 2), 0.99);
    for (std::size_t k = 0; k < i; ++k)
      EXPECT_GT((a - Eigen::Vector3d(at_three[k].topRightCorner<3, 1>())).norm(), 6.0) << "cars in one another";
  }
}

TEST(Traffic, RefusesWhatCannotBe) {
  World world;
  world.routes = {{"open", {{0, 0}, {10, 0}}, false}};
  EXPECT_THROW(Traffic(world, 1, {.cars = -1}), std::runtime_error);
  EXPECT_THROW(Traffic(world, 1, {.on = {"open"}}), std::runtime_error);
  EXPECT_THROW(Traffic(world, 1, {.on = {"nowhere"}}), std::runtime_error);
  EXPECT_THROW(Traffic(world, 1, {.slowest_mps = 9.0, .fastest_mps = 5.0}), std::runtime_error);
  EXPECT_EQ(Traffic(world, 1).size(), 0U);
}

}  // namespace
}  // namespace convoy::simulator
