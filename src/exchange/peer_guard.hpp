// PeerGuard: what one peer may ask of this vehicle. A peer that floods is quarantined, and the others do not notice.
// Pure: driven by the caller's clock, which does not decrease.
#pragma once

#include <convoy/submap/facts.hpp>

#include <algorithm>
#include <cstdint>
#include <map>

namespace convoy {

struct PeerLimits {
  double messages_per_s = 3000.0;  ///< of one vehicle, sustained; > 0
  double burst = 30000.0;          ///< messages at once: a whole history may come in one go; >= 1
  double quarantine_s = 30.0;      ///< nothing is taken from a vehicle that exceeded both, for so long; >= 0
  std::uint32_t max_peers = 1024;  ///< vehicles listened to at the same time, >= 1
  double forget_after_s = 600.0;   ///< a vehicle that is silent for so long makes room for another; > 0
};

/// Throws RangeError.
void validate(const PeerLimits& limits);

struct PeerGuardCounters {
  std::uint64_t quarantines = 0;       ///< begun
  VehicleId last_quarantined = 0;      ///< 0: nobody yet
  std::uint64_t messages_refused = 0;  ///< of vehicles in quarantine, or beyond max_peers
};

class PeerGuard {
 public:
  explicit PeerGuard(const PeerLimits& limits) : limits_(limits) { validate(limits); }

  /// False: the message is to be passed over.
  bool admit(VehicleId sender, double now_s);
  bool quarantined(VehicleId vehicle, double now_s) const;
  const PeerGuardCounters& counters() const { return counters_; }

 private:
  struct Peer {
    double left = 0.0;  // messages that it may still send at once
    double heard_s = 0.0;
    double free_s = -1e300;  // end of its quarantine
  };
  bool make_room(double now_s);

  PeerLimits limits_;
  std::map<VehicleId, Peer> peers_;
  PeerGuardCounters counters_;
};

}  // namespace convoy
