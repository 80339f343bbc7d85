// A pose graph that grows: poses come in order, each with its factors, and only what they touch is solved again.
//
// What is kept between two updates is a FrontTree, with the newest pose last in the order of elimination. Poses that
// moved far from where they were linearised are linearised again, in place. A pose that nothing but its odometry speaks
// of changes nothing and waits outside the tree.
#pragma once

#include <convoy/solver/front_tree.hpp>
#include <convoy/solver/pose_graph.hpp>

#include <memory>
#include <span>
#include <vector>

namespace convoy {

struct IncrementalParams {
  PoseResidual residual = PoseResidual::log;
  double relinearise_m = 0.2;     ///< a pose whose linear step is longer is linearised again
  double relinearise_rad = 0.02;  ///< the same for its rotation
  double propagate = 1e-4;        ///< steps that change by less are not handed down [m, rad]
  double again_factor = 2.0;  ///< steps longer than this times the above are linearised again even if nothing new came
};

/// What the last update did.
struct IncrementalUpdate {
  int fronts = 0;        ///< fronts that were factored
  int relinearised = 0;  ///< poses
  int moved = 0;         ///< poses whose estimate changed
  bool failed = false;   ///< not positive definite: the estimate is the one before; the next update tries again
};

template <class G>
class IncrementalPoseGraph {
 public:
  /// Pose 0 is fixed at `first`.
  explicit IncrementalPoseGraph(const G& first, const IncrementalParams& params = {});

  /// Adds pose size() with its factors to poses before it. The factor to the latest of them gives the starting point.
  /// False, and nothing changed, if there is none or if a factor names any other pose.
  [[nodiscard]] bool add(std::span<const PoseFactor<G>> factors);
  /// Adds factors between poses that are there; none at all: one more iteration, if poses are far from where they are
  /// linearised. False, and nothing changed, if one names any other pose, or a pose twice.
  [[nodiscard]] bool add_factors(std::span<const PoseFactor<G>> factors);

  int size() const { return static_cast<int>(linearised_.size()); }
  G pose(int k) const;
  std::vector<G> poses() const;
  const std::vector<PoseFactor<G>>& factors() const { return factors_; }
  const IncrementalUpdate& last_update() const { return last_; }

  /// Block (i, j) of the covariance of right perturbations of the poses, where they are linearised; zero for pose 0.
  /// Takes time of the paths of i and j to the root. Not while last_update().failed.
  typename G::Adjoint covariance(int i, int j);

  /// The exact solution: batch iterations from the present estimate until nothing moves. The tree is then at that
  /// estimate.
  PoseGraphReport finish();

 private:
  static constexpr int D = G::Dof;

  bool valid(const PoseFactor<G>& factor, int poses) const;
  void append_pose();
  int append(const PoseFactor<G>& factor);
  void update(std::vector<int> new_factors);
  bool is_far(int k, double factor) const;
  int latest_factor(int k) const;
  void place(int k);
  LinearTerm linear(const PoseFactor<G>& factor) const;
  void relinearise(const std::vector<int>& poses);
  void join(std::vector<int>& new_factors);
  void enter(int pose);
  void note_moved();
  const FactoredTree& factored();

  IncrementalParams params_;
  std::vector<PoseFactor<G>> factors_;
  std::vector<int> term_of_;                  ///< of each factor; -1: not in the tree
  std::vector<std::vector<int>> factors_of_;  ///< of each pose
  std::vector<G> linearised_;                 ///< where each pose is linearised
  std::vector<int> unknown_of_;               ///< of each pose; -1: not in the tree
  std::vector<int> pose_of_;                  ///< of each unknown
  std::vector<int> waiting_;  ///< poses outside the tree, in order, each with its one factor to one before
  std::vector<int> far_;      ///< poses to linearise again, sorted
  FrontTree tree_;
  std::shared_ptr<const FactoredTree> factored_;  ///< null: not asked for since the last update
  IncrementalUpdate last_;
};

}  // namespace convoy
