// FleetMonitor: listens to a fleet and shows its common map, without being a vehicle: it never sends anything, so what
// it misses stays missing until the middleware's history or somebody else's repair brings it.
#pragma once

#include <convoy/components/submap_manager.hpp>

namespace convoy {

template <class G>
class FleetMonitor {
 public:
  /// `exchange` must outlive it. Throws ConfigError.
  FleetMonitor(SubmapExchange<G>& exchange, const SubmapManagerParams& params)
      : mute_(exchange), manager_({observer, 1}, mute_, with_observer(params)) {}

  /// Takes what has come in, and rebuilds the map when it is due.
  void step(double now_s) {
    manager_.step(now_s);
    manager_.rebuild(now_s);
  }

  const FactStore<G>& store() const { return manager_.store(); }
  const GlobalMap<G>& map() const { return manager_.map(); }
  std::vector<VehicleState<G>> vehicles(double now_s) { return manager_.vehicles(now_s); }
  const SubmapManagerCounters& counters() const { return manager_.counters(); }

 private:
  static constexpr VehicleId observer = 0xffffffffU;  // the last id; no vehicle should use it

  static SubmapManagerParams with_observer(SubmapManagerParams params) {
    if (!params.limits.roster.empty()) params.limits.roster.push_back(observer);
    return params;
  }

  // An exchange that only takes.
  class Mute final : public SubmapExchange<G> {
   public:
    explicit Mute(SubmapExchange<G>& inner) : inner_(inner) {}
    SendStatus send(const Message<G>&) override { return SendStatus::sent; }
    std::vector<Message<G>> take(double now_s) override { return inner_.take(now_s); }
    ExchangeCounters counters() const override { return inner_.counters(); }

   private:
    SubmapExchange<G>& inner_;
  };

  Mute mute_;
  SubmapManager<G> manager_;
};

}  // namespace convoy
