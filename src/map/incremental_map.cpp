#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/incremental_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include <algorithm>
#include <cmath>
#include <ranges>
#include <tuple>
#include <utility>

namespace convoy {
namespace {

template <class G>
class TreeCovariance final : public CovarianceSource<G> {
 public:
  TreeCovariance(std::shared_ptr<const FactoredTree> tree, std::vector<int> id_of)
      : tree_(std::move(tree)), id_of_(std::move(id_of)) {}

  Eigen::MatrixXd between(int a, int b) override {
    const Eigen::MatrixXd P = tree_->covariance(id(a), id(b));
    return a == b ? symmetrised(P) : P;
  }
  Eigen::MatrixXd joint(const std::vector<int>& unknowns) override {
    std::vector<int> ids;
    for (const int u : unknowns) ids.push_back(id(u));
    return tree_->joint_covariance(ids);
  }

 private:
  int id(int unknown) const { return id_of_[static_cast<std::size_t>(unknown)]; }
  std::shared_ptr<const FactoredTree> tree_;
  std::vector<int> id_of_;
};

// The same place of the same chain: two places of one anchor and moment may be two unknowns.
template <class G>
bool is_same(const Node<G>& a, const Node<G>& b) {
  return a.anchor == b.anchor && a.slam.abscissa_m == b.slam.abscissa_m && a.slam.stamp_s == b.slam.stamp_s &&
         a.slam.pose.translation() == b.slam.pose.translation() && a.slam.pose.rotation() == b.slam.pose.rotation() &&
         a.slam.drift == b.slam.drift && a.slam.heading_lever == b.slam.heading_lever;
}

// Of each class, the first landmark.
template <class G>
std::vector<Key> first_landmarks(const Problem<G>& problem) {
  std::vector<Key> keys(problem.points.size());
  for (auto l = problem.landmarks.rbegin(); l != problem.landmarks.rend(); ++l) keys[at(l->point)] = l->landmark;
  return keys;
}

// Of each unknown of `after`, its number in `before`; -1: it has none. Both list nodes by anchor and moment, points by
// their first landmark and constants by chain, so that one look at each is enough.
template <class G>
std::vector<int> old_numbers(const Problem<G>& before, const Problem<G>& after) {
  std::vector<int> old(after.nodes.size() + after.points.size() + after.constants.size(), -1);
  constexpr std::size_t most_of_one_moment = 8;  // what is not found is taken for new
  const auto moment = [](const Node<G>& node) {
    return std::tie(node.anchor, node.slam.abscissa_m, node.slam.stamp_s);
  };
  const std::size_t nodes = before.nodes.size();
  for (std::size_t n = 0, from = 0; n < after.nodes.size(); ++n) {
    const Node<G>& node = after.nodes[n];
    while (from < nodes && moment(before.nodes[from]) < moment(node)) ++from;
    const std::size_t end = std::min(nodes, from + most_of_one_moment);
    for (std::size_t m = from; m < end && moment(before.nodes[m]) == moment(node); ++m) {
      if (!is_same(before.nodes[m], node)) continue;
      old[n] = static_cast<int>(m);
      from = m + 1;
      break;
    }
  }
  const std::vector<Key> keys_before = first_landmarks(before), keys = first_landmarks(after);
  for (std::size_t p = 0, from = 0; p < keys.size(); ++p) {
    while (from < keys_before.size() && keys_before[from] < keys[p]) ++from;
    if (from < keys_before.size() && keys_before[from] == keys[p])
      old[at(after.unknown_of_point(static_cast<int>(p)))] = before.unknown_of_point(static_cast<int>(from++));
  }
  auto chain = before.chains.begin();
  for (const ChainSpan& span : after.chains) {
    if (span.constants < 0) continue;
    while (chain != before.chains.end() && chain->chain < span.chain) ++chain;
    if (chain != before.chains.end() && chain->chain == span.chain && chain->constants >= 0)
      old[at(after.unknown_of_constants(span.constants))] = before.unknown_of_constants(chain->constants);
  }
  return old;
}

}  // namespace

template <class G>
std::unique_ptr<Map<G>> IncrementalMap<G>::solve(Problem<G> problem) {
  last_ = {};
  const std::shared_ptr<const Problem<G>> before =
      std::exchange(problem_, std::make_shared<const Problem<G>>(std::move(problem)));
  take_unknowns(before.get());
  take_factors();
  for (const int id : gone_) tree_.remove_unknown(id);
  if (before == nullptr || !iterate()) {
    last_.from_start = true;
    std::unique_ptr<Map<G>> map = SparseMap<G>().solve(*problem_);
    restart(*map);
    return map;
  }
  SolveReport report{last_.iterations, true, total_chi2(), factors_->residuals()};
  for (const int size : unknown_sizes(*problem_)) report.dof -= size;
  return std::make_unique<Map<G>>(problem_, estimate_, report,
                                  std::make_unique<TreeCovariance<G>>(tree_.factored(), id_of_));
}

// Estimates of what was there stay; what is new starts from them.
template <class G>
void IncrementalMap<G>::take_unknowns(const Problem<G>* before) {
  const State<G> old_linearised = std::exchange(linearised_, start_of(*problem_));
  const State<G> old_estimate = std::exchange(estimate_, linearised_);
  const std::vector<int> old_ids = std::exchange(id_of_, std::vector<int>(at(linearised_.size()), -1));
  if (before == nullptr) old_number_.assign(id_of_.size(), -1);
  else old_number_ = old_numbers(*before, *problem_);
  std::vector<bool> stays(old_ids.size(), false);
  for (int u = 0; u < linearised_.size(); ++u) {
    const int old = old_number_[at(u)];
    if (old < 0) continue;
    stays[at(old)] = true;
    id_of_[at(u)] = old_ids[at(old)];
    linearised_.set(u, old_linearised, old);
    estimate_.set(u, old_estimate, old);
  }
  gone_.clear();
  for (std::size_t v = 0; v < old_ids.size(); ++v)
    if (!stays[v]) gone_.push_back(old_ids[v]);

  placed_anew_.clear();
  new_nodes_.clear();
  std::vector<bool> anew(at(linearised_.size()), false);
  for (const ChainSpan& span : problem_->chains) {
    const bool whole = starts_anew(span, before);
    for (int n = span.first; n < span.end; ++n) {
      if (!whole && id_of_[at(n)] >= 0) continue;
      const Node<G>& node = problem_->nodes[at(n)];
      estimate_.poses[at(n)] =
          whole || n == span.first
              ? node.initial
              : estimate_.pose(n - 1) * (problem_->nodes[at(n - 1)].slam.pose.inverse() * node.slam.pose);
      anew[at(n)] = true;
      place(n);
    }
  }
  if (problem_->datum >= 0 && id_of_[at(problem_->datum)] < 0) place(problem_->datum);
  const auto& landmarks = problem_->landmarks;  // class by class
  for (std::size_t first = 0, end = 0; first < landmarks.size(); first = end) {
    bool moved = false;
    for (end = first; end < landmarks.size() && landmarks[end].point == landmarks[first].point; ++end)
      moved = moved || anew[at(landmarks[end].node)];
    const int u = problem_->unknown_of_point(landmarks[first].point);
    if (!moved && id_of_[at(u)] >= 0) continue;
    estimate_.points[at(landmarks[first].point)] = mean_of_members(first);
    place(u);
  }
  for (int u = problem_->unknown_of_constants(0); u < linearised_.size(); ++u)
    if (id_of_[at(u)] < 0) place(u);
  for (std::size_t u = 0; u < id_of_.size(); ++u) {
    unknown_of_.resize(std::max(unknown_of_.size(), at(id_of_[u]) + 1));
    unknown_of_[at(id_of_[u])] = static_cast<int>(u);
  }
}

// At its estimate, whether it was there or not.
template <class G>
void IncrementalMap<G>::place(int u) {
  linearised_.set(u, estimate_, u);
  int& id = id_of_[at(u)];
  if (id >= 0) {
    tree_.reset(id);
    placed_anew_.push_back(u);
    return;
  }
  id = tree_.add_unknown(linearised_.is_node(u)    ? G::Dof
                         : linearised_.is_point(u) ? G::Dim
                                                   : Constants<G>::RowsAtCompileTime);
  if (linearised_.is_node(u)) new_nodes_.push_back(id);
}

// A chain that is expressed in another frame, or placed from another chain, may be anywhere else.
template <class G>
bool IncrementalMap<G>::starts_anew(const ChainSpan& span, const Problem<G>* before) const {
  if (before == nullptr) return true;
  const auto old = std::lower_bound(before->chains.begin(), before->chains.end(), span.chain,
                                    [](const ChainSpan& s, const ChainId& id) { return s.chain < id; });
  if (old == before->chains.end() || old->chain != span.chain) return true;
  return old->aligned != span.aligned || old->placed_from != span.placed_from;
}

template <class G>
typename G::Point IncrementalMap<G>::mean_of_members(std::size_t first) const {
  typename G::Point sum = G::Point::Zero();
  int members = 0;
  for (std::size_t l = first;
       l < problem_->landmarks.size() && problem_->landmarks[l].point == problem_->landmarks[first].point; ++l) {
    sum += estimate_.pose(problem_->landmarks[l].node) * problem_->landmarks[l].position;
    ++members;
  }
  return sum / members;
}

template <class G>
LinearTerm IncrementalMap<G>::linear_term(int k) const {
  LinearTerm term;
  for (const int u : factors_->unknowns(k)) term.unknowns.push_back(id_of_[at(u)]);
  factors_->linearise(k, known_[at(k)].information, linearised_, &term);
  return term;
}

// Factors that were there stay in the tree. One is looked for among those that spoke of its first unknown.
template <class G>
void IncrementalMap<G>::take_factors() {
  const std::unique_ptr<LinearFactors<G>> old = std::exchange(factors_, std::make_unique<LinearFactors<G>>(*problem_));
  std::vector<Known> before = std::exchange(known_, std::vector<Known>(at(factors_->size())));
  // Old factors that nobody has claimed, in lists by the first unknown they speak of, in the old problem.
  std::vector<int> next(before.size(), -1), head;
  for (int k = static_cast<int>(before.size()) - 1; k >= 0; --k) {
    const int u = old->unknowns(k).front();
    head.resize(std::max(head.size(), at(u) + 1), -1);
    next[at(k)] = std::exchange(head[at(u)], k);
  }
  for (int k = 0; k < factors_->size(); ++k) {
    const int u = old_number_[at(factors_->unknowns(k).front())];
    const bool speaks_of_news =
        std::ranges::any_of(factors_->unknowns(k), [&](int v) { return old_number_[at(v)] < 0; });
    int* candidate = !speaks_of_news && at(u) < head.size() ? &head[at(u)] : nullptr;
    while (candidate != nullptr && *candidate >= 0 && !is_factor(k, *old, *candidate))
      candidate = &next[at(*candidate)];
    if (candidate == nullptr || *candidate < 0) {
      enter(k);
      continue;
    }
    known_[at(k)] = std::move(before[at(*candidate)]);
    before[at(*candidate)].term = -1;
    *candidate = next[at(*candidate)];
    factor_of_[at(known_[at(k)].term)] = k;
  }
  for (const Known& gone : before) {
    if (gone.term < 0) continue;
    ++last_.gone_factors;
    tree_.remove_term(gone.term);
  }
}

template <class G>
bool IncrementalMap<G>::is_factor(int k, const LinearFactors<G>& old, int old_k) const {
  return std::ranges::equal(factors_->unknowns(k), old.unknowns(old_k),
                            [&](int u, int old_u) { return old_number_[at(u)] == old_u; }) &&
         factors_->says_the_same(k, old, old_k);
}

template <class G>
void IncrementalMap<G>::enter(int k) {
  ++last_.new_factors;
  Known& known = known_[at(k)];
  known.information = factors_->information(k);
  known.term = tree_.add_term(linear_term(k));
  judge(k);
  factor_of_.resize(std::max(factor_of_.size(), at(known.term) + 1));
  factor_of_[at(known.term)] = k;
}

// Each once, as long as `terms` is empty at first.
template <class G>
void IncrementalMap<G>::add_terms_of(int id, std::vector<int>& terms) {
  if (terms.empty()) ++stamp_;
  stamp_of_.resize(factor_of_.size(), 0);
  for (const int t : tree_.terms_of(id)) {
    if (stamp_of_[at(t)] == stamp_) continue;
    stamp_of_[at(t)] = stamp_;
    terms.push_back(t);
  }
}

template <class G>
void IncrementalMap<G>::linearise_at_estimate(const std::vector<int>& unknowns) {
  std::vector<int> stale;
  for (const int u : unknowns) {
    linearised_.set(u, estimate_, u);
    tree_.reset(id_of_[at(u)]);
    add_terms_of(id_of_[at(u)], stale);
  }
  for (const int t : stale) tree_.change_term(t, linear_term(factor_of_[at(t)]));
  last_.relinearised += static_cast<int>(unknowns.size());
}

template <class G>
void IncrementalMap<G>::judge(int k) {
  known_[at(k)].chi2 = factors_->linearise(k, known_[at(k)].information, estimate_, nullptr);
}

template <class G>
void IncrementalMap<G>::judge_around(const std::vector<int>& unknowns) {
  std::vector<int> stale;
  for (const int u : unknowns) add_terms_of(id_of_[at(u)], stale);
  for (const int t : stale) judge(factor_of_[at(t)]);
}

template <class G>
bool IncrementalMap<G>::is_far(int u, const typename State<G>::Step& step) const {
  constexpr double scale = 1e-3, heading_rad_per_m = 1e-4;  // of constants; heights are linear
  if (linearised_.is_node(u))
    return step.template head<G::Dim>().cwiseAbs().maxCoeff() > params_.relinearise_m ||
           step.template tail<G::Dof - G::Dim>().cwiseAbs().maxCoeff() > params_.relinearise_rad;
  if (linearised_.is_point(u)) return step.cwiseAbs().maxCoeff() > params_.relinearise_m;
  return std::abs(step[0]) > scale || std::abs(step[1]) > heading_rad_per_m;
}

template <class G>
double IncrementalMap<G>::total_chi2() const {
  double sum = 0.0;
  for (const Known& known : known_) sum += known.chi2;
  return sum;
}

// Until nothing is far from where it is linearised. False if it does not come to that.
template <class G>
bool IncrementalMap<G>::iterate() {
  linearise_at_estimate(placed_anew_);
  judge_around(placed_anew_);
  const double start_chi2 = total_chi2();
  std::vector<int> far, moved;
  while (last_.iterations < params_.max_iterations) {
    ++last_.iterations;
    const FrontTree::Report report = tree_.update(
        new_nodes_.size() <= 3 ? std::span<const int>(new_nodes_) : std::span<const int>(), params_.propagate);
    last_.fronts += report.fronts;
    if (report.failed) return false;
    far.clear();
    for (const int id : tree_.moved()) {
      const int u = unknown_of_[at(id)];
      const typename State<G>::Step step = tree_.solution(id);
      if (!step.allFinite()) return false;
      estimate_.move(u, linearised_, step);
      moved.push_back(u);
      if (is_far(u, step)) far.push_back(u);
    }
    if (far.empty()) {
      judge_around(moved);
      return total_chi2() <= start_chi2 + 1e-3 * (1.0 + start_chi2);
    }
    linearise_at_estimate(far);
  }
  return false;
}

template <class G>
void IncrementalMap<G>::restart(const Map<G>& map) {
  const State<G> there{map.poses(), map.points(), map.constants()};
  const std::vector<int> number_there = old_numbers(map.problem(), *problem_);
  std::vector<int> elsewhere;
  for (int u = 0; u < estimate_.size(); ++u) {
    const int there_u = number_there[at(u)];
    if (there_u < 0 || !is_far(u, estimate_.step_to(there, u, there_u))) continue;
    estimate_.set(u, there, there_u);
    elsewhere.push_back(u);
  }
  linearise_at_estimate(elsewhere);
  for (int k = 0; k < static_cast<int>(known_.size()); ++k) judge(k);
}

#define CONVOY_INSTANTIATE(G) template class IncrementalMap<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
