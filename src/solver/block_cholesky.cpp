#include <convoy/solver/block_cholesky.hpp>
#include <convoy/solver/block_ordering.hpp>
#include <convoy/solver/dense_kernels.hpp>
#include <convoy/solver/front_cost.hpp>

#include <algorithm>
#include <cstring>
#include <numeric>

namespace convoy {
namespace {

std::size_t at(int i) { return static_cast<std::size_t>(i); }

// Neighbours of each of n things, one after the other.
struct Lists {
  std::vector<int> begin, values;
  const int* first(int i) const { return values.data() + begin[at(i)]; }
  const int* last(int i) const { return values.data() + begin[at(i) + 1]; }
};

// A set of blocks that are eliminated together, while supernodes are still being merged.
struct Draft {
  int columns = 0;  ///< rows of H
  int below = 0;    ///< rows of the front below them
  int parent = -1;
  int first_child = -1, next_sibling = -1;
  int last_block = -1;  ///< chain of blocks through Analysis::next_block, ending at the last
  int first_block = -1;
  bool merged = false;
};

}  // namespace

// From the pattern to everything that factor() walks through. n blocks; "position" counts blocks in elimination order.
class BlockCholesky::Analysis {
 public:
  Analysis(BlockCholesky& solver, const BlockPattern& pattern)
      : solver_(solver), pattern_(pattern), n_(pattern.blocks()) {}

  void run() {
    number(minimum_degree_order(pattern_));
    eliminate();
    postorder();
    eliminate();  // the tree again, now numbered from the leaves up
    draft_supernodes();
    merge_supernodes();
    renumber_by_supernodes();
    fronts();
    slots();
    memory();
  }

 private:
  int block_rows(int position) const { return solver_.sizes_[at(order_[at(position)])]; }

  // `order`: blocks in elimination order. Neighbours of each, by position.
  void number(std::vector<int> order) {
    order_ = std::move(order);
    std::vector<int> position(at(n_));
    for (int p = 0; p < n_; ++p) position[at(order_[at(p)])] = p;
    upper_.begin.assign(at(n_) + 1, 0);
    lower_.begin.assign(at(n_) + 1, 0);
    for (const auto& [i, j] : pattern_.pairs()) {
      const int low = std::min(position[at(i)], position[at(j)]), high = std::max(position[at(i)], position[at(j)]);
      ++upper_.begin[at(low) + 1];
      ++lower_.begin[at(high) + 1];
    }
    for (int p = 0; p < n_; ++p) {
      upper_.begin[at(p) + 1] += upper_.begin[at(p)];
      lower_.begin[at(p) + 1] += lower_.begin[at(p)];
    }
    upper_.values.resize(pattern_.pairs().size());
    lower_.values.resize(pattern_.pairs().size());
    std::vector<int> up(upper_.begin.begin(), upper_.begin.end() - 1),
        down(lower_.begin.begin(), lower_.begin.end() - 1);
    for (const auto& [i, j] : pattern_.pairs()) {
      const int low = std::min(position[at(i)], position[at(j)]), high = std::max(position[at(i)], position[at(j)]);
      upper_.values[at(up[at(low)]++)] = high;
      lower_.values[at(down[at(high)]++)] = low;
    }
  }

  // Elimination tree of blocks (Liu).
  void eliminate() {
    parent_.assign(at(n_), -1);
    std::vector<int> ancestor(at(n_), -1);
    for (int i = 0; i < n_; ++i)
      for (const int* j = lower_.first(i); j != lower_.last(i); ++j)
        for (int k = *j, next; k != -1 && k < i; k = next) {
          next = ancestor[at(k)];
          ancestor[at(k)] = i;
          if (next == -1) parent_[at(k)] = i;
        }
  }

  void postorder() {
    std::vector<int> first_child(at(n_), -1), next_sibling(at(n_), -1), roots;
    for (int k = n_ - 1; k >= 0; --k) {
      if (parent_[at(k)] < 0) {
        roots.push_back(k);
        continue;
      }
      next_sibling[at(k)] = first_child[at(parent_[at(k)])];
      first_child[at(parent_[at(k)])] = k;
    }
    std::vector<int> order, stack;
    order.reserve(at(n_));
    for (auto root = roots.rbegin(); root != roots.rend(); ++root) {
      stack.push_back(*root);
      while (!stack.empty()) {
        const int k = stack.back();
        if (const int child = first_child[at(k)]; child >= 0) {
          first_child[at(k)] = next_sibling[at(child)];
          stack.push_back(child);
        } else {
          order.push_back(order_[at(k)]);
          stack.pop_back();
        }
      }
    }
    number(std::move(order));
  }

