#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/conditioning.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/factors.hpp>
#include <convoy/map/map.hpp>
#include <convoy/submap/content_hash.hpp>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>

namespace convoy {

template <class G>
Map<G>::Map(std::shared_ptr<const Problem<G>> problem, State<G> solution, SolveReport report,
            std::unique_ptr<CovarianceSource<G>> covariances)
    : problem_(std::move(problem)), at_(std::move(solution)), report_(report), covariances_(std::move(covariances)) {}

template <class G>
Hash Map<G>::digest() const {
  ContentHash hash;
  for (const ChainSpan& span : problem_->chains)
    hash.add(span.chain.vehicle, 4).add(span.chain.epoch).add(span.aligned ? 1U : 0U, 1);
  for (std::size_t n = 0; n < at_.poses.size(); ++n) {
    hash.add(problem_->nodes[n].anchor.index, 4);
    add_group(hash, at_.poses[n]);
  }
  for (const auto& point : at_.points) hash.add(point);
  for (const auto& c : at_.constants) hash.add(c);
  return hash.value();
}

template <class G>
const ChainSpan* Map<G>::span(const ChainId& chain) const {
  const auto it = std::lower_bound(problem_->chains.begin(), problem_->chains.end(), chain,
                                   [](const ChainSpan& s, const ChainId& id) { return s.chain < id; });
  return it != problem_->chains.end() && it->chain == chain ? &*it : nullptr;
}

template <class G>
bool Map<G>::aligned(const ChainId& chain) const {
  const ChainSpan* s = span(chain);
  return s != nullptr && s->aligned;
}

namespace {

// The pose between fixed neighbours that the factors around it want: T <- T Exp(H^-1 g), and how it moves with them.
template <class G>
struct LocalPose {
  typename G::Covariance H = G::Covariance::Zero(), H_first = G::Covariance::Zero(), H_second = G::Covariance::Zero();
  ConstantsJacobian<G> H_constants = ConstantsJacobian<G>::Zero();
  typename G::Tangent g = G::Tangent::Zero();

