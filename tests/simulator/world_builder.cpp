#include "world_builder.hpp"

#include "road_marks.hpp"
#include "street_furniture.hpp"

#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>

namespace convoy::simulator {
namespace {

constexpr double parked_m = 1.05;  // middle of a parked car to the kerb

class Furnisher {
 public:
  Furnisher(SceneBuilder& scene, const GroundMesh& ground, const StreetNetwork& network, const StreetPlan& plan,
            const NearLines& routes, const StreetTextures& textures)
      : scene_(scene), ground_(ground), network_(network), plan_(plan), routes_(routes), textures_(textures) {
    for (const Outline& footprint : plan.footprints) walls_.add(footprint.corners, true);
  }

  void furnish(std::size_t index, std::uint32_t seed, double within_m) {
    const Street& street = plan_.streets[index];
    Stream random({seed, 0, 50, street.id});
    const bool trees = random.chance(0.6);
    for (const Stretch& stretch : stretches_between_junctions(network_, street, index)) {
      for (const double side : {1.0, -1.0}) {
        park(street, stretch, side, random, within_m);
        line(street, stretch, side, random, within_m, trees);
      }
    }
  }

 private:
  struct Place {
    Eigen::Vector2d at, ahead;
  };
  static Place place_at(const Street& street, double s, double right) {
    const PointOnLine point = point_at(street.line, s);
    return {point.at + right * Eigen::Vector2d(point.ahead.y(), -point.ahead.x()), point.ahead};
  }
  bool free(const Eigen::Vector2d& point, double clear_of_routes, double within) const {
    const double away = routes_.distance_m(point);
    if (away < clear_of_routes || away > within || walls_.distance_m(point) < 0.5) return false;
    return std::none_of(plan_.footprints.begin(), plan_.footprints.end(),
                        [&](const Outline& footprint) { return contains(footprint.corners, point); });
  }
  Eigen::Vector3d foot(const Eigen::Vector2d& point) const { return {point.x(), point.y(), ground_.height_m(point)}; }

  void park(const Street& street, const Stretch& stretch, double side, Stream& random, double within) {
    if (street.half_width_m < 3.3) return;
    const double from = stretch.from + (stretch.ends_at_junction_from ? 9.0 : 3.0);
    const double to = stretch.to - (stretch.ends_at_junction_to ? 9.0 : 3.0);
    const double share = random.uniform(0.35, 0.75);
    for (double s = from; s < to; s += random.uniform(5.3, 6.4)) {
      const bool taken = random.chance(share);
      const double right = side * (street.half_width_m - parked_m) + random.uniform(-0.12, 0.12);
      const double turn = random.uniform(-0.03, 0.03), height = random.uniform(1.4, 1.62);
      const std::uint32_t paint = random.below(8);
      const Place spot = place_at(street, s, right);
      if (!taken || !free(spot.at, 2.25, within)) continue;
      const double beyond = network_.beyond_kerb_m(spot.at);
      if (beyond > -0.7 || beyond < -1.6) continue;
      const double back = side < 0.0 && street.two_way ? M_PI : 0.0;
      place(scene_, car_model(textures_, paint, height), foot(spot.at),
            std::atan2(spot.ahead.y(), spot.ahead.x()) + turn + back);
    }
  }

  void line(const Street& street, const Stretch& stretch, double side, Stream& random, double within, bool trees) {
    const double to_road = side > 0.0 ? 1.0 : -1.0;
    for (double s = stretch.from + random.uniform(2.0, 8.0); s < stretch.to - 1.5; s += random.uniform(5.0, 9.0)) {
      const double kind = random.uniform(0.0, 1.0), beyond = random.uniform(0.5, 0.9);
      const Place spot = place_at(street, s, side * (street.half_width_m + beyond));
      const double clear = network_.beyond_kerb_m(spot.at);
      Stream own = random;  // what is drawn for one does not change the next
      random();
      if (clear < 0.35 || clear > 1.5 || !free(spot.at, 1.7, within)) continue;
      const double yaw = std::atan2(spot.ahead.y(), spot.ahead.x());
      if (kind < 0.4 && trees) {
        if (walls_.distance_m(spot.at) > 1.6) add_tree(scene_, textures_, foot(spot.at), own);
      } else if (kind < 0.55) {
        add_lamp(scene_, textures_, foot(spot.at), yaw + to_road * M_PI / 2);
      } else if (kind < 0.72) {
        add_sign(scene_, textures_, foot(spot.at), street.two_way && side < 0.0 ? yaw : yaw + M_PI, own);
      } else if (kind < 0.8) {
        add_bin(scene_, textures_, foot(spot.at), yaw);
      } else if (kind < 0.9) {
        for (int i = 0; i < 4; ++i) {
          const Place post = place_at(street, s + 1.2 * i, side * (street.half_width_m + 0.35));
          const double from_kerb = network_.beyond_kerb_m(post.at);
          if (from_kerb > 0.2 && from_kerb < 1.0 && free(post.at, 1.5, within))
            add_bollard(scene_, textures_, foot(post.at));
        }
      }
    }
  }

  SceneBuilder& scene_;
  const GroundMesh& ground_;
  const StreetNetwork& network_;
  const StreetPlan& plan_;
  const NearLines& routes_;
  const StreetTextures& textures_;
  NearLines walls_{8.0};
};

}  // namespace

World build_world(const StreetPlan& plan, std::uint32_t seed, const DetailParams& detail) {
  constexpr double margin_m = 60.0;
  Eigen::AlignedBox2d box;
  for (const Street& street : plan.streets)
    for (const auto& point : street.line) box.extend(point);
  for (const Outline& footprint : plan.footprints)
    for (const auto& corner : footprint.corners) box.extend(corner);
  const Eigen::Vector2d low = box.min().array() - margin_m, high = box.max().array() + margin_m;

  const auto terrain = std::make_shared<Terrain>(seed, low, high, StreetNetwork(plan.streets));
  NearLines routes(std::max({detail.middle_m, detail.furniture_m, detail.close_m}) + 1.0);
  for (const Route& route : plan.routes) routes.add(resampled(route.points, 10.0, route.closed), route.closed);

  SceneBuilder scene;
  const StreetTextures textures = paint_street_textures(scene, seed);
  const TextureId sky = scene.add(paint_sky(seed));
  const GroundMesh ground(*terrain);
  ground.build(scene, textures.ground, [&](const Eigen::Vector2d& point) { return routes.distance_m(point) < 60.0; });
  add_buildings(scene, ground, plan, routes, detail, seed);
  Furnisher furnisher(scene, ground, terrain->network(), plan, routes, textures);
  for (std::size_t i = 0; i < plan.streets.size(); ++i) {
    if (plan.streets[i].lanes == 0) continue;
    add_road_marks(scene, ground, terrain->network(), plan.streets[i], i, textures, seed);
    furnisher.furnish(i, seed, detail.furniture_m);
  }
  World world;
  world.scene = scene.finish();
  world.scene.sky = sky;
  world.ground = terrain;
  world.routes = plan.routes;
  world.attribution = plan.attribution;
  return world;
}

}  // namespace convoy::simulator
