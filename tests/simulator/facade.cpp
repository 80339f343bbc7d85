#include "facade.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace convoy::simulator {

const FacadeStyle& facade_style(std::size_t index) {
  using Wall = FacadeStyle::Wall;
  static const std::array<FacadeStyle, n_facade_styles> styles{{
      {Wall::kPlaster, 176, 2.88, 1.12, 1.76, 0.92, 3.2, 4.0, 222, 2, true, false, true, 0.5},
      {Wall::kBrick, 112, 2.56, 1.04, 1.60, 0.96, 3.1, 3.6, 218, 2, false, false, false, 0.2},
      {Wall::kConcrete, 148, 3.20, 1.92, 1.44, 0.96, 3.0, 3.6, 96, 3, false, true, true, 0.3},
      {Wall::kStone, 164, 3.04, 1.20, 2.00, 0.72, 3.5, 4.6, 120, 2, true, true, true, 0.7},
      {Wall::kPlaster, 140, 2.40, 1.00, 1.44, 0.96, 3.0, 3.4, 230, 1, false, false, false, 0.3},
      {Wall::kBrick, 136, 3.36, 1.60, 1.68, 0.88, 3.2, 4.0, 90, 2, true, false, true, 0.5},
      {Wall::kConcrete, 170, 2.72, 2.08, 1.60, 0.80, 3.1, 4.2, 70, 2, false, false, false, 0.6},
      {Wall::kPlaster, 198, 3.12, 1.36, 1.84, 0.84, 3.3, 4.2, 150, 4, true, true, false, 0.4},
  }};
  return styles[index % n_facade_styles];
}

FacadePlan plan_facade(const FacadeStyle& style, double width_m, double height_m, Stream& random) {
  FacadePlan plan{width_m, height_m, {}};
  const int columns = static_cast<int>((width_m - 0.5) / style.pitch_m);
  if (columns < 1 || height_m < style.ground_storey_m) return plan;
  const double margin = (width_m - columns * style.pitch_m) / 2;
  const int door = static_cast<int>(random.below(static_cast<std::uint32_t>(columns)));
  const double head = style.ground_storey_m - 0.9;
  for (int column = 0; column < columns; ++column) {
    const double middle = margin + (column + 0.5) * style.pitch_m;
    const double kind = random.uniform(0.0, 1.0);
    const double shop = style.pitch_m / 2 - 0.24, half = style.window_width_m / 2;
    if (column == door) {
      plan.openings.push_back({Opening::Kind::kDoor, middle - 0.6, middle + 0.6, 0.14, std::min(head, 2.6)});
    } else if (kind < style.shop_share) {
      plan.openings.push_back({Opening::Kind::kShop, middle - shop, middle + shop, 0.45, head});
    } else if (kind > 0.93 && style.pitch_m > 2.7) {
      plan.openings.push_back({Opening::Kind::kGarage, middle - 1.2, middle + 1.2, 0.1, std::min(head, 2.4)});
    } else {
      plan.openings.push_back(
          {Opening::Kind::kWindow, middle - half, middle + half, 1.2, std::min(head, 1.2 + style.window_height_m)});
    }
    for (double floor = style.ground_storey_m; floor + style.storey_m < height_m + 0.1; floor += style.storey_m) {
      const double z0 = floor + style.sill_m, z1 = std::min(z0 + style.window_height_m, height_m - 0.5);
      if (z1 > z0 + 0.6) plan.openings.push_back({Opening::Kind::kWindow, middle - half, middle + half, z0, z1});
    }
  }
  return plan;
}

namespace {

/// Positions on a wall as points in the world and in its texture.
struct Wall {
  Eigen::Vector2d a, along, inward;
  double z, width, height;

  Wall(const FacadePlan& plan, const Eigen::Vector2d& from, const Eigen::Vector2d& to, double base)
      : a(from),
        along((to - from).normalized()),
        inward(-along.y(), along.x()),
        z(base),
        width((to - from).norm()),
        height(plan.height_m) {}

