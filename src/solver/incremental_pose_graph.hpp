// A pose graph that grows: poses come in order, each with its factors, and only what they touch is solved again.
//
// The factorisation is kept as a tree of fronts, each with the update it handed to its parent. New factors take apart
// the paths from their poses to the root; what hangs below stays as it is, and the top is ordered again with the newest
// pose last (as iSAM2 does: Kaess et al., IJRR 2012). Poses that moved far from where they were linearised are
// linearised again, in place. A pose that nothing but its odometry speaks of changes nothing and waits outside the
// tree.
#pragma once

#include <convoy/solver/pose_graph.hpp>

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
  struct Front {
    std::vector<int> poses;  ///< eliminated here, then those of the separator
    int own = 0;             ///< how many are eliminated here
    int parent = -1;
    std::vector<int> children;
    int ld = 0, ld_update = 0;
    std::vector<double> panel, update;  ///< the right-hand side is the last row
    enum class Mark { keep, refactor, rebuild } mark = Mark::keep;
  };
  static constexpr int D = G::Dof;

  bool valid(const PoseFactor<G>& factor, int poses) const;
  int append(const PoseFactor<G>& factor);
  void update(std::vector<int> new_factors);
  bool is_far(int k, double factor) const;
  void place(int k);
  void relinearise();
  void join(std::vector<int>& new_factors);
  void mark_path(int front, typename Front::Mark mark);
  void mark_involved(int pose);
  bool refactor_marked();
  bool rebuild_top();
  void take_apart(std::vector<int>& top, std::vector<int>& orphans);
  std::vector<int> order_top(const std::vector<int>& top, const std::vector<int>& orphans);
  std::vector<int> build_fronts(const std::vector<int>& order, const std::vector<int>& orphans);
  bool factor(int front);
  void back_substitute();
  void solve_front(const Front& front);
  int new_front();
  int latest_factor(int k) const;
  typename G::Adjoint tree_covariance(int i, int j);
  void gather(const Front& front);
  void rebuild_all();

  IncrementalParams params_;
  std::vector<PoseFactor<G>> factors_;
  std::vector<LinearPoseFactor<G>> linear_;
  std::vector<std::vector<int>> factors_of_;  ///< of each pose
  std::vector<G> linearised_;                 ///< where each pose is linearised
  std::vector<typename G::Tangent> step_;     ///< from there to the estimate
  std::vector<int> front_of_;                 ///< -1: not in the tree
  std::vector<int> waiting_;  ///< poses outside the tree, in order, each with its one factor to one before
  std::vector<int> joining_;  ///< poses that enter the tree in this update
  std::vector<Front> fronts_;
  std::vector<int> free_, roots_;
  std::vector<int> far_;                      ///< poses to linearise again, sorted
  std::vector<int> candidates_;               ///< poses whose step changed and may be far
  std::vector<int> where_, stamp_, changed_;  ///< scratch, by pose
  std::vector<int> marked_;                   ///< fronts with a mark, parents before children once sorted
  std::vector<typename G::Adjoint> column_;   ///< scratch: a block column of the covariance, by pose
  std::vector<double> smallest_pivot_, front_column_;
  int serial_ = 0, update_serial_ = 0;
  bool broken_ = false;  ///< a factorisation failed: rebuild everything next time
  IncrementalUpdate last_;
};

}  // namespace convoy
