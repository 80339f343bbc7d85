#include "street_furniture.hpp"

#include "noise.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace convoy::simulator {
namespace {

using Eigen::Vector3f;

/// A cut across a car: upper edge, half width there; the lower edge is the same all along.
struct Station {
  float x, top, half_top;
};

void add_wheels(Mesh& mesh) {
  constexpr int sides = 12;
  constexpr float radius = 0.32F, half = 0.885F;
  for (const float x : {1.35F, -1.3F}) {
    for (const float y : {1.0F, -1.0F}) {
      std::vector<Corner> disc;
      for (int i = 0; i < sides; ++i) {
        const float angle = y * 2.0F * static_cast<float>(M_PI) * static_cast<float>(i) / sides;
        disc.push_back({Vector3f(x - radius * std::cos(angle), y * half, radius + radius * std::sin(angle)),
                        {0.5F + 0.5F * std::cos(angle), 0.5F - 0.5F * std::sin(angle)}});
      }
      add_polygon(mesh, disc);
    }
  }
}

void add_blob(Mesh& mesh, const Vector3f& middle, const Vector3f& radius, std::uint32_t seed) {
  constexpr int around = 9, up = 6;
  const auto at = [&](int i, int j) {
    const float turn = 2.0F * static_cast<float>(M_PI) * static_cast<float>(i) / around;
    const float rise = static_cast<float>(M_PI) * (static_cast<float>(j) / up - 0.5F);
    const float swell = 1.0F + 0.2F * static_cast<float>(j == 0 || j == up ? 0.0 : lattice_noise(seed, i % around, j));
    const Vector3f out(std::cos(rise) * std::cos(turn), std::cos(rise) * std::sin(turn), std::sin(rise));
    return Corner{middle + swell * out.cwiseProduct(radius),
                  {static_cast<float>(i) / around * 3.0F, static_cast<float>(j) / up * 1.5F}};
  };
  for (int i = 0; i < around; ++i)
    for (int j = 0; j < up; ++j) add_polygon(mesh, {at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)});
}

}  // namespace

std::vector<Mesh> car_model(const StreetTextures& textures, std::size_t paint, double height_m) {
  const auto h = static_cast<float>(height_m);
  const std::array<Station, 8> stations{{{2.2F, 0.55F, 0.75F},
                                         {2.12F, 0.72F, 0.8F},
                                         {1.1F, 0.92F, 0.82F},
                                         {0.4F, h, 0.62F},
                                         {-1.1F, h, 0.62F},
                                         {-1.65F, 0.98F, 0.8F},
                                         {-2.1F, 0.92F, 0.8F},
                                         {-2.2F, 0.6F, 0.76F}}};
  constexpr float low = 0.24F, belt = 0.9F, half = 0.87F;
  std::vector<Mesh> meshes(3);
  Mesh &sides = meshes[0], &top = meshes[1], &dark = meshes[2];
  sides.texture = textures.car_sides[paint % textures.car_sides.size()];
  top.texture = textures.car_tops[paint % textures.car_tops.size()];
  dark.texture = textures.tyre;
  sides.shade = 0.85F;
  const auto side_at = [&](float x, float y, float z) {
    return Corner{{x, y, z}, {(2.2F - x) / 4.4F, std::clamp(1.0F - z / 1.5F, 0.01F, 0.99F)}};
  };
  const auto top_at = [&](const Station& s, float sign) {
    return Corner{{s.x, sign * s.half_top, s.top}, {0.5F - 0.49F * sign, (2.2F - s.x) / 4.4F}};
  };
  for (std::size_t i = 0; i + 1 < stations.size(); ++i) {
    const Station &front = stations[i], &back = stations[i + 1];
    for (const float sign : {1.0F, -1.0F}) {
      const float front_belt = std::min(front.top, belt) - 0.04F, back_belt = std::min(back.top, belt) - 0.04F;
      std::vector<Corner> lower{side_at(front.x, sign * half, low), side_at(front.x, sign * half, front_belt),
                                side_at(back.x, sign * half, back_belt), side_at(back.x, sign * half, low)};
      std::vector<Corner> upper{
          side_at(front.x, sign * half, front_belt), side_at(front.x, sign * front.half_top, front.top),
          side_at(back.x, sign * back.half_top, back.top), side_at(back.x, sign * half, back_belt)};
      if (sign > 0.0F) std::reverse(lower.begin(), lower.end()), std::reverse(upper.begin(), upper.end());
      add_polygon(sides, lower);
      add_polygon(sides, upper);
    }
    add_polygon(top, {top_at(front, -1), top_at(front, 1), top_at(back, 1), top_at(back, -1)});
  }
  for (const float end : {1.0F, -1.0F}) {
    const Station& s = end > 0.0F ? stations.front() : stations.back();
    const float v0 = end > 0.0F ? 0.005F : 0.995F, v1 = end > 0.0F ? 0.06F : 0.94F;
    add_polygon(top, {{{s.x, -end * half, low}, {0.99F, v0}},
                      {{s.x, end * half, low}, {0.01F, v0}},
                      {{s.x, end * s.half_top, s.top}, {0.01F, v1}},
                      {{s.x, -end * s.half_top, s.top}, {0.99F, v1}}});
  }
  add_wheels(dark);
  // The shadow under it.
  add_polygon(dark, {{{-2.1F, -0.85F, 0.03F}, {0, 0}},
                     {{2.1F, -0.85F, 0.03F}, {1, 0}},
                     {{2.1F, 0.85F, 0.03F}, {1, 1}},
                     {{-2.1F, 0.85F, 0.03F}, {0, 1}}});
  return meshes;
}

