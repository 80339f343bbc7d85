// Which of the hypotheses between two chains hold together: pairwise loop test and heaviest clique (DESIGN B5, T2 and
// T3).
//
// An alignment that is geometrically perfect may still be wrong: a street repeats itself. Two alignments between the
// same two chains close a loop with the drift in between, and a wrong one is off by as much as it is wrong. The
// heaviest set that holds together stands, and only if no other one comes near its weight.
#pragma once

#include <convoy/association/constraints.hpp>
#include <convoy/map/hypothesis.hpp>

#include <cstdint>
#include <vector>

namespace convoy {

/// Squared Mahalanobis distance, Dof degrees of freedom, of what h says of the motion between its batches from what is
/// known without it: see relative_prior(). The facts that h names must be held.
template <class G>
double prior_chi2(const RelativePrior<G>& prior, const HypothesisAlignment<G>& alignment);

/// The same, of the loop that h and k close with the drift between their batches, its persistent errors within `slack`.
/// Both are between the same two chains.
template <class G>
double loop_chi2(const FactStore<G>& store, const Hypothesis<G>& h, const Hypothesis<G>& k,
                 const DriftSlack& slack = {});

/// Symmetric relation between 0, 1, ..., which may grow.
class Relation {
 public:
  std::size_t size() const { return rows_.size(); }
  /// The next element; `holds[i]`: related to element i.
  void add(std::vector<bool> holds) { rows_.push_back(std::move(holds)); }
  bool operator()(std::size_t a, std::size_t b) const { return a > b ? rows_[a][b] : rows_[b][a]; }

 private:
  std::vector<std::vector<bool>> rows_;  // each up to its own diagonal
};

/// The heaviest set of elements in which every two are related, ascending; of equally heavy ones the first one found.
/// weights[i] > 0 is that of elements[i]. Exact, by branch and bound with colouring bounds, unless that takes more than
/// `max_lookups` of the relation, which elements with few contradictions never do; beyond, the best found until then,
/// which is no worse than taking one after the other that fits, those that contradict least first.
std::vector<std::size_t> heaviest_clique(const Relation& related, const std::vector<std::size_t>& elements,
                                         const std::vector<int>& weights, std::uint64_t max_lookups = 20'000'000);

}  // namespace convoy
