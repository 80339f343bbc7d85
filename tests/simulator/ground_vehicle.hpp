// Bullet's ray-cast vehicle with a ray caster that asks the ground itself, and tyres of its own: Bullet's let a parked
// vehicle creep down a slope, brake with twice the friction and tell no forces. For vehicle_physics.cpp.
#pragma once

#include "ground.hpp"
#include "vehicle_params.hpp"
#include "vehicle_physics.hpp"

#include <btBulletDynamicsCommon.h>

#include <array>
#include <vector>

namespace convoy::simulator {

/// Height and normal under a tyre, whose contact levels out what is smaller than itself.
struct GroundPatch {
  double height_m = 0.0;
  btVector3 normal{0.0, 0.0, 1.0};
};

class GroundRays final : public btVehicleRaycaster {
 public:
  GroundRays(const Ground& ground, double half_contact_m) : ground_(&ground), half_contact_m_(half_contact_m) {}
  /// Throws std::invalid_argument where the height is no number.
  GroundPatch patch(double x_m, double y_m) const;
  double height_m(double x_m, double y_m) const;
  /// Where the next ray is expected to meet the ground, as a part of its length.
  void guess(double part) { guess_ = part; }
  void* castRay(const btVector3& from, const btVector3& to, btVehicleRaycasterResult& result) override;

 private:
  const Ground* ground_;
  double half_contact_m_, guess_ = 1.0;
};

class GroundVehicle final : public btRaycastVehicle {
 public:
  struct Tyre {
    btVector3 position, ahead, left;  ///< of the contact, world frame
    double load_ns = 0.0;             ///< impulses of one step [N s]
    double free_ahead_ns = 0.0;       ///< of the drive
    double ahead_ns = 0.0, left_ns = 0.0;
    double target_mps = 0.0, target_limit_ns = 0.0;  ///< brake or motor: speed ahead, and the impulse it can give
    double softness = 0.0;                           ///< of lateral hold: slip speed for an impulse
    double spring_m = 0.0;
    bool touches = false, holds = true;  ///< castors touch, and hold nothing
  };

  GroundVehicle(const VehicleParams& params, btRigidBody& body, GroundRays& rays);

  void command(const DriveCommand& command) { command_ = command; }
  /// Impulses of springs, gravity, road and brakes for one step; the body is moved by the world afterwards.
  void updateVehicle(btScalar step) override;
  void turn_wheels(double step_s);  ///< after the world has moved the body
  void forget_the_way();            ///< wheel angles from zero

  const std::array<Tyre, 4>& tyres() const { return tyres_; }
  double steering_rad() const { return steering_rad_; }

 private:
  struct Stop {  // a bump stop or a corner of the body on the ground
    btVector3 position, normal;
    double speed_mps = 0.0;  // that it has to leave with
    double impulse_ns = 0.0;
    int wheel = -1;
  };

  void steer(double step_s);
  void find_contacts(double step_s);
  void add_anti_roll();
  void apply_springs();
  void find_stops(double step_s);
  void drive_car(double step_s);
  void drive_robot(double step_s);
  void solve();
  void solve_stop(Stop& stop);
  void solve_tyre(Tyre& tyre);
  double speed_along(const btVector3& position, const btVector3& direction) const;
  double give_along(const btVector3& position, const btVector3& direction) const;
  void push(const btVector3& position, const btVector3& impulse);

  VehicleParams params_;
  btRigidBody* body_;
  GroundRays* rays_;
  DriveCommand command_;
  std::array<Tyre, 4> tyres_;
  std::vector<Stop> stops_;
  double rest_length_m_, steering_rad_ = 0.0, yaw_rate_radps_ = 0.0, motor_mps_ = 0.0;
};

}  // namespace convoy::simulator
