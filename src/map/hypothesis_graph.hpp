// Do the hypotheses that stand agree with all the rest? (DESIGN B5, T4 and T5)
//
// Each says by itself how its two batches lie to one another, z_h with covariance Z_h. Between the nodes of the map, in
// place of its landmarks, they make a pose graph: small, with one factor per hypothesis, so that each can be weighted
// and left out. Drift, static biases, constants, absolute fixes and encounters are those of the map.
#pragma once

#include <convoy/map/map.hpp>
#include <convoy/map/selection.hpp>

#include <set>
#include <utility>
#include <vector>

namespace convoy {

template <class G>
class HypothesisGraph {
 public:
  /// Of the hypotheses that `selection` has accepted and `map` has solved.
  HypothesisGraph(const Map<G>& map, const Selection<G>& selection);

  /// T5. Of each hypothesis of the selection, how far it lies from a map that has not heard of it: squared Mahalanobis
  /// distance, and the number of directions in which the others say anything (0: none, or it is not accepted).
  std::vector<std::pair<double, int>> leave_one_out() const;

  /// T4. The hypotheses that a robust estimate does without: truncated least squares with one weight per hypothesis, by
  /// graduated non-convexity (Yang et al., RA-L 2020). `confidence`: of the chi-square beyond which one is truncated.
  std::set<Hash> outliers(double confidence) const;

 private:
  Problem<G> weighted(const std::vector<double>& weights) const;

  Problem<G> problem_;                  // without hypotheses
  std::vector<DriftFactor<G>> z_;       // of each accepted hypothesis
  std::vector<Hash> ids_;               // of them
  std::vector<std::size_t> number_of_;  // in the selection
  std::size_t stated_ = 0;
};

}  // namespace convoy
