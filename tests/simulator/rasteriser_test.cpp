#include "rasteriser.hpp"

#include "random.hpp"
#include "test_street.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>

namespace convoy::simulator {
namespace {

Texture plain(std::uint8_t grey) { return {2, 2, {grey, grey, grey, grey}}; }

/// A square of the plane x = ahead, seen from the origin's side; or from the other.
Mesh board(double ahead, double half, TextureId texture, bool from_behind = false) {
  const auto x = static_cast<float>(ahead), h = static_cast<float>(half);
  Mesh mesh;
  mesh.texture = texture;
  mesh.vertices = {
      {{x, h, 1.5F + h}, {0, 0}}, {{x, h, 1.5F - h}, {0, 1}}, {{x, -h, 1.5F - h}, {1, 1}}, {{x, -h, 1.5F + h}, {1, 0}}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  if (from_behind) mesh.triangles = {{0, 2, 1}, {0, 3, 2}};
  return mesh;
}

Scene boards(std::vector<Mesh> meshes) {
  Scene scene;
  scene.textures = {plain(10), plain(100), plain(200)};
  scene.meshes = std::move(meshes);
  return scene;
}

float middle(const Scene& scene) { return Rasteriser(scene, Lens(LensParams{})).render(test_pose(0.0)).at(320, 240); }

TEST(Rasteriser, WhatIsNearerHidesWhateverTheOrder) {
  EXPECT_FLOAT_EQ(middle(boards({board(5, 1, 1), board(9, 1, 2)})), 100.0F);
  EXPECT_FLOAT_EQ(middle(boards({board(9, 1, 2), board(5, 1, 1)})), 100.0F);
  EXPECT_FLOAT_EQ(middle(boards({board(9, 1, 2), board(5, 1, 1, true)})), 200.0F) << "from behind";
  EXPECT_FLOAT_EQ(middle(boards({board(-5, 1, 1)})), 10.0F) << "sky";
  Mesh shaded = board(5, 1, 1);
  shaded.shade = 0.5F;
  EXPECT_FLOAT_EQ(middle(boards({shaded})), 50.0F);
}

TEST(Rasteriser, DepthIsThatOfTheWorldPoint) {
  const Scene scene = test_street();
  Rasteriser rasteriser(scene, Lens(LensParams{}));
  const Eigen::Isometry3d pose = test_pose(40.3, 2.2, 33.0);
  rasteriser.render(pose);
  int pixels = 0, others = 0, skies = 0;
  for (int y = 0; y < 480; y += 5)
    for (int x = 0; x < 640; x += 5) {
      const auto point = rasteriser.world_point(x, y);
      const double depth = rasteriser.depth(x, y), exact = point ? (pose.inverse() * *point).z() : 0.0;
      ++pixels;
      skies += depth == 0.0;
      others += std::abs(depth - exact) > 1e-4 * exact;  // an edge, at which a ray of floats meets what is beside it
    }
  EXPECT_LE(others, pixels / 1000);
  EXPECT_GT(skies, 100);
  EXPECT_LT(skies, pixels / 2);
}

TEST(Rasteriser, ADecalWinsOverWhatItLiesOnAndNotOverWhatIsInFront) {
  for (const double distance : {0.5, 5.0, 50.0, 300.0}) {
    Mesh decal = board(distance, 0.4 * distance, 2);
    decal.bias = 0.02F;
    const Mesh wall = board(distance, 0.5 * distance, 1), front = board(distance - 0.1, 0.3 * distance, 1);
    EXPECT_FLOAT_EQ(middle(boards({wall, decal})), 200.0F) << distance;
    EXPECT_FLOAT_EQ(middle(boards({decal, wall})), 200.0F) << distance;
    EXPECT_FLOAT_EQ(middle(boards({decal, wall, front})), 100.0F) << distance;
    const Scene scene = boards({wall, decal});
    Rasteriser rasteriser(scene, Lens(LensParams{}));
    rasteriser.render(test_pose(0.0));
    EXPECT_NEAR(rasteriser.world_point(320, 240)->x(), distance, 1e-4 * distance) << "the bias does not move it";
  }
}

TEST(Rasteriser, WorldPointsAreOnTheWallsTheyAreOf) {
  const Scene scene = test_street();
  for (const LensParams& lens : {LensParams{}, LensParams::small()}) {
    Rasteriser rasteriser(scene, Lens(lens));
    Stream stream({8, 0, 0, 0});
    int walls = 0, ground = 0, skies = 0;
    for (const Eigen::Isometry3d& pose : {test_pose(1.0), test_pose(40.3, 2.2, 33.0), test_pose(60.0, -3.0, -75.0)}) {
      rasteriser.render(pose);
      for (int i = 0; i < 2000; ++i) {
        const double u = stream.uniform(-0.5, lens.width - 0.5), v = stream.uniform(-0.5, lens.height - 0.5);
        const auto hit = rasteriser.hit(u, v);
        const Eigen::Vector2d flat = rasteriser.lens().ray_of({u, v});
        const Eigen::Vector3d ray = pose.linear() * Eigen::Vector3d(flat.x(), flat.y(), 1.0), from = pose.translation();
        if (!hit) {
          EXPECT_GT(ray.z(), 0.0);
          ++skies;
          continue;
        }
        const auto pixel = rasteriser.project(hit->p_world);
        ASSERT_TRUE(pixel);
        EXPECT_LT((*pixel - Eigen::Vector2d(u, v)).norm(), 1e-6);
        EXPECT_TRUE(rasteriser.visible(hit->p_world, 0.001));
        if (hit->object || hit->mesh + 1 == scene.meshes.size()) continue;
        // Left wall, right wall, road, paint: the planes y = 10, y = -10, z = 0, z = 0.
        const int axis = hit->mesh % 4 < 2 ? 1 : 2;
        const double plane = hit->mesh % 4 == 0 ? 10.0 : hit->mesh % 4 == 1 ? -10.0 : 0.0;
        const Eigen::Vector3d exact = from + ray * ((plane - from[axis]) / ray[axis]);
        (axis == 1 ? walls : ground) += 1;
        EXPECT_LT((hit->p_world - exact).norm(), 0.005 * std::max(1.0, (exact - from).norm() / 30.0)) << u << " " << v;
      }
    }
    EXPECT_GT(walls, 500);
    EXPECT_GT(ground, 500);
    EXPECT_GT(skies, 100);
  }
}

TEST(Rasteriser, AnObjectMovesAndHidesWhatIsBehindIt) {
  Scene scene = test_street();
  Rasteriser rasteriser(scene, Lens(LensParams{}));
  rasteriser.render(test_pose(0.0));
  const Eigen::Vector2d at = *rasteriser.project({11.9, 3.2, 0.7});
  const auto hit = rasteriser.hit(at.x(), at.y());
  ASSERT_TRUE(hit && hit->object);
  EXPECT_EQ(*hit->object, 0U);
  EXPECT_NEAR(hit->p_world.x(), 11.9, 1e-4);
  const Eigen::Vector3d wall_point(30.0, 10.0, 1.4);
  scene.objects[0].T_world_object.translation() = wall_point * 0.4;
  scene.objects[0].T_world_object.translation().z() = 0.6;
  rasteriser.render(test_pose(0.0));
  EXPECT_FALSE(rasteriser.visible(wall_point));
  EXPECT_TRUE(rasteriser.project(wall_point));
  scene.objects[0].T_world_object.translation().x() = -50.0;
  rasteriser.render(test_pose(0.0));
  EXPECT_TRUE(rasteriser.visible(wall_point));
  EXPECT_FALSE(rasteriser.visible({-5.0, 0.0, 0.0})) << "behind the camera";
}

// The light of a pixel is that of its world point: grey runs along the wall.
TEST(Rasteriser, TexturesAreInPerspective) {
  Scene scene = boards({board(8, 6, 1)});
  Texture ramp{512, 2, {}};
  for (int i = 0; i < 1024; ++i) ramp.grey.push_back(static_cast<std::uint8_t>((i % 512) / 2));
  scene.textures[1] = ramp;
  Rasteriser rasteriser(scene, Lens(LensParams{}));
  for (const double turn : {0.0, 35.0, -35.0}) {
    const LightImage& light = rasteriser.render(test_pose(2.0, 3.0, turn));
    int seen = 0;
    for (int y = 0; y < light.height; y += 7)
      for (int x = 0; x < light.width; x += 7) {
        const auto p = rasteriser.world_point(x, y);
        if (!p || std::abs(p->y()) > 5.5 || std::abs(p->z() - 1.5) > 5.5) continue;
        const double u = (6.0 - p->y()) / 12.0;
        ASSERT_NEAR(light.at(x, y), 256.0 * u - 0.75, 1.5) << x << " " << y;
        ++seen;
      }
    EXPECT_GT(seen, 500) << turn;
  }
}

TEST(Rasteriser, GroundUnderTheCameraHasNoHoles) {
  const Scene scene = test_street(36.0, 20);
  Rasteriser rasteriser(scene, Lens(LensParams{}));
  for (double x = 3.0; x < 20.0; x += 1.37) {
    rasteriser.render(test_pose(x, 0.3, x * 3.0));
    for (int v = 300; v < 480; ++v)
      for (int u = 0; u < 640; ++u) ASSERT_TRUE(rasteriser.hit(u, v)) << x << ": " << u << " " << v;
  }
}

TEST(Rasteriser, SaysWhatIsWrongWithAScene) {
  const auto refused = [](auto change) {
    Scene scene = boards({board(5, 1, 1)});
    change(scene);
    EXPECT_THROW(Rasteriser(scene, Lens(LensParams{})), std::invalid_argument);
  };
  refused([](Scene& s) { s.textures.clear(); });
  refused([](Scene& s) { s.sky = 3; });
  refused([](Scene& s) { s.meshes[0].texture = 3; });
  refused([](Scene& s) { s.meshes[0].triangles[0][1] = 4; });
  refused([](Scene& s) { s.meshes[0].vertices[0].position.x() = NAN; });
  RasteriserParams params;
  params.near_m = 0.0;
  EXPECT_THROW(params.validate(), std::invalid_argument);
}

}  // namespace
}  // namespace convoy::simulator
