#include "vehicle_physics.hpp"

#include "ground_vehicle.hpp"
#include "parameter_check.hpp"

#include <cmath>
#include <sstream>
#include <stdexcept>

namespace convoy::simulator {
namespace {

constexpr double step_s = 1.0 / VehiclePhysics::rate_hz;

Eigen::Vector3d eigen(const btVector3& v) { return {v.x(), v.y(), v.z()}; }

Eigen::Isometry3d eigen(const btTransform& T) {
  Eigen::Isometry3d result = Eigen::Isometry3d::Identity();
  for (int column = 0; column < 3; ++column) result.linear().col(column) = eigen(T.getBasis().getColumn(column));
  result.translation() = eigen(T.getOrigin());
  return result;
}

/// Of the body's frame, its wheels on the plane that fits the ground under them.
btTransform standing(const VehicleParams& p, const GroundRays& rays, double x_m, double y_m, double yaw_rad) {
  const double c = std::cos(yaw_rad), s = std::sin(yaw_rad);
  const auto under = [&](double ahead, double left) {
    return btVector3(x_m + c * ahead - s * left, y_m + s * ahead + c * left,
                     rays.patch(x_m + c * ahead - s * left, y_m + s * ahead + c * left).height_m);
  };
  const double half = 0.5 * p.track_m;
  const btVector3 rear_left = under(0.0, half), rear_right = under(0.0, -half);
  const btVector3 front_left = under(p.wheelbase_m, half), front_right = under(p.wheelbase_m, -half);
  const btVector3 ahead = (front_left + front_right - rear_left - rear_right).normalized();
  const btVector3 up = ahead.cross(front_left + rear_left - front_right - rear_right).normalized();
  const btVector3 left = up.cross(ahead);
  return btTransform(btMatrix3x3(ahead.x(), left.x(), up.x(), ahead.y(), left.y(), up.y(), ahead.z(), left.z(), up.z()),
                     (rear_left + rear_right) / 2.0);
}

btVector3 box_inertia(const VehicleParams& p) {
  const double x = p.length_m * p.length_m, y = p.width_m * p.width_m;
  const double z = (p.height_m - p.clearance_m) * (p.height_m - p.clearance_m);
  return btVector3(y + z, x + z, x + y) * (p.mass_kg / 12.0);
}

const VehicleParams& checked(const VehicleParams& params) {
  params.validate();
  return params;
}

}  // namespace

double VehicleState::yaw_rad() const { return std::atan2(T_world_body(1, 0), T_world_body(0, 0)); }
double VehicleState::pitch_rad() const { return std::asin(-std::min(1.0, std::max(-1.0, T_world_body(2, 0)))); }
double VehicleState::roll_rad() const { return std::atan2(T_world_body(2, 1), T_world_body(2, 2)); }

struct VehiclePhysics::Impl {
  VehicleParams params;
  GroundRays rays;
  btDefaultCollisionConfiguration configuration;
  btCollisionDispatcher dispatcher{&configuration};
  btDbvtBroadphase broadphase;
  btSequentialImpulseConstraintSolver solver;
  btDiscreteDynamicsWorld world{&dispatcher, &broadphase, &solver, &configuration};
  btEmptyShape shape;
  btRigidBody body;
  GroundVehicle vehicle;
  VehicleState state;

  Impl(const VehicleParams& p, const Ground& ground)
      : params(p),
        rays(ground, p.wheel_radius_m / 3.0),
        body(p.mass_kg, nullptr, &shape, box_inertia(p)),
        vehicle(p, body, rays) {
    world.setGravity({0.0, 0.0, 0.0});  // the vehicle applies it, so that its tyres can hold against it
    body.setActivationState(DISABLE_DEACTIVATION);
    world.addRigidBody(&body, 0, 0);
  }
  ~Impl() { world.removeRigidBody(&body); }

