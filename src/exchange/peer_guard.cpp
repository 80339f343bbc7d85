#include <convoy/config_error.hpp>
#include <convoy/exchange/peer_guard.hpp>

#include <cmath>

namespace convoy {

void validate(const PeerLimits& l) {
  const auto demand = [](bool holds, const char* name, double value, const char* range) {
    if (!(holds && std::isfinite(value))) throw RangeError("peers", name, value, range);
  };
  demand(l.messages_per_s > 0.0, "messages_per_s", l.messages_per_s, "be > 0");
  demand(l.burst >= 1.0, "burst", l.burst, "be >= 1");
  demand(l.quarantine_s >= 0.0, "quarantine_s", l.quarantine_s, "be >= 0");
  demand(l.max_peers >= 1, "max_peers", l.max_peers, "be >= 1");
  demand(l.forget_after_s > 0.0, "forget_after_s", l.forget_after_s, "be > 0");
}

bool PeerGuard::make_room(double now_s) {
  if (peers_.size() >= limits_.max_peers)
    std::erase_if(peers_, [&](const auto& peer) { return now_s > peer.second.heard_s + limits_.forget_after_s; });
  return peers_.size() < limits_.max_peers;
}

bool PeerGuard::admit(VehicleId sender, double now_s) {
  auto it = peers_.find(sender);
  if (it == peers_.end() && make_room(now_s)) it = peers_.emplace(sender, Peer{limits_.burst, now_s}).first;
  if (it == peers_.end() || now_s < it->second.free_s) {
    ++counters_.messages_refused;
    return false;
  }
  Peer& peer = it->second;
  peer.left = std::min(limits_.burst, peer.left + limits_.messages_per_s * (now_s - peer.heard_s));
  peer.heard_s = now_s;
  if (peer.left >= 1.0) {
    peer.left -= 1.0;
    return true;
  }
  peer.free_s = now_s + limits_.quarantine_s;
  ++counters_.quarantines;
  counters_.last_quarantined = sender;
  ++counters_.messages_refused;
  return false;
}

bool PeerGuard::quarantined(VehicleId vehicle, double now_s) const {
  const auto peer = peers_.find(vehicle);
  return peer != peers_.end() && now_s < peer->second.free_s;
}

}  // namespace convoy