  // Fundamental supernodes. Rows below the diagonal block of each column, from the row subtrees.
  void draft_supernodes() {
    std::vector<int> below(at(n_), 0), below_blocks(at(n_), 0), mark(at(n_), -1), children(at(n_), 0);
    for (int i = 0; i < n_; ++i) {
      mark[at(i)] = i;
      for (const int* j = lower_.first(i); j != lower_.last(i); ++j)
        for (int k = *j; mark[at(k)] != i; k = parent_[at(k)]) {
          mark[at(k)] = i;
          below[at(k)] += block_rows(i);
          ++below_blocks[at(k)];
        }
      if (parent_[at(i)] >= 0) ++children[at(parent_[at(i)])];
    }
    next_block_.assign(at(n_), -1);
    draft_of_.resize(at(n_));
    for (int k = 0; k < n_; ++k) {
      const bool joins = k > 0 && parent_[at(k) - 1] == k && children[at(k)] == 1 &&
                         below_blocks[at(k) - 1] == below_blocks[at(k)] + 1;
      if (!joins) {
        drafts_.emplace_back();
        drafts_.back().first_block = k;
      } else {
        next_block_[at(k) - 1] = k;
      }
      Draft& draft = drafts_.back();
      draft.last_block = k;
      draft.columns += block_rows(k);
      draft.below = below[at(k)];
      draft_of_[at(k)] = static_cast<int>(drafts_.size()) - 1;
    }
    for (int d = static_cast<int>(drafts_.size()) - 1; d >= 0; --d) {
      const int up = parent_[at(drafts_[at(d)].last_block)];
      if (up < 0) continue;
      Draft& draft = drafts_[at(d)];
      draft.parent = draft_of_[at(up)];
      draft.next_sibling = drafts_[at(draft.parent)].first_child;
      drafts_[at(draft.parent)].first_child = d;
    }
  }

  static double saving(const Draft& child, const Draft& parent) {
    return front_cost(child.columns, child.columns + child.below) +
           front_cost(parent.columns, parent.columns + parent.below) -
           front_cost(child.columns + parent.columns, child.columns + parent.columns + parent.below);
  }

  // From the leaves up, every supernode takes in those children that are cheaper inside than as fronts of their own.
  void merge_supernodes() {
    std::vector<std::pair<double, int>> candidates;
    for (int p = 0; p < static_cast<int>(drafts_.size()); ++p) {
      Draft& parent = drafts_[at(p)];
      candidates.clear();
      for (int c = parent.first_child; c >= 0; c = drafts_[at(c)].next_sibling)
        candidates.emplace_back(-saving(drafts_[at(c)], parent), c);
      std::sort(candidates.begin(), candidates.end());
      for (const auto& [unused, c] : candidates)
        if (saving(drafts_[at(c)], parent) > 0.0) take_in(drafts_[at(c)], parent);
      // Children that were taken in leave their own children behind.
      int head = -1;
      std::vector<int>& kept = scratch_;
      kept.clear();
      for (int c = parent.first_child; c >= 0; c = drafts_[at(c)].next_sibling) {
        if (!drafts_[at(c)].merged) kept.push_back(c);
        else
          for (int g = drafts_[at(c)].first_child; g >= 0; g = drafts_[at(g)].next_sibling) kept.push_back(g);
      }
      for (auto c = kept.rbegin(); c != kept.rend(); ++c) {
        drafts_[at(*c)].parent = p;
        drafts_[at(*c)].next_sibling = head;
        head = *c;
      }
      parent.first_child = head;
    }
  }

  void take_in(Draft& child, Draft& parent) {
    next_block_[at(child.last_block)] = parent.first_block;
    parent.first_block = child.first_block;
    parent.columns += child.columns;
    child.merged = true;
  }

