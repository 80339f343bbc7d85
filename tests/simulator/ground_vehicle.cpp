#include "ground_vehicle.hpp"

#include <algorithm>
#include <cmath>
#include <span>
#include <sstream>
#include <stdexcept>

namespace convoy::simulator {
namespace {

constexpr int solver_rounds = 12;
constexpr double motor_lead_mps = 0.1;   // of the motor's speed over the wheels'
constexpr double spring_length_m = 0.6;  // from its upper end to the wheel's middle, unloaded

btVector3 connection(const VehicleParams& p, std::size_t wheel, double length_m) {
  const double x = wheel < RearLeft ? p.wheelbase_m : 0.0;
  const double y = wheel % 2 == 0 ? 0.5 * p.track_m : -0.5 * p.track_m;
  return {x - p.centre_ahead_m, y, p.wheel_radius_m + length_m - p.centre_height_m};
}

double share_of_load(const VehicleParams& p, std::size_t wheel) {
  const double front = p.centre_ahead_m / p.wheelbase_m;
  return 0.5 * (wheel < RearLeft ? front : 1.0 - front);
}

double toward(double from, double to, double by) { return from + std::clamp(to - from, -by, by); }

}  // namespace

double GroundRays::height_m(double x_m, double y_m) const {
  const double height = ground_->height_m(x_m, y_m);
  if (std::isfinite(height)) return height;
  std::ostringstream text;
  text << "Ground::height_m(" << x_m << ", " << y_m << ") is " << height
       << "; a vehicle needs a finite height everywhere: mend the ground or keep the route on it";
  throw std::invalid_argument(text.str());
}

GroundPatch GroundRays::patch(double x_m, double y_m) const {
  const double a = half_contact_m_;
  const double middle = height_m(x_m, y_m), east = height_m(x_m + a, y_m), west = height_m(x_m - a, y_m);
  const double north = height_m(x_m, y_m + a), south = height_m(x_m, y_m - a);
  btVector3 normal(-(east - west) / (2.0 * a), -(north - south) / (2.0 * a), 1.0);
  return {(2.0 * middle + east + west + north + south) / 6.0, normal.normalized()};
}

void* GroundRays::castRay(const btVector3& from, const btVector3& to, btVehicleRaycasterResult& result) {
  const btVector3 ray = to - from;
  if (ray.z() > -0.2 * ray.length()) return nullptr;  // on its side
  // The ray is nearly upright and moves little from one step to the next: the plane at the last hit is met, nothing
  // else is asked of the ground, which takes most of the time on a large map.
  const btVector3 at = from + ray * guess_;
  const GroundPatch under = patch(at.x(), at.y());
  const double height_over = (at - btVector3(at.x(), at.y(), under.height_m)).dot(under.normal);
  const double part = guess_ - height_over / std::min(ray.dot(under.normal), -0.1 * ray.length());
  if (part > 1.0) return nullptr;
  result.m_hitPointInWorld = from + ray * part;
  result.m_hitNormalInWorld = under.normal;
  result.m_distFraction = part;
  return this;
}

GroundVehicle::GroundVehicle(const VehicleParams& params, btRigidBody& body, GroundRays& rays)
    : btRaycastVehicle(btVehicleTuning(), &body, &rays),
      params_(params),
      body_(&body),
      rays_(&rays),
      rest_length_m_(spring_length_m - params.deflection_m) {
  setCoordinateSystem(1, 2, 0);
  for (std::size_t i = 0; i < tyres_.size(); ++i) {
    const double share = share_of_load(params, i);
    btVehicleTuning tuning;  // Bullet multiplies by the body's mass
    tuning.m_suspensionStiffness = share * VehiclePhysics::gravity_mps2 / params.deflection_m;
    tuning.m_suspensionCompression = tuning.m_suspensionDamping =
        2.0 * params.damping_ratio * share * std::sqrt(VehiclePhysics::gravity_mps2 / params.deflection_m);
    tuning.m_maxSuspensionTravelCm = 100.0 * (params.deflection_m + params.travel_m);
    tuning.m_maxSuspensionForce = 1e9;
    addWheel(connection(params, i, rest_length_m_), {0.0, 0.0, -1.0}, {0.0, -1.0, 0.0}, spring_length_m,
             params.wheel_radius_m, tuning, i < RearLeft);
    tyres_[i].holds = params.kind == VehicleKind::Car || i >= RearLeft;
  }
  resetSuspension();  // Bullet leaves its lengths undefined
}

double GroundVehicle::speed_along(const btVector3& position, const btVector3& direction) const {
  return direction.dot(body_->getVelocityInLocalPoint(position - body_->getCenterOfMassPosition()));
}

double GroundVehicle::give_along(const btVector3& position, const btVector3& direction) const {
  return body_->computeImpulseDenominator(position, direction);
}

void GroundVehicle::push(const btVector3& position, const btVector3& impulse) {
  body_->applyImpulse(impulse, position - body_->getCenterOfMassPosition());
}

void GroundVehicle::updateVehicle(btScalar step) {
  steer(step);
  find_contacts(step);
  if (params_.kind == VehicleKind::Car) drive_car(step);
  else drive_robot(step);
  body_->setLinearVelocity(body_->getLinearVelocity() + btVector3(0.0, 0.0, -VehiclePhysics::gravity_mps2 * step));
  apply_springs();
  find_stops(step);
  solve();
}

void GroundVehicle::steer(double step_s) {
  if (params_.kind != VehicleKind::Car) return;
  const double wanted = std::clamp(command_.steering_rad, -params_.max_steering_rad, params_.max_steering_rad);
  const double lag = params_.steering_lag_s > 0.0 ? 1.0 - std::exp(-step_s / params_.steering_lag_s) : 1.0;
  const double limit = params_.steering_rate_radps * step_s;
  steering_rad_ += std::clamp((wanted - steering_rad_) * lag, -limit, limit);
  const double curvature = std::tan(steering_rad_) / params_.wheelbase_m;
  for (int i = 0; i < 2; ++i) {  // Ackermann: all axles point at one middle
    const double to_side = (i == FrontLeft ? 0.5 : -0.5) * params_.track_m;
    setSteeringValue(std::atan(params_.wheelbase_m * curvature / (1.0 - to_side * curvature)), i);
  }
}

void GroundVehicle::find_contacts(double step_s) {
  for (btWheelInfo& wheel : std::span(&m_wheelInfo[0], tyres_.size())) {
    rays_->guess((wheel.m_raycastInfo.m_suspensionLength + params_.wheel_radius_m) /
                 (spring_length_m + params_.wheel_radius_m));
    rayCast(wheel);
  }
  updateSuspension(step_s);
  add_anti_roll();
  const btVector3 body_ahead = body_->getWorldTransform().getBasis().getColumn(0);
  const btVector3 body_up = body_->getWorldTransform().getBasis().getColumn(2);
  for (std::size_t i = 0; i < tyres_.size(); ++i) {
    Tyre& tyre = tyres_[i];
    const btWheelInfo& wheel = m_wheelInfo[static_cast<int>(i)];
    const btVector3 normal = wheel.m_raycastInfo.m_contactNormalWS;
    tyre.touches = wheel.m_raycastInfo.m_isInContact;
    tyre.position = wheel.m_raycastInfo.m_contactPointWS;
    tyre.left = normal.cross(body_ahead.rotate(body_up, wheel.m_steering)).normalized();
    tyre.ahead = tyre.left.cross(normal);
    tyre.load_ns = tyre.touches ? wheel.m_wheelsSuspensionForce * step_s : 0.0;
    tyre.spring_m = rest_length_m_ - wheel.m_raycastInfo.m_suspensionLength;
    tyre.free_ahead_ns = tyre.target_mps = tyre.target_limit_ns = 0.0;
    const double stiffness_ns = params_.cornering_stiffness * std::max(tyre.load_ns, 1e-9);
    tyre.softness = std::abs(speed_along(tyre.position, tyre.ahead)) / stiffness_ns;
  }
}

void GroundVehicle::add_anti_roll() {
  for (int left : {0, 2}) {
    btWheelInfo &a = m_wheelInfo[left], &b = m_wheelInfo[left + 1];
    if (!a.m_raycastInfo.m_isInContact && !b.m_raycastInfo.m_isInContact) continue;
    const double difference = a.m_raycastInfo.m_suspensionLength - b.m_raycastInfo.m_suspensionLength;
    a.m_wheelsSuspensionForce = std::max(0.0, a.m_wheelsSuspensionForce - params_.anti_roll_npm * difference);
    b.m_wheelsSuspensionForce = std::max(0.0, b.m_wheelsSuspensionForce + params_.anti_roll_npm * difference);
  }
}

void GroundVehicle::apply_springs() {
  for (std::size_t i = 0; i < tyres_.size(); ++i) {
    if (!tyres_[i].touches) continue;
    push(tyres_[i].position, m_wheelInfo[static_cast<int>(i)].m_raycastInfo.m_contactNormalWS * tyres_[i].load_ns);
  }
}

void GroundVehicle::find_stops(double step_s) {
  stops_.clear();
  const auto add = [&](const btVector3& position, const btVector3& normal, double depth_m, int wheel) {
    if (depth_m > 0.0) stops_.push_back({position, normal, std::min(0.1 * depth_m / step_s, 0.5), 0.0, wheel});
  };
  for (int i = 0; i < 4; ++i) {
    const btWheelInfo::RaycastInfo& ray = m_wheelInfo[i].m_raycastInfo;
    const double length =
        (ray.m_contactPointWS - ray.m_hardPointWS).dot(ray.m_wheelDirectionWS) - params_.wheel_radius_m;
    if (ray.m_isInContact)
      add(ray.m_contactPointWS, ray.m_contactNormalWS, rest_length_m_ - params_.travel_m - length, i);
  }
  const double behind = -0.5 * (params_.length_m - params_.wheelbase_m) - params_.centre_ahead_m;
  const bool upright = body_->getWorldTransform().getBasis()[2][2] > 0.7;
  for (int corner = 0; corner < (upright ? 4 : 8); ++corner) {
    const btVector3 at = body_->getWorldTransform()(
        btVector3(behind + (corner & 1 ? params_.length_m : 0.0), (corner & 2 ? 0.5 : -0.5) * params_.width_m,
                  (corner & 4 ? params_.height_m : params_.clearance_m) - params_.centre_height_m));
    const double depth = rays_->height_m(at.x(), at.y()) - at.z();
    if (depth > 0.0) add(at, rays_->patch(at.x(), at.y()).normal, depth, -1);
  }
}

void GroundVehicle::drive_car(double step_s) {
  const double drive = std::clamp(command_.drive_mps2, -params_.max_drive_mps2, params_.max_drive_mps2);
  const double brake = std::clamp(command_.brake_mps2, 0.0, params_.max_brake_mps2);
  double load_ns = 0.0;
  for (const Tyre& tyre : tyres_) load_ns += tyre.load_ns;
  for (Tyre& tyre : tyres_) {
    const double mass = load_ns > 0.0 ? params_.mass_kg * tyre.load_ns / load_ns : 0.0;
    tyre.free_ahead_ns = mass * drive * step_s;
    tyre.target_limit_ns = mass * brake * step_s + params_.rolling_resistance * tyre.load_ns;
  }
}

void GroundVehicle::drive_robot(double step_s) {
  const double drive = std::clamp(command_.drive_mps2, -params_.max_drive_mps2, params_.max_drive_mps2);
  const double brake = std::clamp(command_.brake_mps2, 0.0, params_.max_brake_mps2);
  const double turn = std::clamp(command_.yaw_rate_radps, -params_.max_yaw_rate_radps, params_.max_yaw_rate_radps);
  yaw_rate_radps_ = toward(yaw_rate_radps_, turn, params_.yaw_acceleration_radps2 * step_s);
  Tyre &left = tyres_[RearLeft], &right = tyres_[RearRight];
  // The motor holds a speed of its own: that of the wheels would creep, as the centre of mass swings around the axle.
  const double speed = 0.5 * (speed_along(left.position, left.ahead) + speed_along(right.position, right.ahead));
  motor_mps_ = std::clamp(motor_mps_ + drive * step_s, speed - motor_lead_mps, speed + motor_lead_mps);
  motor_mps_ = toward(motor_mps_, 0.0, brake * step_s);
  left.target_mps = motor_mps_ - 0.5 * params_.track_m * yaw_rate_radps_;
  right.target_mps = motor_mps_ + 0.5 * params_.track_m * yaw_rate_radps_;
  left.target_limit_ns = right.target_limit_ns = params_.friction * params_.mass_kg * VehiclePhysics::gravity_mps2;
}

// Gauss-Seidel over the contacts, begun from the last step's impulses: what stands comes to stand still.
void GroundVehicle::solve() {
  for (Tyre& tyre : tyres_) {
    if (!tyre.touches || !tyre.holds) tyre.ahead_ns = tyre.left_ns = 0.0;
    const double hold = tyre.ahead_ns;
    tyre.ahead_ns =
        std::clamp(hold, tyre.free_ahead_ns - tyre.target_limit_ns, tyre.free_ahead_ns + tyre.target_limit_ns);
    if (tyre.touches && tyre.holds) push(tyre.position, tyre.ahead * tyre.ahead_ns + tyre.left * tyre.left_ns);
  }
  for (int round = 0; round < solver_rounds; ++round) {
    for (Stop& stop : stops_) solve_stop(stop);
    for (Tyre& tyre : tyres_)
      if (tyre.touches && tyre.holds) solve_tyre(tyre);
  }
}

void GroundVehicle::solve_stop(Stop& stop) {
  const double missing = stop.speed_mps - speed_along(stop.position, stop.normal);
  const double before = stop.impulse_ns;
  stop.impulse_ns = std::max(0.0, before + missing / give_along(stop.position, stop.normal));
  push(stop.position, stop.normal * (stop.impulse_ns - before));
  if (stop.wheel >= 0) {
    tyres_[static_cast<std::size_t>(stop.wheel)].load_ns += stop.impulse_ns - before;
    return;
  }
  btVector3 slide = body_->getVelocityInLocalPoint(stop.position - body_->getCenterOfMassPosition());
  slide -= stop.normal * stop.normal.dot(slide);
  const double speed = slide.length();
  if (speed < 1e-9) return;
  slide /= speed;
  push(stop.position, slide * -std::min(0.5 * params_.friction * std::abs(stop.impulse_ns - before),
                                        speed / give_along(stop.position, slide)));
}

void GroundVehicle::solve_tyre(Tyre& tyre) {
  const double ahead_before = tyre.ahead_ns, left_before = tyre.left_ns;
  const double give_left = give_along(tyre.position, tyre.left), give_ahead = give_along(tyre.position, tyre.ahead);
  // A lateral spring of slip speed against force, implicit: stiff as the vehicle stands, of slip angle as it rolls.
  tyre.left_ns -= (speed_along(tyre.position, tyre.left) + tyre.softness * tyre.left_ns) / (give_left + tyre.softness);
  const double missing = tyre.target_mps - speed_along(tyre.position, tyre.ahead);
  tyre.ahead_ns = std::clamp(tyre.ahead_ns + missing / give_ahead, tyre.free_ahead_ns - tyre.target_limit_ns,
                             tyre.free_ahead_ns + tyre.target_limit_ns);
  const double size = std::hypot(tyre.ahead_ns, tyre.left_ns), limit = params_.friction * tyre.load_ns;
  if (size > limit) {
    tyre.ahead_ns *= limit / size;
    tyre.left_ns *= limit / size;
  }
  push(tyre.position, tyre.ahead * (tyre.ahead_ns - ahead_before) + tyre.left * (tyre.left_ns - left_before));
}

void GroundVehicle::turn_wheels(double step_s) {
  for (std::size_t i = 0; i < tyres_.size(); ++i) {
    btWheelInfo& wheel = m_wheelInfo[static_cast<int>(i)];
    if (tyres_[i].touches)
      wheel.m_deltaRotation = speed_along(tyres_[i].position, tyres_[i].ahead) * step_s / params_.wheel_radius_m;
    wheel.m_rotation += wheel.m_deltaRotation;
  }
}

void GroundVehicle::forget_the_way() {
  for (std::size_t i = 0; i < tyres_.size(); ++i)
    m_wheelInfo[static_cast<int>(i)].m_rotation = m_wheelInfo[static_cast<int>(i)].m_deltaRotation = 0.0;
}

}  // namespace convoy::simulator
