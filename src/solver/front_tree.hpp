// FrontTree: a Cholesky factorisation that changes piece by piece: the normal equations H x = b of a problem that
// grows.
//
// H is a sum of small dense terms, one per factor. The factorisation is kept as a tree of fronts, each with the update
// it hands to its parent. A term that comes or goes takes apart the paths from its unknowns to the root; what hangs
// below stays as it is, and the top is ordered again (as iSAM2 does: Kaess et al., IJRR 2012). A term whose values
// change is factored again in place. Solutions are handed down only as far as they change.
//
// Fronts are never changed once factored, only replaced: FactoredTree is a look at all of them as they are now, and
// stays what it is while the tree goes on.
#pragma once

#include <convoy/solver/index.hpp>

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <vector>

namespace convoy {

/// What one factor adds to the normal equations.
struct LinearTerm {
  std::vector<int> unknowns;  ///< each once
  Eigen::MatrixXd H;          ///< of their rows, stacked in this order; the lower triangle counts
  Eigen::VectorXd b;
};

/// A factorisation for questions about covariances. Not to be used from two threads at once, but independent of its
/// tree.
class FactoredTree {
 public:
  /// Block (i, j) of H^-1. Both must have been in the tree. The first question about an unknown takes the time of its
  /// path to the root, those that follow only that of a product.
  Eigen::MatrixXd covariance(int i, int j) const;
  /// Of several unknowns stacked.
  Eigen::MatrixXd joint_covariance(const std::vector<int>& unknowns) const;

 private:
  friend class FrontTree;
  struct Front {
    std::vector<int> unknowns;  ///< eliminated here, then those of the separator
    int own = 0;                ///< how many are eliminated here
    int rows = 0, columns = 0;  ///< the right-hand side is the last row; columns of those eliminated here
    int ld = 0, ld_update = 0;
    std::vector<double> panel, update;
  };
  struct Path {
    std::vector<int> fronts;            ///< from the unknown's own to the root
    std::vector<Eigen::MatrixXd> half;  ///< rows of L^-1 E, E the columns of the unknown, front by front
  };
  const Path& path_of(int unknown) const;
  Path half_solved(int unknown) const;
  static Eigen::MatrixXd product(const Path& a, const Path& b);
  int size(int unknown) const { return sizes_[static_cast<std::size_t>(unknown)]; }

  std::vector<std::shared_ptr<const Front>> fronts_;
  std::vector<int> parents_, front_of_, sizes_;
  mutable std::map<int, Path> paths_;  // asked for so far
  mutable std::vector<int> row_of_;    // scratch, by unknown
};

class FrontTree {
 public:
  /// A pivot at or below this fraction of its diagonal entry counts as not positive.
  explicit FrontTree(double pivot_tolerance = 1e-14) : pivot_tolerance_(pivot_tolerance) {}

  // ---- changes; they count from the next update() on
  /// `size` >= 1. Some term must speak of it by then.
  int add_unknown(int size);
  /// No term may speak of it by then.
  void remove_unknown(int unknown);
  int add_term(LinearTerm term);
  /// Other values of the same unknowns.
  void change_term(int term, LinearTerm value);
  void remove_term(int term);
  /// Its solution counts from zero again, since the caller has moved the point it is relative to: all of its terms
  /// change.
  void reset(int unknown);

  struct Report {
    int fronts = 0;  ///< that were factored
    bool failed =
        false;  ///< not positive definite: the solution is the one before, and the next update factors everything
  };
  /// Factors what has changed and solves. `last`: unknowns that are soon to be spoken of again, eliminated after all
  /// others that are ordered now. Steps that change by less than `propagate` in every component are not handed down.
  Report update(std::span<const int> last, double propagate);

  /// The solution of H x = b.
  Eigen::Map<const Eigen::VectorXd> solution(int unknown) const;
  /// Unknowns whose solution the last update has changed.
  const std::vector<int>& moved() const { return moved_; }
  const LinearTerm& term(int index) const { return terms_[at(index)]; }
  const std::vector<int>& terms_of(int unknown) const { return unknowns_[at(unknown)].terms; }
  bool contains(int unknown) const { return unknowns_[at(unknown)].node >= 0; }

  std::shared_ptr<const FactoredTree> factored() const;

 private:
  using Front = FactoredTree::Front;
  struct Unknown {
    int size = 0;  ///< 0: this place is free
    std::size_t offset = 0;
    int node = -1;         ///< where it is eliminated; -1: not in the tree
    bool leaving = false;  ///< at the next update
    std::vector<int> terms;
  };
  enum class Mark : std::uint8_t { keep, refactor, rebuild };
  struct Node {
    std::vector<int> unknowns;
    int own = 0;
    std::vector<int> terms;  ///< assembled here
    int parent = -1;
    std::vector<int> children;
    std::shared_ptr<const Front> front;
    Mark mark = Mark::keep;
  };

  void mark_path(int node, Mark mark);
  void mark_all();
  void collect_marked();
  bool factor_anew(std::span<const int> last);
  void take_apart(std::vector<int>& top, std::vector<int>& orphans);
  bool rebuild_top(std::span<const int> last);
  std::vector<int> order(const std::vector<int>& top, const std::vector<int>& orphans, std::span<const int> last);
  std::vector<int> build(const std::vector<int>& order, const std::vector<int>& orphans);
  int new_node();
  bool factor(int node);
  void add_term_to(Front& front, const LinearTerm& term) const;
  void add_child_to(Front& front, const Front& child);
  void back_substitute(double propagate);
  void solve(const Front& front, double propagate);

  double pivot_tolerance_;
  std::vector<Unknown> unknowns_;
  std::vector<std::vector<int>> free_unknowns_;  ///< by size
  std::vector<double> x_;
  std::vector<LinearTerm> terms_;
  std::vector<int> node_of_term_, free_terms_;
  std::vector<Node> nodes_;
  std::vector<int> free_nodes_, roots_;
  std::vector<int> joining_, leaving_;  ///< unknowns that enter or leave the tree at the next update
  std::vector<int> marked_;             ///< nodes with a mark, parents before children
  std::vector<int> moved_;
  std::vector<int> where_, stamp_, moved_at_;  ///< scratch, by unknown
  std::vector<int> rows_;                      ///< scratch
  std::vector<double> column_;                 ///< scratch
  int serial_ = 0, update_serial_ = 0;
  bool restructured_ = false, broken_ = false;
  Report report_;
};

}  // namespace convoy
