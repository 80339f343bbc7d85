// Where the chains of a problem start from (DESIGN B2): along accepted hypotheses, then by absolute fixes, then by
// encounters. Of the facts alone, in canonical order, so that the result does not depend on what was known when.
#pragma once

#include <convoy/map/problem.hpp>

#include <algorithm>
#include <vector>

namespace convoy {

/// An absolute fix that was selected, and its node.
template <class G>
struct FixAtNode {
  const AbsoluteFixFact<G>* fix;
  int node;
};

/// An encounter that was selected, its answer, and their nodes.
template <class G>
struct EncounterAtNodes {
  const EncounterFact<G>* seen;
  const WaypointFact<G>* answer;
  int observer, other;
};

struct PlacedChains {
  std::vector<int> group;     ///< of each chain: the smallest chain that accepted hypotheses connect it to
  std::vector<int> gauges;    ///< chains held where they start, for want of a static bias
  std::vector<int> floating;  ///< chains whose group nothing but absolute fixes or encounters hold
};

/// Which chain of the problem it is, of those it has.
template <class G>
int chain_number(const Problem<G>& problem, const ChainId& chain) {
  return static_cast<int>(std::ranges::lower_bound(problem.chains, chain, {}, &ChainSpan::chain) -
                          problem.chains.begin());
}

/// The static bias of a chain, if it is known; else null.
template <class G>
const PriorFact<G>* known_prior(const FactStore<G>& store, const ChainId& chain) {
  const PriorFact<G>* prior = store.prior(chain);
  return prior != nullptr && prior->known ? prior : nullptr;
}

/// Gives the nodes of `problem` their initial poses and says which of its chains are aligned, placed from where and by
/// which hypotheses; adds the node of the datum, if one is to be estimated. Needs chains with their persistent drift,
/// and nodes.
template <class G>
PlacedChains place(const FactStore<G>& store, const Selection<G>& selection, const ProblemOptions& options,
                   const std::vector<FixAtNode<G>>& fixes, const std::vector<EncounterAtNodes<G>>& encounters,
                   Problem<G>& problem);

}  // namespace convoy
