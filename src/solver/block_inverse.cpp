// What is asked of H^-1: blocks of it, by the paths of what is asked for or by selected inversion.
#include <convoy/solver/block_cholesky.hpp>
#include <convoy/solver/dense_kernels.hpp>
#include <convoy/solver/index.hpp>

#include <algorithm>
#include <cstring>

namespace convoy {
Eigen::MatrixXd BlockCholesky::covariance(int i, int j) const {
  std::vector<std::size_t> down;  // from the supernode of i to its root
  for (int s = supernode_of_[index(i)]; s >= 0; s = supernodes_[at(s)].parent) down.push_back(at(s));
  Eigen::MatrixXd result = Eigen::MatrixXd::Zero(sizes_[index(i)], sizes_[index(j)]);
  std::fill(work_.begin(), work_.end(), 0.0);
  for (int c = 0; c < sizes_[index(j)]; ++c) {
    work_[at(position_[index(j)] + c)] = 1.0;
    // A column of the identity fills on the path of j alone; of the solution, only what is above i is needed.
    for (int s = supernode_of_[index(j)]; s >= 0; s = supernodes_[at(s)].parent)
      forward(supernodes_[at(s)], supernodes_[at(s) + 1], work_.data(), scratch_.data());
    for (auto s = down.rbegin(); s != down.rend(); ++s)
      backward(supernodes_[*s], supernodes_[*s + 1], work_.data(), scratch_.data());
    for (int r = 0; r < sizes_[index(i)]; ++r) result(r, c) = work_[at(position_[index(i)] + r)];
    const auto clear = [&](int s) {
      for (; s >= 0; s = supernodes_[at(s)].parent)
        std::fill_n(work_.begin() + supernodes_[at(s)].first, supernodes_[at(s)].columns, 0.0);
    };
    clear(supernode_of_[index(j)]);
    clear(supernode_of_[index(i)]);
  }
  return result;
}

// Columns of L^-1, each on the path of its block; their products.
Eigen::MatrixXd BlockCholesky::joint_covariance(const std::vector<int>& blocks) const {
  std::vector<std::size_t> paths;  // children before parents
  int rows = 0;
  for (const int b : blocks) {
    rows += sizes_[index(b)];
    for (int s = supernode_of_[index(b)]; s >= 0; s = supernodes_[at(s)].parent) paths.push_back(at(s));
  }
  std::sort(paths.begin(), paths.end());
  paths.erase(std::unique(paths.begin(), paths.end()), paths.end());
  Eigen::Index height = 0;
  for (const std::size_t s : paths) height += supernodes_[s].columns;

  Eigen::MatrixXd columns = Eigen::MatrixXd::Zero(height, rows);
  std::fill(work_.begin(), work_.end(), 0.0);
  int column = 0;
  for (const int b : blocks)
    for (int c = 0; c < sizes_[index(b)]; ++c, ++column) {
      work_[at(position_[index(b)] + c)] = 1.0;
      for (int s = supernode_of_[index(b)]; s >= 0; s = supernodes_[at(s)].parent)
        forward(supernodes_[at(s)], supernodes_[at(s) + 1], work_.data(), scratch_.data());
      Eigen::Index row = 0;
      for (const std::size_t s : paths) {
        double* x = work_.data() + supernodes_[s].first;
        std::copy_n(x, supernodes_[s].columns, columns.col(column).data() + row);
        std::fill_n(x, supernodes_[s].columns, 0.0);
        row += supernodes_[s].columns;
      }
    }
  Eigen::MatrixXd joint(rows, rows);
  for (int i = 0; i < rows; ++i)
    for (int j = 0; j <= i; ++j)
      joint(i, j) = joint(j, i) = dense::dot(columns.col(i).data(), columns.col(j).data(), static_cast<int>(height));
  return joint;
}

// Z = H^-1 on the rows of the front of s, both triangles, from Z on the front of its parent:
//   [M; W] = [I; L21] L11^-1,  Z21 = -Z22 W,  Z11 = M^T M - W^T Z21.
void BlockCholesky::inverse_front(std::size_t s, const double* parent_front, double* front, double* scratch) const {
  const Supernode& node = supernodes_[s];
  const int columns = node.columns, below = node.rows - columns;
  const std::ptrdiff_t ld = node.ld;
  if (below > 0) {
    const std::ptrdiff_t ld_parent = supernodes_[at(node.parent)].ld;
    const Run* begin = runs_.data() + node.runs_begin;
    const Run* end = runs_.data() + supernodes_[s + 1].runs_begin;
    for (const Run* c = begin; c != end; ++c)
      for (int k = 0; k < c->length; ++k) {
        const double* from = parent_front + (c->target + k) * ld_parent;
        double* to = front + (columns + c->source + k) * ld + columns;
        for (const Run* r = begin; r != end; ++r)
          for (int i = 0; i < r->length; ++i) to[r->source + i] = from[r->target + i];
      }
  }
  const double* L = factor_.data() + node.panel;
  double* X = scratch;  // rows x columns
  std::fill_n(X, ld * columns, 0.0);
  for (int c = 0; c < columns; ++c) {
    X[c * ld + c] = 1.0;
    std::copy_n(L + c * ld + columns, below, X + c * ld + columns);
  }
  dense::solve_right(X, node.ld, node.rows, columns, L, node.ld);
  const int ld_transposed = dense::padded(columns);
  double* transposed = X + ld * ld_transposed;  // columns x rows
  for (int c = 0; c < columns; ++c)
    for (int r = 0; r < node.rows; ++r) transposed[std::ptrdiff_t(r) * ld_transposed + c] = X[c * ld + r];
  for (int r = 0; r < node.rows; ++r)  // rows of padding, so that what is computed there is a number
    for (int c = columns; c < ld_transposed; ++c) transposed[std::ptrdiff_t(r) * ld_transposed + c] = 0.0;

  // -Z21, kept apart with a leading dimension of its own: rows of tiles may be padded.
  double* minus = transposed + std::ptrdiff_t(ld_transposed) * ld;
  const int ld_minus = node.ld_update;
  std::fill_n(minus, std::ptrdiff_t(ld_minus) * columns, 0.0);
  if (below > 0)
    dense::add_product(minus, ld_minus, below, columns, front + columns * ld + columns, node.ld, {X + columns, ld, 1},
                       below);
  double* Z11 = front;
  for (int c = 0; c < columns; ++c) std::fill_n(Z11 + c * ld, ld_transposed, 0.0);
  dense::add_product(Z11, node.ld, columns, columns, transposed, ld_transposed, {X, ld, 1}, columns);
  if (below > 0)
    dense::add_product(Z11, node.ld, columns, columns, transposed + std::ptrdiff_t(columns) * ld_transposed,
                       ld_transposed, {minus, ld_minus, 1}, below);
  for (int c = 0; c < columns; ++c) {
    for (int r = c + 1; r < columns; ++r) Z11[r * ld + c] = Z11[c * ld + r];
    for (int r = 0; r < below; ++r)
      front[c * ld + columns + r] = front[(columns + r) * ld + c] = -minus[std::ptrdiff_t(c) * ld_minus + r];
  }
}

// visit(s, front): H^-1 on the rows of every front, both triangles, leading dimension that of the front.
template <class Visit>
void BlockCholesky::visit_inverse(const Visit& visit) const {
  std::vector<double> stack(inverse_stack_ + 8), scratch(inverse_scratch_ + 8);
  const std::size_t count = supernodes_.size() - 1;
  // Parents before children; a front stays while its descendants are worked on.
  std::vector<std::size_t> begin(count);
  for (std::size_t s = count; s-- > 0;) {
    const Supernode& node = supernodes_[s];
    const double* parent = nullptr;
    if (node.parent >= 0) {
      const Supernode& up = supernodes_[at(node.parent)];
      begin[s] = begin[at(node.parent)] + at(up.ld) * at(up.rows) + 4;
      parent = stack.data() + begin[at(node.parent)];
    }
    double* front = stack.data() + begin[s];
    inverse_front(s, parent, front, scratch.data());
    visit(s, front);
  }
}

std::vector<double> BlockCholesky::marginals() const {
  std::vector<double> result(square_offsets_.back());
  visit_inverse([&](std::size_t s, const double* front) {
    const Supernode& node = supernodes_[s];
    for (int c = 0; c < node.columns;) {
      const int block = block_of_row_[at(node.first + c)], size = sizes_[index(block)];
      double* to = result.data() + square_offsets_[index(block)];
      for (int k = 0; k < size; ++k, to += size) std::copy_n(front + std::ptrdiff_t(c + k) * node.ld + c, size, to);
      c += size;
    }
  });
  return result;
}

std::vector<double> BlockCholesky::selected_inverse() const {
  std::vector<double> result(values_.size());
  visit_inverse([&](std::size_t s, const double* front) {
    const Supernode& node = supernodes_[s];
    for (std::size_t e = node.entries_begin; e < supernodes_[s + 1].entries_begin; ++e) {
      const Entry& entry = entries_[e];
      const double* from = front + (entry.target - node.panel);
      double* to = result.data() + entry.values;
      for (int c = 0; c < entry.columns; ++c, from += node.ld, to += entry.rows) std::copy_n(from, entry.rows, to);
    }
  });
  return result;
}

}  // namespace convoy
