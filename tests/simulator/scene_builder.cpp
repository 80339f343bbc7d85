#include "scene_builder.hpp"

#include <cmath>

namespace convoy::simulator {

void add_polygon(Mesh& mesh, const std::vector<Corner>& corners) {
  const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
  mesh.vertices.insert(mesh.vertices.end(), corners.begin(), corners.end());
  for (std::uint32_t i = 2; i < corners.size(); ++i) mesh.triangles.push_back({first, first + i - 1, first + i});
}

void add_box(Mesh& mesh, const Eigen::Vector3f& base, const Eigen::Vector3f& half, float yaw_rad) {
  const Eigen::Vector3f ahead(std::cos(yaw_rad), std::sin(yaw_rad), 0.0F), left(-ahead.y(), ahead.x(), 0.0F);
  const Eigen::Vector3f up(0.0F, 0.0F, half.z());
  const Eigen::Vector3f x = half.x() * ahead, y = half.y() * left;
  const auto side = [&](const Eigen::Vector3f& from, const Eigen::Vector3f& to) {
    add_polygon(mesh,
                {{base + from, {0, 1}}, {base + to, {1, 1}}, {base + to + up, {1, 0}}, {base + from + up, {0, 0}}});
  };
  side(-x - y, x - y);
  side(x - y, x + y);
  side(x + y, -x + y);
  side(-x + y, -x - y);
  add_polygon(mesh, {{base - x - y + up, {0, 1}},
                     {base + x - y + up, {1, 1}},
                     {base + x + y + up, {1, 0}},
                     {base - x + y + up, {0, 0}}});
  add_polygon(mesh, {{base - x - y, {0, 1}}, {base - x + y, {0, 0}}, {base + x + y, {1, 0}}, {base + x - y, {1, 1}}});
}

void add_pillar(Mesh& mesh, const Eigen::Vector3f& base, float radius_m, float top_radius_m, float height_m,
                int sides) {
  const auto rim = [&](int i, float radius, float z) {
    const float angle = 2.0F * static_cast<float>(M_PI) * static_cast<float>(i) / static_cast<float>(sides);
    return Eigen::Vector3f(base + Eigen::Vector3f(radius * std::cos(angle), radius * std::sin(angle), z));
  };
  std::vector<Corner> lid;
  for (int i = 0; i < sides; ++i) {
    const float u = static_cast<float>(i) / static_cast<float>(sides), next = u + 1.0F / static_cast<float>(sides);
    add_polygon(mesh, {{rim(i, radius_m, 0), {u, 1}},
                       {rim(i + 1, radius_m, 0), {next, 1}},
                       {rim(i + 1, top_radius_m, height_m), {next, 0}},
                       {rim(i, top_radius_m, height_m), {u, 0}}});
    lid.push_back({rim(i, top_radius_m, height_m), {u, 0}});
  }
  add_polygon(mesh, lid);
}

TextureId SceneBuilder::add(Texture texture) {
  scene.textures.push_back(std::move(texture));
  return static_cast<TextureId>(scene.textures.size() - 1);
}

Mesh& SceneBuilder::piece(TextureId texture, double x_m, double y_m, float bias_m, float shade) {
  constexpr double piece_m = 32.0;
  Mesh& mesh = pieces_[{texture, bias_m, shade, static_cast<int>(std::floor(x_m / piece_m)),
                        static_cast<int>(std::floor(y_m / piece_m))}];
  mesh.texture = texture, mesh.bias = bias_m, mesh.shade = shade;
  return mesh;
}

Scene SceneBuilder::finish() {
  for (auto& [key, mesh] : pieces_)
    if (!mesh.triangles.empty()) scene.meshes.push_back(std::move(mesh));
  pieces_.clear();
  return std::move(scene);
}

}  // namespace convoy::simulator
