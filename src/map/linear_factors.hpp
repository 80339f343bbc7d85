// The factors of a problem, each as a term of the normal equations at an estimate: H = J^T W J, b = -J^T W r.
#pragma once

#include <convoy/map/problem.hpp>
#include <convoy/solver/front_tree.hpp>

#include <cstdint>
#include <span>
#include <vector>

namespace convoy {

/// Factors are numbered in a canonical order. The landmarks of one node whose errors have a part in common are one
/// factor (F2), since they are one measurement.
template <class G>
class LinearFactors {
 public:
  /// `problem` must outlive it.
  explicit LinearFactors(const Problem<G>& problem);

  int size() const { return static_cast<int>(factors_.size()); }
  /// What factor k speaks of, each once, by the numbers of the problem.
  std::span<const int> unknowns(int k) const {
    return std::span(unknowns_).subspan(factors_[at(k)].first_unknown, factors_[at(k)].unknowns);
  }
  /// W, the inverse covariance of its residual.
  Eigen::MatrixXd information(int k) const;
  /// H and b of factor k, rows of its unknowns stacked, and r^T W r. `term` null: that alone.
  double linearise(int k, const Eigen::MatrixXd& W, const State<G>& at, LinearTerm* term) const;
  /// True if factor k says of its unknowns, whichever they are, what factor `k_other` of `other` says of its own. Both
  /// are of one store, where facts never change.
  bool says_the_same(int k, const LinearFactors& other, int k_other) const;
  /// Rows of all residuals together.
  int residuals() const;

 private:
  enum class Kind : std::uint8_t { prior, constants, drift, bounded, fix, encounter, landmarks };
  struct Factor {
    Kind kind;
    std::size_t index;                    // within its kind; of landmarks: the first one in by_node_
    std::size_t first_unknown, unknowns;  // in unknowns_; of landmarks: the node, the points, whose scale they have
    std::size_t landmarks = 0;
  };
  void add(Kind kind, std::size_t index, std::initializer_list<int> unknowns);
  void add_landmarks();
  void add_landmarks(std::size_t first, std::size_t end);
  const LandmarkFactor<G>& landmark(const Factor& f, std::size_t i) const { return *by_node_[f.index + i]; }
  double landmarks(const Factor& f, const Eigen::MatrixXd& W, const State<G>& state, LinearTerm* term) const;

  const Problem<G>& problem_;
  std::vector<Factor> factors_;
  std::vector<int> unknowns_;
  std::vector<const LandmarkFactor<G>*> by_node_;
  std::vector<std::uint32_t> index_of_;  // of their landmarks, in their chains
};

}  // namespace convoy
