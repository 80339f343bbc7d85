// A fleet whose front ends follow a script, so that what each vehicle states does not depend on the network.
#pragma once

#include <convoy/components/association_component.hpp>
#include <convoy/components/front_end_component.hpp>
#include <convoy/components/submap_manager.hpp>
#include <convoy/exchange/in_process.hpp>
#include <convoy/frontend/frozen_landmarks.hpp>
#include <convoy/geometry/groups.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

#include <memory>
#include <optional>
#include <vector>

namespace convoy::test {

using Exchange = std::unique_ptr<SubmapExchange<SE2>>;

struct ScriptedStep {
  SE2 truth;  ///< T_world_body
  FrontEndState<SE2> state;
  std::optional<std::vector<FrozenLandmark<SE2>>> landmarks;  ///< a segment closes here
};

inline const SE2::Tangent drift_per_m(4e-4, 4e-4, 4e-6);

/// 100 m along the street at 2 m/s, a segment every 20 m with what lies within 18 m. One world for all vehicles.
inline std::vector<ScriptedStep> script_of(VehicleId vehicle, std::uint64_t world = 1) {
  Random world_random(world), random(1000 * world + vehicle);
  const Points points = scattered(world_random, 500, 110.0, 2.0);
  std::vector<ScriptedStep> script;
  ScriptedStep step;
  step.truth = SE2(-50.0 - 8.0 * vehicle, 3.0 * vehicle, 0.0);
  script.push_back(step);
  const Eigen::Vector3d sigma = drift_per_m.cwiseSqrt();
  for (int k = 1; k <= 100; ++k) {
    const SE2 U = SE2::Exp({1.0, 0.0, 0.02 * std::sin(0.1 * k + vehicle)});
    step.truth = step.truth * U * SE2::Exp(sigma.cwiseProduct(random.unit_normal<3>()));
    step.state.stamp_s = 0.5 * k;
    step.state.abscissa_m = k;
    step.state.pose = step.state.pose * U;
    step.landmarks.reset();
    if (k % 20 == 0) {
      Points seen;
      for (const auto& p : points)
        if ((p - step.truth.translation()).norm() < 18.0) seen.push_back(p);
      step.landmarks.emplace();
      for (const auto& l : frozen_batch(random, {}, step.truth, seen, {0.08, 0.05}).landmarks)
        step.landmarks->push_back({l.position, l.covariance, l.loading, {}, step.landmarks->size()});
    }
    script.push_back(step);
  }
  return script;
}

struct MemberOptions {
  std::optional<Estimate<SE2>> static_bias;
  SubmapManagerParams submaps;
  Epoch epoch = 1;
};

/// One vehicle without a thread.
class Member {
 public:
  Member(VehicleId vehicle, Exchange exchange, const MemberOptions& options = {})
      : script(script_of(vehicle)),
        exchange_(std::move(exchange)),
        manager({vehicle, options.epoch}, *exchange_, options.submaps),
        front_end_component(front_end_, manager, drift()),
        association(manager, {}) {
    manager.open_chain(0.0, options.static_bias);
  }

  /// The next step of the script; false at its end.
  bool drive() {
    if (next_ == script.size()) return false;
    const ScriptedStep& step = script[next_++];
    EXPECT_TRUE(front_end_.advance(step.state));
    if (step.landmarks) front_end_.close(*step.landmarks);
    front_end_component.poll();
    return true;
  }
  void step(double now_s) {
    manager.step(now_s);
    association.step();
    manager.rebuild(now_s);
  }
  SE2 truth() const { return script[next_ - 1].truth; }
  ChainId chain() const { return manager.self(); }
  Hash facts() const { return manager.store().digest(); }
  Hash map_digest() const { return manager.map().map->digest(); }
  VehicleState<SE2> view_of(const ChainId& other, double now_s) {
    for (auto& state : manager.vehicles(now_s))
      if (state.chain == other) return state;
    return {};
  }

  const std::vector<ScriptedStep> script;

 private:
  static DriftParams<SE2> drift() {
    DriftParams<SE2> params;
    params.rate = drift_per_m;
    return params;
  }
  Exchange exchange_;
  FrozenLandmarks<SE2> front_end_;
  std::size_t next_ = 0;

 public:
  SubmapManager<SE2> manager;
  FrontEndComponent<SE2> front_end_component;
  AssociationComponent<SE2> association;
};

/// Members on one clock. A member that was reset has vanished.
class ScriptedFleet {
 public:
  explicit ScriptedFleet(const Impairment& impairment = {}) : impairment_(impairment) {}

  InProcessNetwork<SE2>& network() { return network_; }
  Member& add(VehicleId vehicle, const MemberOptions& options = {}) {
    return add(vehicle, network_.join(impairment_), options);
  }
  Member& add(VehicleId vehicle, Exchange exchange, const MemberOptions& options = {}) {
    members.push_back(std::make_unique<Member>(vehicle, std::move(exchange), options));
    return *members.back();
  }

  /// All members that have script left drive on, for so many steps of 0.5 s.
  void drive(int steps) {
    for (int k = 0; k < steps; ++k, now_s += 0.5)
      for (auto& member : members)
        if (member) {
          member->drive();
          member->step(now_s);
        }
  }

  /// Talks on, without driving, until nobody misses anything and all hold the same. False after so many seconds.
  bool settle(double timeout_s = 120.0) {
    for (const double end_s = now_s + timeout_s; now_s < end_s; now_s += 0.5) {
      for (auto& member : members)
        if (member) member->step(now_s);
      if (settled()) return true;
    }
    return false;
  }

  bool settled() const {
    const Member* first = nullptr;
    for (const auto& member : members) {
      if (!member) continue;
      if (first == nullptr) first = member.get();
      if (member->manager.store().missing_count() != 0 || member->facts() != first->facts() ||
          member->manager.map().facts != member->facts())
        return false;
    }
    return first != nullptr;
  }

  std::vector<std::unique_ptr<Member>> members;
  double now_s = 0.0;

 private:
  InProcessNetwork<SE2> network_;
  Impairment impairment_;
};

}  // namespace convoy::test
