#include <convoy/config_error.hpp>
#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <cmath>

namespace convoy {

template <class G>
typename G::Tangent DriftParams<G>::default_rate() {
  typename G::Tangent rate;
  rate.template head<G::Dim>().setConstant(3e-5);             // 5 mm per sqrt(m)
  rate.template tail<G::Dof - G::Dim>().setConstant(3e-7);    // 0.03 deg per sqrt(m)
  return rate;
}

template <class G>
void validate(const DriftParams<G>& p) {
  if (!(p.gamma > 0.0)) throw ConfigError("drift: gamma must be > 0; 1 is the safe default");
  if (!p.rate.allFinite() || p.rate.minCoeff() < 0.0) throw ConfigError("drift: every rate must be >= 0 (m^2/m, rad^2/m)");
  if (!(p.landmark_inflation >= 1.0)) throw ConfigError("drift: landmark_inflation must be >= 1");
  const auto translation = p.rate.template head<G::Dim>();
  if (p.model == DriftModel::literal && (translation.array() != translation[0]).any())
    throw ConfigError("drift: the literal model needs equal rates in x and y (and z), since its noise has no direction");
  const auto tilt = p.rate.template segment<G::Dof - G::Dim - 1>(G::Dim);  // roll and pitch; none in the plane
  const double yaw = p.rate[G::Dof - 1];
  if (p.model == DriftModel::literal && (tilt.array() != 0.0).any() && (tilt.array() != yaw).any())
    throw ConfigError("drift: the literal model needs equal rates of rotation, or none but about z");
}

template <class G>
ChainState<G> DriftAccumulator<G>::advance(double stamp_s, double abscissa_m, const G& pose,
                                           const typename G::Covariance& slam_drift) {
  const double ds = std::max(0.0, abscissa_m - state_.abscissa_m);
  const typename G::Covariance step = (ds * params_.rate).asDiagonal();
  if (params_.model == DriftModel::literal) {
    unknown_ += step;  // eq. 4: P_b(s) = P_b(s-1) + ds P_eps
    state_.drift = unknown_;
  } else {
    const typename G::Adjoint Ad = pose.adjoint();
    unknown_ += Ad * step * Ad.transpose();
    state_.drift = symmetrised(params_.gamma * slam_drift + unknown_);
  }
  state_.stamp_s = stamp_s;
  state_.abscissa_m = abscissa_m;
  state_.pose = pose;
  return state_;
}

template <class G>
Increment<G> increment(const ChainState<G>& a, const ChainState<G>& b) {
  const typename G::Adjoint Ad = b.pose.inverse().adjoint();
  typename G::Tangent floor;
  floor.template head<G::Dim>().setConstant(1e-10);
  floor.template tail<G::Dof - G::Dim>().setConstant(1e-12);
  // Between anchors a SLAM may regain information, so that C_b - C_a is indefinite: nothing less than zero is meant.
  typename G::Covariance Q = positive_part(typename G::Covariance(Ad * (b.drift - a.drift) * Ad.transpose()));
  Q.diagonal() += floor;
  return {a.pose.inverse() * b.pose, Q};
}

#define CONVOY_INSTANTIATE(G)                    \
  template struct DriftParams<G>;                \
  template void validate(const DriftParams<G>&); \
  template class DriftAccumulator<G>;            \
  template Increment<G> increment(const ChainState<G>&, const ChainState<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
