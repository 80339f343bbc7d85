#include "live_source.hpp"

#include <convoy/simulator/camera.hpp>
#include <convoy/simulator/district.hpp>
#include <convoy/simulator/gps.hpp>
#include <convoy/simulator/odometer.hpp>
#include <convoy/simulator/osm_world.hpp>
#include <convoy/simulator/route_follower.hpp>
#include <convoy/simulator/traffic.hpp>
#include <convoy/simulator/vehicle_physics.hpp>

#include "fleet_bodies.hpp"
#include "progress.hpp"
#include "sensor_samples.hpp"
#include "sim_error.hpp"

#include <algorithm>
#include <cstdio>
#include <future>
#include <optional>
#include <thread>

namespace convoy::simulator {
namespace {

constexpr int physics_steps = 24;  // in a step of 0.1 s

StreetPlan make_plan(const SimOptions& options) {
  const StillAt still("laying out the streets");
  try {
    if (options.world == "district") return plan_district(options.seed);
    OsmReport report;
    StreetPlan plan = plan_osm(options.world, {}, report);
    for (const std::string& line : what_is_missing(report)) std::fprintf(stderr, "convoy sim: %s\n", line.c_str());
    return plan;
  } catch (const std::runtime_error& error) {
    throw SetUpError(error.what());
  }
}

/// Its index.
std::size_t find_route(const std::vector<Route>& routes, const std::string& name) {
  std::string known;
  for (std::size_t i = 0; i < routes.size(); ++i) {
    if (routes[i].name == name) return i;
    known += (known.empty() ? "" : ", ") + routes[i].name;
  }
  throw SetUpError("no route '" + name + "'; there are: " + known);
}

/// The index of each vehicle's.
std::vector<std::size_t> find_routes(const std::vector<Route>& routes, const SimOptions& options) {
  if (routes.empty()) throw SetUpError("the world has no route to drive along");
  std::vector<std::size_t> found{0};
  if (!options.routes.empty()) found.clear();
  for (const std::string& name : options.routes) found.push_back(find_route(routes, name));
  if (found.size() > static_cast<std::size_t>(options.vehicles))
    throw SetUpError("--route names " + std::to_string(found.size()) + " routes for " +
                     std::to_string(options.vehicles) + " vehicles; name at most one for each");
  found.resize(static_cast<std::size_t>(options.vehicles), found.back());
  return found;
}

TruthData truth_of(const VehicleState& state) {
  TruthData truth;
  truth.T_world_body = numbers_of(state.T_world_body);
  Eigen::Map<Eigen::Vector3d>(truth.velocity_world.data()) = state.velocity_world_mps;
  Eigen::Map<Eigen::Vector3d>(truth.turn_body.data()) = state.turn_body_radps;
  return truth;
}

OdometryData data_of(const OdometerReading& r) {
  return {r.frame,
          r.stamp_s,
          r.left_ticks,
          r.right_ticks,
          r.distance_m,
          r.speed_mps,
          r.wheels_yaw_rate_radps,
          r.gyro_yaw_rate_radps,
          r.sigma_distance_m,
          r.sigma_wheels_yaw_rate_radps,
          r.sigma_gyro_yaw_rate_radps};
}

std::array<double, 6> packed(const Eigen::Matrix3d& m) {
  return {m(0, 0), m(0, 1), m(0, 2), m(1, 1), m(1, 2), m(2, 2)};
}

std::array<double, 3> numbers_of(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

GpsData data_of(const GpsReading& r, GpsKind kind, const Eigen::Vector3d& antenna) {
  GpsData data;
  data.reading = r.frame;
  data.stamp_s = r.stamp_s;
  data.kind = kind;
  data.fix = r.fix;
  data.antenna_body = numbers_of(antenna);
  data.position = numbers_of(r.antenna_world_m);
  data.covariance = packed(r.covariance_m2);
  data.drift_covariance = packed(r.drift_covariance_m2);
  data.correlation_s = r.correlation_s;
  return data;
}

CameraParams camera_params(const SimOptions& options, std::uint32_t vehicle, std::optional<std::uint32_t> own_body) {
  CameraParams params;
  params.lens.width = options.width;
  params.lens.height = options.height;
  params.lens.fx *= options.width / 640.0;
  params.lens.fy = params.lens.fx;
  params.lens.cx = (options.width - 1) / 2.0;
  params.lens.cy = (options.height - 1) / 2.0;
  params.rendering.hidden_object = own_body;
  params.drop_probability = options.drop_probability;
  params.seed = options.seed;
  params.vehicle = vehicle;
  return params;
}

CameraData data_of(const CameraParams& params) {
  const LensParams& lens = params.lens;
  const auto& k = lens.coefficients;
  return {lens.width,
          lens.height,
          VehiclePhysics::rate_hz / physics_steps,
          lens.fx,
          lens.fy,
          lens.cx,
          lens.cy,
          {k[0], k[1], k[2], k[3], 0.0},
          params.T_body_camera};
}

std::vector<float> depths(const Rasteriser& truth) {
  const LensParams& lens = truth.lens().params();
  std::vector<float> all;
  all.reserve(static_cast<std::size_t>(lens.width) * static_cast<std::size_t>(lens.height));
  for (int v = 0; v < lens.height; ++v)
    for (int u = 0; u < lens.width; ++u) all.push_back(truth.depth(u, v));
  return all;
}

/// A vehicle with its driver and its sensors.
struct Driven {
  Driven(const SimOptions& options, const World& world, const Route& route, std::uint32_t vehicle_number)
      : number(vehicle_number),
        follower(route, follower_params(options, vehicle_number), params),
        start(follower.start(start_m(options, route, vehicle_number))),
        physics(params, *world.ground, start.x_m, start.y_m, start.yaw_rad),
        odometer(OdometerParams(), params, options.seed, vehicle_number) {
    if (options.gps != "none") {
      gps_params = options.gps == "rtk" ? rtk_gps() : standard_gps();
      gps_kind = options.gps == "rtk" ? GpsKind::rtk : GpsKind::standard;
      gps.emplace(gps_params, options.seed, vehicle_number);
    }
  }

  static double start_m(const SimOptions& options, const Route& route, std::uint32_t number) {
    const double at_m = options.gap_m * (options.vehicles - static_cast<double>(number));
    if (const RouteLine line(route, 0.0); !line.closed() && at_m >= line.length_m())
      throw SetUpError("the " + std::to_string(options.vehicles) + " vehicles are further apart than route '" +
                       route.name + "' is long");
    return at_m;
  }

  static RouteFollowerParams follower_params(const SimOptions& options, std::uint32_t number) {
    RouteFollowerParams follower;
    follower.speed_mps = options.speed_mps;
    if (!options.offset_m.empty())
      follower.offset_m = options.offset_m[std::min<std::size_t>(number, options.offset_m.size()) - 1];
    return follower;
  }

  void sense(VehicleStep& step) {
    if (const auto reading = odometer.step(physics.state())) step.odometry.push_back(data_of(*reading));
    if (!gps) return;
    if (const auto reading = gps->step(physics.state()))
      step.gps.push_back(data_of(*reading, gps_kind, gps_params.antenna_body_m));
  }

  /// Drives for one step of the camera.
  VehicleStep drive() {
    VehicleStep step;
    step.vehicle = number;
    if (physics.state().step == 0) sense(step);  // it stands
    for (int i = 0; i < physics_steps; ++i) {
      physics.step(follower.step(physics.state()));
      sense(step);
    }
    step.truth = truth_of(physics.state());
    return step;
  }

  std::uint32_t number;
  VehicleParams params;
  RouteFollower follower;
  RouteFollower::Start start;
  VehiclePhysics physics;
  Odometer odometer;
  GpsParams gps_params;
  GpsKind gps_kind = GpsKind::standard;
  std::optional<Gps> gps;
};

}  // namespace

struct LiveSource::Impl {
  static std::unique_ptr<Impl> make(const SimOptions& options) {
    const StreetPlan plan = make_plan(options);
    find_routes(plan.routes, options);  // before the part that takes long
    const StillAt still("building the world");
    return std::make_unique<Impl>(options, plan);
  }

