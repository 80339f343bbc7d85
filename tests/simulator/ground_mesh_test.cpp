#include "ground_mesh.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace convoy::simulator {
namespace {

TEST(GroundMesh, CoversTheGroundOnce) {
  const StreetNetwork network({{{{-60, 0}, {60, 10}}, 4.0, 2, true, 1}, {{{0, -60}, {10, 60}}, 5.0, 2, true, 2}});
  const Terrain terrain(1, {-80, -80}, {80, 80}, network);
  for (const bool close : {true, false}) {
    SceneBuilder builder;
    GroundMesh(terrain).build(builder, {0, 1, 2, 3}, [&](const Eigen::Vector2d&) { return close; });
    const Scene scene = builder.finish();
    std::array<double, 4> areas{};
    double kerb_faces = 0.0;
    for (const Mesh& mesh : scene.meshes) {
      for (const auto& t : mesh.triangles) {
        const Eigen::Vector3f a = mesh.vertices[t[0]].position, b = mesh.vertices[t[1]].position;
        const Eigen::Vector3f c = mesh.vertices[t[2]].position;
        if (std::max({a.norm(), b.norm(), c.norm()}) > 200.0F) continue;  // the land around
        const Eigen::Vector3f doubled = (b - a).cross(c - a);
        EXPECT_GT(doubled.z(), -1e-3F);
        areas.at(mesh.texture) += 0.5 * static_cast<double>(doubled.z());
        if (mesh.shade < 0.9F) kerb_faces += 0.5 * static_cast<double>(doubled.norm());
      }
    }
    EXPECT_NEAR(areas[0] + areas[1] + areas[2] + areas[3], 160.0 * 160.0, 1.0);
    // Two streets with round ends, less their crossing, and with its rounded corners.
    EXPECT_NEAR(areas[0], 120.4 * 8 + 120.4 * 10 + M_PI * (16 + 25) - 80.0, 40.0);
    EXPECT_NEAR(kerb_faces / Terrain::kerb_m, 4 * 120.4 + 2 * M_PI * 9 - 36.0, 30.0);
  }
}

TEST(GroundMesh, LiesOnTheTerrainAtItsCorners) {
  const Terrain terrain(1, {-80, -80}, {80, 80}, StreetNetwork({}));
  const GroundMesh ground(terrain);
  for (double x = -80; x < 80; x += 4) EXPECT_NEAR(ground.bed_m({x, 8}), terrain.bed_m(x, 8), 1e-9);
  for (double x = -80; x < 80; x += 0.3) EXPECT_NEAR(ground.bed_m({x, 9.1}), terrain.bed_m(x, 9.1), 0.03);
}

}  // namespace
}  // namespace convoy::simulator
