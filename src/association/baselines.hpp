// Three other ways to associate, which the paper argues against (Section IV), so that its argument can be run. Nothing
// else uses them. Each takes the map a and the new landmarks b and returns pairings (i of a, j of b), ascending and
// one-to-one. All are deterministic: landmarks are taken in the order of their keys, so that the order in which they
// are given does not matter; budgets are counted, never timed.
#pragma once

#include <convoy/association/constraints.hpp>
#include <convoy/association/search.hpp>

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

namespace convoy {

/// Joint Compatibility Branch and Bound (Neira and Tardos 2001; the paper's [21]): new landmarks one after the other,
/// each paired with an individually compatible one (eq. 5) or with none. The residuals l_i - T_a_b l_j of all pairs
/// together must be within their chi-square limit, their covariance being H P H^T + R: the error of the prior is common
/// to all, and the noise each landmark's own (what a batch shares is not told apart from it). The most pairings win, of
/// as many the least chi-square.
///
/// That chi-square is the sum of the squared innovations of a Kalman filter of T_a_b, one update per pair, linearised
/// at the mean of the prior: O(Dof^3) per node however many the pairs, and wrong where the heading is poorly known and
/// the landmarks far from the anchor. As in the original a hypothesis that is not jointly compatible is not pursued.
///
/// `confidence`: of both tests, (0, 1). Exponential; after `max_nodes` hypotheses it returns the best one so far.
/// Without a prior nothing can be tested, and it returns nothing.
template <class G>
SearchResult jcbb(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior, double confidence,
                  std::uint64_t max_nodes);

struct ConfigurationParams {
  double gate = 0.99;  ///< chi-square confidence that two measures are the same, or a pair fits an alignment, (0, 1)
  std::uint64_t max_alignments = 2000;  ///< so many of the matches are tried, drawn by a generator of fixed seed
};

/// Three closest neighbours (the paper's [19]): landmarks that see theirs at the same distances and angles are a match;
/// angles are compared by the sides opposite, whose variance is known even in a row, and mirror images told apart.
/// Every match implies an alignment; other matches are added to it from near to far as long as they fit, and improve
/// it. The largest set wins, of as large ones the first drawn; it holds the neighbours of the match that it began with.
///
/// With a prior, pairs must be individually compatible at `confidence`, (0, 1), and so must the alignment be. `nodes`
/// of the result: alignments tried; cut off if there were more matches than that.
template <class G>
SearchResult triplets(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior,
                      double confidence, const ConfigurationParams& params = {});

/// Delaunay triangles (the paper's [20]): those of both sides with the same perimeter, area and sides, in the same
/// sense of rotation, are a match; RANSAC over matches finds the alignment that the most of their vertices fit. In
/// space triangles are those of x and y, so both frames must be level, and heights must agree, too. Else as triplets().
template <class G>
SearchResult delaunay(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior,
                      double confidence, const ConfigurationParams& params = {});

/// The Delaunay triangles of points [m] (Bowyer 1981, Watson 1981), counter-clockwise, the smallest index first,
/// sorted. A point within a millimetre of another belongs to none; of four on a circle, chance decides, the same every
/// time. Points in a row have flat ones, if any. About O(n^1.5).
std::vector<std::array<int, 3>> delaunay_triangulation(const std::vector<Eigen::Vector2d>& points);

}  // namespace convoy
