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

#include <cmath>
#include <memory>
#include <optional>
#include <vector>

namespace convoy::test {

template <class G>
using ExchangeOf = std::unique_ptr<SubmapExchange<G>>;
using Exchange = ExchangeOf<SE2>;

template <class G>
struct ScriptedStepOf {
  G truth;  ///< T_world_body
  FrontEndState<G> state;
  std::optional<std::vector<FrozenLandmark<G>>> landmarks;  ///< a segment closes here
};
using ScriptedStep = ScriptedStepOf<SE2>;

template <class G>
typename G::Tangent drift_per_m_of() {
  typename G::Tangent rate;
  rate.template head<G::Dim>().setConstant(4e-4);
  rate.template tail<G::Dof - G::Dim>().setConstant(4e-6);
  return rate;
}
inline const SE2::Tangent drift_per_m(4e-4, 4e-4, 4e-6);

inline SE2 scripted_start(SE2, VehicleId v) { return {-50.0 - 8.0 * v, 3.0 * v, 0.0}; }
inline SE2 scripted_motion(SE2, VehicleId v, int k) { return SE2::Exp({1.0, 0.0, 0.02 * std::sin(0.1 * k + v)}); }
/// In space the course also climbs, pitches and rolls.
inline SE3 scripted_start(SE3, VehicleId v) {
  return {{1.0, 0.05 * v, -0.02 * v, 0.0}, {-50.0 - 8.0 * v, 3.0 * v, 0.5 * v}};
}
inline SE3 scripted_motion(SE3, VehicleId v, int k) {
  SE3::Tangent d;
  d << 1.0, 0.0, 0.05 * std::cos(0.2 * k), 0.01 * std::cos(0.15 * k + v), 0.01 * std::sin(0.2 * k),
      0.02 * std::sin(0.1 * k + v);
  return SE3::Exp(d);
}

/// 100 m along the street at 2 m/s, a segment every 20 m with what lies within 18 m. One world for all vehicles.
template <class G = SE2>
std::vector<ScriptedStepOf<G>> script_of(VehicleId vehicle, std::uint64_t world = 1) {
  Random world_random(world), random(1000 * world + vehicle);
  const PointsOf<G> points = scattered<G>(world_random, 500, 110.0, 2.0);
  std::vector<ScriptedStepOf<G>> script;
  ScriptedStepOf<G> step;
  step.truth = scripted_start(G(), vehicle);
  script.push_back(step);
  const typename G::Tangent sigma = drift_per_m_of<G>().cwiseSqrt();
  for (int k = 1; k <= 100; ++k) {
    const G U = scripted_motion(G(), vehicle, k);
    step.truth = step.truth * U * G::Exp(sigma.cwiseProduct(random.unit_normal<G::Dof>()));
    step.state.stamp_s = 0.5 * k;
    step.state.abscissa_m = k;
    step.state.pose = step.state.pose * U;
    step.landmarks.reset();
    if (k % 20 == 0) {
      PointsOf<G> seen;
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

template <class G>
struct MemberOptionsOf {
  std::optional<Estimate<G>> static_bias;
  SubmapManagerParams submaps;
  Epoch epoch = 1;
};

using MemberOptions = MemberOptionsOf<SE2>;

/// One vehicle without a thread.
template <class G>
class MemberOf {
 public:
  MemberOf(VehicleId vehicle, ExchangeOf<G> exchange, const MemberOptionsOf<G>& options = {})
      : script(script_of<G>(vehicle)),
        exchange_(std::move(exchange)),
        manager({vehicle, options.epoch}, *exchange_, options.submaps),
        front_end_component(front_end_, manager, drift()),
        association(manager, {}) {
    manager.open_chain(0.0, options.static_bias);
  }

  /// The next step of the script; false at its end.
  bool drive() {
    if (next_ == script.size()) return false;
    const ScriptedStepOf<G>& step = script[next_++];
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
  G truth() const { return script[next_ - 1].truth; }
  ChainId chain() const { return manager.self(); }
  Hash facts() const { return manager.store().digest(); }
  Hash map_digest() const { return manager.map().map->digest(); }
  VehicleState<G> view_of(const ChainId& other, double now_s) {
    for (auto& state : manager.vehicles(now_s))
      if (state.chain == other) return state;
    return {};
  }

  const std::vector<ScriptedStepOf<G>> script;

 private:
  static DriftParams<G> drift() {
    DriftParams<G> params;
    params.rate = drift_per_m_of<G>();
    return params;
  }
  ExchangeOf<G> exchange_;
  FrozenLandmarks<G> front_end_;
  std::size_t next_ = 0;

 public:
  SubmapManager<G> manager;
  FrontEndComponent<G> front_end_component;
  AssociationComponent<G> association;
};

using Member = MemberOf<SE2>;

/// Members on one clock. A member that was reset has vanished.
template <class G>
class ScriptedFleetOf {
 public:
  explicit ScriptedFleetOf(const Impairment& impairment = {}) : impairment_(impairment) {}

  InProcessNetwork<G>& network() { return network_; }
  MemberOf<G>& add(VehicleId vehicle, const MemberOptionsOf<G>& options = {}) {
    return add(vehicle, network_.join(impairment_), options);
  }
  MemberOf<G>& add(VehicleId vehicle, ExchangeOf<G> exchange, const MemberOptionsOf<G>& options = {}) {
    members.push_back(std::make_unique<MemberOf<G>>(vehicle, std::move(exchange), options));
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
    const MemberOf<G>* first = nullptr;
    for (const auto& member : members) {
      if (!member) continue;
      if (first == nullptr) first = member.get();
      if (member->manager.store().missing_count() != 0 || member->facts() != first->facts() ||
          member->manager.map().facts != member->facts())
        return false;
    }
    return first != nullptr;
  }

  std::vector<std::unique_ptr<MemberOf<G>>> members;
  double now_s = 0.0;

 private:
  InProcessNetwork<G> network_;
  Impairment impairment_;
};
using ScriptedFleet = ScriptedFleetOf<SE2>;

}  // namespace convoy::test
