// What there is to be seen. World frame: x east, y north, z up [m]; the origin is the middle of the district's ground.
// Body frame of a vehicle: x ahead, y to the left, z up; its origin is on the ground under the middle of the rear axle.
// Camera frame: x to the right, y down, z ahead. T_a_b maps points of frame b into frame a.
#pragma once

#include <Eigen/Geometry>

#include <array>
#include <cstdint>
#include <vector>

namespace convoy::simulator {

using TextureId = std::uint32_t;

/// Grey reflectance, 0 (black) to 255 (white). Repeats in both directions.
struct Texture {
  int width = 0, height = 0;       ///< texels, >= 1
  std::vector<std::uint8_t> grey;  ///< width x height, row by row; row 0 at v = 0
};

struct Vertex {
  Eigen::Vector3f position;  ///< of the mesh's frame [m]
  Eigen::Vector2f uv;        ///< 1 is the whole texture; u to the right of the row, v down the rows
};

/// Triangles of one texture, seen from the side on which their corners run counter-clockwise.
struct Mesh {
  TextureId texture = 0;
  std::vector<Vertex> vertices;
  std::vector<std::array<std::uint32_t, 3>> triangles;
  float shade = 1.0F;  ///< of light that falls on it: 1 in the sun, less in the shade
  float bias = 0.0F;   ///< what is painted on another surface lies so much in front of it [m], see the rasteriser
};

/// What moves as a whole: T_world_object changes, the meshes do not.
struct Object {
  std::vector<Mesh> meshes;  ///< object frame
  Eigen::Isometry3d T_world_object = Eigen::Isometry3d::Identity();
};

struct Scene {
  std::vector<Texture> textures;
  std::vector<Mesh> meshes;  ///< world frame; what stands still. One mesh is a piece of the district, some 10 to 50 m
                             ///< wide, so that what is not in view can be passed over
  std::vector<Object> objects;  ///< what moves
  TextureId sky = 0;            ///< a panorama: u is the bearing / 2 pi, v 0 at the zenith and 1 at the horizon
};

}  // namespace convoy::simulator
