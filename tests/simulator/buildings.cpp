#include "buildings.hpp"

#include <Eigen/Geometry>

#include <algorithm>
#include <array>
#include <cmath>

namespace convoy::simulator {
namespace {

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

struct Edge {
  Eigen::Vector2d a, b, outward;
  double length;
};

/// The footprints of a plan, to ask what hides what.
class Blocks {
 public:
  explicit Blocks(const StreetPlan& plan) : plan_(plan) {
    for (const Outline& footprint : plan.footprints) {
      Eigen::AlignedBox2d box;
      for (const auto& corner : footprint.corners) box.extend(corner);
      boxes_.push_back(box);
    }
  }

  /// Height of the tallest other house that stands at a point; 0: none.
  double height_at(const Eigen::Vector2d& point, std::size_t but) const {
    double height = 0.0;
    for (std::size_t i = 0; i < boxes_.size(); ++i)
      if (i != but && boxes_[i].contains(point) && contains(plan_.footprints[i].corners, point))
        height = std::max(height, plan_.footprints[i].height_m);
    return height;
  }

  bool sees(const Eigen::Vector2d& from, const Eigen::Vector2d& to) const {
    Eigen::AlignedBox2d path(from);
    path.extend(to);
    for (std::size_t i = 0; i < boxes_.size(); ++i) {
      if (!boxes_[i].intersects(path)) continue;
      const auto& corners = plan_.footprints[i].corners;
      for (std::size_t k = 0; k < corners.size(); ++k) {
        const Eigen::Vector2d &a = corners[k], &b = corners[(k + 1) % corners.size()];
        if (cross(to - from, a - from) * cross(to - from, b - from) < 0.0 &&
            cross(b - a, from - a) * cross(b - a, to - a) < 0.0)
          return false;
      }
    }
    return true;
  }

