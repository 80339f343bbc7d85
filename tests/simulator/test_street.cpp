#include "test_street.hpp"

#include "random.hpp"

#include <algorithm>
#include <cmath>

namespace convoy::simulator {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

enum TextureIndex : TextureId { kSky, kRoad, kPaint, kFirstWall };
constexpr TextureId kWalls = 6;

/// Value noise of several pitches, each half the one before and half as strong.
std::vector<float> clouds(int size, int pitch, Stream& stream) {
  std::vector<float> sum(static_cast<std::size_t>(size * size));
  float strength = 1.0F;
  for (; pitch >= 1; pitch /= 2, strength *= 0.6F) {
    const int n = size / pitch;
    std::vector<float> knots;
    for (int i = 0; i < n * n; ++i) knots.push_back(static_cast<float>(stream.uniform(-1.0, 1.0)));
    const auto knot = [&](int x, int y) { return knots[static_cast<std::size_t>((y % n) * n + x % n)]; };
    for (int y = 0; y < size; ++y)
      for (int x = 0; x < size; ++x) {
        const float a = static_cast<float>(x % pitch) / static_cast<float>(pitch);
        const float b = static_cast<float>(y % pitch) / static_cast<float>(pitch);
        const int i = x / pitch, j = y / pitch;
        sum[static_cast<std::size_t>(y * size + x)] +=
            strength * ((knot(i, j) * (1 - a) + knot(i + 1, j) * a) * (1 - b) +
                        (knot(i, j + 1) * (1 - a) + knot(i + 1, j + 1) * a) * b);
      }
  }
  return sum;
}

Texture cloudy(int size, int pitch, float mean, float strength, std::uint32_t id) {
  Stream stream({11, 0, 0, id});
  Texture texture{size, size, {}};
  for (const float value : clouds(size, pitch, stream))
    texture.grey.push_back(static_cast<std::uint8_t>(std::clamp(mean + strength * value, 0.0F, 255.0F)));
  return texture;
}

/// 16 m x 16 m of facade: windows at one pitch, stains and small marks that are nowhere else.
Texture facade(std::uint32_t id) {
  constexpr int size = 1024, pitch = 256;
  Texture texture = cloudy(size, 32, 150.0F, 20.0F, id);
  Stream stream({12, 0, 0, id});
  const auto fill = [&texture](int x0, int y0, int w, int h, std::uint8_t grey) {
    for (int y = y0; y < y0 + h; ++y)
      for (int x = x0; x < x0 + w; ++x) texture.grey[static_cast<std::size_t>((y % size) * size + x % size)] = grey;
  };
  for (int y = 60; y < size; y += pitch)
    for (int x = 70; x < size; x += pitch) {
      fill(x - 8, y - 8, 106, 146, 200);
      fill(x, y, 90, 130, 50);
      fill(x + 42, y, 6, 130, 200);
      if (stream.chance(0.3)) fill(x, y, 90, 20 + static_cast<int>(stream.below(100)), 170);
    }
  for (int i = 0; i < 60; ++i)
    fill(static_cast<int>(stream.below(size)), static_cast<int>(stream.below(size)),
         4 + static_cast<int>(stream.below(20)), 4 + static_cast<int>(stream.below(20)),
         static_cast<std::uint8_t>(stream.below(256)));
  return texture;
}

/// A board from `corner` along two sides, cut into `columns` strips; texture repeats every `repeat_m`.
void add_board(Mesh& mesh, const Vector3f& corner, const Vector3f& along, const Vector3f& down, int columns,
               float repeat_m, const Vector2f& shift = Vector2f::Zero()) {
  const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
  for (int i = 0; i <= columns; ++i) {
    const float part = static_cast<float>(i) / static_cast<float>(columns);
    const float u = part * along.norm() / repeat_m;
    mesh.vertices.push_back({corner + part * along, shift + Vector2f(u, 0.0F)});
    mesh.vertices.push_back({corner + part * along + down, shift + Vector2f(u, down.norm() / repeat_m)});
  }
  for (std::uint32_t i = 0; i < static_cast<std::uint32_t>(columns); ++i) {
    const std::uint32_t a = first + 2 * i;
    mesh.triangles.push_back({a, a + 1, a + 3});
    mesh.triangles.push_back({a, a + 3, a + 2});
  }
}

Object box() {
  Mesh mesh;
  mesh.texture = kFirstWall + 1;
  const float x = 2.1F, y = 0.9F, z = 1.4F;
  add_board(mesh, {-x, -y, z}, {2 * x, 0, 0}, {0, 0, -z}, 1, 8.0F);
  add_board(mesh, {x, -y, z}, {0, 2 * y, 0}, {0, 0, -z}, 1, 8.0F);
  add_board(mesh, {x, y, z}, {-2 * x, 0, 0}, {0, 0, -z}, 1, 8.0F);
  add_board(mesh, {-x, y, z}, {0, -2 * y, 0}, {0, 0, -z}, 1, 8.0F);
  add_board(mesh, {-x, y, z}, {2 * x, 0, 0}, {0, -2 * y, 0}, 1, 8.0F);
  Object object;
  object.meshes.push_back(mesh);
  object.T_world_object.translation() = Eigen::Vector3d(14.0, 3.2, 0.0);
  return object;
}

}  // namespace

