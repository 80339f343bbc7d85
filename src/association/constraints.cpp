#include <convoy/association/constraints.hpp>
#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace convoy {
namespace {

// Effect of a wrong scale and of a turning gyro on the end of a motion, right perturbation: A_k of DESIGN B1.3, which
// takes the way for straight. A way that comes back has its end moved by up to half of what a straight one would have.
template <class G>
typename G::Covariance slack_covariance(const G& motion, double length_m, const DriftSlack& slack) {
  constexpr int Rot = G::Dof - G::Dim;
  const typename G::Point t = motion.rotation().transpose() * motion.translation();
  typename G::Tangent by_scale = G::Tangent::Zero();
  by_scale.template head<G::Dim>() = slack.scale * t;
  typename G::Covariance C = by_scale * by_scale.transpose();
  for (int axis = 0; axis < Rot; ++axis) {
    typename G::Tangent by_heading = G::Tangent::Zero();
    by_heading[G::Dim + axis] = slack.heading_rad_per_m * length_m;
    if constexpr (G::Dim == 2) {
      by_heading.template head<2>() << -t.y(), t.x();
    } else {
      by_heading.template head<3>() = Eigen::Vector3d::Unit(axis).cross(t);
    }
    by_heading.template head<G::Dim>() *= 0.5 * slack.heading_rad_per_m * length_m;
    C += by_heading * by_heading.transpose();
  }
  const double turn = slack.heading_rad_per_m * length_m;
  C.diagonal().template head<G::Dim>().array() +=
      turn * turn * std::max(0.0, length_m * length_m - t.squaredNorm()) / 16.0;
  return C;
}

template <class G>
Increment<G> slack_increment(const ChainState<G>& a, const ChainState<G>& b, const PersistentDrift& persistent,
                             const DriftSlack& slack) {
  Increment<G> drift = increment(a, b);
  drift.covariance += slack_covariance(drift.motion, b.abscissa_m - a.abscissa_m, slack);
  const Eigen::Vector2d sigma(persistent.scale, persistent.heading_rad_per_m);
  drift.covariance += drift.constants * sigma.cwiseAbs2().asDiagonal() * drift.constants.transpose();
  return drift;
}

// Pose of an anchor in the common frame from its static bias and the drift since the start.
template <class G>
RelativePrior<G> absolute_prior(const FactStore<G>& store, const Key& anchor, const DriftSlack& slack) {
  const PriorFact<G>& prior = *store.prior(anchor.chain);
  const Increment<G> drift = slack_increment({}, store.anchor(anchor)->state, prior.persistent, slack);
  const typename G::Adjoint Ad = drift.motion.inverse().adjoint();
  return {prior.mean * drift.motion, Ad * prior.covariance * Ad.transpose() + drift.covariance};
}

}  // namespace

template <class G>
bool complete(const FactStore<G>& store, const Key& anchor) {
  const AnchorFact<G>* fact = store.anchor(anchor);
  if (fact == nullptr || store.prior(anchor.chain) == nullptr) return false;
  const auto& batches = store.chains().at(anchor.chain).batches;
  const auto batch = batches.find(anchor.index);
  if (batch == batches.end()) return fact->landmark_count == 0;
  const auto counted = [&](std::uint32_t index) { return index - fact->first_landmark < fact->landmark_count; };
  return std::count_if(batch->second.begin(), batch->second.end(), counted) == std::int64_t{fact->landmark_count};
}

