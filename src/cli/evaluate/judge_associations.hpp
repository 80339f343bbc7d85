// Associations of a finished run against the truth: by the identities of landmarks where the run knows them, else by
// the true poses (evaluate.hpp).
#pragma once

#include <vector>

#include <nlohmann/json.hpp>

#include "evaluate/run_folder.hpp"

namespace convoy::cli {

/// Of a map, those that it accepted, in the order in which it came to them.
template <class G>
std::vector<const MapAssociation*> accepted_by_time(const MapRecord<G>& map);

/// Pairings are true whose landmarks are no further apart than this, where the truth knows their places and no names.
inline constexpr double same_place_m = 0.3;

/// "associations" in metrics.json: what the map of the first survivor accepted. Null where there is no map.
template <class G>
nlohmann::json judge_associations(const RunRecord<G>& run);

}  // namespace convoy::cli