  Impl(const SimOptions& sim_options, const StreetPlan& plan)
      : options(sim_options), world(build_world(plan, options.seed, DetailParams())) {
    const std::vector<std::size_t> routes = find_routes(world.routes, options);
    const RouteLine first(world.routes[routes.front()], 0.0);
    distance_m = options.distance_m.value_or(options.duration_s ? 1e9 : first.length_m());
    if (options.traffic) traffic.emplace(world, options.seed);
    first_body = add_bodies(world, options.vehicles, options.seed);
    for (const std::size_t route : routes)
      driven.push_back(
          std::make_unique<Driven>(options, world, world.routes[route], static_cast<std::uint32_t>(driven.size() + 1)));
    const auto textures = mip_textures(world.scene);
    cameras.resize(driven.size());
    in_parallel([&](std::size_t i) {
      cameras[i] = std::make_unique<Camera>(
          world.scene, camera_params(options, driven[i]->number, first_body + static_cast<std::uint32_t>(i)), textures);
    });
    for (std::size_t i = 0; i < driven.size(); ++i)
      vehicles.push_back({driven[i]->number, data_of(cameras[i]->params())});
  }

  /// Without pictures.
  StepData drive() {
    StepData step;
    step.step = ++done;
    for (const auto& vehicle : driven) step.vehicles.push_back(vehicle->drive());
    step.time_s = driven.front()->physics.state().time_s;
    step.last = ends(step.time_s);
    if (traffic) traffic->set(step.time_s);
    for (std::size_t i = 0; i < driven.size(); ++i)
      place_body(world, first_body + static_cast<std::uint32_t>(i), driven[i]->physics.state().T_world_body);
    return step;
  }

