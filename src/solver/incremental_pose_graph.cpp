#include <convoy/geometry/groups.hpp>
#include <convoy/solver/incremental_pose_graph.hpp>
#include <convoy/solver/index.hpp>

#include <Eigen/LU>
#include <algorithm>
#include <array>

namespace convoy {
template <class G>
IncrementalPoseGraph<G>::IncrementalPoseGraph(const G& first, const IncrementalParams& params) : params_(params) {
  append_pose();
  linearised_.back() = first;
}

template <class G>
bool IncrementalPoseGraph<G>::valid(const PoseFactor<G>& f, int poses) const {
  return f.from >= 0 && f.to >= 0 && f.from < poses && f.to < poses && f.from != f.to;
}

template <class G>
void IncrementalPoseGraph<G>::append_pose() {
  linearised_.emplace_back();
  unknown_of_.push_back(-1);
  factors_of_.emplace_back();
}

template <class G>
int IncrementalPoseGraph<G>::append(const PoseFactor<G>& f) {
  const int index = static_cast<int>(factors_.size());
  factors_.push_back(f);
  term_of_.push_back(-1);
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
  append_pose();
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
  const bool failed = last_.failed;
  last_ = {};
  if (!added.empty() || !far_.empty() || failed) update(std::move(added));
  return true;
}

template <class G>
G IncrementalPoseGraph<G>::pose(int k) const {
  const int u = unknown_of_[at(k)];
  return u < 0 ? linearised_[at(k)] : linearised_[at(k)] * G::Exp(tree_.solution(u));
}

template <class G>
std::vector<G> IncrementalPoseGraph<G>::poses() const {
  std::vector<G> result;
  for (int k = 0; k < size(); ++k) result.push_back(pose(k));
  return result;
}

template <class G>
bool IncrementalPoseGraph<G>::is_far(int k, double factor) const {
  const typename G::Tangent d = tree_.solution(unknown_of_[at(k)]);
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

template <class G>
LinearTerm IncrementalPoseGraph<G>::linear(const PoseFactor<G>& f) const {
  LinearPoseFactor<G> l;
  l.linearise(params_.residual, f, linearised_[at(f.from)], linearised_[at(f.to)]);
  if (f.from == 0) return {{unknown_of_[at(f.to)]}, l.H_to, l.b_to};
  if (f.to == 0) return {{unknown_of_[at(f.from)]}, l.H_from, l.b_from};
  LinearTerm term{
      {unknown_of_[at(f.from)], unknown_of_[at(f.to)]}, Eigen::MatrixXd(2 * D, 2 * D), Eigen::VectorXd(2 * D)};
  term.H.template topLeftCorner<D, D>() = l.H_from;
  term.H.template bottomLeftCorner<D, D>() = l.H_to_from;
  term.H.template bottomRightCorner<D, D>() = l.H_to;
  term.b << l.b_from, l.b_to;
  return term;
}

template <class G>
void IncrementalPoseGraph<G>::relinearise(const std::vector<int>& poses) {
  std::vector<int> stale;
  for (const int k : poses) {
    linearised_[at(k)] = pose(k);
    tree_.reset(unknown_of_[at(k)]);
    stale.insert(stale.end(), factors_of_[at(k)].begin(), factors_of_[at(k)].end());
  }
  std::sort(stale.begin(), stale.end());
  stale.erase(std::unique(stale.begin(), stale.end()), stale.end());
  for (const int f : stale)
    if (term_of_[at(f)] >= 0) tree_.change_term(term_of_[at(f)], linear(factors_[at(f)]));
  last_.relinearised += static_cast<int>(poses.size());
}

template <class G>
void IncrementalPoseGraph<G>::update(std::vector<int> new_factors) {
  relinearise(far_);
  join(new_factors);
  for (const int f : new_factors) term_of_[at(f)] = tree_.add_term(linear(factors_[at(f)]));
  factored_.reset();
  const int newest = *std::max_element(pose_of_.begin(), pose_of_.end());
  const std::array<int, 1> last{unknown_of_[at(newest)]};
  const FrontTree::Report report = tree_.update(last, params_.propagate);
  last_.fronts += report.fronts;
  last_.failed = report.failed;
  note_moved();
}

// What new factors speak of enters the tree, with everything it hangs on and the factors that it hangs by.
template <class G>
void IncrementalPoseGraph<G>::join(std::vector<int>& new_factors) {
  for (std::size_t n = 0; n < new_factors.size(); ++n)  // grows on the way
    for (const int k : {factors_[at(new_factors[n])].from, factors_[at(new_factors[n])].to}) {
      if (k == 0 || unknown_of_[at(k)] >= 0) continue;
      enter(k);
      const int f = latest_factor(k);
      if (std::find(new_factors.begin(), new_factors.end(), f) == new_factors.end()) new_factors.push_back(f);
    }
  std::erase_if(waiting_, [&](int k) { return unknown_of_[at(k)] >= 0; });
}

template <class G>
void IncrementalPoseGraph<G>::enter(int k) {
  const int u = unknown_of_[at(k)] = tree_.add_unknown(D);
  pose_of_.resize(std::max(pose_of_.size(), at(u) + 1));
  pose_of_[at(u)] = k;
}

// What is far from where it is linearised is so until it is linearised again.
template <class G>
void IncrementalPoseGraph<G>::note_moved() {
  last_.moved += static_cast<int>(tree_.moved().size());
  std::erase_if(far_, [&](int k) { return !is_far(k, 1.0); });
  for (const int u : tree_.moved())
    if (const int k = pose_of_[at(u)]; is_far(k, 1.0)) far_.push_back(k);
  std::sort(far_.begin(), far_.end());
  far_.erase(std::unique(far_.begin(), far_.end()), far_.end());
  for (const int k : waiting_) place(k);
}

template <class G>
const FactoredTree& IncrementalPoseGraph<G>::factored() {
  if (!factored_) factored_ = tree_.factored();
  return *factored_;
}

template <class G>
typename G::Adjoint IncrementalPoseGraph<G>::covariance(int i, int j) {
  if (i == 0 || j == 0) return G::Adjoint::Zero();
  const int u = unknown_of_[at(i)], v = unknown_of_[at(j)];
  if (u >= 0 && v >= 0) return factored().covariance(u, v);
  if (u >= 0 || (v < 0 && j > i)) return covariance(j, i).transpose();
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

template <class G>
PoseGraphReport IncrementalPoseGraph<G>::finish() {
  PoseGraphParams params;
  params.residual = params_.residual;
  PoseGraphSolver<G> batch({poses(), factors_}, params);
  const PoseGraphReport report = batch.optimise();
  std::vector<int> outside;
  for (std::size_t f = 0; f < factors_.size(); ++f)
    if (term_of_[f] < 0) outside.push_back(static_cast<int>(f));
  std::vector<int> inside;
  for (int k = 1; k < size(); ++k) {
    if (unknown_of_[at(k)] < 0) enter(k);
    else inside.push_back(k);
    linearised_[at(k)] = batch.poses()[at(k)];
    tree_.reset(unknown_of_[at(k)]);
  }
  waiting_.clear();
  far_.clear();
  last_ = {};
  relinearise(inside);
  update(std::move(outside));
  return report;
}

#define CONVOY_INSTANTIATE(G) template class IncrementalPoseGraph<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