void place(SceneBuilder& scene, const std::vector<Mesh>& model, const Eigen::Vector3d& foot, double yaw_rad) {
  const Eigen::Isometry3f T(Eigen::Translation3f(foot.cast<float>()) *
                            Eigen::AngleAxisf(static_cast<float>(yaw_rad), Vector3f::UnitZ()));
  for (const Mesh& part : model) {
    Mesh& mesh = scene.piece(part.texture, foot.x(), foot.y(), part.bias, part.shade);
    const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
    for (const Vertex& vertex : part.vertices) mesh.vertices.push_back({T * vertex.position, vertex.uv});
    for (const auto& triangle : part.triangles)
      mesh.triangles.push_back({first + triangle[0], first + triangle[1], first + triangle[2]});
  }
}

void add_tree(SceneBuilder& scene, const StreetTextures& textures, const Eigen::Vector3d& foot, Stream& random) {
  const Vector3f base = foot.cast<float>() - Vector3f(0, 0, 0.2F);
  const auto radius = static_cast<float>(random.uniform(0.11, 0.2));
  const auto stem = static_cast<float>(random.uniform(2.8, 3.8)), crown = static_cast<float>(random.uniform(1.3, 2.0));
  add_pillar(scene.piece(textures.bark, foot.x(), foot.y()), base, radius, 0.7F * radius, stem + 0.6F, 7);
  Mesh& leaves = scene.piece(textures.leaves, foot.x(), foot.y());
  const std::uint32_t seed = random();
  for (int blob = 0; blob < 4; ++blob) {
    const auto turn = static_cast<float>(random.uniform(0.0, 6.28)), out = static_cast<float>(random.uniform(0.2, 0.6));
    const auto up = static_cast<float>(random.uniform(0.3, 1.0));
    const Vector3f middle =
        base + Vector3f(out * crown * std::cos(turn), out * crown * std::sin(turn), stem + up * crown);
    add_blob(leaves, middle, 0.8F * crown * Vector3f(1.0F, 1.0F, 0.85F), seed + static_cast<std::uint32_t>(blob));
  }
}

void add_lamp(SceneBuilder& scene, const StreetTextures& textures, const Eigen::Vector3d& foot, double yaw_rad) {
  Mesh& mesh = scene.piece(textures.metal, foot.x(), foot.y(), 0.0F, 0.75F);
  const Vector3f base = foot.cast<float>();
  add_pillar(mesh, base, 0.13F, 0.11F, 0.9F, 8);
  add_pillar(mesh, base, 0.075F, 0.05F, 6.2F, 8);
  const auto yaw = static_cast<float>(yaw_rad);
  const Vector3f arm(std::cos(yaw), std::sin(yaw), 0.0F);
  add_box(mesh, base + 0.8F * arm + Vector3f(0, 0, 6.1F), {0.85F, 0.04F, 0.08F}, yaw);
  add_box(scene.piece(textures.stone, foot.x(), foot.y()), base + 1.6F * arm + Vector3f(0, 0, 6.0F),
          {0.35F, 0.13F, 0.1F}, yaw);
}

void add_sign(SceneBuilder& scene, const StreetTextures& textures, const Eigen::Vector3d& foot, double yaw_rad,
              Stream& random) {
  const Vector3f base = foot.cast<float>();
  add_pillar(scene.piece(textures.metal, foot.x(), foot.y(), 0.0F, 0.75F), base, 0.035F, 0.035F, 2.9F, 6);
  const auto yaw = static_cast<float>(yaw_rad);
  const Vector3f ahead(std::cos(yaw), std::sin(yaw), 0.0F), left(-ahead.y(), ahead.x(), 0.0F);
  const Vector3f front = base + 0.05F * ahead, back = base - 0.045F * ahead;
  const std::uint32_t boards = 1 + random.below(2);
  float z = 2.85F;
  for (std::uint32_t board = 0; board < boards; ++board, z -= 0.7F) {
    const std::uint32_t kind = random.below(8);
    const auto sides = kind < 4 ? 4 : kind < 6 ? 12 : 3;
    std::vector<Corner> face, rear;
    for (int i = 0; i < sides; ++i) {
      const float angle = static_cast<float>(M_PI) *
                          (2.0F * static_cast<float>(i) / static_cast<float>(sides) + (sides == 4 ? 0.25F : 0.5F));
      const float radius = sides == 4 ? 0.42F : 0.34F, x = -radius * std::cos(angle), y = radius * std::sin(angle);
      const Vector3f offset = x * left + (y + z - 0.3F) * Vector3f::UnitZ();
      const Eigen::Vector2f uv(0.5F + x / 0.7F, 0.5F - y / 0.7F);
      face.push_back({front + offset, uv});
      rear.push_back({back + offset, uv});
    }
    // Seen from ahead, left is at the right hand.
    Mesh& shown = scene.piece(textures.signs[kind], foot.x(), foot.y());
    std::reverse(face.begin(), face.end());
    add_polygon(shown, face);
    add_polygon(scene.piece(textures.sign_back, foot.x(), foot.y(), 0.0F, 0.8F), rear);
  }
}

void add_bin(SceneBuilder& scene, const StreetTextures& textures, const Eigen::Vector3d& foot, double yaw_rad) {
  add_box(scene.piece(textures.bin, foot.x(), foot.y(), 0.0F, 0.9F), foot.cast<float>(), {0.25F, 0.22F, 0.95F},
          static_cast<float>(yaw_rad));
}

void add_bollard(SceneBuilder& scene, const StreetTextures& textures, const Eigen::Vector3d& foot) {
  add_pillar(scene.piece(textures.metal, foot.x(), foot.y(), 0.0F, 0.75F), foot.cast<float>(), 0.07F, 0.06F, 0.85F, 8);
}

}  // namespace convoy::simulator
