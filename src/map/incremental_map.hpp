// IncrementalMap: a sparse map that grows. Of a new problem only what differs from the one before is worked in.
//
// The solution is that of SparseMap but for how far it is iterated: unknowns whose linear step is small are not
// linearised again, and steps that change by next to nothing are not handed on. It depends on the way there by as much,
// and no more; the map that all vehicles agree on to the bit is SparseMap's.
#pragma once

#include <convoy/map/linear_factors.hpp>
#include <convoy/map/map.hpp>
#include <convoy/solver/front_tree.hpp>

#include <memory>
#include <vector>

namespace convoy {

struct IncrementalMapParams {
  double relinearise_m = 0.1;     ///< a node or point whose linear step is longer is linearised again
  double relinearise_rad = 0.01;  ///< the same for the rotation of a node
  double propagate = 3e-4;        ///< steps that change by less are not handed on [m, rad]
  int max_iterations = 10;        ///< what still moves then is solved from the start
};

/// What the last solve() did.
struct IncrementalMapReport {
  int fronts = 0;  ///< that were factored
  int new_factors = 0, gone_factors = 0;
  int relinearised = 0;  ///< unknowns
  int iterations = 0;
  bool from_start = false;  ///< by SparseMap, from the canonical start: it did not converge from where it was
};

template <class G>
class IncrementalMap {
 public:
  explicit IncrementalMap(const IncrementalMapParams& params = {}) : params_(params), tree_(0.0) {}

  /// Of any problem: how long it takes depends on how much of it was in the one before.
  std::unique_ptr<Map<G>> solve(Problem<G> problem);
  /// Goes on from the solution of `map` at the next solve().
  void restart(const Map<G>& map);

  const IncrementalMapReport& last() const { return last_; }

 private:
  struct Known {  // a factor that is in the tree
    int term = -1;
    Eigen::MatrixXd information;
    double chi2 = 0.0;
  };
  void take_unknowns(const Problem<G>* before);
  void place(int unknown);
  bool starts_anew(const ChainSpan& span, const Problem<G>* before) const;
  typename G::Point mean_of_members(std::size_t first) const;
  void take_factors();
  bool is_factor(int k, const LinearFactors<G>& old, int old_k) const;
  void enter(int factor);
  bool iterate();
  void add_terms_of(int id, std::vector<int>& terms);
  void linearise_at_estimate(const std::vector<int>& unknowns);
  void judge(int factor);  // at the estimate
  void judge_around(const std::vector<int>& unknowns);
  bool is_far(int unknown, const typename State<G>::Step& step) const;
  LinearTerm linear_term(int factor) const;
  double total_chi2() const;

  IncrementalMapParams params_;
  FrontTree tree_;
  std::shared_ptr<const Problem<G>> problem_;
  std::unique_ptr<LinearFactors<G>> factors_;
  State<G> linearised_, estimate_;       // of the problem's unknowns
  std::vector<int> id_of_;               // in the tree, of each unknown of the problem
  std::vector<int> unknown_of_;          // the other way round
  std::vector<int> old_number_;          // of each unknown of the problem, in the one before; -1: it is new
  std::vector<int> gone_;                // in the tree: what this problem has no more
  std::vector<int> placed_anew_;         // unknowns of the problem that were there, and start from somewhere else now
  std::vector<int> new_nodes_;           // in the tree
  std::vector<Known> known_;             // each factor of the problem
  std::vector<int> factor_of_;           // of each term of the tree
  std::vector<std::uint64_t> stamp_of_;  // scratch, by term
  std::uint64_t stamp_ = 0;
  IncrementalMapReport last_;
};

}  // namespace convoy