  // Supernodes in postorder; blocks and rows numbered along.
  void renumber_by_supernodes() {
    std::vector<int> order, stack, child(drafts_.size());
    for (std::size_t d = 0; d < drafts_.size(); ++d) child[d] = drafts_[d].first_child;
    order.reserve(at(n_));
    for (int root = 0; root < static_cast<int>(drafts_.size()); ++root) {
      if (drafts_[at(root)].parent >= 0 || drafts_[at(root)].merged) continue;
      stack.push_back(root);
      while (!stack.empty()) {
        const int d = stack.back();
        if (const int c = child[at(d)]; c >= 0) {
          child[at(d)] = drafts_[at(c)].next_sibling;
          stack.push_back(c);
          continue;
        }
        stack.pop_back();
        for (int b = drafts_[at(d)].first_block; b >= 0; b = next_block_[at(b)]) {
          order.push_back(order_[at(b)]);
          if (b == drafts_[at(d)].last_block) break;
        }
        Supernode node;
        node.columns = drafts_[at(d)].columns;
        solver_.supernodes_.push_back(node);
        blocks_end_.push_back(static_cast<int>(order.size()));
      }
    }
    number(std::move(order));
    int row = 0;
    solver_.position_.resize(at(n_));
    solver_.supernode_of_.resize(at(n_));
    for (int p = 0, s = 0; p < n_; ++p) {
      while (blocks_end_[at(s)] <= p) ++s;
      const int block = order_[at(p)];
      solver_.position_[at(block)] = row;
      solver_.supernode_of_[at(block)] = s;
      for (int r = 0; r < block_rows(p); ++r) solver_.block_of_row_.push_back(block);
      row += block_rows(p);
    }
  }

  // The rows of every front: what its own blocks see above them and what its children hand up.
  void fronts() {
    const int count = static_cast<int>(solver_.supernodes_.size());
    std::vector<std::vector<int>> below(at(count));  // positions of blocks, sorted; freed once the parent has read them
    solver_.last_child_.assign(at(count), -1);
    solver_.previous_sibling_.assign(at(count), -1);
    std::vector<int> mark(at(n_), -1), where(at(n_), 0);
    std::vector<std::vector<Run>> runs(at(count));
    std::size_t entries = 0;
    int row = 0;
    for (int s = 0, begin = 0; s < count; begin = blocks_end_[at(s)], ++s) {
      Supernode& node = solver_.supernodes_[at(s)];
      const int end = blocks_end_[at(s)];
      std::vector<int>& rows = below[at(s)];
      const auto see = [&](int p) {
        if (p < end || mark[at(p)] == s) return;
        mark[at(p)] = s;
        rows.push_back(p);
      };
      for (int p = begin; p < end; ++p) std::for_each(upper_.first(p), upper_.last(p), see);
      for (int c = solver_.last_child_[at(s)]; c >= 0; c = solver_.previous_sibling_[at(c)])
        std::for_each(below[at(c)].begin(), below[at(c)].end(), see);
      std::sort(rows.begin(), rows.end());

      int local = 0;
      for (int p = begin; p < end; ++p) {
        where[at(p)] = local;
        local += block_rows(p);
      }
      for (const int p : rows) {
        where[at(p)] = local;
        local += block_rows(p);
      }
      node.first = row;
      row += node.columns;
      node.rows = local;
      node.ld = dense::padded(local);
      node.ld_update = dense::padded(local - node.columns);
      node.panel = entries;
      entries += at(node.ld) * at(node.columns);
      add_entries(node, begin, end, where);
      for (int c = solver_.last_child_[at(s)]; c >= 0; c = solver_.previous_sibling_[at(c)]) {
        runs[at(c)] = runs_into(below[at(c)], where);
        below[at(c)] = {};
      }
      node.row_runs_begin = solver_.row_runs_.size();
      for (const int p : rows)
        add_run(solver_.row_runs_, node.row_runs_begin, where[at(p)], global_row(p), block_rows(p));
      if (!rows.empty()) {
        node.parent = solver_.supernode_of_[at(order_[at(rows.front())])];
        solver_.previous_sibling_[at(s)] = solver_.last_child_[at(node.parent)];
        solver_.last_child_[at(node.parent)] = s;
      }
    }
    for (int s = 0; s < count; ++s) {
      solver_.supernodes_[at(s)].runs_begin = solver_.runs_.size();
      solver_.runs_.insert(solver_.runs_.end(), runs[at(s)].begin(), runs[at(s)].end());
    }
    for (int s = count - 1; s >= 0; --s) {
      Supernode& node = solver_.supernodes_[at(s)];
      if (node.parent >= 0) node.depth = solver_.supernodes_[at(node.parent)].depth + 1;
    }
    Supernode end;
    end.first = row;
    end.panel = entries;
    end.entries_begin = solver_.entries_.size();
    end.runs_begin = solver_.runs_.size();
    end.row_runs_begin = solver_.row_runs_.size();
    solver_.supernodes_.push_back(end);
  }

