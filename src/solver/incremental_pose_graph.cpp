#include <convoy/geometry/groups.hpp>
#include <convoy/solver/block_ordering.hpp>
#include <convoy/solver/dense_kernels.hpp>
#include <convoy/solver/front_cost.hpp>
#include <convoy/solver/incremental_pose_graph.hpp>

#include <Eigen/LU>
#include <algorithm>

namespace convoy {
namespace {

std::size_t at(int i) { return static_cast<std::size_t>(i); }

}  // namespace

template <class G>
IncrementalPoseGraph<G>::IncrementalPoseGraph(const G& first, const IncrementalParams& params) : params_(params) {
  linearised_.push_back(first);
  step_.push_back(G::Tangent::Zero());
  front_of_.push_back(-1);
  factors_of_.emplace_back();
  where_.push_back(0);
  stamp_.push_back(-1);
  changed_.push_back(-1);
}

template <class G>
bool IncrementalPoseGraph<G>::valid(const PoseFactor<G>& f, int poses) const {
  return f.from >= 0 && f.to >= 0 && f.from < poses && f.to < poses && f.from != f.to;
}

template <class G>
int IncrementalPoseGraph<G>::append(const PoseFactor<G>& f) {
  const int index = static_cast<int>(factors_.size());
  factors_.push_back(f);
  linear_.emplace_back();
  factors_of_[at(f.from)].push_back(index);
  factors_of_[at(f.to)].push_back(index);
  return index;
}

template <class G>
bool IncrementalPoseGraph<G>::add(std::span<const PoseFactor<G>> factors) {
  const int k = size();
  if (factors.empty()) return false;
  for (const PoseFactor<G>& f : factors)
    if (!valid(f, k + 1) || (f.from != k && f.to != k)) return false;
  linearised_.emplace_back();
  step_.push_back(G::Tangent::Zero());
  front_of_.push_back(-1);
  factors_of_.emplace_back();
  where_.push_back(0);
  stamp_.push_back(-1);
  changed_.push_back(-1);
  waiting_.push_back(k);
  std::vector<int> added;
  for (const PoseFactor<G>& f : factors) added.push_back(append(f));
  place(k);
  last_ = {};
  const auto again = [&](int far) { return is_far(far, params_.again_factor); };
  if (factors.size() > 1) update(std::move(added));
  else if (std::any_of(far_.begin(), far_.end(), again)) update({});
  return true;
}

template <class G>
bool IncrementalPoseGraph<G>::add_factors(std::span<const PoseFactor<G>> factors) {
  for (const PoseFactor<G>& f : factors)
    if (!valid(f, size())) return false;
  std::vector<int> added;
  for (const PoseFactor<G>& f : factors) added.push_back(append(f));
  last_ = {};
  if (!added.empty() || !far_.empty() || broken_) update(std::move(added));
  return true;
}

template <class G>
G IncrementalPoseGraph<G>::pose(int k) const {
  return linearised_[at(k)] * G::Exp(step_[at(k)]);
}

template <class G>
std::vector<G> IncrementalPoseGraph<G>::poses() const {
  std::vector<G> result;
  for (int k = 0; k < size(); ++k) result.push_back(pose(k));
  return result;
}

template <class G>
bool IncrementalPoseGraph<G>::is_far(int k, double factor) const {
  const typename G::Tangent& d = step_[at(k)];
  return d.template head<G::Dim>().cwiseAbs().maxCoeff() > factor * params_.relinearise_m ||
         d.template tail<D - G::Dim>().cwiseAbs().maxCoeff() > factor * params_.relinearise_rad;
}

// The factor of a pose to the latest of those before it.
template <class G>
int IncrementalPoseGraph<G>::latest_factor(int k) const {
  int latest = -1, previous = -1;
  for (const int f : factors_of_[at(k)]) {
    const int other = factors_[at(f)].from == k ? factors_[at(f)].to : factors_[at(f)].from;
    if (other >= k || other <= previous) continue;
    previous = other;
    latest = f;
  }
  return latest;
}

// Where a pose outside the tree is: behind the one before it.
template <class G>
void IncrementalPoseGraph<G>::place(int k) {
  const PoseFactor<G>& f = factors_[at(latest_factor(k))];
  linearised_[at(k)] = f.to == k ? pose(f.from) * f.measured : pose(f.to) * f.measured.inverse();
}

// Marks are closed upwards: what is above a marked front is marked at least as strongly.
template <class G>
void IncrementalPoseGraph<G>::mark_path(int front, typename Front::Mark mark) {
  for (; front >= 0 && fronts_[at(front)].mark < mark; front = fronts_[at(front)].parent)
    fronts_[at(front)].mark = mark;
}

// Every front that a pose is in depends on where it is linearised: its own, and below it those with it in the
// separator.
template <class G>
void IncrementalPoseGraph<G>::mark_involved(int pose) {
  mark_path(front_of_[at(pose)], Front::Mark::refactor);
  std::vector<int> stack{front_of_[at(pose)]};
  while (!stack.empty()) {
    const int f = stack.back();
    stack.pop_back();
    for (const int c : fronts_[at(f)].children) {
      Front& child = fronts_[at(c)];
      if (std::find(child.poses.begin() + child.own, child.poses.end(), pose) == child.poses.end()) continue;
      mark_path(c, Front::Mark::refactor);
      stack.push_back(c);
    }
  }
}

template <class G>
void IncrementalPoseGraph<G>::relinearise() {
  std::vector<int> stale;
  for (const int k : far_) {
    linearised_[at(k)] = pose(k);
    step_[at(k)].setZero();
    stale.insert(stale.end(), factors_of_[at(k)].begin(), factors_of_[at(k)].end());
    mark_involved(k);
  }
  std::sort(stale.begin(), stale.end());
  stale.erase(std::unique(stale.begin(), stale.end()), stale.end());
  for (const int f : stale) {
    const PoseFactor<G>& factor = factors_[at(f)];
    linear_[at(f)].linearise(params_.residual, factor, linearised_[at(factor.from)], linearised_[at(factor.to)]);
  }
  last_.relinearised = static_cast<int>(far_.size());
  far_.clear();
}

template <class G>
void IncrementalPoseGraph<G>::update(std::vector<int> new_factors) {
  ++update_serial_;
  if (broken_) {
    rebuild_all();
    return;
  }
  relinearise();
  if (!new_factors.empty()) {
    join(new_factors);
    for (const int f : new_factors) {
      const PoseFactor<G>& factor = factors_[at(f)];
      linear_[at(f)].linearise(params_.residual, factor, linearised_[at(factor.from)], linearised_[at(factor.to)]);
      for (const int k : {factor.from, factor.to})
        if (front_of_[at(k)] >= 0) mark_path(front_of_[at(k)], Front::Mark::rebuild);
    }
  }
  if (!refactor_marked() || (!new_factors.empty() && !rebuild_top())) {
    broken_ = last_.failed = true;
    return;
  }
  back_substitute();
}

// What new factors speak of enters the tree, with everything it hangs on and the factors that it hangs by.
template <class G>
void IncrementalPoseGraph<G>::join(std::vector<int>& new_factors) {
  joining_.clear();
  for (std::size_t n = 0; n < new_factors.size(); ++n)  // grows on the way
    for (const int k : {factors_[at(new_factors[n])].from, factors_[at(new_factors[n])].to}) {
      if (k == 0 || front_of_[at(k)] >= 0 || std::find(joining_.begin(), joining_.end(), k) != joining_.end()) continue;
      joining_.push_back(k);
      const int f = latest_factor(k);
      if (std::find(new_factors.begin(), new_factors.end(), f) == new_factors.end()) new_factors.push_back(f);
    }
  std::erase_if(waiting_, [&](int k) { return std::find(joining_.begin(), joining_.end(), k) != joining_.end(); });
}

// Children before parents; what is to be rebuilt keeps its mark.
template <class G>
bool IncrementalPoseGraph<G>::refactor_marked() {
  marked_.clear();
  std::vector<int> stack = roots_;
  while (!stack.empty()) {
    const int f = stack.back();
    stack.pop_back();
    if (fronts_[at(f)].mark == Front::Mark::keep) continue;
    marked_.push_back(f);
    stack.insert(stack.end(), fronts_[at(f)].children.begin(), fronts_[at(f)].children.end());
  }
  for (auto f = marked_.rbegin(); f != marked_.rend(); ++f)
    if (fronts_[at(*f)].mark == Front::Mark::refactor && !factor(*f)) return false;
  return true;
}

// The fronts to be rebuilt are dissolved. `top`: their poses; `orphans`: what hung below.
template <class G>
void IncrementalPoseGraph<G>::take_apart(std::vector<int>& top, std::vector<int>& orphans) {
  for (const int f : marked_) {
    Front& front = fronts_[at(f)];
    if (front.mark != Front::Mark::rebuild) continue;
    for (int k = 0; k < front.own; ++k) {
      top.push_back(front.poses[at(k)]);
      front_of_[at(front.poses[at(k)])] = -1;
    }
    for (const int c : front.children)
      if (fronts_[at(c)].mark != Front::Mark::rebuild) {
        orphans.push_back(c);
        fronts_[at(c)].parent = -1;
      }
    front.children.clear();
    front.parent = -1;
    front.mark = Front::Mark::keep;
    free_.push_back(f);
    roots_.erase(std::remove(roots_.begin(), roots_.end(), f), roots_.end());
  }
  std::erase_if(marked_, [&](int f) { return fronts_[at(f)].mark == Front::Mark::keep; });
}

template <class G>
bool IncrementalPoseGraph<G>::rebuild_top() {
  std::vector<int> top, orphans;
  take_apart(top, orphans);
  top.insert(top.end(), joining_.begin(), joining_.end());
  std::sort(top.begin(), top.end());
  const std::vector<int> built = build_fronts(order_top(top, orphans), orphans);
  for (const int f : built) {
    if (!factor(f)) return false;
    marked_.push_back(f);
    fronts_[at(f)].mark = Front::Mark::rebuild;
  }
  return true;
}

// The poses of the top in elimination order, the newest last.
template <class G>
std::vector<int> IncrementalPoseGraph<G>::order_top(const std::vector<int>& top, const std::vector<int>& orphans) {
  ++serial_;
  const int n = static_cast<int>(top.size()) - 1;
  for (int i = 0; i < n; ++i) {
    where_[at(top[at(i)])] = i;
    stamp_[at(top[at(i)])] = serial_;
  }
  BlockPattern pattern(std::vector<int>(at(n), D));
  for (int i = 0; i < n; ++i)
    for (const int f : factors_of_[at(top[at(i)])]) {
      const int other = factors_[at(f)].from == top[at(i)] ? factors_[at(f)].to : factors_[at(f)].from;
      if (stamp_[at(other)] == serial_ && where_[at(other)] < i) pattern.add(i, where_[at(other)]);
    }
  for (const int o : orphans) {
    const Front& orphan = fronts_[at(o)];
    for (auto a = orphan.poses.begin() + orphan.own; a != orphan.poses.end(); ++a)
      for (auto b = orphan.poses.begin() + orphan.own; b != a; ++b)
        if (stamp_[at(*a)] == serial_ && stamp_[at(*b)] == serial_) pattern.add(where_[at(*a)], where_[at(*b)]);
  }
  std::vector<int> order;
  for (const int i : minimum_degree_order(pattern)) order.push_back(top[at(i)]);
  order.push_back(top.back());
  return order;
}

// Symbolic elimination of the top; fronts in an order with children first.
template <class G>
std::vector<int> IncrementalPoseGraph<G>::build_fronts(const std::vector<int>& order, const std::vector<int>& orphans) {
  const int n = static_cast<int>(order.size());
  ++serial_;
  for (int i = 0; i < n; ++i) {
    where_[at(order[at(i)])] = i;
    stamp_[at(order[at(i)])] = serial_;
  }
  // Columns: what each pose sees later in the order.
  std::vector<std::vector<int>> later(at(n)), children(at(n)), hung(at(n));
  std::vector<int> mark(at(n), -1), parent(at(n), -1);
  for (const int o : orphans) {
    const Front& orphan = fronts_[at(o)];
    int first = n;
    for (auto p = orphan.poses.begin() + orphan.own; p != orphan.poses.end(); ++p)
      first = std::min(first, where_[at(*p)]);
    hung[at(first)].push_back(o);
  }
  for (int i = 0; i < n; ++i) {
    const auto see = [&](int j) {
      if (j <= i || mark[at(j)] == i) return;
      mark[at(j)] = i;
      later[at(i)].push_back(j);
    };
    for (const int f : factors_of_[at(order[at(i)])])
      for (const int k : {factors_[at(f)].from, factors_[at(f)].to})
        if (stamp_[at(k)] == serial_) see(where_[at(k)]);
    for (const int o : hung[at(i)]) {
      const Front& orphan = fronts_[at(o)];
      for (auto p = orphan.poses.begin() + orphan.own; p != orphan.poses.end(); ++p) see(where_[at(*p)]);
    }
    for (const int c : children[at(i)]) std::for_each(later[at(c)].begin(), later[at(c)].end(), see);
    std::sort(later[at(i)].begin(), later[at(i)].end());
    if (later[at(i)].empty()) continue;
    parent[at(i)] = later[at(i)].front();
    children[at(parent[at(i)])].push_back(i);
  }
  // From the leaves up, each column takes in children that are cheaper inside than as fronts of their own.
  std::vector<int> owner(at(n));
  std::vector<std::vector<int>> own(at(n)), below(at(n));
  for (int i = 0; i < n; ++i) {
    owner[at(i)] = i;
    own[at(i)] = {i};
    std::vector<int>& kept = below[at(i)];
    const double separator = D * static_cast<double>(later[at(i)].size());
    for (const int c : children[at(i)]) {
      const double mine = D * static_cast<double>(own[at(i)].size()), its = D * static_cast<double>(own[at(c)].size());
      const double its_separator = D * static_cast<double>(later[at(c)].size());
      const double saving = front_cost(its, its + its_separator) + front_cost(mine, mine + separator) -
                            front_cost(mine + its, mine + its + separator);
      if (saving <= 0.0) {
        kept.push_back(c);
        continue;
      }
      own[at(i)].insert(own[at(i)].end(), own[at(c)].begin(), own[at(c)].end());
      owner[at(c)] = i;
      kept.insert(kept.end(), below[at(c)].begin(), below[at(c)].end());
    }
  }
  const auto find = [&](int i) {
    while (owner[at(i)] != i) i = owner[at(i)] = owner[at(owner[at(i)])];
    return i;
  };
  std::vector<int> built, front_at(at(n), -1);
  for (int i = 0; i < n; ++i) {
    if (owner[at(i)] != i) continue;
    const int f = new_front();
    front_at[at(i)] = f;
    Front& front = fronts_[at(f)];
    std::sort(own[at(i)].begin(), own[at(i)].end());
    front.own = static_cast<int>(own[at(i)].size());
    for (const int j : own[at(i)]) {
      front.poses.push_back(order[at(j)]);
      front_of_[at(order[at(j)])] = f;
      for (const int o : hung[at(j)]) {
        front.children.push_back(o);
        fronts_[at(o)].parent = f;
      }
    }
    for (const int j : later[at(i)]) front.poses.push_back(order[at(j)]);
    for (const int c : below[at(i)]) {
      front.children.push_back(front_at[at(find(c))]);
      fronts_[at(front.children.back())].parent = f;
    }
    if (later[at(i)].empty()) roots_.push_back(f);
    built.push_back(f);
  }
  return built;
}

template <class G>
int IncrementalPoseGraph<G>::new_front() {
  if (free_.empty()) {
    fronts_.emplace_back();
    return static_cast<int>(fronts_.size()) - 1;
  }
  const int f = free_.back();
  free_.pop_back();
  fronts_[at(f)].poses.clear();
  return f;
}

// Assembles and factors one front: its factors, what its children hand up, and the right-hand side as a last row.
template <class G>
bool IncrementalPoseGraph<G>::factor(int index) {
  Front& front = fronts_[at(index)];
  ++last_.fronts;
  ++serial_;
  const int poses = static_cast<int>(front.poses.size()), own = front.own;
  for (int i = 0; i < poses; ++i) {
    where_[at(front.poses[at(i)])] = i;
    stamp_[at(front.poses[at(i)])] = serial_;
  }
  const int rows = D * poses + 1, columns = D * own, below = rows - columns;
  front.ld = dense::padded(rows);
  front.ld_update = dense::padded(below);
  front.panel.assign(at(front.ld) * at(columns) + dense::kRowPad, 0.0);
  front.update.assign(at(front.ld_update) * at(below) + dense::kRowPad, 0.0);
  const auto column = [&](int i) {  // of pose i of the front, so that [row] is the row of the front
    return i < own ? front.panel.data() + std::ptrdiff_t(D * i) * front.ld
                   : front.update.data() + std::ptrdiff_t(D * (i - own)) * front.ld_update - columns;
  };
  const auto stride = [&](int i) { return i < own ? front.ld : front.ld_update; };
  using Block = typename G::Adjoint;
  using Target = Eigen::Map<Block, 0, Eigen::OuterStride<>>;
  const auto add = [&](int i, int j, const auto& block) {  // rows of pose i, columns of pose j
    if (i >= j) Target(column(j) + D * i, Eigen::OuterStride<>(stride(j))) += block;
    else Target(column(i) + D * j, Eigen::OuterStride<>(stride(i))) += block.transpose();
  };
  const auto add_rhs = [&](int i, const typename G::Tangent& b) {
    double* to = column(i) + D * poses;
    for (int c = 0; c < D; ++c) to[c * stride(i)] += b[c];
  };
  for (int i = 0; i < own; ++i) {
    const int pose = front.poses[at(i)];
    for (const int f : factors_of_[at(pose)]) {
      const PoseFactor<G>& factor = factors_[at(f)];
      const LinearPoseFactor<G>& linear = linear_[at(f)];
      const bool is_from = factor.from == pose;
      const int other = is_from ? factor.to : factor.from;
      if (other == 0) {
        add(i, i, is_from ? linear.H_from : linear.H_to);
        add_rhs(i, is_from ? linear.b_from : linear.b_to);
        continue;
      }
      // Eliminated below, or to be added with the other one, or not in the tree yet.
      if (stamp_[at(other)] != serial_ || (where_[at(other)] < own && !is_from)) continue;
      const int from = where_[at(factor.from)], to = where_[at(factor.to)];
      add(from, from, linear.H_from);
      add(to, to, linear.H_to);
      add(to, from, linear.H_to_from);
      add_rhs(from, linear.b_from);
      add_rhs(to, linear.b_to);
    }
  }
  for (const int c : front.children) {
    const Front& child = fronts_[at(c)];
    const int separator = static_cast<int>(child.poses.size()) - child.own;
    for (int j = 0; j < separator; ++j) {
      const int to_j = where_[at(child.poses[at(child.own + j)])];
      const double* from = child.update.data() + std::ptrdiff_t(D * j) * child.ld_update;
      for (int i = j; i < separator; ++i) {
        const int to_i = where_[at(child.poses[at(child.own + i)])];
        add(to_i, to_j,
            Eigen::Map<const Block, 0, Eigen::OuterStride<>>(from + D * i, Eigen::OuterStride<>(child.ld_update)));
      }
      typename G::Tangent b;
      for (int d = 0; d < D; ++d) b[d] = from[d * child.ld_update + D * separator];
      add_rhs(to_j, b);
    }
  }
  smallest_pivot_.resize(at(columns));
  for (int c = 0; c < columns; ++c)
    smallest_pivot_[at(c)] = 1e-14 * std::max(0.0, front.panel[at(c) * at(front.ld) + at(c)]);
  return dense::factor_front(front.panel.data(), front.ld, rows, columns, front.update.data(), front.ld_update,
                             smallest_pivot_.data()) < 0;
}

// Steps of the poses of a front from those of its separator.
template <class G>
void IncrementalPoseGraph<G>::solve_front(const Front& front) {
  const int poses = static_cast<int>(front.poses.size()), columns = D * front.own, below = D * (poses - front.own);
  std::vector<double>& x = smallest_pivot_;  // scratch: steps of the whole front
  x.resize(at(columns + below));
  for (int i = front.own; i < poses; ++i)
    Eigen::Map<typename G::Tangent>(x.data() + D * i) = step_[at(front.poses[at(i)])];
  for (int c = columns - 1; c >= 0; --c) {
    const double* L = front.panel.data() + std::ptrdiff_t(c) * front.ld;
    x[at(c)] = (L[columns + below] - dense::dot(L + c + 1, x.data() + c + 1, columns + below - c - 1)) / L[c];
  }
  for (int i = 0; i < front.own; ++i) {
    const int pose = front.poses[at(i)];
    const Eigen::Map<const typename G::Tangent> step(x.data() + D * i);
    if ((step - step_[at(pose)]).cwiseAbs().maxCoeff() < params_.propagate) continue;
    step_[at(pose)] = step;
    changed_[at(pose)] = update_serial_;
    ++last_.moved;
    candidates_.push_back(pose);
  }
}

template <class G>
void IncrementalPoseGraph<G>::back_substitute() {
  std::vector<int> stack = roots_;
  while (!stack.empty()) {
    const int f = stack.back();
    stack.pop_back();
    Front& front = fronts_[at(f)];
    const bool touched = front.mark != Front::Mark::keep;
    const auto separator = front.poses.begin() + front.own;
    if (!touched &&
        std::none_of(separator, front.poses.end(), [&](int k) { return changed_[at(k)] == update_serial_; }))
      continue;
    front.mark = Front::Mark::keep;
    solve_front(front);
    stack.insert(stack.end(), front.children.begin(), front.children.end());
  }
  far_.clear();
  for (const int k : candidates_)
    if (is_far(k, 1.0)) far_.push_back(k);
  std::sort(far_.begin(), far_.end());
  far_.erase(std::unique(far_.begin(), far_.end()), far_.end());
  candidates_ = far_;
  for (const int k : waiting_) place(k);
}

// Everything linearised where it is now, one new tree.
template <class G>
void IncrementalPoseGraph<G>::rebuild_all() {
  fronts_.clear();
  free_.clear();
  roots_.clear();
  marked_.clear();
  waiting_.clear();
  joining_.clear();
  candidates_.clear();
  for (int k = 1; k < size(); ++k) {
    linearised_[at(k)] = pose(k);
    step_[at(k)].setZero();
    front_of_[at(k)] = -1;
    joining_.push_back(k);
  }
  for (std::size_t f = 0; f < factors_.size(); ++f)
    linear_[f].linearise(params_.residual, factors_[f], linearised_[at(factors_[f].from)],
                         linearised_[at(factors_[f].to)]);
  last_.relinearised = size() - 1;
  far_.clear();
  broken_ = !rebuild_top();
  last_.failed = broken_;
  if (!broken_) back_substitute();
}

template <class G>
typename G::Adjoint IncrementalPoseGraph<G>::covariance(int i, int j) {
  if (i == 0 || j == 0) return G::Adjoint::Zero();
  if (front_of_[at(i)] >= 0 && front_of_[at(j)] >= 0) return tree_covariance(i, j);
  if (front_of_[at(i)] >= 0 || (front_of_[at(j)] < 0 && j > i)) return covariance(j, i).transpose();
  // A pose outside the tree follows from the one before it, T_i = T_p U Exp(noise): d_i = Ad(U^-1) d_p + noise.
  const PoseFactor<G>& f = factors_[at(latest_factor(i))];
  const int p = f.from == i ? f.to : f.from;
  const G U = f.to == i ? f.measured : f.measured.inverse();
  const typename G::Adjoint A = U.inverse().adjoint();
  if (i != j) return A * covariance(p, j);
  typename G::Adjoint noise = f.information.inverse();
  if (f.from == i) noise = f.measured.adjoint() * noise * f.measured.adjoint().transpose();  // the other way round
  return A * covariance(p, p) * A.transpose() + noise;
}

// The block column, at the poses of a front.
template <class G>
void IncrementalPoseGraph<G>::gather(const Front& front) {
  const Eigen::Index rows = D * static_cast<Eigen::Index>(front.poses.size());
  front_column_.resize(static_cast<std::size_t>(rows * D));
  Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, D>> x(front_column_.data(), rows, D);
  for (std::size_t k = 0; k < front.poses.size(); ++k)
    x.template middleRows<D>(D * static_cast<Eigen::Index>(k)) = column_[at(front.poses[k])];
}

// Column j of H^-1: forward from j to the root, back down to i.
template <class G>
typename G::Adjoint IncrementalPoseGraph<G>::tree_covariance(int i, int j) {
  column_.resize(linearised_.size());
  std::vector<int> down;
  for (const int from : {j, i}) {
    down.clear();
    for (int f = front_of_[at(from)]; f >= 0; f = fronts_[at(f)].parent) {
      down.push_back(f);
      for (const int pose : fronts_[at(f)].poses) column_[at(pose)].setZero();
    }
  }
  column_[at(j)].setIdentity();
  const auto scatter = [&](const Front& front, int begin, int end) {
    const int rows = D * static_cast<int>(front.poses.size());
    Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, D>> x(front_column_.data(), rows, D);
    for (int k = begin; k < end; ++k) column_[at(front.poses[at(k)])] = x.template middleRows<D>(D * k);
  };
  for (int f = front_of_[at(j)]; f >= 0; f = fronts_[at(f)].parent) {
    const Front& front = fronts_[at(f)];
    const int columns = D * front.own, rows = D * static_cast<int>(front.poses.size());
    gather(front);
    for (int d = 0; d < D; ++d) {
      double* x = front_column_.data() + d * rows;
      for (int c = 0; c < columns; ++c) {
        const double* L = front.panel.data() + std::ptrdiff_t(c) * front.ld;
        x[c] /= L[c];
        dense::add_scaled(x + c + 1, -x[c], L + c + 1, rows - c - 1);
      }
    }
    scatter(front, 0, static_cast<int>(front.poses.size()));
  }
  for (auto f = down.rbegin(); f != down.rend(); ++f) {
    const Front& front = fronts_[at(*f)];
    const int columns = D * front.own, rows = D * static_cast<int>(front.poses.size());
    gather(front);
    for (int d = 0; d < D; ++d) {
      double* x = front_column_.data() + d * rows;
      for (int c = columns - 1; c >= 0; --c) {
        const double* L = front.panel.data() + std::ptrdiff_t(c) * front.ld;
        x[c] = (x[c] - dense::dot(L + c + 1, x + c + 1, rows - c - 1)) / L[c];
      }
    }
    scatter(front, 0, front.own);
  }
  return column_[at(i)];
}

template <class G>
PoseGraphReport IncrementalPoseGraph<G>::finish() {
  PoseGraphParams params;
  params.residual = params_.residual;
  PoseGraphSolver<G> batch({poses(), factors_}, params);
  const PoseGraphReport report = batch.optimise();
  for (int k = 1; k < size(); ++k) {
    linearised_[at(k)] = batch.poses()[at(k)];
    step_[at(k)].setZero();
  }
  last_ = {};
  ++update_serial_;
  rebuild_all();
  return report;
}

#define CONVOY_INSTANTIATE(G) template class IncrementalPoseGraph<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