  template <class R, class W, class J, class JOther, class JConstants>
  void add(const R& r, const W& weight, const J& J_T, typename G::Covariance& H_other, const JOther& J_other,
           const JConstants& J_c) {
    const Eigen::Matrix<double, G::Dof, R::RowsAtCompileTime> JW = J_T.transpose() * weight;
    H += JW * J_T;
    H_other += JW * J_other;
    H_constants += JW * J_c;
    g -= JW * r;
  }
};

}  // namespace

template <class G>
typename Map<G>::Placement Map<G>::place(const ChainSpan& s, const ChainState<G>& state) const {
  const auto& nodes = problem_->nodes;
  const auto slam = [&](int n) -> const ChainState<G>& { return nodes[static_cast<std::size_t>(n)].slam; };
  int before = s.first;  // the last node not later than the state
  while (before + 1 < s.end && slam(before + 1).stamp_s <= state.stamp_s) ++before;
  Placement p;
  p.first = before;
  p.second = before + 1 < s.end ? before + 1 : -1;
  p.constants = s.constants;
  const G& T_a = at_.pose(before);
  const Constants<G> c = at_.constants_of(s.constants);
  const DriftFactor<G> to_here = drift_between(slam(before), state, s);
  p.mean = s.constants < 0 ? T_a * to_here.motion : T_a * (to_here.motion * G::Exp(to_here.A * c));
  const bool bounded = s.persistent.bounded();
  if (p.second < 0 && !bounded) {
    const DriftResidual<G> r(to_here, T_a, p.mean, c);
    p.A = -r.J_a;
    p.C = -r.J_c;
    p.noise = to_here.covariance;
    return p;
  }
  DriftFactor<G> onwards;
  if (p.second >= 0) onwards = drift_between(state, slam(p.second), s);
  const typename G::Covariance W_a = inverse_covariance(to_here.covariance);
  const typename G::Covariance W_b =
      p.second >= 0 ? inverse_covariance(onwards.covariance) : G::Covariance::Zero().eval();
  LocalPose<G> local;
  for (int iteration = 0; iteration < 4; ++iteration) {
    local = {};
    const DriftResidual<G> r_a(to_here, T_a, p.mean, c);
    local.add(r_a.r, W_a, r_a.J_b, local.H_first, r_a.J_a, r_a.J_c);
    if (p.second >= 0) {
      const DriftResidual<G> r_b(onwards, p.mean, at_.pose(p.second), c);
      local.add(r_b.r, W_b, r_b.J_a, local.H_second, r_b.J_b, r_b.J_c);
    }
    if constexpr (G::Dim == 3) {
      const auto add = [&](const BoundedFactor& f, const G& T_0, const G& T_1, bool here_is_second, auto& H_other) {
        const BoundedResidual r(f, &T_0, T_1, c[2]);
        Eigen::Matrix3d J_c = Eigen::Matrix3d::Zero();
        J_c.col(2) = r.J_c;
        const Eigen::Matrix3d W = f.information.asDiagonal();
        if (here_is_second) local.add(r.r, W, r.J_b, H_other, r.J_a, J_c);
        else local.add(r.r, W, r.J_a, H_other, r.J_b, J_c);
      };
      if (bounded) add(bounded_between(&slam(before), state, s), T_a, p.mean, true, local.H_first);
      if (bounded && p.second >= 0)
        add(bounded_between(&state, slam(p.second), s), p.mean, at_.pose(p.second), false, local.H_second);
    }
    p.mean = p.mean * G::Exp(local.H.ldlt().solve(local.g));
  }
  p.noise = inverse_covariance(local.H);
  p.A = -p.noise * local.H_first;
  p.B = -p.noise * local.H_second;
  p.C = -p.noise * local.H_constants;
  return p;
}

template <class G>
std::vector<std::pair<int, Eigen::MatrixXd>> Map<G>::parts(const Placement& p) const {
  std::vector<std::pair<int, Eigen::MatrixXd>> parts{{p.first, p.A}};
  if (p.second >= 0) parts.emplace_back(p.second, p.B);
  if (p.constants >= 0) parts.emplace_back(problem_->unknown_of_constants(p.constants), p.C);
  return parts;
}

template <class G>
typename G::Covariance Map<G>::covariance(const Placement& a, const Placement& b) {
  typename G::Covariance P = G::Covariance::Zero();
  for (const auto& [i, J_i] : parts(a))
    for (const auto& [j, J_j] : parts(b)) P += J_i * covariances_->between(i, j) * J_j.transpose();
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
  std::vector<int> unknowns;
  Eigen::Index n = 0;
  for (const auto& [unknown, J] : parts(p)) {
    unknowns.push_back(unknown);
    n += J.cols();
  }
  for (const int c : classes) unknowns.push_back(problem_->unknown_of_point(c));
  const Eigen::Index rest = G::Dim * static_cast<Eigen::Index>(classes.size());
  Eigen::MatrixXd F = Eigen::MatrixXd::Zero(G::Dof + rest, n + rest);  // unknowns -> pose and points
  Eigen::Index column = 0;
  for (const auto& [unknown, J] : parts(p)) {
    F.block(0, column, G::Dof, J.cols()) = J;
    column += J.cols();
  }
  F.bottomRightCorner(rest, rest).setIdentity();
  Surroundings<G> around{
      p.mean, p.noise, {}, symmetrised(Eigen::MatrixXd(F * covariances_->joint(unknowns) * F.transpose()))};
  for (const int c : classes) around.points.push_back(at_.point(c));
  return around;
}

template <class G>
std::optional<PointEstimate<G>> Map<G>::landmark(const FactStore<G>& store, const LandmarkFact<G>& l) {
  const AnchorFact<G>* anchor = store.anchor(l.anchor_key());
  const ChainSpan* s = span(l.key.chain);
  if (anchor == nullptr || s == nullptr) return std::nullopt;
  const Placement p = place(*s, anchor->state);
  const typename G::Point position = landmark_scale(l.key.chain) * l.position;
  const typename G::PointJacobian H = p.mean.act_jacobian(position);
  const typename G::PointCovariance R = p.mean.rotation();
  std::vector<std::pair<int, Eigen::MatrixXd>> moved_by = parts(p);
  for (auto& [unknown, J] : moved_by) {
    J = (H * J).eval();
    if (s->persistent.scales_landmarks && unknown == problem_->unknown_of_constants(s->constants))
      J.col(0) += R * l.position;
  }
  typename G::PointCovariance P = H * p.noise * H.transpose() + R * l.covariance * R.transpose();
  for (const auto& [i, J_i] : moved_by)
    for (const auto& [j, J_j] : moved_by) P += J_i * covariances_->between(i, j) * J_j.transpose();
  return PointEstimate<G>{p.mean * position, symmetrised(P)};
}

template <class G>
double Map<G>::landmark_scale(const ChainId& chain) const {
  const ChainSpan* s = span(chain);
  return scales_landmarks(chain) ? 1.0 + at_.constants_of(s->constants)[0] : 1.0;
}

template <class G>
bool Map<G>::scales_landmarks(const ChainId& chain) const {
  const ChainSpan* s = span(chain);
  return s != nullptr && s->persistent.scales_landmarks;
}

template <class G>
PointEstimate<G> Map<G>::class_point(int index) {
  const int unknown = problem_->unknown_of_point(index);
  return {at_.point(index), covariances_->between(unknown, unknown)};
}

template <class G>
std::optional<Estimate<G>> Map<G>::datum() {
  if (problem_->datum < 0) return std::nullopt;
  return Estimate<G>{at_.pose(problem_->datum),
                     symmetrised(typename G::Covariance(covariances_->between(problem_->datum, problem_->datum)))};
}

template <class G>
std::optional<typename Map<G>::Learnt> Map<G>::constants(const ChainId& chain) {
  const ChainSpan* s = span(chain);
  if (s == nullptr || s->constants < 0 || !s->persistent.constant()) return std::nullopt;
  const int unknown = problem_->unknown_of_constants(s->constants);
  const Eigen::MatrixXd P = covariances_->between(unknown, unknown);
  const Constants<G>& c = at_.constants[static_cast<std::size_t>(s->constants)];
  return Learnt{c.template head<2>(), P.diagonal().template head<2>().cwiseSqrt()};
}

template <class G>
std::pair<double, int> Map<G>::contradiction(const AbsoluteFixFactor<G>& f) {
  const G& T = at_.pose(f.node);
  const G D = f.datum < 0 ? G() : at_.pose(f.datum);
  const AbsoluteFixResidual<G> one(f, T, D);
  if (f.datum < 0) return contradiction<G::Dim>(one.r, f.covariance, {{f.node, one.J_T}});
  return contradiction<G::Dim>(one.r, f.covariance, {{f.node, one.J_T}, {f.datum, one.J_D}});
}

template <class G>
std::pair<double, int> Map<G>::contradiction(const EncounterFactor<G>& f) {
  const EncounterResidual<G> one(f, at_.pose(f.observer), at_.pose(f.other));
  return contradiction<G::Dim>(one.r, f.covariance, {{f.observer, one.J_o}, {f.other, one.J_w}});
}

template <class G>
std::pair<double, int> Map<G>::contradiction(const DriftFactor<G>& f) {
  const DriftResidual<G> one(f, at_.pose(f.a), at_.pose(f.b));
  return contradiction<G::Dof>(one.r, f.covariance, {{f.a, one.J_a}, {f.b, one.J_b}});
}

// With w = S^-1/2 r and M = I - S^-1/2 J P J^T S^-T/2, the measurement's own share in its residual taken off, w^T M^-1
// w is what a map without it would find. An eigenvalue of M is s0 / (1 + s0), s0 the variance of the measurement in
// units of that of the map without it; where it is nothing but rounding, nothing but the measurement itself determines
// that direction.
template <class G>
template <int R>
std::pair<double, int> Map<G>::contradiction(
    const Eigen::Matrix<double, R, 1>& r, const Eigen::Matrix<double, R, R>& S,
    const std::vector<std::pair<int, Eigen::Matrix<double, R, G::Dof>>>& jacobians) {
  using Square = Eigen::Matrix<double, R, R>;
  Square JPJ = Square::Zero();
  for (const auto& [i, J_i] : jacobians)
    for (const auto& [j, J_j] : jacobians) JPJ += J_i * covariances_->between(i, j) * J_j.transpose();
  const Eigen::LLT<Square> llt(S);
  const Square half = llt.matrixL().solve(JPJ), whitened = llt.matrixL().solve(half.transpose());
  const Eigen::SelfAdjointEigenSolver<Square> eigen(symmetrised(Square(Square::Identity() - whitened)));
  const Eigen::Matrix<double, R, 1> w = eigen.eigenvectors().transpose() * llt.matrixL().solve(r);
  std::pair<double, int> result{0.0, 0};
  for (int i = 0; i < R; ++i) {
    if (eigen.eigenvalues()[i] < 1e-7) continue;
    result.first += w[i] * w[i] / eigen.eigenvalues()[i];
    ++result.second;
  }
  return result;
}

#define CONVOY_INSTANTIATE(G) template class Map<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
