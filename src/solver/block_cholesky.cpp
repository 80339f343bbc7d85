#include <convoy/solver/block_cholesky.hpp>
#include <convoy/solver/dense_kernels.hpp>
#include <convoy/solver/index.hpp>

#include <algorithm>
#include <cstring>

namespace convoy {
void BlockCholesky::set_zero() { std::fill(values_.begin(), values_.end(), 0.0); }

void BlockCholesky::assemble(std::size_t s, double* update, double damping) {
  const Supernode& node = supernodes_[s];
  const Supernode& next = supernodes_[s + 1];
  std::memset(factor_.data() + node.panel, 0, sizeof(double) * (next.panel - node.panel));
  std::memset(update, 0, sizeof(double) * at(node.ld_update) * at(node.rows - node.columns));
  int column = 0;
  for (std::size_t e = node.entries_begin; e < next.entries_begin; ++e) {
    const Entry& entry = entries_[e];
    const double* from = values_.data() + entry.values;
    double* to = factor_.data() + entry.target;
    for (int c = 0; c < entry.columns; ++c, from += entry.rows, to += node.ld)
      for (int r = 0; r < entry.rows; ++r) to[r] = from[r];
    if (!entry.diagonal) continue;
    to = factor_.data() + entry.target;
    for (int c = 0; c < entry.columns; ++c, to += node.ld + 1) {
      smallest_pivot_[at(column++)] = pivot_tolerance_ * std::max(0.0, *to);
      *to += damping * *to;
    }
  }
}

void BlockCholesky::extend_add(std::size_t child, const double* source, double* panel, double* update) const {
  const Supernode& node = supernodes_[child];
  const Supernode& parent = supernodes_[at(node.parent)];
  const Run* end = runs_.data() + supernodes_[child + 1].runs_begin;
  for (const Run* columns = runs_.data() + node.runs_begin; columns != end; ++columns)
    for (int c = 0; c < columns->length; ++c) {
      const double* from = source + std::ptrdiff_t(columns->source + c) * node.ld_update;
      const int target = columns->target + c;
      double* to = target < parent.columns
                       ? panel + std::ptrdiff_t(target) * parent.ld
                       : update + std::ptrdiff_t(target - parent.columns) * parent.ld_update - parent.columns;
      dense::add_to(to + target, from + columns->source + c, columns->length - c);
      for (const Run* rows = columns + 1; rows != end; ++rows)
        dense::add_to(to + rows->target, from + rows->source, rows->length);
    }
}

FactorStatus BlockCholesky::factor(double damping) {
  std::array<double*, 2> top{updates_[0].data(), updates_[1].data()};
  const std::size_t count = supernodes_.size() - 1;
  // Children of s hold the top of the stack of the other parity, the last child on top.
  for (std::size_t s = 0; s < count; ++s) {
    const Supernode& node = supernodes_[s];
    const std::size_t side = static_cast<std::size_t>(node.depth & 1);
    double* update = top[side];
    assemble(s, update, damping);
    for (int child = last_child_[s]; child >= 0; child = previous_sibling_[at(child)]) {
      const Supernode& below = supernodes_[at(child)];
      top[1 - side] -= at(below.ld_update) * at(below.rows - below.columns);
      extend_add(at(child), top[1 - side], factor_.data() + node.panel, update);
    }
    const int failed = dense::factor_front(factor_.data() + node.panel, node.ld, node.rows, node.columns, update,
                                           node.ld_update, smallest_pivot_.data());
    if (failed >= 0) return {block_of_row_[at(node.first + failed)]};
    if (node.parent >= 0) top[side] += at(node.ld_update) * at(node.rows - node.columns);
  }
  return {};
}

void BlockCholesky::forward(const Supernode& node, const Supernode& next, double* x, double* scratch) const {
  const int below = node.rows - node.columns;
  std::memset(scratch, 0, sizeof(double) * at(below));
  double* own = x + node.first;
  const double* L = factor_.data() + node.panel;
  for (int c = 0; c < node.columns; ++c, L += node.ld) {
    own[c] /= L[c];
    dense::add_scaled(own + c + 1, -own[c], L + c + 1, node.columns - c - 1);
    dense::add_scaled(scratch, own[c], L + node.columns, below);
  }
  for (std::size_t r = node.row_runs_begin; r < next.row_runs_begin; ++r) {
    const Run& run = row_runs_[r];
    dense::add_scaled(x + run.target, -1.0, scratch + run.source - node.columns, run.length);
  }
}

void BlockCholesky::backward(const Supernode& node, const Supernode& next, double* x, double* scratch) const {
  const int below = node.rows - node.columns;
  for (std::size_t r = node.row_runs_begin; r < next.row_runs_begin; ++r) {
    const Run& run = row_runs_[r];
    std::memcpy(scratch + run.source - node.columns, x + run.target, sizeof(double) * at(run.length));
  }
  double* own = x + node.first;
  const double* L = factor_.data() + node.panel + std::ptrdiff_t(node.columns - 1) * node.ld;
  for (int c = node.columns - 1; c >= 0; --c, L -= node.ld) {
    own[c] -= dense::dot(L + node.columns, scratch, below);
    own[c] -= dense::dot(L + c + 1, own + c + 1, node.columns - c - 1);
    own[c] /= L[c];
  }
}

void BlockCholesky::solve(double* x) const {
  for (std::size_t b = 0; b < sizes_.size(); ++b) std::copy_n(x + offsets_[b], sizes_[b], work_.data() + position_[b]);
  const std::size_t count = supernodes_.size() - 1;
  for (std::size_t s = 0; s < count; ++s) forward(supernodes_[s], supernodes_[s + 1], work_.data(), scratch_.data());
  for (std::size_t s = count; s-- > 0;) backward(supernodes_[s], supernodes_[s + 1], work_.data(), scratch_.data());
  for (std::size_t b = 0; b < sizes_.size(); ++b) std::copy_n(work_.data() + position_[b], sizes_[b], x + offsets_[b]);
}

}  // namespace convoy
