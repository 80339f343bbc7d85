// What a vehicle says of itself: the fields that its status lines and its summary.json have in common.
#pragma once

#include <convoy/components/vehicle.hpp>
#include <convoy/geometry/se2.hpp>

#include <nlohmann/json.hpp>

#include <string>

namespace convoy::cli {

/// vehicle, epoch, vehicle_s, integrity, reasons (names), landmarks_exported, landmarks_known, facts_missing,
/// associations_accepted, bytes_sent, requests_sent, settled, facts_digest, map_digest. `t_s`: on the vehicle's clock.
nlohmann::json vehicle_status(double t_s, const VehicleSnapshot<SE2>& snapshot);

/// Sixteen hex digits.
std::string hex(Hash hash);

}  // namespace convoy::cli
