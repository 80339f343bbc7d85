// What a vehicle says of itself: the fields that its status lines and its summary.json have in common.
#pragma once

#include <convoy/components/vehicle.hpp>
#include <convoy/geometry/groups.hpp>

#include <nlohmann/json.hpp>

#include <string>

namespace convoy::cli {

/// vehicle, epoch, vehicle_s, integrity, reasons (names), landmarks_exported, landmarks_known, facts_missing,
/// associations_accepted, bytes_sent, requests_sent, settled, facts_digest, map_digest. `t_s`: on the vehicle's clock.
template <class G>
nlohmann::json vehicle_status(double t_s, const VehicleSnapshot<G>& snapshot);

/// Sixteen hex digits.
std::string hex(Hash hash);

}  // namespace convoy::cli
