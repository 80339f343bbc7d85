// The estimation problem that a selection of facts amounts to (DESIGN B1.3): poses of anchors, points of classes, and
// one factor per fact that says something about them. What every backend solves, and where each starts from.
#pragma once

#include <convoy/map/selection.hpp>

#include <set>
#include <vector>

namespace convoy {

/// An anchor that carries factors. Anchors without any need no node (thinning): the drift between any two
/// anchors is known (DESIGN eq. 2).
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

/// Constants of a chain: kappa (scale), g [rad/m], and in space the height [m] of its start in the common frame.
template <class G>
using Constants = Eigen::Matrix<double, G::Dim == 2 ? 2 : 3, 1>;
template <class G>
using ConstantsJacobian = Eigen::Matrix<double, G::Dof, Constants<G>::RowsAtCompileTime>;

/// F5: c ~ mean + N(0, diag(sigma^2)).
template <class G>
struct ConstantsFactor {
  Constants<G> mean, sigma;
};

/// F1: T_b = T_a * motion * Exp(A c) * Exp(N(0, Q)).
template <class G>
struct DriftFactor {
  int a, b;
  G motion;
  typename G::Covariance covariance;
  int constants = -1;  ///< whose c; -1: none
  ConstantsJacobian<G> A = ConstantsJacobian<G>::Zero();
};

/// F6, in space: the errors e of what a chain says of its tilt and height are AR(1) along the way,
/// e_b = phi e_a + N(0, (1 - phi^2) diag(sigma^2)); without a: e_b ~ N(0, diag(sigma^2)).
struct BoundedFactor {
  int a = -1, b = 0;
  int constants = 0;  ///< whose third one is the height of the start
  double phi = 0.0;
  Eigen::Vector3d up_a, up_b;             ///< what the chain says is up, body frame of each node
  double height_a = 0.0, height_b = 0.0;  ///< above the start of the chain, as it says [m]
  Eigen::Vector3d information;            ///< of (roll, pitch, height); 0: not bounded
};

/// F2: T_node^-1 m = (1 + kappa) (l + N(0, S)). Factors of one node share errors: Cov(l_i, l_j) = loading_i loading_j^T.
/// `loading`: of Problem::loadings; -1: nothing is shared.
template <class G>
struct LandmarkFactor {
  int node, point;
  Key landmark;
  typename G::Point position;
  typename G::PointCovariance covariance;
  int loading = -1;
  int constants = -1;  ///< whose kappa; -1: kappa is 0
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

/// F4: where the observer sees the other's mark: T_o^-1 T_w q = z + N(0, S).
template <class G>
struct EncounterFactor {
  int observer, other;
  Key encounter;
  typename G::Point mark;      ///< q, node frame of the other
  typename G::Point position;  ///< z, node frame of the observer
  typename G::PointCovariance covariance;
};

struct ChainSpan {
  ChainId chain;
  int first = 0, end = 0;    ///< its nodes; the first is the start of the epoch, index 0
  bool aligned = false;      ///< expressed in the common frame; else in a frame of its own
  ChainId placed_from = {};  ///< where its start values begin; nobody: absolute fixes or encounters have placed it
  int constants = -1;        ///< of Problem::constants; -1: none
  PersistentDrift persistent = {};
};

template <class G>
struct Problem {
  std::vector<ChainSpan> chains;
  std::vector<Node<G>> nodes;             ///< chains in canonical order, each in index order
  std::vector<typename G::Point> points;  ///< start values, one per class of the selection, same order
  std::vector<PriorFactor<G>> priors;
  std::vector<DriftFactor<G>> drifts;
  std::vector<LandmarkFactor<G>> landmarks;   ///< those of a point together
  std::vector<typename G::Loading> loadings;  ///< of landmarks
  std::set<Hash> placed_by;                   ///< hypotheses that the start values of chains come from
  std::vector<ConstantsFactor<G>> constants;
  std::vector<BoundedFactor> bounded;
  std::vector<EncounterFactor<G>> encounters;
  std::vector<AbsoluteFixFactor<G>> fixes;
  int datum = -1;  ///< node of T_enu_common, the last one, of no chain; -1: none

