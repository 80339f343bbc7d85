#include "ground_mesh.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace convoy::simulator {
namespace {

constexpr double raster_m = 4.0, fine_m = 1.0;
constexpr double kerb_stone_m = 0.16, pavement_m = 4.2;

constexpr double tile_m = 8.0;  // of road, pavement and yard textures

}  // namespace

double GroundMesh::bed_m(const Eigen::Vector2d& point) const {
  const Eigen::Vector2d& low = terrain_.low();
  const double gx = (point.x() - low.x()) / raster_m, gy = (point.y() - low.y()) / raster_m;
  const double ix = std::floor(gx), iy = std::floor(gy), u = gx - ix, v = gy - iy;
  const auto at = [&](double dx, double dy) {
    return terrain_.bed_m(low.x() + (ix + dx) * raster_m, low.y() + (iy + dy) * raster_m);
  };
  const double origin = at(0, 0), far = at(1, 1);
  // Two triangles, divided by the diagonal from the origin.
  if (u >= v) {
    const double corner = at(1, 0);
    return origin + u * (corner - origin) + v * (far - corner);
  }
  const double corner = at(0, 1);
  return origin + v * (corner - origin) + u * (far - corner);
}

double GroundMesh::height_m(const Eigen::Vector2d& point) const {
  return bed_m(point) + (terrain_.network().beyond_kerb_m(point) > 0.0 ? Terrain::kerb_m : 0.0);
}

void GroundMesh::build(SceneBuilder& scene, const GroundTextures& textures,
                       const std::function<bool(const Eigen::Vector2d&)>& close) const {
  const Eigen::Vector2d &low = terrain_.low(), &high = terrain_.high();
  const int columns = static_cast<int>(std::ceil((high.x() - low.x()) / raster_m));
  const int rows = static_cast<int>(std::ceil((high.y() - low.y()) / raster_m));
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const Eigen::Vector2d corner = low + raster_m * Eigen::Vector2d(column, row);
      const Eigen::Vector2d middle = corner.array() + raster_m / 2;
      const double beyond = terrain_.network().beyond_kerb_m(middle);
      const int parts = std::abs(beyond) < raster_m && close(middle) ? static_cast<int>(raster_m / fine_m) : 1;
      const double step = raster_m / parts;
      for (int part = 0; part < parts * parts; ++part) {
        const Eigen::Vector2d from = corner + step * Eigen::Vector2d(part % parts, part / parts);
        const auto at = [&](double dx, double dy) {
          const Eigen::Vector2d point = from + step * Eigen::Vector2d(dx, dy);
          return Point{point, terrain_.network().beyond_kerb_m(point)};
        };
        const Point a = at(0, 0), b = at(1, 0), c = at(1, 1), d = at(0, 1);
        add_triangle(scene, textures, {a, b, c});
        add_triangle(scene, textures, {a, c, d});
      }
    }
  }
  add_land_around(scene, textures.yard);
}

void GroundMesh::add_triangle(SceneBuilder& scene, const GroundTextures& textures,
                              const std::array<Point, 3>& corners) const {
  const std::array<double, 5> edges{-1e9, 0.0, kerb_stone_m, pavement_m, 1e9};
  const std::array<TextureId, 4> surfaces{textures.road, textures.kerb, textures.pavement, textures.yard};
  const auto clip = [](const std::vector<Point>& polygon, double edge, bool keep_above) {
    std::vector<Point> kept;
    for (std::size_t i = 0; i < polygon.size(); ++i) {
      const Point &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
      const bool a_in = keep_above == (a.beyond_kerb > edge), b_in = keep_above == (b.beyond_kerb > edge);
      if (a_in) kept.push_back(a);
      if (a_in == b_in) continue;
      // From the same end whichever triangle asks, so that neighbours meet.
      const bool forward = a.at.x() < b.at.x() || (a.at.x() == b.at.x() && a.at.y() < b.at.y());
      const Point &from = forward ? a : b, &to = forward ? b : a;
      const double share = (edge - from.beyond_kerb) / (to.beyond_kerb - from.beyond_kerb);
      kept.push_back({from.at + share * (to.at - from.at), edge});
    }
    return kept;
  };
  for (std::size_t band = 0; band < surfaces.size(); ++band) {
    std::vector<Point> polygon =
        clip(clip({corners.begin(), corners.end()}, edges[band], true), edges[band + 1], false);
    if (polygon.size() < 3) continue;
    const double rise = band == 0 ? 0.0 : Terrain::kerb_m;
    const double scale = band == 1 ? 1.0 / 2.0 : 1.0 / tile_m;
    std::vector<Corner> face;
    for (const Point& point : polygon)
      face.push_back({Eigen::Vector3d(point.at.x(), point.at.y(), bed_m(point.at) + rise).cast<float>(),
                      (point.at * scale).cast<float>()});
    add_polygon(scene.piece(surfaces[band], corners[0].at.x(), corners[0].at.y()), face);
    if (band != 0) continue;
    for (std::size_t i = 0; i < polygon.size(); ++i) {
      const Point &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
      if (a.beyond_kerb == 0.0 && b.beyond_kerb == 0.0) add_kerb_face(scene, textures.kerb, a.at, b.at);
    }
  }
}

void GroundMesh::add_kerb_face(SceneBuilder& scene, TextureId texture, const Eigen::Vector2d& from,
                               const Eigen::Vector2d& to) const {
  const auto at = [&](const Eigen::Vector2d& point, double rise) {
    return Eigen::Vector3d(point.x(), point.y(), bed_m(point) + rise).cast<float>().eval();
  };
  const Eigen::Vector2d along = (to - from).cwiseAbs();
  const auto u = [&](const Eigen::Vector2d& point) {
    return static_cast<float>((along.x() > along.y() ? point.x() : point.y()) / 2.0);
  };
  // The road lies to the left of from -> to.
  add_polygon(scene.piece(texture, from.x(), from.y(), 0.0F, 0.72F), {{at(to, 0), {u(to), 0.06F}},
                                                                      {at(from, 0), {u(from), 0.06F}},
                                                                      {at(from, Terrain::kerb_m), {u(from), 0}},
                                                                      {at(to, Terrain::kerb_m), {u(to), 0}}});
}

void GroundMesh::add_land_around(SceneBuilder& scene, TextureId texture) const {
  constexpr double reach_m = 1500.0;
  const Eigen::Vector2d low = terrain_.low();
  const Eigen::Vector2d size = ((terrain_.high() - low) / raster_m).array().ceil() * raster_m;
  const std::array<double, 4> xs{low.x() - reach_m, low.x(), low.x() + size.x(), low.x() + size.x() + reach_m};
  const std::array<double, 4> ys{low.y() - reach_m, low.y(), low.y() + size.y(), low.y() + size.y() + reach_m};
  const double z = Terrain::kerb_m;
  for (std::size_t i = 0; i < 9; ++i) {
    if (i == 4) continue;
    const double x0 = xs[i % 3], x1 = xs[i % 3 + 1], y0 = ys[i / 3], y1 = ys[i / 3 + 1];
    const auto corner = [&](double x, double y) {
      return Corner{Eigen::Vector3d(x, y, z).cast<float>(), Eigen::Vector2d(x / tile_m, y / tile_m).cast<float>()};
    };
    Mesh mesh;
    mesh.texture = texture;
    add_polygon(mesh, {corner(x0, y0), corner(x1, y0), corner(x1, y1), corner(x0, y1)});
    scene.add(std::move(mesh));
  }
}

}  // namespace convoy::simulator
