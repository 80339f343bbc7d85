#include <convoy/solver/block_ordering.hpp>
#include <convoy/solver/dense_kernels.hpp>
#include <convoy/solver/front_cost.hpp>
#include <convoy/solver/front_tree.hpp>

#include <algorithm>
#include <cmath>

namespace convoy {

// ---- changes

int FrontTree::add_unknown(int size) {
  if (at(size) >= free_unknowns_.size()) free_unknowns_.resize(at(size) + 1);
  std::vector<int>& free = free_unknowns_[at(size)];
  int u = static_cast<int>(unknowns_.size());
  if (free.empty()) {
    unknowns_.push_back({size, x_.size(), -1, false, {}});
    x_.resize(x_.size() + at(size));
    where_.push_back(0);
    stamp_.push_back(-1);
    moved_at_.push_back(-1);
  } else {
    u = free.back();
    free.pop_back();
    unknowns_[at(u)].size = size;
  }
  reset(u);
  joining_.push_back(u);
  return u;
}

void FrontTree::remove_unknown(int u) {
  unknowns_[at(u)].leaving = true;
  leaving_.push_back(u);
  restructured_ = true;
  if (contains(u)) mark_path(unknowns_[at(u)].node, Mark::rebuild);
}

int FrontTree::add_term(LinearTerm term) {
  int t = static_cast<int>(terms_.size());
  if (free_terms_.empty()) {
    terms_.emplace_back();
    node_of_term_.push_back(-1);
  } else {
    t = free_terms_.back();
    free_terms_.pop_back();
  }
  terms_[at(t)] = std::move(term);
  restructured_ = true;
  for (const int u : terms_[at(t)].unknowns) {
    unknowns_[at(u)].terms.push_back(t);
    if (contains(u)) mark_path(unknowns_[at(u)].node, Mark::rebuild);
  }
  return t;
}

void FrontTree::change_term(int t, LinearTerm value) {
  terms_[at(t)] = std::move(value);
  if (node_of_term_[at(t)] >= 0) mark_path(node_of_term_[at(t)], Mark::refactor);
}

void FrontTree::remove_term(int t) {
  restructured_ = true;
  for (const int u : terms_[at(t)].unknowns) std::erase(unknowns_[at(u)].terms, t);
  if (const int n = node_of_term_[at(t)]; n >= 0) {
    mark_path(n, Mark::rebuild);
    std::erase(nodes_[at(n)].terms, t);
  }
  node_of_term_[at(t)] = -1;
  terms_[at(t)] = {};
  free_terms_.push_back(t);
}

void FrontTree::reset(int u) {
  std::fill_n(x_.begin() + static_cast<std::ptrdiff_t>(unknowns_[at(u)].offset), unknowns_[at(u)].size, 0.0);
}

Eigen::Map<const Eigen::VectorXd> FrontTree::solution(int u) const {
  return {x_.data() + unknowns_[at(u)].offset, unknowns_[at(u)].size};
}

// Marks are closed upwards: what is above a marked node is marked at least as strongly.
void FrontTree::mark_path(int n, Mark mark) {
  for (; n >= 0 && nodes_[at(n)].mark < mark; n = nodes_[at(n)].parent) nodes_[at(n)].mark = mark;
}

void FrontTree::mark_all() {
  std::vector<int> stack = roots_;
  while (!stack.empty()) {
    Node& node = nodes_[at(stack.back())];
    stack.pop_back();
    node.mark = Mark::rebuild;
    stack.insert(stack.end(), node.children.begin(), node.children.end());
  }
}

// ---- an update

FrontTree::Report FrontTree::update(std::span<const int> last, double propagate) {
  ++update_serial_;
  report_ = {};
  moved_.clear();
  if (broken_) mark_all();
  collect_marked();
  broken_ = !factor_anew(last);
  report_.failed = broken_;
  if (!broken_) back_substitute(propagate);
  return report_;
}

void FrontTree::collect_marked() {
  marked_.clear();
  std::vector<int> stack = roots_;
  while (!stack.empty()) {
    const int n = stack.back();
    stack.pop_back();
    if (nodes_[at(n)].mark == Mark::keep) continue;
    marked_.push_back(n);
    stack.insert(stack.end(), nodes_[at(n)].children.begin(), nodes_[at(n)].children.end());
  }
}

bool FrontTree::factor_anew(std::span<const int> last) {
  for (auto n = marked_.rbegin(); n != marked_.rend(); ++n)  // children before parents
    if (nodes_[at(*n)].mark == Mark::refactor && !factor(*n)) return false;
  return (!restructured_ && !broken_) || rebuild_top(last);
}

bool FrontTree::rebuild_top(std::span<const int> last) {
  std::vector<int> top, orphans;
  take_apart(top, orphans);
  for (const int u : joining_)
    if (!unknowns_[at(u)].leaving) top.push_back(u);
  joining_.clear();
  for (const int u : leaving_) {
    unknowns_[at(u)].leaving = false;
    free_unknowns_[at(unknowns_[at(u)].size)].push_back(u);
  }
  leaving_.clear();
  std::sort(top.begin(), top.end());
  const std::vector<int> built = build(order(top, orphans, last), orphans);
  restructured_ = false;
  bool ok = true;
  for (const int n : built) {
    nodes_[at(n)].mark = Mark::rebuild;
    ok = ok && factor(n);
  }
  return ok;
}

// The nodes to be rebuilt are dissolved. `top`: their unknowns; `orphans`: what hung below.
void FrontTree::take_apart(std::vector<int>& top, std::vector<int>& orphans) {
  for (const int n : marked_) {
    Node& node = nodes_[at(n)];
    if (node.mark != Mark::rebuild) continue;
    for (int k = 0; k < node.own; ++k) {
      Unknown& unknown = unknowns_[at(node.unknowns[at(k)])];
      unknown.node = -1;
      if (!unknown.leaving) top.push_back(node.unknowns[at(k)]);
    }
    for (const int t : node.terms) node_of_term_[at(t)] = -1;
    for (const int c : node.children) {
      if (nodes_[at(c)].mark == Mark::rebuild) continue;
      orphans.push_back(c);
      nodes_[at(c)].parent = -1;
    }
    if (node.parent < 0) std::erase(roots_, n);
    node = {};
    free_nodes_.push_back(n);
  }
}

// Unknowns of the top in elimination order.
std::vector<int> FrontTree::order(const std::vector<int>& top, const std::vector<int>& orphans,
                                  std::span<const int> last) {
  ++serial_;
  std::vector<int> first, held_back;
  for (const int u : top) (std::find(last.begin(), last.end(), u) == last.end() ? first : held_back).push_back(u);
  std::vector<int> sizes;
  for (const int u : first) {
    where_[at(u)] = static_cast<int>(sizes.size());
    stamp_[at(u)] = serial_;
    sizes.push_back(unknowns_[at(u)].size);
  }
  BlockPattern pattern(std::move(sizes));
  const auto sees = [&](int u, int v) {
    if (stamp_[at(v)] == serial_ && where_[at(v)] < where_[at(u)]) pattern.add(where_[at(u)], where_[at(v)]);
  };
  for (const int u : first)
    for (const int t : unknowns_[at(u)].terms)
      for (const int v : terms_[at(t)].unknowns) sees(u, v);
  for (const int o : orphans) {
    const Node& orphan = nodes_[at(o)];
    for (auto u = orphan.unknowns.begin() + orphan.own; u != orphan.unknowns.end(); ++u)
      if (stamp_[at(*u)] == serial_)
        for (auto v = orphan.unknowns.begin() + orphan.own; v != orphan.unknowns.end(); ++v) sees(*u, *v);
  }
  std::vector<int> order;
  for (const int i : minimum_degree_order(pattern)) order.push_back(first[at(i)]);
  order.insert(order.end(), held_back.begin(), held_back.end());
  return order;
}

// Symbolic elimination of the top; nodes in an order with children first.
std::vector<int> FrontTree::build(const std::vector<int>& order, const std::vector<int>& orphans) {
  const int n = static_cast<int>(order.size());
  ++serial_;
  for (int i = 0; i < n; ++i) {
    where_[at(order[at(i)])] = i;
    stamp_[at(order[at(i)])] = serial_;
  }
  // Columns: what each unknown sees later in the order.
  std::vector<std::vector<int>> later(at(n)), children(at(n)), hung(at(n)), terms(at(n));
  std::vector<int> mark(at(n), -1);
  std::vector<double> separator(at(n), 0.0);
  for (const int o : orphans) {
    const Node& orphan = nodes_[at(o)];
    int first = n;
    for (auto u = orphan.unknowns.begin() + orphan.own; u != orphan.unknowns.end(); ++u)
      first = std::min(first, where_[at(*u)]);
    hung[at(first)].push_back(o);
  }
  for (int i = 0; i < n; ++i) {
    const auto see = [&](int j) {
      if (j <= i || mark[at(j)] == i) return;
      mark[at(j)] = i;
      later[at(i)].push_back(j);
      separator[at(i)] += unknowns_[at(order[at(j)])].size;
    };
    for (const int t : unknowns_[at(order[at(i)])].terms) {
      if (node_of_term_[at(t)] == -1) {
        node_of_term_[at(t)] = -2;  // spoken for
        terms[at(i)].push_back(t);
      }
      for (const int u : terms_[at(t)].unknowns)
        if (stamp_[at(u)] == serial_) see(where_[at(u)]);
    }
    for (const int o : hung[at(i)]) {
      const Node& orphan = nodes_[at(o)];
      for (auto u = orphan.unknowns.begin() + orphan.own; u != orphan.unknowns.end(); ++u) see(where_[at(*u)]);
    }
    for (const int c : children[at(i)]) std::for_each(later[at(c)].begin(), later[at(c)].end(), see);
    std::sort(later[at(i)].begin(), later[at(i)].end());
    if (!later[at(i)].empty()) children[at(later[at(i)].front())].push_back(i);
  }
  // From the leaves up, each column takes in children that are cheaper inside than as fronts of their own.
  std::vector<int> owner(at(n));
  std::vector<std::vector<int>> own(at(n)), below(at(n));
  std::vector<double> columns(at(n));
  for (int i = 0; i < n; ++i) {
    owner[at(i)] = i;
    own[at(i)] = {i};
    columns[at(i)] = unknowns_[at(order[at(i)])].size;
    for (const int c : children[at(i)]) {
      const double mine = columns[at(i)], its = columns[at(c)];
      const double saving = front_cost(its, its + separator[at(c)]) + front_cost(mine, mine + separator[at(i)]) -
                            front_cost(mine + its, mine + its + separator[at(i)]);
      if (saving <= 0.0) {
        below[at(i)].push_back(c);
        continue;
      }
      own[at(i)].insert(own[at(i)].end(), own[at(c)].begin(), own[at(c)].end());
      columns[at(i)] += its;
      owner[at(c)] = i;
      below[at(i)].insert(below[at(i)].end(), below[at(c)].begin(), below[at(c)].end());
    }
  }
  std::vector<int> built, node_at(at(n), -1);
  for (int i = 0; i < n; ++i) {
    if (owner[at(i)] != i) continue;
    const int index = new_node();
    node_at[at(i)] = index;
    Node& node = nodes_[at(index)];
    std::sort(own[at(i)].begin(), own[at(i)].end());
    node.own = static_cast<int>(own[at(i)].size());
    for (const int j : own[at(i)]) {
      node.unknowns.push_back(order[at(j)]);
      unknowns_[at(order[at(j)])].node = index;
      for (const int t : terms[at(j)]) node_of_term_[at(t)] = index;
      node.terms.insert(node.terms.end(), terms[at(j)].begin(), terms[at(j)].end());
      for (const int o : hung[at(j)]) {
        node.children.push_back(o);
        nodes_[at(o)].parent = index;
      }
    }
    for (const int j : later[at(i)]) node.unknowns.push_back(order[at(j)]);
    for (const int c : below[at(i)]) {
      node.children.push_back(node_at[at(c)]);
      nodes_[at(node_at[at(c)])].parent = index;
    }
    if (later[at(i)].empty()) roots_.push_back(index);
    built.push_back(index);
  }
  return built;
}

int FrontTree::new_node() {
  if (free_nodes_.empty()) {
    nodes_.emplace_back();
    return static_cast<int>(nodes_.size()) - 1;
  }
  const int n = free_nodes_.back();
  free_nodes_.pop_back();
  return n;
}

// ---- one front

namespace {

// Column `c` of a front, so that [row] is its row.
template <class Front>
double* column_of(Front& front, int c) {
  return c < front.columns ? front.panel.data() + std::ptrdiff_t(c) * front.ld
                           : front.update.data() + std::ptrdiff_t(c - front.columns) * front.ld_update - front.columns;
}

}  // namespace

// Assembles and factors: its terms, what its children hand up, and the right-hand side as a last row.
bool FrontTree::factor(int n) {
  Node& node = nodes_[at(n)];
  ++report_.fronts;
  auto front = std::make_shared<Front>();
  front->unknowns = node.unknowns;
  front->own = node.own;
  for (std::size_t k = 0; k < node.unknowns.size(); ++k) {
    where_[at(node.unknowns[k])] = front->rows;
    front->rows += unknowns_[at(node.unknowns[k])].size;
    if (static_cast<int>(k) + 1 == node.own) front->columns = front->rows;
  }
  ++front->rows;
  const int below = front->rows - front->columns;
  front->ld = dense::padded(front->rows);
  front->ld_update = dense::padded(below);
  front->panel.assign(at(front->ld) * at(front->columns) + dense::kRowPad, 0.0);
  front->update.assign(at(front->ld_update) * at(below) + dense::kRowPad, 0.0);
  for (const int t : node.terms) add_term_to(*front, terms_[at(t)]);
  for (const int c : node.children) add_child_to(*front, *nodes_[at(c)].front);
  column_.resize(at(front->columns));
  for (int c = 0; c < front->columns; ++c)
    column_[at(c)] = pivot_tolerance_ * std::max(0.0, front->panel[at(c) * at(front->ld) + at(c)]);
  const bool ok = dense::factor_front(front->panel.data(), front->ld, front->rows, front->columns, front->update.data(),
                                      front->ld_update, column_.data()) < 0;
  node.front = std::move(front);
  return ok;
}

void FrontTree::add_term_to(Front& front, const LinearTerm& term) const {
  Eigen::Index from_column = 0;
  for (const int v : term.unknowns) {
    const int columns = unknowns_[at(v)].size, to_column = where_[at(v)];
    Eigen::Index from_row = 0;
    for (const int u : term.unknowns) {
      const int rows = unknowns_[at(u)].size, to_row = where_[at(u)];
      if (to_row >= to_column)
        for (int c = 0; c < columns; ++c) {
          double* to = column_of(front, to_column + c) + to_row;
          for (int r = 0; r < rows; ++r)
            to[r] +=
                from_row >= from_column ? term.H(from_row + r, from_column + c) : term.H(from_column + c, from_row + r);
        }
      from_row += rows;
    }
    for (int c = 0; c < columns; ++c) column_of(front, to_column + c)[front.rows - 1] += term.b[from_column + c];
    from_column += columns;
  }
}

void FrontTree::add_child_to(Front& front, const Front& child) {
  rows_.clear();  // of the front, by row of the child's update
  for (auto u = child.unknowns.begin() + child.own; u != child.unknowns.end(); ++u)
    for (int k = 0; k < unknowns_[at(*u)].size; ++k) rows_.push_back(where_[at(*u)] + k);
  rows_.push_back(front.rows - 1);
  const int n = static_cast<int>(rows_.size());
  const bool in_order = std::is_sorted(rows_.begin(), rows_.end());
  for (int j = 0; j + 1 < n; ++j) {
    const double* from = child.update.data() + std::ptrdiff_t(j) * child.ld_update;
    if (!in_order) {
      for (int i = j; i < n; ++i) {
        const auto [column, row] = std::minmax(rows_[at(j)], rows_[at(i)]);
        column_of(front, column)[row] += from[i];
      }
      continue;
    }
    double* to = column_of(front, rows_[at(j)]);
    for (int i = j; i < n;) {  // runs of rows that lie together in both
      int end = i + 1;
      while (end < n && rows_[at(end)] == rows_[at(i)] + end - i) ++end;
      dense::add_to(to + rows_[at(i)], from + i, end - i);
      i = end;
    }
  }
}

// ---- solving

void FrontTree::back_substitute(double propagate) {
  std::vector<int> stack = roots_;
  while (!stack.empty()) {
    Node& node = nodes_[at(stack.back())];
    stack.pop_back();
    const bool touched = node.mark != Mark::keep;
    if (!touched && std::none_of(node.unknowns.begin() + node.own, node.unknowns.end(),
                                 [&](int u) { return moved_at_[at(u)] == update_serial_; }))
      continue;
    node.mark = Mark::keep;
    solve(*node.front, propagate);
    stack.insert(stack.end(), node.children.begin(), node.children.end());
  }
}

// Of the unknowns of a front from those of its separator.
void FrontTree::solve(const Front& front, double propagate) {
  const int rows = front.rows - 1;
  std::vector<double>& x = column_;
  x.resize(at(rows));
  int row = front.columns;
  for (std::size_t k = at(front.own); k < front.unknowns.size(); ++k) {
    const Unknown& u = unknowns_[at(front.unknowns[k])];
    std::copy_n(x_.data() + u.offset, u.size, x.data() + row);
    row += u.size;
  }
  for (int c = front.columns - 1; c >= 0; --c) {
    const double* L = front.panel.data() + std::ptrdiff_t(c) * front.ld;
    x[at(c)] = (L[rows] - dense::dot(L + c + 1, x.data() + c + 1, rows - c - 1)) / L[c];
  }
  row = 0;
  for (int k = 0; k < front.own; ++k) {
    const int index = front.unknowns[at(k)];
    const Unknown& u = unknowns_[at(index)];
    double* old = x_.data() + u.offset;
    double change = 0.0;
    for (int i = 0; i < u.size; ++i) change = std::max(change, std::abs(x[at(row + i)] - old[i]));
    if (!(change < propagate)) {
      std::copy_n(x.data() + row, u.size, old);
      moved_at_[at(index)] = update_serial_;
      moved_.push_back(index);
    }
    row += u.size;
  }
}

// ---- covariances

std::shared_ptr<const FactoredTree> FrontTree::factored() const {
  auto tree = std::make_shared<FactoredTree>();
  for (const Node& node : nodes_) {
    tree->fronts_.push_back(node.front);
    tree->parents_.push_back(node.parent);
  }
  for (const Unknown& u : unknowns_) {
    tree->front_of_.push_back(u.node);
    tree->sizes_.push_back(u.size);
  }
  tree->row_of_.resize(unknowns_.size());
  return tree;
}

// H^-1 = L^-T L^-1, so a block of it is the product of two half-solved columns, which live on their paths alone.
FactoredTree::Path FactoredTree::half_solved(int unknown) const {
  const auto at = [](int i) { return static_cast<std::size_t>(i); };
  Path path;
  Eigen::MatrixXd handed_up;  // rows of the separator of the front before
  const Front* before = nullptr;
  for (int f = front_of_[at(unknown)]; f >= 0; f = parents_[at(f)]) {
    const Front& front = *fronts_[at(f)];
    int row = 0;
    for (const int u : front.unknowns) {
      row_of_[at(u)] = row;
      row += size(u);
    }
    Eigen::MatrixXd x = Eigen::MatrixXd::Zero(front.rows - 1, size(unknown));
    if (before == nullptr) {
      x.middleRows(row_of_[at(unknown)], size(unknown)).setIdentity();
    } else {
      Eigen::Index from = 0;
      for (auto u = before->unknowns.begin() + before->own; u != before->unknowns.end(); ++u) {
        x.middleRows(row_of_[at(*u)], size(*u)) = handed_up.middleRows(from, size(*u));
        from += size(*u);
      }
    }
    for (Eigen::Index d = 0; d < x.cols(); ++d) {
      double* column = x.col(d).data();
      for (int c = 0; c < front.columns; ++c) {
        const double* L = front.panel.data() + std::ptrdiff_t(c) * front.ld;
        if (column[c] == 0.0) continue;  // before the unknown itself
        column[c] /= L[c];
        dense::add_scaled(column + c + 1, -column[c], L + c + 1, front.rows - 1 - c - 1);
      }
    }
    path.fronts.push_back(f);
    path.half.emplace_back(x.topRows(front.columns));
    handed_up = x.bottomRows(x.rows() - front.columns);
    before = &front;
  }
  return path;
}

Eigen::MatrixXd FactoredTree::product(const Path& a, const Path& b) {
  Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(a.half.front().cols(), b.half.front().cols());
  auto i = a.fronts.size(), j = b.fronts.size();
  while (i > 0 && j > 0 && a.fronts[i - 1] == b.fronts[j - 1]) {  // from the root down, while they are the same
    --i;
    --j;
    sum += a.half[i].transpose() * b.half[j];
  }
  return sum;
}

const FactoredTree::Path& FactoredTree::path_of(int unknown) const {
  const auto [it, fresh] = paths_.try_emplace(unknown);
  if (fresh) it->second = half_solved(unknown);
  return it->second;
}

Eigen::MatrixXd FactoredTree::covariance(int i, int j) const {
  const Path& a = path_of(i);
  return product(a, path_of(j));
}

Eigen::MatrixXd FactoredTree::joint_covariance(const std::vector<int>& unknowns) const {
  Eigen::Index rows = 0;
  for (const int u : unknowns) rows += size(u);
  Eigen::MatrixXd P(rows, rows);
  Eigen::Index row = 0;
  for (std::size_t i = 0; i < unknowns.size(); ++i) {
    Eigen::Index column = 0;
    for (std::size_t j = 0; j <= i; ++j) {
      const Eigen::MatrixXd block = covariance(unknowns[i], unknowns[j]);
      P.block(row, column, block.rows(), block.cols()) = block;
      P.block(column, row, block.cols(), block.rows()) = block.transpose();
      column += block.cols();
    }
    row += size(unknowns[i]);
  }
  return P;
}

}  // namespace convoy