  void settle(double x_m, double y_m, double yaw_rad);
  void advance(const DriveCommand& command);
  void read_state(std::uint64_t steps);
};

void VehiclePhysics::Impl::settle(double x_m, double y_m, double yaw_rad) {
  const btTransform T_world_rest = standing(params, rays, x_m, y_m, yaw_rad);
  const btTransform T_rest_centre(btMatrix3x3::getIdentity(), {params.centre_ahead_m, 0.0, params.centre_height_m});
  body.setWorldTransform(T_world_rest * T_rest_centre);
  DriveCommand brakes;
  brakes.brake_mps2 = params.max_brake_mps2;
  for (int i = 0; i < 10 * static_cast<int>(rate_hz); ++i) {
    advance(brakes);
    if (i >= static_cast<int>(rate_hz) && body.getLinearVelocity().length() < 1e-9 &&
        body.getAngularVelocity().length() < 1e-9)
      break;
  }
  read_state(0);
  const double moved = (state.T_world_body.translation() - eigen(T_world_rest.getOrigin())).norm();
  if (!(moved < 0.5) || !(body.getLinearVelocity().length() < 0.01)) {
    std::ostringstream text;
    text << "VehiclePhysics: the vehicle does not stay where it is put (" << x_m << ", " << y_m << "), it moves by "
         << moved << " m: start it on ground less steep";
    throw std::invalid_argument(text.str());
  }
  vehicle.forget_the_way();
  read_state(0);
}

void VehiclePhysics::Impl::advance(const DriveCommand& command) {
  vehicle.command(command);
  vehicle.updateVehicle(step_s);
  world.stepSimulation(step_s, 0);
  vehicle.turn_wheels(step_s);
}

void VehiclePhysics::Impl::read_state(std::uint64_t steps) {
  const btTransform T_centre_body(btMatrix3x3::getIdentity(), {-params.centre_ahead_m, 0.0, -params.centre_height_m});
  const btTransform T_world_body = body.getWorldTransform() * T_centre_body;
  state.step = steps;
  state.time_s = static_cast<double>(steps) / rate_hz;
  state.T_world_body = eigen(T_world_body);
  const btVector3 velocity = body.getVelocityInLocalPoint(T_world_body.getOrigin() - body.getCenterOfMassPosition());
  state.velocity_world_mps = eigen(velocity);
  state.turn_body_radps = eigen(body.getAngularVelocity() * T_world_body.getBasis());
  state.speed_mps = velocity.dot(T_world_body.getBasis().getColumn(0));
  state.steering_rad = vehicle.steering_rad();
  for (std::size_t i = 0; i < state.wheels.size(); ++i) {
    const btWheelInfo& wheel = vehicle.getWheelInfo(static_cast<int>(i));
    const GroundVehicle::Tyre& tyre = vehicle.tyres()[i];
    WheelState& out = state.wheels[i];
    // m_deltaRotation is damped by Bullet, so that its sum is not the way gone: the difference of m_rotation is.
    out.speed_radps = (wheel.m_rotation - out.angle_rad) / step_s;
    out.angle_rad = wheel.m_rotation;
    out.steering_rad = wheel.m_steering;
    out.normal_n = tyre.load_ns / step_s;
    out.longitudinal_n = tyre.ahead_ns / step_s;
    out.lateral_n = tyre.left_ns / step_s;
    out.spring_m = tyre.spring_m;
  }
}

VehiclePhysics::VehiclePhysics(const VehicleParams& params, const Ground& ground, double x_m, double y_m,
                               double yaw_rad) {
  check_that(std::isfinite(x_m) && std::isfinite(y_m) && std::isfinite(yaw_rad), "VehiclePhysics: x, y, yaw",
             "not finite; say where the vehicle starts");
  impl_ = std::make_unique<Impl>(checked(params), ground);
  impl_->settle(x_m, y_m, yaw_rad);
}
VehiclePhysics::~VehiclePhysics() = default;
VehiclePhysics::VehiclePhysics(VehiclePhysics&&) noexcept = default;
VehiclePhysics& VehiclePhysics::operator=(VehiclePhysics&&) noexcept = default;

void VehiclePhysics::step(const DriveCommand& command) {
  check_that(std::isfinite(command.drive_mps2) && std::isfinite(command.brake_mps2) &&
                 std::isfinite(command.steering_rad) && std::isfinite(command.yaw_rate_radps),
             "DriveCommand", "a value is not finite; see what the driver computed it from");
  impl_->advance(command);
  impl_->read_state(impl_->state.step + 1);
}

const VehicleState& VehiclePhysics::state() const { return impl_->state; }
const VehicleParams& VehiclePhysics::params() const { return impl_->params; }

}  // namespace convoy::simulator
