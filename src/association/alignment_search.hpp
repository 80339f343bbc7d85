// The search of the association by alignment: where one batch may lie on another, the likeliest first. A largest
// compatible set (search.hpp) is not the truth: chance sets grow with the number of landmarks, and which of several
// equal ones is found is luck. Here every place that the prior allows is tried, and what counts is by how much the
// landmarks are likelier to be the same ones than to be there by chance, at the density where they are.
#pragma once

#include <convoy/association/constraints.hpp>
#include <convoy/association/search.hpp>

#include <cstdint>
#include <vector>

namespace convoy {

struct AlignmentSearchParams {
  double gate = 0.99;             ///< chi-square confidence within which two landmarks agree with an alignment, (0, 1)
  double min_odds = 4.0;          ///< a pair is kept if it is so many times likelier true than chance, > 0
  double density_radius_m = 3.5;  ///< radius within which landmarks are counted for their density, > 0
  std::size_t max_proposals = 100;      ///< places looked at closely, >= 2
  std::uint64_t max_votes = 5'000'000;  ///< pairs of landmarks tried over all headings; beyond, the search is cut off
};

/// Throws ConfigError when a value is out of its range.
void validate(const AlignmentSearchParams& params);

/// One place of batch b on batch a.
template <class G>
struct CandidateAlignment {
  G T_a_b;
  typename G::Covariance covariance = G::Covariance::Zero();  ///< of a right perturbation
  std::vector<IndexPairing> pairings;                         ///< (i of a, j of b), ascending, one-to-one
  /// Log of how many times likelier the landmarks of b are where they are seen, if this is their place, than among
  /// landmarks of their density thrown at random.
  double log_likelihood_ratio = 0.0;
};

template <class G>
struct AlignmentSearchResult {
  std::vector<CandidateAlignment<G>>
      candidates;                ///< best first, no two of which agree on half of their pairs; at most 5
  double chance_pairings = 0.0;  ///< how many pairings places beside the best one come to, on average
  std::uint64_t votes = 0;       ///< pairs of landmarks tried over all headings
  std::uint64_t places = 0;      ///< how many alignments there are that could be told apart
  bool cut_off = false;          ///< the budget would not have sufficed: nothing was searched
};

/// Votes of pairs of landmarks for places, heading by heading within the prior; then the best places are refined by
/// pairing what agrees and maximum a posteriori, and ranked by their likelihood ratio. Deterministic: ties fall by
/// canonical order. Without a prior every heading and place is tried. Needs has_level(prior).
template <class G>
AlignmentSearchResult<G> find_alignments(const Batch<G>& a, const Batch<G>& b,
                                         const std::optional<RelativePrior<G>>& prior, double prior_confidence,
                                         const AlignmentSearchParams& params, const LooksAlike<G>& looks_alike = {});

/// True if find_alignments() can be asked: in the plane always, in space if the tilt is known to 0.1 rad.
template <class G>
bool has_level(const std::optional<RelativePrior<G>>& prior);

}  // namespace convoy
