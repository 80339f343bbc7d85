// Triangles by texture and by piece of the district.
#pragma once

#include "scene.hpp"

#include <map>
#include <tuple>

namespace convoy::simulator {

using Corner = Vertex;  // of a polygon

/// Adds a convex polygon, counter-clockwise as seen.
void add_polygon(Mesh& mesh, const std::vector<Corner>& corners);
/// Adds a box that stands on `base` (middle of its foot); `half` is half its length, half its width and its height.
/// Every side shows uv (0..1, 0..1).
void add_box(Mesh& mesh, const Eigen::Vector3f& base, const Eigen::Vector3f& half, float yaw_rad);
/// Adds an upright prism of n sides without a foot; u goes once around.
void add_pillar(Mesh& mesh, const Eigen::Vector3f& base, float radius_m, float top_radius_m, float height_m, int sides);

class SceneBuilder {
 public:
  TextureId add(Texture texture);
  Mesh& add(Mesh mesh) { return scene.meshes.emplace_back(std::move(mesh)); }

  /// The mesh of this texture about (x, y): pieces are 32 m wide.
  Mesh& piece(TextureId texture, double x_m, double y_m, float bias_m = 0.0F, float shade = 1.0F);
  /// Moves the pieces into the scene.
  Scene finish();

  Scene scene;

 private:
  std::map<std::tuple<TextureId, float, float, int, int>, Mesh> pieces_;
};

}  // namespace convoy::simulator
