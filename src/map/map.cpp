#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/factors.hpp>
#include <convoy/map/map.hpp>
#include <convoy/submap/content_hash.hpp>

#include <algorithm>

namespace convoy {

template <class G>
Map<G>::Map(Problem<G> problem, std::vector<G> poses, std::vector<typename G::Point> points, SolveReport report,
            std::unique_ptr<CovarianceSource<G>> covariances)
    : problem_(std::move(problem)),
      poses_(std::move(poses)),
      points_(std::move(points)),
      report_(report),
      covariances_(std::move(covariances)) {
  ContentHash hash;
  for (const ChainSpan& span : problem_.chains)
    hash.add(span.chain.vehicle, 4).add(span.chain.epoch).add(span.aligned ? 1U : 0U, 1);
  for (std::size_t n = 0; n < poses_.size(); ++n) {
    hash.add(problem_.nodes[n].anchor.index, 4);
    add_group(hash, poses_[n]);
  }
  for (const auto& point : points_) hash.add(point);
  digest_ = hash.value();
}

template <class G>
const ChainSpan* Map<G>::span(const ChainId& chain) const {
  const auto it = std::lower_bound(problem_.chains.begin(), problem_.chains.end(), chain,
                                   [](const ChainSpan& s, const ChainId& id) { return s.chain < id; });
  return it != problem_.chains.end() && it->chain == chain ? &*it : nullptr;
}

template <class G>
bool Map<G>::aligned(const ChainId& chain) const {
  const ChainSpan* s = span(chain);
  return s != nullptr && s->aligned;
}

template <class G>
typename Map<G>::Placement Map<G>::place(const ChainSpan& s, const ChainState<G>& state) const {
  const auto& nodes = problem_.nodes;
  int before = s.first;  // the last node not later than the state
  while (before + 1 < s.end && nodes[static_cast<std::size_t>(before) + 1].slam.stamp_s <= state.stamp_s) ++before;
  const G& T_a = poses_[static_cast<std::size_t>(before)];
  const Increment<G> first = increment(nodes[static_cast<std::size_t>(before)].slam, state);
  Placement placement;
  placement.first = before;
  placement.A = first.motion.inverse().adjoint();
  placement.mean = T_a * first.motion;
  placement.noise = first.covariance;
  if (before + 1 >= s.end) return placement;
  // Between two nodes: e = what the chain a -> b is off by is shared out by the covariances of its two halves.
  const G& T_b = poses_[static_cast<std::size_t>(before) + 1];
  const Increment<G> second = increment(state, nodes[static_cast<std::size_t>(before) + 1].slam);
  const typename G::Adjoint Ad = second.motion.inverse().adjoint();
  const typename G::Covariance total = Ad * first.covariance * Ad.transpose() + second.covariance;
  const typename G::Covariance K =
      total.ldlt().solve(typename G::Covariance(Ad * first.covariance)).transpose();  // Q1 Ad^T total^-1
  const typename G::Tangent e = ((placement.mean * second.motion).inverse() * T_b).Log();
  placement.second = before + 1;
  placement.mean = placement.mean * G::Exp(K * e);
  placement.A -= K * (first.motion * second.motion).inverse().adjoint();
  placement.B = K;
  placement.noise = symmetrised(typename G::Covariance(first.covariance - K * Ad * first.covariance));
  return placement;
}

template <class G>
typename G::Covariance Map<G>::covariance(const Placement& a, const Placement& b) {
  typename G::Covariance P = a.A * covariances_->nodes(a.first, b.first) * b.A.transpose();
  if (b.second >= 0) P += a.A * covariances_->nodes(a.first, b.second) * b.B.transpose();
  if (a.second >= 0) P += a.B * covariances_->nodes(a.second, b.first) * b.A.transpose();
  if (a.second >= 0 && b.second >= 0) P += a.B * covariances_->nodes(a.second, b.second) * b.B.transpose();
  return P;
}

template <class G>
std::optional<Estimate<G>> Map<G>::pose(const ChainId& chain, const ChainState<G>& state) {
  const ChainSpan* s = span(chain);
  if (s == nullptr) return std::nullopt;
  const Placement p = place(*s, state);
  return Estimate<G>{p.mean, symmetrised(typename G::Covariance(covariance(p, p) + p.noise))};
}

template <class G>
std::optional<Eigen::Matrix<double, 2 * G::Dof, 2 * G::Dof>> Map<G>::joint_covariance(const ChainId& chain_a,
                                                                                      const ChainState<G>& state_a,
                                                                                      const ChainId& chain_b,
                                                                                      const ChainState<G>& state_b) {
  const ChainSpan *sa = span(chain_a), *sb = span(chain_b);
  if (sa == nullptr || sb == nullptr) return std::nullopt;
  const Placement a = place(*sa, state_a), b = place(*sb, state_b);
  Eigen::Matrix<double, 2 * G::Dof, 2 * G::Dof> P;
  P.template topLeftCorner<G::Dof, G::Dof>() = covariance(a, a) + a.noise;
  P.template bottomRightCorner<G::Dof, G::Dof>() = covariance(b, b) + b.noise;
  P.template topRightCorner<G::Dof, G::Dof>() = covariance(a, b);
  P.template bottomLeftCorner<G::Dof, G::Dof>() = covariance(a, b).transpose();
  return P;
}

template <class G>
std::optional<Surroundings<G>> Map<G>::surroundings(const ChainId& chain, const ChainState<G>& state,
                                                    const std::vector<int>& classes) {
  const ChainSpan* s = span(chain);
  if (s == nullptr) return std::nullopt;
  const Placement p = place(*s, state);
  std::vector<int> nodes{p.first};
  if (p.second >= 0) nodes.push_back(p.second);
  const Eigen::Index n = G::Dof * static_cast<Eigen::Index>(nodes.size());
  const Eigen::Index rest = G::Dim * static_cast<Eigen::Index>(classes.size());
  Eigen::MatrixXd F = Eigen::MatrixXd::Zero(G::Dof + rest, n + rest);  // nodes and points -> pose and points
  F.template block<G::Dof, G::Dof>(0, 0) = p.A;
  if (p.second >= 0) F.template block<G::Dof, G::Dof>(0, G::Dof) = p.B;
  F.bottomRightCorner(rest, rest).setIdentity();
  Surroundings<G> around{
      p.mean, p.noise, {}, symmetrised(Eigen::MatrixXd(F * covariances_->joint(nodes, classes) * F.transpose()))};
  for (const int c : classes) around.points.push_back(points_[static_cast<std::size_t>(c)]);
  return around;
}

template <class G>
std::optional<PointEstimate<G>> Map<G>::landmark(const FactStore<G>& store, const LandmarkFact<G>& l) {
  const AnchorFact<G>* anchor = store.anchor(l.anchor_key());
  if (anchor == nullptr) return std::nullopt;
  const auto estimate = pose(l.key.chain, anchor->state);
  if (!estimate) return std::nullopt;
  const typename G::PointJacobian H = estimate->mean.act_jacobian(l.position);
  const auto R = estimate->mean.rotation();
  return PointEstimate<G>{estimate->mean * l.position,
                          symmetrised(typename G::PointCovariance(H * estimate->covariance * H.transpose() +
                                                                  R * l.covariance * R.transpose()))};
}

template <class G>
PointEstimate<G> Map<G>::class_point(int index) {
  return {points_[static_cast<std::size_t>(index)], covariances_->point(index)};
}

template <class G>
std::optional<Estimate<G>> Map<G>::datum() {
  if (problem_.datum < 0) return std::nullopt;
  return Estimate<G>{poses_[static_cast<std::size_t>(problem_.datum)],
                     symmetrised(covariances_->nodes(problem_.datum, problem_.datum))};
}

// With w = S^-1/2 r and M = I - S^-1/2 J P J^T S^-T/2, the fix' own share in its residual taken off, w^T M^-1 w is what
// a map without the fix would find. An eigenvalue of M is s0 / (1 + s0), s0 the variance without the fix in units of
// the fix' own; where it is nothing but rounding, nothing but the fix itself determines that direction.
template <class G>
std::pair<double, int> Map<G>::contradiction(const AbsoluteFixFactor<G>& f) {
  const G& T = poses_[static_cast<std::size_t>(f.node)];
  const G D = f.datum < 0 ? G() : poses_[static_cast<std::size_t>(f.datum)];
  const AbsoluteFixResidual<G> one(f, T, D);
  typename G::PointCovariance JPJ = one.J_T * covariances_->nodes(f.node, f.node) * one.J_T.transpose();
  if (f.datum >= 0) {
    const typename G::PointCovariance cross = one.J_T * covariances_->nodes(f.node, f.datum) * one.J_D.transpose();
    JPJ += cross + cross.transpose() + one.J_D * covariances_->nodes(f.datum, f.datum) * one.J_D.transpose();
  }
  const Eigen::LLT<typename G::PointCovariance> llt(f.covariance);
  const typename G::PointCovariance half = llt.matrixL().solve(JPJ), whitened = llt.matrixL().solve(half.transpose());
  const Eigen::SelfAdjointEigenSolver<typename G::PointCovariance> eigen(
      symmetrised(typename G::PointCovariance(G::PointCovariance::Identity() - whitened)));
  const typename G::Point w = eigen.eigenvectors().transpose() * llt.matrixL().solve(one.r);
  std::pair<double, int> result{0.0, 0};
  for (int i = 0; i < G::Dim; ++i) {
    if (eigen.eigenvalues()[i] < 1e-7) continue;
    result.first += w[i] * w[i] / eigen.eigenvalues()[i];
    ++result.second;
  }
  return result;
}

#define CONVOY_INSTANTIATE(G) template class Map<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