  // Unknowns: nodes first, then points, then constants.
  int unknown_of_point(int p) const { return static_cast<int>(nodes.size()) + p; }
  int unknown_of_constants(int k) const { return static_cast<int>(nodes.size() + points.size()) + k; }
};

/// An estimate of every unknown of a problem.
template <class G>
struct State {
  /// Between two estimates of one unknown: a right perturbation of a node, a difference of points or constants.
  using Step = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, G::Dof, 1>;

  std::vector<G> poses;                   ///< of Problem::nodes
  std::vector<typename G::Point> points;  ///< of Problem::points
  std::vector<Constants<G>> constants;    ///< of Problem::constants

  const G& pose(int n) const { return poses[static_cast<std::size_t>(n)]; }
  const typename G::Point& point(int p) const { return points[static_cast<std::size_t>(p)]; }
  Constants<G> constants_of(int k) const {
    return k < 0 ? Constants<G>::Zero() : constants[static_cast<std::size_t>(k)];
  }

  // Any unknown, by its number in the problem.
  int size() const { return static_cast<int>(poses.size() + points.size() + constants.size()); }
  bool is_node(int u) const { return static_cast<std::size_t>(u) < poses.size(); }
  bool is_point(int u) const { return !is_node(u) && static_cast<std::size_t>(u) < poses.size() + points.size(); }
  void set(int u, const State& from, int v) {
    if (is_node(u)) poses[static_cast<std::size_t>(u)] = from.pose(v);
    else if (is_point(u)) points[point_index(u)] = from.points[from.point_index(v)];
    else constants[constants_index(u)] = from.constants[from.constants_index(v)];
  }
  void move(int u, const State& from, const Step& step) {
    if (is_node(u)) poses[static_cast<std::size_t>(u)] = from.pose(u) * G::Exp(typename G::Tangent(step));
    else if (is_point(u)) points[point_index(u)] = from.points[point_index(u)] + step;
    else constants[constants_index(u)] = from.constants[constants_index(u)] + step;
  }
  Step step_to(const State& to, int u, int v) const {
    if (is_node(u)) return (pose(u).inverse() * to.pose(v)).Log();
    if (is_point(u)) return to.points[to.point_index(v)] - points[point_index(u)];
    return to.constants[to.constants_index(v)] - constants[constants_index(u)];
  }

 private:
  std::size_t point_index(int u) const { return static_cast<std::size_t>(u) - poses.size(); }
  std::size_t constants_index(int u) const { return static_cast<std::size_t>(u) - poses.size() - points.size(); }
};

/// Where a problem is started from.
template <class G>
State<G> start_of(const Problem<G>& problem);

/// Rows of each unknown of a problem: of nodes, of points, of constants.
template <class G>
std::vector<int> unknown_sizes(const Problem<G>& problem);

/// What stands between two states of a chain whose persistent drift is known.
template <class G>
DriftFactor<G> drift_between(const ChainState<G>& a, const ChainState<G>& b, const ChainSpan& span);
/// `a` null: the start of the process.
template <class G>
BoundedFactor bounded_between(const ChainState<G>* a, const ChainState<G>& b, const ChainSpan& span);

struct ProblemOptions {
  VehicleId reference = 0;           ///< whose start is the common frame if no static bias is known
  bool common_frame_is_enu = false;  ///< the common frame is that of the absolute fixes, and no datum is looked for
  bool plain = false;                ///< F0, F1 and F2 alone: the paper's method knows no others
};

/// The common frame is the one of the static biases, if any is known. Else it is the start of `reference` (its first
/// epoch that is connected to another chain; 0: the smallest chain in the largest group of chains that accepted
/// hypotheses connect). Chains that nothing connects to it keep a frame of their own and are not aligned.
///
/// Absolute fixes add a datum T_enu_common (flat prior) once those of the common frame fix its yaw, and align every
/// group of chains whose own fixes do so. With `common_frame_is_enu` there is no datum: chains are aligned by their
/// fixes (or a static bias) alone, and nobody's start is the common frame.
///
/// A group of chains that nothing else aligns is aligned by its encounters with aligned chains, three or more of them
/// from places far enough apart.
///
/// `before`: what this function made of the same store when it held less, or of another selection, with the same
/// options. What did not change is taken from there instead of the store; the result is the same, to the bit.
template <class G>
Problem<G> build_problem(const FactStore<G>& store, const Selection<G>& selection, const ProblemOptions& options = {},
                         const Problem<G>* before = nullptr);

}  // namespace convoy