template <class G>
std::optional<RelativePrior<G>> relative_prior(const FactStore<G>& store, const Key& a, const Key& b,
                                               const DriftSlack& slack) {
  if (a.chain == b.chain) {
    const bool forward = a.index <= b.index;
    const PriorFact<G>* prior = store.prior(a.chain);
    const Increment<G> drift =
        slack_increment(store.anchor(forward ? a : b)->state, store.anchor(forward ? b : a)->state,
                        prior != nullptr ? prior->persistent : PersistentDrift{}, slack);
    if (forward) return RelativePrior<G>{drift.motion, drift.covariance};
    const typename G::Adjoint Ad = drift.motion.adjoint();  // (U Exp(e))^-1 = U^-1 Exp(-Ad_U e)
    return RelativePrior<G>{drift.motion.inverse(), Ad * drift.covariance * Ad.transpose()};
  }
  if (!store.prior(a.chain)->known || !store.prior(b.chain)->known) return std::nullopt;
  const RelativePrior<G> pa = absolute_prior(store, a, slack), pb = absolute_prior(store, b, slack);
  const G T_a_b = pa.mean.inverse() * pb.mean;
  const typename G::Adjoint Ad = T_a_b.inverse().adjoint();
  return RelativePrior<G>{T_a_b, symmetrised(Ad * pa.covariance * Ad.transpose() + pb.covariance)};
}

template <class G>
Batch<G> batch_of(const FactStore<G>& store, const Key& anchor) {
  Batch<G> batch{anchor, {}};
  const auto& chain = store.chains().at(anchor.chain);
  if (const auto it = chain.batches.find(anchor.index); it != chain.batches.end())
    for (const std::uint32_t index : it->second) batch.landmarks.push_back(chain.landmarks.at(index));
  add_scale_error(batch.landmarks, landmark_scale_sigma(store, anchor.chain));
  return batch;
}

template <class G>
double landmark_scale_sigma(const FactStore<G>& store, const ChainId& chain) {
  const PriorFact<G>* prior = store.prior(chain);
  return prior != nullptr && prior->persistent.scales_landmarks ? prior->persistent.scale : 0.0;
}

// The columns of [L, sigma l], turned so that the strongest come first; what the weakest says becomes each one's own.
template <class G>
void add_scale_error(std::vector<LandmarkFact<G>>& landmarks, double sigma) {
  if (sigma == 0.0) return;
  constexpr int Columns = G::Shared + 1;
  using Gram = Eigen::Matrix<double, Columns, Columns>;
  using Wide = Eigen::Matrix<double, G::Dim, Columns>;
  const auto with_scale = [&](const LandmarkFact<G>& l) {
    Wide all;
    all << l.loading, sigma * l.position;
    return all;
  };
  Gram gram = Gram::Zero();
  for (const LandmarkFact<G>& l : landmarks) gram += with_scale(l).transpose() * with_scale(l);
  const Eigen::SelfAdjointEigenSolver<Gram> eigen(gram);  // ascending
  for (LandmarkFact<G>& l : landmarks) {
    const typename G::Loading strongest = with_scale(l) * eigen.eigenvectors().template rightCols<G::Shared>();
    l.covariance += sigma * sigma * l.position * l.position.transpose();
    l.loading = (1.0 - 1e-6) * strongest;  // so that rounding leaves the landmark's own part positive
  }
}

template <class G>
IndividualCompatibility<G>::IndividualCompatibility(const std::optional<RelativePrior<G>>& prior, double confidence)
    : prior_(prior), threshold_(chi2_quantile(confidence, G::Dim)) {}

template <class G>
bool IndividualCompatibility<G>::operator()(const LandmarkFact<G>& i, const LandmarkFact<G>& j) const {
  if (!prior_) return true;
  const typename G::PointJacobian H = prior_->mean.act_jacobian(j.position);
  const auto R = prior_->mean.rotation();
  const typename G::Point nu = i.position - prior_->mean * j.position;  // eq. 5
  const typename G::PointCovariance C =
      i.covariance + R * j.covariance * R.transpose() + H * prior_->covariance * H.transpose();
  return squared_mahalanobis(nu, C) < threshold_;
}