Scene test_street(double length_m, int triangles_per_metre) {
  Scene scene;
  scene.textures = {cloudy(512, 128, 215.0F, 18.0F, 0), cloudy(1024, 16, 90.0F, 22.0F, 1),
                    cloudy(256, 8, 220.0F, 20.0F, 2)};
  for (TextureId i = 0; i < kWalls; ++i) scene.textures.push_back(facade(i + 10));
  const int houses = std::max(1, static_cast<int>(length_m / 12.0));
  for (int i = 0; i < houses; ++i) {
    const float x = 12.0F * static_cast<float>(i);
    const int strips = std::max(1, 6 * triangles_per_metre);
    Mesh left, right, road, paint;
    left.texture = kFirstWall + static_cast<TextureId>(i) % kWalls;
    right.texture = kFirstWall + static_cast<TextureId>(i + 2) % kWalls;
    right.shade = 0.6F;
    const Vector2f shift(0.37F * static_cast<float>(i), 0.0F);
    const float height = 12.0F + 2.0F * static_cast<float>(i % 3);
    add_board(left, {x, 10, height}, {12, 0, 0}, {0, 0, -height}, strips, 16.0F, shift);
    add_board(right, {x + 12, -10, height}, {-12, 0, 0}, {0, 0, -height}, strips, 16.0F, shift);
    road.texture = kRoad;
    add_board(road, {x, 10, 0}, {12, 0, 0}, {0, -20, 0}, strips, 6.0F, shift);
    paint.texture = kPaint;
    paint.bias = 0.02F;
    add_board(paint, {x + 2, 0.1F, 0}, {3, 0, 0}, {0, -0.2F, 0}, 1, 2.0F);
    add_board(paint, {x, 5.1F, 0}, {12, 0, 0}, {0, -0.15F, 0}, 1, 2.0F);
    for (Mesh* mesh : {&left, &right, &road, &paint}) scene.meshes.push_back(*mesh);
  }
  Mesh end;
  end.texture = kFirstWall;
  add_board(end, {12.0F * static_cast<float>(houses), 10, 14}, {0, -20, 0}, {0, 0, -14}, 4, 16.0F);
  scene.meshes.push_back(end);
  scene.objects.push_back(box());
  scene.sky = kSky;
  return scene;
}

Eigen::Isometry3d test_pose(double x_m, double y_m, double left_deg) {
  Eigen::Isometry3d T_world_camera = Eigen::Isometry3d::Identity();
  T_world_camera.translation() = Eigen::Vector3d(x_m, y_m, 1.5);
  Eigen::Matrix3d R_body_camera;
  R_body_camera << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  T_world_camera.linear() =
      Eigen::AngleAxisd(left_deg * M_PI / 180.0, Eigen::Vector3d::UnitZ()).toRotationMatrix() * R_body_camera;
  return T_world_camera;
}

}  // namespace convoy::simulator
