// Whole vehicles over DDS that follow the script of the fleets in one thread.
#pragma once

#include "../unit/components/scripted_fleet.hpp"
#include "dds_testing.hpp"

#include <convoy/components/vehicle.hpp>

#include <algorithm>
#include <chrono>
#include <memory>
#include <vector>

namespace convoy::dds::testing {

inline double steady_s() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// A vehicle with its thread.
template <class G>
class Host {
 public:
  Host(VehicleId id, const DdsConfig& network)
      : script_(test::script_of<G>(id)),
        vehicle_(
            params(id, script_[0].truth), slam_,
            [this, network] {
              auto exchange = std::make_unique<DdsExchange<G>>(network);
              exchange_ = exchange.get();
              return exchange;
            },
            steady_s) {
    vehicle_.configure();
    vehicle_.activate();
  }
  ~Host() { vehicle_.shutdown(); }

  void drive() {
    for (const auto& step : script_)
      vehicle_.feed([&] {
        ASSERT_TRUE(slam_.advance(step.state));
        if (step.landmarks) slam_.close(*step.landmarks);
      });
  }
  VehicleSnapshot<G> look() { return vehicle_.snapshot(); }
  const G& truth() const { return script_.back().truth; }
  const DdsExchange<G>& exchange() const { return *exchange_; }

 private:
  static VehicleParams<G> params(VehicleId id, const G& start) {
    VehicleParams<G> p;
    p.id = id;
    p.drift.rate = test::drift_per_m_of<G>();
    p.submaps.map_period_s = 0.1;
    p.submaps.repair.digest_period_s = 0.2;
    if (id == 1) p.static_bias = Estimate<G>{start, G::Covariance::Zero()};
    return p;
  }
  std::vector<test::ScriptedStepOf<G>> script_;
  FrozenLandmarks<G> slam_;
  DdsExchange<G>* exchange_ = nullptr;
  Vehicle<G> vehicle_;
};

/// True once all hold the same facts and made the same map of them.
template <class G>
bool one_map(const std::vector<VehicleSnapshot<G>>& looks) {
  return std::all_of(looks.begin(), looks.end(), [&](const auto& s) {
    return s.settled && s.vehicles.size() == looks.size() && s.facts_digest == looks[0].facts_digest &&
           s.map_digest == looks[0].map_digest && s.landmarks_known > 50;
  });
}

}  // namespace convoy::dds::testing
