// The literal model with its noise fitted to runs whose truth is known: the best that a constant P_eps can do (DESIGN
// B6).
#pragma once

#include <convoy/drift/drift_model.hpp>

#include <vector>

#include "consistency/statistic.hpp"

namespace convoy::cli::consistency {

/// Maximum likelihood over spans of about `span_m` of the tracks: the rates (equal in translation, equal in rotation)
/// of DriftModel::literal. Keep the calibration runs apart from those that are judged.
template <class G>
DriftParams<G> fit_literal(const std::vector<TrueTrack<G>>& calibration, double span_m = 80.0);

}  // namespace convoy::cli::consistency