  int global_row(int position) const { return solver_.position_[at(order_[at(position)])]; }

  static void add_run(std::vector<Run>& runs, std::size_t begin, int source, int target, int length) {
    if (runs.size() > begin && runs.back().source + runs.back().length == source &&
        runs.back().target + runs.back().length == target)
      runs.back().length += length;
    else runs.push_back({source, target, length});
  }

  // A run may not cross from the columns of the parent into its update, which lies elsewhere.
  std::vector<Run> runs_into(const std::vector<int>& below, const std::vector<int>& where) const {
    std::vector<Run> runs;
    const int parent_end = below.empty() ? 0 : blocks_end_[at(solver_.supernode_of_[at(order_[at(below.front())])])];
    int source = 0;
    std::size_t begin = 0;
    for (const int p : below) {
      if (p >= parent_end && begin == 0) begin = runs.size();
      add_run(runs, begin, source, where[at(p)], block_rows(p));
      source += block_rows(p);
    }
    return runs;
  }

  void add_entries(Supernode& node, int begin, int end, const std::vector<int>& where) {
    node.entries_begin = solver_.entries_.size();
    std::vector<int>& column = scratch_;
    for (int p = begin; p < end; ++p) {
      const std::size_t base = node.panel + at(where[at(p)]) * at(node.ld);
      const int size = block_rows(p);
      add_entry(order_[at(p)], order_[at(p)], {values_, base + at(where[at(p)]), size, size, true});
      column.assign(upper_.first(p), upper_.last(p));
      std::sort(column.begin(), column.end());
      column.erase(std::unique(column.begin(), column.end()), column.end());
      for (const int q : column)
        add_entry(order_[at(q)], order_[at(p)], {values_, base + at(where[at(q)]), block_rows(q), size, false});
    }
  }

  void add_entry(int row_block, int column_block, const Entry& entry) {
    solver_.entries_.push_back(entry);
    blocks_of_entry_.emplace_back(row_block, column_block);
    values_ += at(entry.rows) * at(entry.columns);
  }

  // Entries in the order of slot(): by the larger block number, then the smaller.
  void slots() {
    std::vector<int>& starts = solver_.row_starts_;
    starts.assign(at(n_) + 1, 0);
    for (const auto& [i, j] : blocks_of_entry_) ++starts[at(std::max(i, j)) + 1];
    for (int i = 0; i < n_; ++i) starts[at(i) + 1] += starts[at(i)];
    // A pass by the smaller number first leaves every row sorted.
    std::vector<int> by_smaller(at(n_) + 1, 0), sorted(blocks_of_entry_.size());
    for (const auto& [i, j] : blocks_of_entry_) ++by_smaller[at(std::min(i, j)) + 1];
    for (int i = 0; i < n_; ++i) by_smaller[at(i) + 1] += by_smaller[at(i)];
    for (std::size_t e = 0; e < blocks_of_entry_.size(); ++e) {
      const auto& [i, j] = blocks_of_entry_[e];
      sorted[at(by_smaller[at(std::min(i, j))]++)] = static_cast<int>(e);
    }
    std::vector<int> next(starts.begin(), starts.end() - 1);
    solver_.row_blocks_.resize(blocks_of_entry_.size());
    solver_.row_slots_.resize(blocks_of_entry_.size());
    for (const int e : sorted) {
      const auto& [i, j] = blocks_of_entry_[at(e)];
      const std::size_t to = at(next[at(std::max(i, j))]++);
      solver_.row_blocks_[to] = std::min(i, j);
      solver_.row_slots_[to] = {solver_.entries_[at(e)].values, i < j};
    }
  }

