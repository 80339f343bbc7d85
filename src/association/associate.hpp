// Association of two batches: constraints, search, and the decision whether what was found means anything
// (paper, Section IV). A largest compatible set always exists; it is the decision that keeps the map free of chance.
#pragma once

#include <convoy/association/alignment.hpp>
#include <convoy/association/alignment_search.hpp>
#include <convoy/association/constraints.hpp>
#include <convoy/association/search.hpp>

#include <cstdint>
#include <optional>
#include <vector>

namespace convoy {

enum class SearchMethod : std::uint8_t {
  alignment,  ///< the likeliest place (alignment_search.hpp); where it cannot be asked (has_level()): gcbb
  gcbb,       ///< a largest set of pairings that go together
  fig5,       ///< the same by the paper's Fig. 5 as written: a baseline, exponential
};
const char* to_string(SearchMethod method);

struct AssociationParams {
  ConstraintParams constraints;
  SearchMethod method = SearchMethod::alignment;
  AlignmentSearchParams alignment;
  /// Landmarks of a batch of the store, with what is joined with it (reach.hpp); beyond, the answer is "none". No
  /// vehicle sees as many at once, and who says so does not stop the others.
  std::size_t max_landmarks = 500;
  int min_pairings = 5;         ///< fewer never decide anything
  double residual = 0.99;       ///< chi-square confidence of the aligned set
  double pairing = 0.9;         ///< chi-square confidence within which two landmarks agree with an alignment
  double separation = 0.999;    ///< a pairing is left out unless exchanging its partner is this much worse
  double min_similarity = 0.3;  ///< of patches that may be of one thing (appearance.hpp), [-1, 1]; -1: not compared
  /// A second, incompatible place makes the first one ambiguous if fewer than so many like it are to be expected by
  /// chance: the world repeats itself.
  double min_runner_up_false_alarms = 1e-3;
  // Of the likeliest places (alignment), beside `alignment`:
  double max_chance_places = 0.1;  ///< at most so many places as likely are to be expected by chance
  /// The share of its log ratio that the best place elsewhere has, and the share of its pairings that places beside it
  /// have on average, around it or along what is paired (a wall, a row), may come to so much together, (0, 1].
  double max_doubt = 0.77;
  // Of largest sets (gcbb, fig5):
  std::uint64_t max_nodes = 200'000;    ///< of the search tree; beyond, the answer is "none"
  std::size_t max_candidates = 20'000;  ///< pairs that may be paired; the same
  double max_false_alarms = 1e-5;       ///< expected number of alignments as good by chance, at the local density
  double max_runner_up_share = 0.7;     ///< of the first one's support: a second with more makes it ambiguous
};

/// Throws ConfigError when a value is out of its range.
void validate(const AssociationParams& params);

enum class Decision : std::uint8_t { accepted, none, ambiguous };
const char* to_string(Decision decision);

/// Why nothing was accepted.
enum class Rejection : std::uint8_t {
  not_rejected,
  too_few_candidates,  ///< the unary constraint left too few pairs
  too_few_pairings,    ///< the largest set is too small
  search_cut_off,      ///< node budget, or too many candidates or landmarks
  geometry,            ///< the pairs do not align within their covariances
  prior,               ///< they align, but not where the static bias and the drift allow
  chance,              ///< such a set is to be expected by chance
  runner_up,           ///< another place fits nearly as well
  repeats,             ///< another place fits, and not by chance: the world repeats itself
  unfit,               ///< a landmark or the prior is not finite, or its covariance is none; facts are missing
};
inline constexpr int rejection_count = 10;
const char* to_string(Rejection rejection);

template <class G>
struct AssociationResult {
  Decision decision = Decision::none;
  Rejection rejection = Rejection::not_rejected;
  std::vector<Pairing> pairings;            ///< canonical; the best set also when it was not accepted
  std::vector<Pairing> runner_up_pairings;  ///< canonical; if ambiguous, the best set elsewhere
  Alignment<G> alignment;                   ///< T_a_b of that set
  int support = 0;                          ///< number of pairings
  int runner_up = 0;                        ///< support of the best alignment elsewhere
  /// Alignments (gcbb, fig5) or places (alignment) as good as this one that are to be expected by chance.
  double expected_false_alarms = 0;
  double chance_pairings = 0.0;       ///< that places beside this one have on average, if that is how it was found
  double log_likelihood_ratio = 0.0;  ///< of the best alignment, if that is how it was found
  double runner_up_log_likelihood_ratio = 0.0;  ///< of the best elsewhere
  std::size_t candidates = 0;    ///< pairs that passed the unary constraint; by alignment, those of the best place
  std::uint64_t compatible = 0;  ///< pairs of pairs that passed the binary constraint; by alignment 0
  std::uint64_t nodes = 0;       ///< of the search tree, or votes; and pairs of pairings weighed against each other

  /// What is to be stated as facts: the accepted set; if ambiguous both, since which of the two is right may follow
  /// from what other batches say, and that this place has a double is itself worth knowing.
  std::vector<std::vector<Pairing>> statements() const;
};

/// Batches a and b of one or two chains, anchor keys a < b (so that everybody computes the same). Deterministic: a
/// function of the facts alone. b are the new landmarks, a is the map. What the landmarks say of themselves
/// (appearance.hpp) must fit, and `looks_alike`, if there is one, must hold.
template <class G>
AssociationResult<G> associate(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior,
                               const AssociationParams& params, const LooksAlike<G>& looks_alike = {});

}  // namespace convoy