  Corner at(double x, double up, double depth, double texture_x, double texture_up) const {
    const Eigen::Vector2d place = a + x * along + depth * inward;
    // Half a texel away from the upper edge, since textures repeat.
    const double v = std::clamp((height - texture_up) / (height + FacadePainter::foot_m), 0.001, 0.999);
    return {Eigen::Vector3d(place.x(), place.y(), z + up).cast<float>(),
            Eigen::Vector2d(texture_x / width, v).cast<float>()};
  }
  Corner at(double x, double up, double depth = 0.0) const { return at(x, up, depth, x, up); }
};

std::vector<double> cuts_of(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  values.erase(std::unique(values.begin(), values.end(), [](double p, double q) { return q - p < 1e-6; }),
               values.end());
  return values;
}

void add_reveal(Mesh& mesh, const Wall& wall, const Opening& o, double depth) {
  const double strip = 0.1;  // the wall beside the opening goes on around its corner
  const auto side = [&](double x, double texture_x, bool left) {
    const Corner front0 = wall.at(x, o.z0), front1 = wall.at(x, o.z1);
    const Corner back0 = wall.at(x, o.z0, depth, texture_x, o.z0), back1 = wall.at(x, o.z1, depth, texture_x, o.z1);
    left ? add_polygon(mesh, {front0, back0, back1, front1}) : add_polygon(mesh, {back0, front0, front1, back1});
  };
  side(o.x0, o.x0 - strip, true);
  side(o.x1, o.x1 + strip, false);
  add_polygon(mesh, {wall.at(o.x0, o.z1, depth, o.x0, o.z1 + strip), wall.at(o.x1, o.z1, depth, o.x1, o.z1 + strip),
                     wall.at(o.x1, o.z1), wall.at(o.x0, o.z1)});
  add_polygon(mesh, {wall.at(o.x0, o.z0), wall.at(o.x1, o.z0), wall.at(o.x1, o.z0, depth, o.x1, o.z0 - strip),
                     wall.at(o.x0, o.z0, depth, o.x0, o.z0 - strip)});
}

}  // namespace

void add_facade(SceneBuilder& scene, TextureId texture, const FacadePlan& plan, const Eigen::Vector2d& a,
                const Eigen::Vector2d& b, double z, float shade) {
  const Wall wall(plan, a, b, z);
  std::vector<double> xs{0.0, wall.width}, zs{-FacadePainter::foot_m, plan.height_m};
  for (const Opening& o : plan.openings) {
    xs.insert(xs.end(), {o.x0, o.x1});
    zs.insert(zs.end(), {o.z0, o.z1});
  }
  xs = cuts_of(std::move(xs)), zs = cuts_of(std::move(zs));
  Mesh front, reveals;
  front.texture = reveals.texture = texture;
  front.shade = shade, reveals.shade = 0.7F * shade;
  for (std::size_t i = 0; i + 1 < xs.size(); ++i) {
    for (std::size_t j = 0; j + 1 < zs.size(); ++j) {
      const double x = (xs[i] + xs[i + 1]) / 2, up = (zs[j] + zs[j + 1]) / 2;
      const bool open = std::any_of(plan.openings.begin(), plan.openings.end(),
                                    [&](const Opening& o) { return x > o.x0 && x < o.x1 && up > o.z0 && up < o.z1; });
      if (open) continue;
      add_polygon(front, {wall.at(xs[i], zs[j]), wall.at(xs[i + 1], zs[j]), wall.at(xs[i + 1], zs[j + 1]),
                          wall.at(xs[i], zs[j + 1])});
    }
  }
  for (const Opening& o : plan.openings) {
    const double depth = o.kind == Opening::Kind::kWindow ? 0.12 : 0.18;
    add_polygon(front, {wall.at(o.x0, o.z0, depth), wall.at(o.x1, o.z0, depth), wall.at(o.x1, o.z1, depth),
                        wall.at(o.x0, o.z1, depth)});
    add_reveal(reveals, wall, o, depth);
  }
  scene.add(std::move(front));
  if (!reveals.triangles.empty()) scene.add(std::move(reveals));
}

void add_flat_facade(SceneBuilder& scene, TextureId texture, const FacadePlan& plan, const Eigen::Vector2d& a,
                     const Eigen::Vector2d& b, double z, float shade) {
  const Wall wall(plan, a, b, z);
  Mesh mesh;
  mesh.texture = texture, mesh.shade = shade;
  const double foot = -FacadePainter::foot_m, top = plan.height_m;
  add_polygon(mesh, {wall.at(0, foot), wall.at(wall.width, foot), wall.at(wall.width, top), wall.at(0, top)});
  scene.add(std::move(mesh));
}

}  // namespace convoy::simulator
