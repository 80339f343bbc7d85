#include "traffic.hpp"

#include "paint.hpp"
#include "polyline.hpp"
#include "street_furniture.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace convoy::simulator {

Traffic::Traffic(World& world, std::uint32_t seed, const TrafficParams& params) : world_(world) {
  if (params.cars < 0) throw std::runtime_error("traffic: cars is " + std::to_string(params.cars) + ", not 0 or more");
  if (!(params.slowest_mps >= 0.0) || !(params.fastest_mps >= params.slowest_mps) || !(params.fastest_mps <= 40.0))
    throw std::runtime_error("traffic: speeds must be 0 <= slowest <= fastest <= 40 m/s");
  std::vector<std::size_t> ways;
  for (std::size_t i = 0; i < world.routes.size(); ++i) {
    const Route& route = world.routes[i];
    const bool named = std::find(params.on.begin(), params.on.end(), route.name) != params.on.end();
    if (named && !route.closed)
      throw std::runtime_error("traffic: route '" + route.name + "' is not closed; name another");
    if (named || (params.on.empty() && route.closed && route.name.ends_with("opposite"))) ways.push_back(i);
    lengths_.push_back(length_m(route.points, route.closed));
  }
  for (const std::string& name : params.on)
    if (std::none_of(world.routes.begin(), world.routes.end(), [&](const Route& route) { return route.name == name; }))
      throw std::runtime_error("traffic: there is no route '" + name + "'");
  if (ways.empty() || params.cars == 0) return;

  Stream random({seed, 0, 60, 0});
  SceneBuilder own;
  const StreetTextures painted = paint_car_textures(own, seed);
  const auto first = static_cast<TextureId>(world.scene.textures.size());
  std::move(own.scene.textures.begin(), own.scene.textures.end(), std::back_inserter(world.scene.textures));
  // All on a route keep one speed, or they would drive through one another.
  std::vector<double> speeds, phases;
  for (std::size_t i = 0; i < ways.size(); ++i) {
    speeds.push_back(random.uniform(params.slowest_mps, params.fastest_mps));
    phases.push_back(random.uniform(0.0, 1.0));
  }
  const auto on_each = (static_cast<std::size_t>(params.cars) + ways.size() - 1) / ways.size();
  for (std::size_t k = 0; k < static_cast<std::size_t>(params.cars); ++k) {
    const std::size_t way = k % ways.size();
    const double spread = random.uniform(-0.25, 0.25);
    const double share = phases[way] + (static_cast<double>(k / ways.size()) + spread) / static_cast<double>(on_each);
    Object object;
    object.meshes = car_model(painted, random.below(8), random.uniform(1.4, 1.6));
    for (Mesh& mesh : object.meshes) mesh.texture += first;
    world.scene.objects.push_back(std::move(object));
    cars_.push_back({world.scene.objects.size() - 1, ways[way], share * lengths_[ways[way]], speeds[way]});
  }
  set(0.0);
}

void Traffic::set(double time_s) {
  for (const Car& car : cars_) {
    const Route& route = world_.routes[car.route];
    const double s = car.start_m + car.speed_mps * time_s;
    const auto at = [&](double ahead) { return point_at(route.points, s + ahead, true).at; };
    const auto on_ground = [&](const Eigen::Vector2d& p) {
      return Eigen::Vector3d(p.x(), p.y(), world_.ground->height_m(p.x(), p.y()));
    };
    const Eigen::Vector3d front = on_ground(at(1.3)), rear = on_ground(at(-1.3));
    const Eigen::Vector3d x = (front - rear).normalized(), y = Eigen::Vector3d::UnitZ().cross(x).normalized();
    Eigen::Isometry3d& T = world_.scene.objects[car.object].T_world_object;
    T.linear().col(0) = x, T.linear().col(1) = y, T.linear().col(2) = x.cross(y);
    T.translation() = (front + rear) / 2;
  }
}

}  // namespace convoy::simulator
