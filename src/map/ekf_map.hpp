// The paper's map: one extended Kalman filter over all biases (anchor poses) and fused landmarks, fed fact by fact
// (paper, Section III: "taken into account thanks to a Kalman filter"). Kept as the baseline: dense, so O(n^2) per
// fact; linearised once per fact, so its result depends on their order (here the canonical one). Landmarks are
// independent given their anchor, as the paper takes them: loadings are not used.
#pragma once

#include <convoy/map/map.hpp>

namespace convoy {

template <class G>
class EkfMap final : public Backend<G> {
 public:
  std::unique_ptr<Map<G>> solve(Problem<G> problem) const override;
  bool takes_every_factor() const override { return false; }  // the paper's filter knows no others
};

}  // namespace convoy
