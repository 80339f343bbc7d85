// Is the drift of a vehicle the white noise that the map takes it for? Judged by the accepted closures, before fusing
// (DESIGN B6).
#pragma once

#include <convoy/drift/calibration.hpp>
#include <convoy/map/selection.hpp>

namespace convoy {

/// Lag-1 correlation of the whitened innovations of the accepted hypotheses that involve `chain`, in the order of
/// driving; of each batch that closed a loop only its strongest hypothesis, and the latest `most` of them. A persistent
/// error (scale of an odometer, rate of a gyro) makes neighbours alike. Of a closure between two vehicles either may be
/// the one.
template <class G>
Lag1 drift_correlation(const FactStore<G>& store, const Selection<G>& selection, const ChainId& chain,
                       std::size_t most = 60);

}  // namespace convoy
