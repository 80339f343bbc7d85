// The symbolic part: from the pattern to the fronts, and to where each block lives.
#include <convoy/solver/block_cholesky.hpp>
#include <convoy/solver/block_ordering.hpp>
#include <convoy/solver/dense_kernels.hpp>
#include <convoy/solver/front_cost.hpp>
#include <convoy/solver/index.hpp>

#include <algorithm>
#include <cstring>
#include <numeric>

namespace convoy {
namespace {

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
  const int *begin = row_blocks_.data() + row_starts_[index(row)],
            *end = row_blocks_.data() + row_starts_[index(row) + 1];
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

}  // namespace convoy
