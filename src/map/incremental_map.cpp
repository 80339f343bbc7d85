#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/incremental_map.hpp>
#include <convoy/map/sparse_map.hpp>
#include <convoy/submap/content_hash.hpp>

#include <algorithm>
#include <cmath>
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

// What an unknown is, whatever its number.
template <class G>
class Identities {
 public:
  explicit Identities(const Problem<G>& problem) : problem_(problem), first_of_(problem.points.size(), Key{}) {
    for (auto l = problem.landmarks.rbegin(); l != problem.landmarks.rend(); ++l)
      first_of_[static_cast<std::size_t>(l->point)] = l->landmark;
  }

  Hash of(int unknown) const {
    const auto u = static_cast<std::size_t>(unknown), nodes = problem_.nodes.size(), points = problem_.points.size();
    ContentHash hash;
    if (u < nodes) {
      const Node<G>& node = problem_.nodes[u];
      add_key(hash, node.anchor);
      hash.add(node.slam.abscissa_m).add(node.slam.stamp_s).add(node.slam.drift).add(node.slam.heading_lever);
      add_group(hash, node.slam.pose);
    } else if (u < nodes + points) {
      add_key(hash.add(1U, 1), first_of_[u - nodes]);
    } else {
      const auto is_its = [&](const ChainSpan& s) { return s.constants == static_cast<int>(u - nodes - points); };
      const ChainSpan& span = *std::find_if(problem_.chains.begin(), problem_.chains.end(), is_its);
      hash.add(2U, 1).add(span.chain.vehicle, 4).add(span.chain.epoch);
    }
    return hash.value();
  }

  /// By their numbers; of two that look alike, which only broken facts have, the second gets another name.
  std::unordered_map<Hash, int> all(int unknowns) const {
    std::unordered_map<Hash, int> numbers;
    numbers.reserve(static_cast<std::size_t>(unknowns));
    for (int u = 0; u < unknowns; ++u) {
      Hash name = of(u);
      while (!numbers.try_emplace(name, u).second) ++name;
    }
    return numbers;
  }

 private:
  const Problem<G>& problem_;
  std::vector<Key> first_of_;  // the first landmark of each class
};

}  // namespace

template <class G>
std::unique_ptr<Map<G>> IncrementalMap<G>::solve(Problem<G> problem) {
  ++serial_;
  last_ = {};
  const std::shared_ptr<const Problem<G>> before =
      std::exchange(problem_, std::make_shared<const Problem<G>>(std::move(problem)));
  take_unknowns(before.get());
  take_factors();
  drop_what_is_gone();
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
  const auto old_numbers = std::exchange(number_of_, Identities<G>(*problem_).all(linearised_.size()));
  std::vector<bool> stays(old_ids.size(), false);
  for (const auto& [name, u] : number_of_) {
    const auto old = old_numbers.find(name);
    if (old == old_numbers.end()) continue;
    stays[at(old->second)] = true;
    id_of_[at(u)] = old_ids[at(old->second)];
    linearised_.set(u, old_linearised, old->second);
    estimate_.set(u, old_estimate, old->second);
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
  factors_->linearise(k, known_of_[at(k)]->information, linearised_, &term);
  return term;
}

template <class G>
void IncrementalMap<G>::take_factors() {
  factors_ = std::make_unique<LinearFactors<G>>(*problem_);
  known_of_.assign(at(factors_->size()), nullptr);
  for (int k = 0; k < factors_->size(); ++k) {
    ContentHash hash;
    hash.add(factors_->content(k));
    for (const int u : factors_->unknowns(k)) hash.add(static_cast<std::uint64_t>(id_of_[at(u)]), 4);
    auto [it, fresh] = known_.try_emplace(hash.value());
    for (Hash name = hash.value(); it->second.seen == serial_;)
      std::tie(it, fresh) = known_.try_emplace(++name);  // a twin
    Known& known = it->second;
    known.seen = serial_;
    known_of_[at(k)] = &known;
    if (fresh) {
      ++last_.new_factors;
      known.information = factors_->information(k);
      known.term = tree_.add_term(linear_term(k));
      known.chi2 = factors_->linearise(k, known.information, estimate_, nullptr);
      factor_of_.resize(std::max(factor_of_.size(), at(known.term) + 1));
    }
    factor_of_[at(known.term)] = k;
  }
}

template <class G>
void IncrementalMap<G>::drop_what_is_gone() {
  last_.gone_factors = static_cast<int>(std::erase_if(known_, [&](const auto& entry) {
    if (entry.second.seen == serial_) return false;
    tree_.remove_term(entry.second.term);
    return true;
  }));
  for (const int id : gone_) tree_.remove_unknown(id);
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
  judge(stale);
  last_.relinearised += static_cast<int>(unknowns.size());
}

template <class G>
void IncrementalMap<G>::judge(const std::vector<int>& terms) {
  for (const int t : terms) {
    const int k = factor_of_[at(t)];
    known_of_[at(k)]->chi2 = factors_->linearise(k, known_of_[at(k)]->information, estimate_, nullptr);
  }
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
  for (const Known* known : known_of_) sum += known->chi2;
  return sum;
}

// Until nothing is far from where it is linearised. False if it does not come to that.
template <class G>
bool IncrementalMap<G>::iterate() {
  linearise_at_estimate(placed_anew_);
  const double start_chi2 = total_chi2();
  std::vector<int> far, stale;
  while (last_.iterations < params_.max_iterations) {
    ++last_.iterations;
    const FrontTree::Report report = tree_.update(
        new_nodes_.size() <= 3 ? std::span<const int>(new_nodes_) : std::span<const int>(), params_.propagate);
    last_.fronts += report.fronts;
    if (report.failed) return false;
    far.clear();
    stale.clear();
    for (const int id : tree_.moved()) {
      const int u = unknown_of_[at(id)];
      const typename State<G>::Step step = tree_.solution(id);
      if (!step.allFinite()) return false;
      estimate_.move(u, linearised_, step);
      if (is_far(u, step)) far.push_back(u);
      add_terms_of(id, stale);
    }
    judge(stale);
    if (far.empty()) return total_chi2() <= start_chi2 + 1e-3 * (1.0 + start_chi2);
    linearise_at_estimate(far);
  }
  return false;
}

template <class G>
void IncrementalMap<G>::restart(const Map<G>& map) {
  const State<G> there{map.poses(), map.points(), map.constants()};
  std::vector<int> elsewhere;
  for (const auto& [name, number] : Identities<G>(map.problem()).all(there.size())) {
    const auto mine = number_of_.find(name);
    if (mine == number_of_.end() || !is_far(mine->second, estimate_.step_to(there, mine->second, number))) continue;
    estimate_.set(mine->second, there, number);
    elsewhere.push_back(mine->second);
  }
  linearise_at_estimate(elsewhere);
}

#define CONVOY_INSTANTIATE(G) template class IncrementalMap<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