  void memory() {
    const std::size_t count = solver_.supernodes_.size() - 1;
    std::array<std::size_t, 2> top{}, most{};
    std::vector<std::size_t> inverse(count, 0);
    FactorSize& size = solver_.factor_size_;
    int widest = 0;
    for (std::size_t s = 0; s < count; ++s) {
      const Supernode& node = solver_.supernodes_[s];
      const std::size_t side = static_cast<std::size_t>(node.depth & 1);
      const double below = node.rows - node.columns, columns = node.columns;
      size.flops += columns * (columns * columns / 3.0 + columns * below + below * below);
      widest = std::max(widest, node.columns);
      solver_.inverse_scratch_ = std::max(solver_.inverse_scratch_, 3 * at(node.ld) * at(dense::padded(node.columns)));
      top[side] += update_size(node);
      most[side] = std::max(most[side], top[side]);
      // What the children of this node have left is taken off when it is done.
      for (int c = solver_.last_child_[s]; c >= 0; c = solver_.previous_sibling_[at(c)])
        top[1 - side] -= update_size(solver_.supernodes_[at(c)]);
    }
    for (std::size_t s = count; s-- > 0;) {
      const Supernode& node = solver_.supernodes_[s];
      inverse[s] = at(node.ld) * at(node.rows) + 4 + (node.parent >= 0 ? inverse[at(node.parent)] : 0);
      solver_.inverse_stack_ = std::max(solver_.inverse_stack_, inverse[s]);
    }
    for (std::size_t side = 0; side < 2; ++side) solver_.updates_[side].assign(most[side] + 8, 0.0);
    solver_.values_.assign(values_, 0.0);
    solver_.factor_.assign(solver_.supernodes_.back().panel + 8, 0.0);
    solver_.smallest_pivot_.assign(at(widest), 0.0);
    solver_.work_.assign(at(solver_.size_), 0.0);
    solver_.scratch_.assign(at(solver_.size_) + 8, 0.0);
    size.supernodes = count;
    size.entries = solver_.supernodes_.back().panel;
    size.bytes = 8 * (values_ + solver_.factor_.size() + solver_.updates_[0].size() + solver_.updates_[1].size()) +
                 sizeof(Entry) * solver_.entries_.size() +
                 sizeof(Run) * (solver_.runs_.size() + solver_.row_runs_.size()) + sizeof(Supernode) * count +
                 (sizeof(Slot) + 4) * solver_.row_slots_.size();
  }

  static std::size_t update_size(const Supernode& node) { return at(node.ld_update) * at(node.rows - node.columns); }

  BlockCholesky& solver_;
  const BlockPattern& pattern_;
  int n_;
  std::vector<int> order_;  ///< block at each position
  Lists upper_, lower_;     ///< neighbours at later and at earlier positions
  std::vector<int> parent_;
  std::vector<Draft> drafts_;
  std::vector<int> draft_of_, next_block_, blocks_end_, scratch_;
  std::vector<std::pair<int, int>> blocks_of_entry_;  ///< (row, column) blocks
  std::size_t values_ = 0;
};

BlockCholesky::BlockCholesky(const BlockPattern& pattern) : sizes_(pattern.sizes()) {
  offsets_.reserve(sizes_.size() + 1);
  square_offsets_.reserve(sizes_.size() + 1);
  std::size_t square = 0;
  for (const int size : sizes_) {
    offsets_.push_back(size_);
    square_offsets_.push_back(square);
    size_ += size;
    square += at(size) * at(size);
  }
  offsets_.push_back(size_);
  square_offsets_.push_back(square);
  Analysis analysis(*this, pattern);
  analysis.run();
}

// Where (i, j) stands in row_blocks_, null if it does not.
const int* BlockCholesky::find(int i, int j) const {
  const int row = std::max(i, j), column = std::min(i, j);
  const int *begin = row_blocks_.data() + row_starts_[index(row)], *end = row_blocks_.data() + row_starts_[index(row) + 1];
  const int* found = std::lower_bound(begin, end, column);
  return found != end && *found == column ? found : nullptr;
}

bool BlockCholesky::in_pattern(int i, int j) const { return find(i, j) != nullptr; }

BlockCholesky::Slot BlockCholesky::slot(int i, int j) const {
  Slot slot = row_slots_[static_cast<std::size_t>(find(i, j) - row_blocks_.data())];
  // row_slots_ is for (larger, smaller): asked the other way round, the block is the other way round, too.
  if (i < j) slot.transposed = !slot.transposed;
  return slot;
}

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