  StepData next() {
    StepData step = drive();
    in_parallel([&](std::size_t i) { take_picture(i, step.vehicles[i]); });
    return step;
  }

  bool ends(double time_s) const {
    if (options.duration_s && time_s > *options.duration_s - 1e-6) return true;
    if (driven.front()->follower.driven_m() >= distance_m) return true;
    const bool over = std::all_of(driven.begin(), driven.end(), [](const auto& v) { return v->follower.finished(); });
    if (over && (options.duration_s || options.distance_m))
      std::fprintf(stderr, "convoy sim: at the end of the route after %.0f m and %.0f s; a closed one leads on\n",
                   driven.front()->follower.driven_m(), time_s);
    return over;
  }

  void take_picture(std::size_t i, VehicleStep& step) {
    const VehicleState& state = driven[i]->physics.state();
    std::optional<Frame> taken = cameras[i]->take(state.T_world_body, done - 1);
    if (!taken) return;  // dropped
    FrameData frame;
    frame.frame = taken->index;
    frame.stamp_s = state.time_s;
    frame.width = taken->image.width;
    frame.height = taken->image.height;
    frame.grey = std::move(taken->image.values);
    if (options.depth) frame.depth_m = depths(cameras[i]->truth());
    step.frames.push_back(std::move(frame));
  }

  /// For each vehicle; what is done depends on nothing but its number.
  template <class Work>
  void in_parallel(const Work& work) const {
    const std::size_t workers = std::min<std::size_t>(driven.size(), std::max(1U, std::thread::hardware_concurrency()));
    const auto share = [&](std::size_t first) {
      for (std::size_t i = first; i < driven.size(); i += workers) work(i);
    };
    std::vector<std::future<void>> others;
    for (std::size_t w = 1; w < workers; ++w) others.push_back(std::async(std::launch::async, share, w));
    share(0);
    for (auto& other : others) other.get();
  }

  const SimOptions options;
  World world;
  double distance_m = 0.0;
  std::optional<Traffic> traffic;
  std::uint32_t first_body = 0;  // object of vehicle 1
  std::vector<std::unique_ptr<Driven>> driven;
  std::vector<std::unique_ptr<Camera>> cameras;
  std::vector<SourceVehicle> vehicles;
  std::uint32_t done = 0;
};

LiveSource::LiveSource(const SimOptions& options) try : impl_(Impl::make(options)) {
} catch (const std::invalid_argument& error) {  // a vehicle that cannot be put there
  throw SetUpError(error.what());
}
LiveSource::~LiveSource() = default;

const std::vector<SourceVehicle>& LiveSource::vehicles() const { return impl_->vehicles; }
StepData LiveSource::next() { return impl_->next(); }
double LiveSource::step_s() const { return physics_steps / VehiclePhysics::rate_hz; }
std::string LiveSource::attribution() const { return impl_->world.attribution; }

double LiveSource::duration_s() const {
  const double way_s = impl_->distance_m / impl_->options.speed_mps;
  return std::min(way_s, impl_->options.duration_s.value_or(way_s));
}

FrameData LiveSource::snapshot(const std::function<void(double time_s)>& tell) {
  const bool drives = impl_->options.duration_s || impl_->options.distance_m;
  StepData step;
  do {
    step = impl_->drive();
    tell(step.time_s);
  } while (drives && !step.last);
  impl_->take_picture(0, step.vehicles.front());
  return step.vehicles.front().frames.at(0);
}

WorldNote describe_world(const SimOptions& options) {
  const StreetPlan plan = make_plan(options);
  WorldNote note{plan.attribution, {}};
  for (const Route& route : plan.routes) {
    const RouteLine line(route, 0.0);
    note.routes.push_back({route.name, line.route_length_m(), line.closed()});
  }
  return note;
}

}  // namespace convoy::simulator