 private:
  const StreetPlan& plan_;
  std::vector<Eigen::AlignedBox2d> boxes_;
};

/// Whether somebody on a route can look at the front.
bool in_sight(const Blocks& blocks, const std::vector<Eigen::Vector2d>& viewpoints, const Edge& edge) {
  constexpr double reach_m = 70.0;
  for (const double share : {0.1, 0.5, 0.9}) {
    const Eigen::Vector2d point = edge.a + share * (edge.b - edge.a) + 0.05 * edge.outward;
    for (const Eigen::Vector2d& viewpoint : viewpoints) {
      const Eigen::Vector2d away = viewpoint - point;
      if (away.dot(edge.outward) > 0.1 && away.squaredNorm() < reach_m * reach_m && blocks.sees(point, viewpoint))
        return true;
    }
  }
  return false;
}

/// A moulding along the upper end of a wall.
void add_cornice(SceneBuilder& scene, TextureId texture, const Edge& edge, double top) {
  constexpr double out_m = 0.28, high_m = 0.42, over_m = 0.2;
  const Eigen::Vector2d along = (edge.b - edge.a) / edge.length;
  const auto at = [&](bool right, double out, double up) {
    const Eigen::Vector2d place =
        (right ? Eigen::Vector2d(edge.b + over_m * along) : Eigen::Vector2d(edge.a - over_m * along)) +
        out * edge.outward;
    const double u = right ? edge.length / 2.0 : 0.0;
    return Corner{Eigen::Vector3d(place.x(), place.y(), top + up).cast<float>(),
                  Eigen::Vector2d(u, -up / 2.0 + out).cast<float>()};
  };
  Mesh mesh;
  mesh.texture = texture, mesh.shade = shade_of(edge.outward);
  add_polygon(mesh, {at(false, out_m, 0.1 - high_m), at(true, out_m, 0.1 - high_m), at(true, out_m, 0.1),
                     at(false, out_m, 0.1)});
  Mesh below = mesh;
  below.vertices.clear(), below.triangles.clear();
  below.shade = 0.5F;
  add_polygon(below, {at(false, 0.0, -high_m), at(true, 0.0, -high_m), at(true, out_m, 0.1 - high_m),
                      at(false, out_m, 0.1 - high_m)});
  add_polygon(mesh,
              {at(false, 0.0, -high_m), at(false, out_m, 0.1 - high_m), at(false, out_m, 0.1), at(false, 0.0, 0.1)});
  add_polygon(mesh, {at(true, out_m, 0.1 - high_m), at(true, 0.0, -high_m), at(true, 0.0, 0.1), at(true, out_m, 0.1)});
  scene.add(std::move(mesh));
  scene.add(std::move(below));
}

void add_blank(SceneBuilder& scene, TextureId texture, const Edge& edge, double base, double height) {
  const double tile = FacadePainter::blank_tile_m, foot = FacadePainter::foot_m;
  const auto at = [&](const Eigen::Vector2d& p, double u, double up) {
    return Corner{Eigen::Vector3d(p.x(), p.y(), base + up).cast<float>(),
                  Eigen::Vector2d(u / tile, (height - up) / tile).cast<float>()};
  };
  Mesh& mesh = scene.piece(texture, edge.a.x(), edge.a.y(), 0.0F, shade_of(edge.outward));
  add_polygon(mesh, {at(edge.a, 0.0, -foot), at(edge.b, edge.length, -foot), at(edge.b, edge.length, height),
                     at(edge.a, 0.0, height)});
}

}  // namespace

float shade_of(const Eigen::Vector2d& outward) {
  const Eigen::Vector2d sun(-0.56, -0.83);
  return static_cast<float>(0.64 + 0.36 * std::max(0.0, outward.dot(sun)));
}

void add_buildings(SceneBuilder& scene, const GroundMesh& ground, const StreetPlan& plan, const NearLines& routes,
                   const DetailParams& detail, std::uint32_t seed) {
  const FacadePainter painter(seed);
  const Blocks blocks(plan);
  std::array<TextureId, n_facade_styles> blanks{};
  Stream blank_random({seed, 0, 40, 0});
  for (std::size_t i = 0; i < blanks.size(); ++i)
    blanks[i] = scene.add(painter.paint_blank(facade_style(i), blank_random));
  Stream stone_random({seed, 0, 41, 0});
  FacadeStyle stone = facade_style(3);
  stone.wall = FacadeStyle::Wall::kPlaster, stone.grey = 186.0;
  const TextureId stone_texture = scene.add(painter.paint_blank(stone, stone_random));
  std::vector<Eigen::Vector2d> viewpoints;
  for (const Route& route : plan.routes) {
    const Polyline points = resampled(route.points, 5.0, route.closed);
    viewpoints.insert(viewpoints.end(), points.begin(), points.end());
  }
  for (std::size_t f = 0; f < plan.footprints.size(); ++f) {
    const Outline& footprint = plan.footprints[f];
    Stream looks({seed, 0, 42, footprint.id});
    const std::size_t which = looks.below(n_facade_styles);
    const FacadeStyle& style = facade_style(which);
    const std::size_t n = footprint.corners.size();
    double base = 0.0;
    for (const auto& corner : footprint.corners) base += ground.bed_m(corner) / static_cast<double>(n);
    base += Terrain::kerb_m;
    for (std::size_t i = 0; i < n; ++i) {
      Edge edge{footprint.corners[i], footprint.corners[(i + 1) % n], {}, 0.0};
      edge.length = (edge.b - edge.a).norm();
      if (edge.length < 0.02) continue;
      edge.outward = Eigen::Vector2d(edge.b.y() - edge.a.y(), edge.a.x() - edge.b.x()) / edge.length;
      const Eigen::Vector2d middle = (edge.a + edge.b) / 2;
      const double neighbour =
          std::min(blocks.height_at(middle + 0.4 * edge.outward, f),
                   std::min(blocks.height_at(edge.a + 0.15 * (edge.b - edge.a) + 0.4 * edge.outward, f),
                            blocks.height_at(edge.a + 0.85 * (edge.b - edge.a) + 0.4 * edge.outward, f)));
      if (neighbour >= footprint.height_m) continue;
      const double away = std::min({routes.distance_m(middle), routes.distance_m(edge.a), routes.distance_m(edge.b)});
      if (neighbour > 0.0 || edge.length < 2.2 || away >= detail.middle_m) {
        add_blank(scene, blanks[which], edge, base, footprint.height_m);
        continue;
      }
      Stream random({seed, static_cast<std::uint32_t>(i) + 1, 43, footprint.id});
      const FacadePlan front = plan_facade(style, edge.length, footprint.height_m, random);
      const bool close = away < detail.close_m && in_sight(blocks, viewpoints, edge);
      const TextureId texture =
          scene.add(painter.paint(style, front, close ? detail.close_texel_m : detail.middle_texel_m, random));
      const float shade = shade_of(edge.outward);
      close ? add_facade(scene, texture, front, edge.a, edge.b, base, shade)
            : add_flat_facade(scene, texture, front, edge.a, edge.b, base, shade);
      if (close && (style.surrounds || style.bands)) add_cornice(scene, stone_texture, edge, base + footprint.height_m);
    }
  }
}

}  // namespace convoy::simulator
