// The surface of roads, kerbs, pavements and yards as triangles.
#pragma once

#include "scene_builder.hpp"
#include "street_network.hpp"

#include <functional>

namespace convoy::simulator {

struct GroundTextures {
  TextureId road = 0, kerb = 0, pavement = 0, yard = 0;
};

/// The ground as drawn: planes over a raster of 4 m. What lies on the ground takes its height from here.
class GroundMesh {
 public:
  explicit GroundMesh(const Terrain& terrain) : terrain_(terrain) {}

  /// Height of the drawn surface without kerbs [m].
  double bed_m(const Eigen::Vector2d& point) const;
  /// Height of the drawn surface [m].
  double height_m(const Eigen::Vector2d& point) const;

  /// Draws it all. Kerbs are exact to centimetres where `close` says so of a place, to decimetres elsewhere.
  void build(SceneBuilder& scene, const GroundTextures& textures,
             const std::function<bool(const Eigen::Vector2d&)>& close) const;

 private:
  struct Point {
    Eigen::Vector2d at;
    double beyond_kerb;
  };
  void add_triangle(SceneBuilder& scene, const GroundTextures& textures, const std::array<Point, 3>& corners) const;
  void add_kerb_face(SceneBuilder& scene, TextureId texture, const Eigen::Vector2d& from,
                     const Eigen::Vector2d& to) const;
  void add_land_around(SceneBuilder& scene, TextureId texture) const;

  const Terrain& terrain_;
};

}  // namespace convoy::simulator
