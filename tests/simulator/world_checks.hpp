// What tests of worlds have in common.
#pragma once

#include "polyline.hpp"
#include "street_network.hpp"
#include "world.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>

namespace convoy::simulator {

/// FNV-1a over all that is drawn.
inline std::uint64_t hash_of(const Scene& scene) {
  std::uint64_t hash = 0xcbf29ce484222325ULL;
  const auto add = [&](const void* data, std::size_t size) {
    const auto* bytes = static_cast<const unsigned char*>(data);
    for (std::size_t i = 0; i < size; ++i) hash = (hash ^ bytes[i]) * 0x100000001b3ULL;
  };
  for (const Texture& texture : scene.textures) {
    add(&texture.width, sizeof texture.width);
    add(texture.grey.data(), texture.grey.size());
  }
  for (const Mesh& mesh : scene.meshes) {
    add(&mesh.texture, sizeof mesh.texture);
    add(&mesh.shade, sizeof mesh.shade);
    for (const Vertex& vertex : mesh.vertices) {
      add(vertex.position.data(), 3 * sizeof(float));
      add(vertex.uv.data(), 2 * sizeof(float));
    }
    add(mesh.triangles.data(), mesh.triangles.size() * sizeof mesh.triangles[0]);
  }
  return hash;
}

inline void expect_sound(const Mesh& mesh, std::size_t textures) {
  ASSERT_LT(mesh.texture, textures);
  EXPECT_FALSE(mesh.triangles.empty());
  for (const Vertex& vertex : mesh.vertices) {
    ASSERT_TRUE(vertex.position.allFinite() && vertex.uv.allFinite());
    ASSERT_LT(vertex.position.norm(), 5000.0F);
  }
  for (const auto& triangle : mesh.triangles)
    for (const std::uint32_t corner : triangle) ASSERT_LT(corner, mesh.vertices.size());
}

inline void expect_sound(const Scene& scene) {
  ASSERT_FALSE(scene.meshes.empty());
  ASSERT_LT(scene.sky, scene.textures.size());
  std::size_t bytes = 0;
  for (const Texture& texture : scene.textures) {
    ASSERT_GE(texture.width, 1);
    ASSERT_EQ(texture.grey.size(), static_cast<std::size_t>(texture.width) * static_cast<std::size_t>(texture.height));
    bytes += texture.grey.size();
  }
  EXPECT_LT(bytes, 220'000'000U);  // and a third more of it as mipmaps
  for (const Mesh& mesh : scene.meshes) expect_sound(mesh, scene.textures.size());
  for (const Object& object : scene.objects)
    for (const Mesh& mesh : object.meshes) expect_sound(mesh, scene.textures.size());
}

/// Bends of 5 m, on the road, away from walls.
inline void expect_drivable(const Route& route, const StreetNetwork& network, const std::vector<Outline>& footprints,
                            double radius_m = 5.0) {
  NearLines walls(10.0);
  for (const Outline& footprint : footprints) walls.add(footprint.corners, true);
  EXPECT_GE(smallest_radius_m(route.points, route.closed), radius_m) << route.name;
  for (std::size_t i = 0; i + 1 < route.points.size(); ++i) {
    const double step = (route.points[i + 1] - route.points[i]).norm();
    EXPECT_GE(step, 0.2) << route.name << " " << i;
    EXPECT_LE(step, 1.0) << route.name << " " << i;
    EXPECT_LT(network.beyond_kerb_m(route.points[i]), -1.0) << route.name << " " << route.points[i].transpose();
    EXPECT_GT(walls.distance_m(route.points[i]), 1.5) << route.name << " " << route.points[i].transpose();
    for (const Outline& footprint : footprints) EXPECT_FALSE(contains(footprint.corners, route.points[i]));
  }
}

}  // namespace convoy::simulator
