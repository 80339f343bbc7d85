// What a vehicle says of itself: the fields that its status lines and its summary.json have in common.
#pragma once

#include <convoy/components/vehicle.hpp>
#include <convoy/geometry/groups.hpp>

#include <nlohmann/json.hpp>

#include <string>

namespace convoy::cli {

/// vehicle, epoch, vehicle_s (on the vehicle's clock: `t_s`), integrity, reasons (names)
/// peers: vehicles that the network knows to be there; null while it is being opened anew
/// landmarks_exported: of this vehicle; landmarks_known: of all
/// facts_missing: known to exist, and asked for; facts_lost: declared missing, since nobody who is left has them
/// facts_waiting: not sent yet, for want of a budget or of a network that takes them
/// network_reopened: times the watchdog opened the network anew
/// refused: another process claims this vehicle's id and began earlier (its epoch is not later); nothing is sent any more
/// associations_accepted, bytes_sent (since the start, with all headers), requests_sent
/// settled: nothing is missing, waiting or to be searched, and the map holds every fact
/// facts_digest, map_digest: equal on vehicles that hold the same
/// Status lines end with exhausted: the sensor log has been driven to its end.
template <class G>
nlohmann::json vehicle_status(double t_s, const VehicleSnapshot<G>& snapshot);

/// Sixteen hex digits.
std::string hex(Hash hash);

}  // namespace convoy::cli