template <class G>
DistanceTable::DistanceTable(const Batch<G>& batch, const std::vector<bool>& used) {
  std::vector<const LandmarkFact<G>*> rows;
  for (std::size_t i = 0; i < batch.landmarks.size(); ++i) {
    row_.push_back(rows.size());
    if (used.empty() || used[i]) rows.push_back(&batch.landmarks[i]);
  }
  n_ = rows.size();
  for (auto* table : {&distance_, &variance_, &turn_variance_}) table->assign(n_ * n_, 0.0);
  for (std::size_t i = 0; i < n_; ++i)
    for (std::size_t j = 0; j < n_; ++j) {
      const typename G::Point d = rows[i]->position - rows[j]->position;
      const double length = d.norm();
      if (i == j || length == 0.0) continue;
      const typename G::Loading L = rows[i]->loading - rows[j]->loading;
      const typename G::PointCovariance S = rows[i]->own_covariance() + rows[j]->own_covariance() + L * L.transpose();
      distance_[i * n_ + j] = length;
      variance_[i * n_ + j] = d.dot(S * d) / (length * length);
      turn_variance_[i * n_ + j] = std::max(0.0, S.trace() - variance_[i * n_ + j]) / (length * length);
    }
}

DistanceCompatibility::DistanceCompatibility(const DistanceTable& a, const DistanceTable& b,
                                             const ConstraintParams& params)
    : a_(a), b_(b), threshold_(chi2_quantile(params.distance, 1)), min_distance_m_(params.min_distance_m) {}

bool DistanceCompatibility::operator()(int i1, int j1, int i2, int j2) const {
  if (i1 == i2 || j1 == j2) return false;
  const double da = a_.distance(i1, i2), db = b_.distance(j1, j2);
  if (da < min_distance_m_ || db < min_distance_m_) return false;
  const double difference = da - db;
  return difference * difference < threshold_ * (a_.variance(i1, i2) + b_.variance(j1, j2));
}

template <class G>
HeadingCompatibility<G>::HeadingCompatibility(const Batch<G>& a, const Batch<G>& b, const DistanceTable& table_a,
                                              const DistanceTable& table_b,
                                              const std::optional<RelativePrior<G>>& prior, double confidence)
    : a_(a), table_a_(table_a), table_b_(table_b) {
  if (!prior) return;
  constexpr int Rot = G::Dof - G::Dim;
  turn_variance_ = eigenvalues(prior->covariance.template bottomRightCorner<Rot, Rot>().eval()).maxCoeff();
  threshold_ = chi2_quantile(confidence, Rot);
  const auto R = prior->mean.rotation();
  for (const auto& l : b.landmarks) b_.push_back(R * l.position);
}

template <class G>
bool HeadingCompatibility<G>::operator()(int i1, int j1, int i2, int j2) const {
  if (b_.empty()) return true;
  const auto in_a = [&](int i) { return a_.landmarks[static_cast<std::size_t>(i)].position; };
  const typename G::Point to_a = in_a(i2) - in_a(i1);
  const typename G::Point to_b = b_[static_cast<std::size_t>(j2)] - b_[static_cast<std::size_t>(j1)];
  const double cosine = to_a.dot(to_b) / std::sqrt(to_a.squaredNorm() * to_b.squaredNorm());
  const double turn = std::acos(std::clamp(cosine, -1.0, 1.0));
  const double variance = turn_variance_ + table_a_.turn_variance(i1, i2) + table_b_.turn_variance(j1, j2);
  return turn * turn < threshold_ * variance;
}

#define CONVOY_INSTANTIATE(G)                                                                          \
  template std::optional<RelativePrior<G>> relative_prior(const FactStore<G>&, const Key&, const Key&, \
                                                          const DriftSlack&);                          \
  template bool complete(const FactStore<G>&, const Key&);                                             \
  template Batch<G> batch_of(const FactStore<G>&, const Key&);                                         \
  template void add_scale_error(std::vector<LandmarkFact<G>>&, double);                                \
  template double landmark_scale_sigma(const FactStore<G>&, const ChainId&);                           \
  template class IndividualCompatibility<G>;                                                           \
  template class HeadingCompatibility<G>;                                                              \
  template DistanceTable::DistanceTable(const Batch<G>&, const std::vector<bool>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
