// How the vehicles of a scenario are configured: what `convoy demo` drives, and what is measured beside it.
#pragma once

#include <convoy/components/vehicle_config.hpp>

#include "scenario/scenario.hpp"

namespace convoy::cli {

/// Of the vehicle of `log`: its id, the roster, its static prior, and the noise of the sensors of this scenario.
/// Folders, network and clock are left at their defaults.
template <class G>
VehicleConfig<G> vehicle_config_of(const Scenario<G>& scenario, const VehicleLog<G>& log);

/// The paper's own method instead: literal drift, EKF map, Fig. 5 search.
template <class G>
void use_paper_method(VehicleConfig<G>& config);

}  // namespace convoy::cli
