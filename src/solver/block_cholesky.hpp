// Cholesky factorisation of symmetric positive definite matrices made of small blocks: what the normal equations of a
// map are. Multifrontal, on supernodes; the pattern is analysed once, then values change and are factored again without
// a single allocation. Same pattern, same values: same bits, on every x86-64 (dense_kernels.hpp).
//
//   BlockPattern pattern({3, 3, 2});                     // block sizes
//   pattern.add(0, 1);                                   // H(0, 1) and H(1, 0) are not zero; the diagonal never is
//   BlockCholesky solver(pattern);
//   solver.set_zero();
//   solver.add(solver.slot(1, 0), J_1.transpose() * W * J_0);
//   if (!solver.factor().ok()) ...
//   solver.solve(x);                                     // x <- H^-1 x
//   solver.marginals();                                  // every diagonal block of H^-1
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace convoy {

/// Which blocks of a symmetric matrix are not zero.
class BlockPattern {
 public:
  /// Size (>= 1) of each diagonal block.
  explicit BlockPattern(std::vector<int> sizes = {}) : sizes_(std::move(sizes)) {}

  /// H(i, j) and H(j, i), in any order, any number of times; i == j is allowed and says nothing new.
  void add(int i, int j) {
    if (i != j) pairs_.emplace_back(i, j);
  }

  int blocks() const { return static_cast<int>(sizes_.size()); }
  const std::vector<int>& sizes() const { return sizes_; }
  const std::vector<std::pair<int, int>>& pairs() const { return pairs_; }

 private:
  std::vector<int> sizes_;
  std::vector<std::pair<int, int>> pairs_;
};

struct FactorStatus {
  int failed_block = -1;  ///< the block whose pivot is not positive (to the tolerance) or not finite; -1: none
  bool ok() const { return failed_block < 0; }
};

/// What the analysis found.
struct FactorSize {
  std::size_t supernodes = 0;
  std::size_t entries = 0;  ///< doubles that hold L, explicit zeros and padding included
  double flops = 0;         ///< multiplications and additions of one factorisation
  std::size_t bytes = 0;    ///< of everything that is held between two factorisations
};

/// Not to be used from two threads at once, not even what is const.
class BlockCholesky {
 public:
  /// Where a block of H lives.
  struct Slot {
    std::size_t offset = 0;
    bool transposed = false;
  };

  BlockCholesky() = default;
  /// Orders the blocks (approximate minimum degree), finds supernodes, and sets all memory aside. The values are zero.
  explicit BlockCholesky(const BlockPattern& pattern);

  int blocks() const { return static_cast<int>(sizes_.size()); }
  /// Number of rows of H.
  int size() const { return size_; }
  int block_size(int block) const { return sizes_[index(block)]; }
  /// First row of a block in H, in x and in b.
  int offset(int block) const { return offsets_[index(block)]; }
  const FactorSize& factor_size() const { return factor_size_; }

  /// H(i, j); (i, j) or (j, i) must be in the pattern. Values added at (i, j) are those of (j, i), transposed.
  /// log(degree).
  Slot slot(int i, int j) const;
  bool in_pattern(int i, int j) const;

  void set_zero();

  /// H(i, j) += block (size of i by size of j) and H(j, i) += block^T. Of a diagonal block both triangles must be
  /// given.
  template <class Derived>
  void add(Slot slot, const Eigen::MatrixBase<Derived>& block) {
    constexpr int Rows = Derived::RowsAtCompileTime, Cols = Derived::ColsAtCompileTime;
    double* values = values_.data() + slot.offset;
    if (slot.transposed)
      Eigen::Map<Eigen::Matrix<double, Cols, Rows>>(values, block.cols(), block.rows()) += block.transpose();
    else Eigen::Map<Eigen::Matrix<double, Rows, Cols>>(values, block.rows(), block.cols()) += block;
  }

  /// A pivot at or below this fraction of its diagonal entry counts as not positive: what is left of such a number is
  /// rounding.
  void set_pivot_tolerance(double fraction) { pivot_tolerance_ = fraction; }

  /// H + damping diag(H) = L L^T. The values of H stay as they are.
  [[nodiscard]] FactorStatus factor(double damping = 0.0);

  /// x <- H^-1 x. Only after a factor() that was ok, like all that follows.
  void solve(double* x) const;
  void solve(Eigen::VectorXd& x) const { solve(x.data()); }

  /// Every diagonal block of H^-1, one after the other, each column-major: block b begins at marginal_offset(b).
  /// Selected inversion (Takahashi) on the supernodes.
  std::vector<double> marginals() const;
  std::size_t marginal_offset(int block) const { return square_offsets_[index(block)]; }

  /// H^-1 at every block of the pattern, for the price of marginals(). Block (i, j): in_slot(values, slot(i, j)).
  std::vector<double> selected_inverse() const;
  template <int Rows, int Cols>
  static Eigen::Matrix<double, Rows, Cols> in_slot(const std::vector<double>& values, Slot slot) {
    const double* at = values.data() + slot.offset;
    if (slot.transposed) return Eigen::Map<const Eigen::Matrix<double, Cols, Rows>>(at).transpose();
    return Eigen::Map<const Eigen::Matrix<double, Rows, Cols>>(at);
  }

  /// The same for blocks of any size, by their numbers; (i, j) must be in the pattern.
  Eigen::MatrixXd in_slot(const std::vector<double>& values, int i, int j) const {
    const Slot at = slot(i, j);
    const double* block = values.data() + at.offset;
    if (at.transposed) return Eigen::Map<const Eigen::MatrixXd>(block, block_size(j), block_size(i)).transpose();
    return Eigen::Map<const Eigen::MatrixXd>(block, block_size(i), block_size(j));
  }

  /// Block (i, j) of H^-1, in time of the paths of i and j to the root of the elimination tree.
  Eigen::MatrixXd covariance(int i, int j) const;
  /// Covariance of several blocks stacked, each named once, in time of their paths to the root and the square of their
  /// rows.
  Eigen::MatrixXd joint_covariance(const std::vector<int>& blocks) const;

 private:
  /// Rows [source, source + length) of a child's update are rows [target, target + length) of its parent's front.
  struct Run {
    int source, target, length;
  };
  struct Supernode {
    int first = 0;              ///< first row in elimination order
    int columns = 0, rows = 0;  ///< of the front: rows >= columns
    int ld = 0, ld_update = 0;
    int parent = -1;
    int depth = 0;                   ///< 0: a root
    std::size_t panel = 0;           ///< where L begins
    std::size_t entries_begin = 0;   ///< into entries_
    std::size_t runs_begin = 0;      ///< into runs_
    std::size_t row_runs_begin = 0;  ///< into row_runs_
  };
  /// A block of H within its front.
  struct Entry {
    std::size_t values, target;
    int rows, columns;
    bool diagonal;
  };

  class Analysis;

  static std::size_t index(int i) { return static_cast<std::size_t>(i); }
  void assemble(std::size_t s, double* update, double damping);
  void extend_add(std::size_t child, const double* source, double* panel, double* update) const;
  void forward(const Supernode& node, const Supernode& next, double* x, double* scratch) const;
  void backward(const Supernode& node, const Supernode& next, double* x, double* scratch) const;
  const int* find(int i, int j) const;
  template <class Visit>
  void visit_inverse(const Visit& visit) const;
  void inverse_front(std::size_t s, const double* parent_front, double* front, double* scratch) const;

  std::vector<int> sizes_, offsets_;
  std::vector<std::size_t> square_offsets_;
  int size_ = 0;
  std::vector<int> position_;                       ///< first row of each block in elimination order
  std::vector<int> supernode_of_;                   ///< of each block
  std::vector<int> block_of_row_;                   ///< in elimination order
  std::vector<Supernode> supernodes_;               ///< in postorder; one more at the end closes the ranges
  std::vector<int> last_child_, previous_sibling_;  ///< of each supernode; -1: none
  std::vector<Entry> entries_;
  std::vector<Run> runs_, row_runs_;
  std::vector<int> row_starts_, row_blocks_;  ///< pattern in block order, for slot(): neighbours j < i of i, sorted
  std::vector<Slot> row_slots_;
  std::vector<double> values_, factor_;
  std::array<std::vector<double>, 2> updates_;  ///< stacks of updates, by parity of the depth
  std::vector<double> smallest_pivot_;
  mutable std::vector<double> work_, scratch_;
  std::size_t inverse_stack_ = 0, inverse_scratch_ = 0;
  double pivot_tolerance_ = 1e-14;
  FactorSize factor_size_;
};

}  // namespace convoy
