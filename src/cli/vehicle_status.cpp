#include "vehicle_status.hpp"

#include <cstdio>

namespace convoy::cli {

using nlohmann::json;

std::string hex(Hash hash) {
  char text[17];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(hash));
  return text;
}

template <class G>
json vehicle_status(double t_s, const VehicleSnapshot<G>& s) {
  json status;
  status["vehicle"] = s.self.vehicle;
  status["epoch"] = s.self.epoch;
  status["vehicle_s"] = t_s;
  for (const VehicleState<G>& v : s.vehicles)
    if (v.chain == s.self) {
      status["integrity"] = to_string(v.integrity);
      status["reasons"] = names_of_reasons(v.reasons);
    }
  status["peers"] = s.live_peers ? json(*s.live_peers) : json();
  status["landmarks_exported"] = s.landmarks_exported;
  status["landmarks_known"] = s.landmarks_known;
  status["facts_missing"] = s.facts_missing;
  status["facts_lost"] = s.facts_lost;
  status["facts_waiting"] = s.network.outbox.facts_waiting;
  status["network_reopened"] = s.network.reopened;
  status["refused"] = s.refused;
  status["associations_accepted"] = s.association.accepted;
  status["bytes_sent"] = s.exchange.bytes_sent;
  status["requests_sent"] = s.repair.requests_sent;
  status["settled"] = s.settled;
  status["facts_digest"] = hex(s.facts_digest);
  status["map_digest"] = hex(s.map_digest);
  return status;
}

#define CONVOY_INSTANTIATE(G) template json vehicle_status(double, const VehicleSnapshot<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
