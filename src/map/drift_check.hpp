// Is the drift of a vehicle the white noise it is taken for? Judged by its accepted closures, before fusing (DESIGN
// B6).
#pragma once

#include <convoy/drift/calibration.hpp>
#include <convoy/map/selection.hpp>

#include <map>
#include <set>
#include <utility>

namespace convoy {

/// Lag-1 correlation of the whitened innovations of the hypotheses that stand and involve `chain`, in the order of
/// driving; of each batch that closed a loop only its strongest hypothesis, and the latest `most` of them. A persistent
/// error (scale of an odometer, rate of a gyro) that its chain does not state makes neighbours alike. Of a closure
/// between two vehicles either may be the one.
template <class G>
Lag1 drift_correlation(const FactStore<G>& store, const Selection<G>& selection, const ChainId& chain,
                       std::size_t most = 60);

/// The same for all chains of one store as it grows. What a chain's closures have said is not asked again.
template <class G>
class DriftCheck {
 public:
  /// Chains whose drift raises the alarm.
  std::set<ChainId> alarms(const FactStore<G>& store, const Selection<G>& selection);

 private:
  std::map<ChainId, std::pair<Hash, bool>> judged_;  // (of its closures, alarm)
};

}  // namespace convoy
