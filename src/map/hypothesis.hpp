// A hypothesis: landmarks of two batches that are stated to be the same, and what becomes of it.
#pragma once

#include <convoy/submap/fact_store.hpp>

#include <cstdint>
#include <memory>
#include <vector>

namespace convoy {

enum class HypothesisState : std::uint8_t {
  accepted,
  waiting,         ///< some of its landmarks or their anchors have not arrived
  vetoed,          ///< an author's last verdict on it is a veto
  malformed,       ///< not one-to-one between exactly two batches, or too few pairings
  geometry,        ///< its pairs do not align within their covariances
  prior,           ///< it contradicts what static biases and drift say without it
  outvoted,        ///< it contradicts a heavier set of hypotheses between the same two chains
  ambiguous,       ///< the two chains fit together in two ways, and neither outweighs the other
  unconfirmed,     ///< the only one between two chains, and a place that looks the same could be out of sight
  doubtful,        ///< it stands, but its landmarks could each be another: too few are left to tie its batches
  class_conflict,  ///< it would make two landmarks of one batch the same
  map_residual,    ///< it contradicts the rest of the map
};
inline constexpr int hypothesis_state_count = 12;
/// The word that reports use.
const char* to_string(HypothesisState state);

/// What the pairs of a hypothesis say by themselves of the motion between their batches.
template <class G>
struct HypothesisAlignment {
  G T_a_b;
  typename G::Covariance P = G::Covariance::Zero();
  const typename G::Covariance& covariance() const { return P; }  ///< of a right perturbation
};

template <class G>
struct Hypothesis {
  Hash id = 0;
  std::shared_ptr<const std::vector<Pairing>> pairings;  ///< one for all copies
  ChainId author;                                        ///< the smallest chain that states it
  HypothesisState state = HypothesisState::waiting;
  Key batch_a, batch_b;  ///< anchors, a < b; the first landmark of each pairing is of a
  HypothesisAlignment<G> alignment;
};

}  // namespace convoy
