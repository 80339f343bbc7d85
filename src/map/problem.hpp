// The estimation problem that a selection of facts amounts to (DESIGN B1.3): poses of anchors, points of classes, and
// one factor per fact that says something about them. What every backend solves, and where each starts from.
#pragma once

#include <convoy/map/selection.hpp>

#include <set>
#include <vector>

namespace convoy {

/// An anchor that carries factors. Anchors without any need no node: the drift between two nodes is exact (thinning).
template <class G>
struct Node {
  Key anchor;
  ChainState<G> slam;
  G initial;  ///< T_common_anchor to start from: canonical, so that the result does not depend on history
};

/// F0: T ~ mean * Exp(N(0, P)).
template <class G>
struct PriorFactor {
  int node;
  G mean;
  typename G::Covariance covariance;
};

/// F1: T_b = T_a * motion * Exp(N(0, Q)).
template <class G>
struct DriftFactor {
  int a, b;
  G motion;
  typename G::Covariance covariance;
};

/// F2: T_node^-1 m = l + N(0, S). Factors of one node share errors: Cov(l_i, l_j) = loading_i loading_j^T.
template <class G>
struct LandmarkFactor {
  int node, point;
  Key landmark;
  typename G::Point position;
  typename G::PointCovariance covariance;
  typename G::Loading loading = G::Loading::Zero();
};

/// F3: D T_node q = z + N(0, S), the datum D = T_enu_common being a node, too, or the identity.
template <class G>
struct AbsoluteFixFactor {
  int node, datum;  ///< datum: -1 if the common frame is east-north(-up) itself
  Key fix;
  typename G::Point antenna;   ///< q, the lever, node frame
  typename G::Point position;  ///< z, east-north(-up)
  typename G::PointCovariance covariance;
};

struct ChainSpan {
  ChainId chain;
  int first = 0, end = 0;  ///< its nodes; the first is the start of the epoch, index 0
  bool aligned = false;    ///< expressed in the common frame; else in a frame of its own
};

template <class G>
struct Problem {
  std::vector<ChainSpan> chains;
  std::vector<Node<G>> nodes;                 ///< chains in canonical order, each in index order
  std::vector<typename G::Point> points;      ///< start values, one per class of the selection, same order
  std::vector<PriorFactor<G>> priors;
  std::vector<DriftFactor<G>> drifts;
  std::vector<LandmarkFactor<G>> landmarks;
  std::set<Hash> placed_by;  ///< hypotheses that the start values of chains come from
  std::vector<AbsoluteFixFactor<G>> fixes;
  int datum = -1;  ///< node of T_enu_common, the last one, of no chain; -1: none
};

/// The common frame is the one of the static biases, if any is known. Else it is the start of `reference` (its first epoch
/// that is connected to another chain; 0: the smallest chain in the largest group of chains that accepted hypotheses
/// connect). Chains that nothing connects to it keep a frame of their own and are not aligned.
///
/// Absolute fixes add a datum T_enu_common (flat prior) once those of the common frame fix its yaw, and align every group
/// of chains whose own fixes do so. With `common_frame_is_enu` there is no datum: chains are aligned by their fixes (or a static
/// bias) alone, and nobody's start is the common frame.
template <class G>
Problem<G> build_problem(const FactStore<G>& store, const Selection<G>& selection, VehicleId reference = 0,
                         bool common_frame_is_enu = false);

}  // namespace convoy
