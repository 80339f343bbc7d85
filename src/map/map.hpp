// Map: the poses of all vehicles and the landmarks in the common frame, with covariances: a function of the facts.
#pragma once

#include <convoy/map/problem.hpp>

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

namespace convoy {

template <class G>
struct Estimate {
  G mean;                                                     ///< T_common_body; of a chain not aligned: T_chain_body
  typename G::Covariance covariance = G::Covariance::Zero();  ///< right perturbation (rho [m], theta [rad])
};

template <class G>
struct PointEstimate {
  typename G::Point mean = G::Point::Zero();  ///< common frame [m]
  typename G::PointCovariance covariance = G::PointCovariance::Zero();
};

/// What a backend keeps to answer for covariances. An unknown is a node, a point or the constants of a chain, by its
/// index in the Problem: see Problem::unknown_of_point() and its like.
template <class G>
class CovarianceSource {
 public:
  virtual ~CovarianceSource() = default;
  /// Cov(d_a, d_b) of two unknowns, nodes by right perturbations.
  virtual Eigen::MatrixXd between(int a, int b) = 0;
  /// Of several stacked, each named once.
  virtual Eigen::MatrixXd joint(const std::vector<int>& unknowns) = 0;
};

/// A pose and points around it as the map knows them together.
template <class G>
struct Surroundings {
  G pose;  ///< T_common_body; of a chain that is not aligned: T_chain_body
  typename G::Covariance motion =
      G::Covariance::Zero();              ///< of what it owes to the SLAM since the last node, not the map
  std::vector<typename G::Point> points;  ///< common frame [m]
  Eigen::MatrixXd covariance;             ///< joint, (Dof + Dim n)^2, of (d_pose, d_points), without `motion`
};

/// How a solution was reached.
struct SolveReport {
  int iterations = 0;
  bool converged = false;
  double chi2 = 0.0;  ///< twice the cost at the solution
  int dof = 0;        ///< residuals minus unknowns
};

/// One solved map. Not thread-safe: covariances are computed when asked for.
template <class G>
class Map {
 public:
  Map(std::shared_ptr<const Problem<G>> problem, State<G> solution, SolveReport report,
      std::unique_ptr<CovarianceSource<G>> covariances);

  /// True if the chain is known and expressed in the common frame.
  bool aligned(const ChainId& chain) const;

  /// The pose where a vehicle's SLAM said `state`, corrected: extrapolated from the last node before it, or smoothed
  /// between two. O(1) in its length but for finding the nodes. Empty if unknown; aligned() tells which frame it is in.
  std::optional<Estimate<G>> pose(const ChainId& chain, const ChainState<G>& state);

  /// Joint covariance of two such poses, (d_a, d_b): 2 Dof x 2 Dof. Empty if one of the chains is unknown.
  std::optional<Eigen::Matrix<double, 2 * G::Dof, 2 * G::Dof>> joint_covariance(const ChainId& chain_a,
                                                                                const ChainState<G>& state_a,
                                                                                const ChainId& chain_b,
                                                                                const ChainState<G>& state_b);

  /// The pose where a vehicle's SLAM said `state`, with the points of some classes of the selection (each named once).
  /// Empty if the chain is unknown.
  std::optional<Surroundings<G>> surroundings(const ChainId& chain, const ChainState<G>& state,
                                              const std::vector<int>& classes);

  /// A landmark in the frame of its chain's map. Empty if its anchor's chain is unknown.
  std::optional<PointEstimate<G>> landmark(const FactStore<G>& store, const LandmarkFact<G>& landmark);
  /// PersistentDrift::scales_landmarks of a chain.
  bool scales_landmarks(const ChainId& chain) const;
  /// True metres per metre of this chain's landmark positions, as estimated; 1 unless it scales them.
  double landmark_scale(const ChainId& chain) const;

  /// What the map has learnt of kappa (true distance = (1 + kappa) x said) and g [rad/m] of a chain: mean and standard
  /// deviation. Empty if it states none.
  struct Learnt {
    Eigen::Vector2d mean, sigma;
  };
  std::optional<Learnt> constants(const ChainId& chain);

  /// The solved point of class `index` of the selection.
  PointEstimate<G> class_point(int index);

  /// T_enu_common, from absolute fixes. Empty if they do not fix it, or if the common frame is east-north(-up) itself.
  std::optional<Estimate<G>> datum();

  /// How far an absolute fix of the problem lies from a map that has not heard of it: squared Mahalanobis distance, and
  /// the number of directions in which the others say anything (0: none).
  std::pair<double, int> contradiction(const AbsoluteFixFactor<G>& fix);
  std::pair<double, int> contradiction(const EncounterFactor<G>& encounter);
  std::pair<double, int> contradiction(const DriftFactor<G>& motion);

  const Problem<G>& problem() const { return *problem_; }
  const std::shared_ptr<const Problem<G>>& shared_problem() const { return problem_; }
  const std::vector<G>& poses() const { return at_.poses; }                     ///< of Problem::nodes
  const std::vector<typename G::Point>& points() const { return at_.points; }   ///< of Problem::points
  const std::vector<Constants<G>>& constants() const { return at_.constants; }  ///< of Problem::constants
  const SolveReport& report() const { return report_; }
  /// Hash of every pose and point to the bit. Equal for equal facts.
  Hash digest() const;

 private:
  // d_pose = A d_first + B d_second + C d_constants + noise, by the nodes around it.
  struct Placement {
    int first = 0, second = -1;  // nodes; -1: none
    int constants = -1;
    G mean;
    typename G::Covariance A = G::Covariance::Zero(), B = G::Covariance::Zero(), noise = G::Covariance::Zero();
    ConstantsJacobian<G> C = ConstantsJacobian<G>::Zero();
  };
  const ChainSpan* span(const ChainId& chain) const;
  Placement place(const ChainSpan& span, const ChainState<G>& state) const;
  typename G::Covariance covariance(const Placement& a, const Placement& b);
  std::vector<std::pair<int, Eigen::MatrixXd>> parts(const Placement& placement) const;
  template <int R>
  std::pair<double, int> contradiction(const Eigen::Matrix<double, R, 1>& r, const Eigen::Matrix<double, R, R>& S,
                                       const std::vector<std::pair<int, Eigen::Matrix<double, R, G::Dof>>>& jacobians);

  std::shared_ptr<const Problem<G>> problem_;
  State<G> at_;
  SolveReport report_;
  std::unique_ptr<CovarianceSource<G>> covariances_;
};

template <class G>
class IncrementalMap;

/// Solves a problem. Stateless: the same problem gives the same map, to the bit.
template <class G>
class Backend {
 public:
  virtual ~Backend() = default;
  virtual std::unique_ptr<Map<G>> solve(Problem<G> problem) const = 0;
  /// False: it knows static biases, drift and landmarks alone (ProblemOptions::plain).
  virtual bool takes_every_factor() const { return true; }
  /// What comes to the same solutions as a problem grows, quicker; null: there is none.
  virtual std::shared_ptr<IncrementalMap<G>> incremental() const { return nullptr; }
};

}  // namespace convoy
