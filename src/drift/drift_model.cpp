#include <convoy/config_error.hpp>
#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

namespace convoy {

template <class G>
typename G::Tangent DriftParams<G>::default_rate() {
  typename G::Tangent rate;
  rate.template head<G::Dim>().setConstant(3e-5);           // 5 mm per sqrt(m)
  rate.template tail<G::Dof - G::Dim>().setConstant(3e-7);  // 0.03 deg per sqrt(m)
  return rate;
}

namespace {

void validate(const PersistentDrift& p, int dim, DriftModel model) {
  const auto within = [](double value, double low, double high) { return value >= low && value <= high; };
  if (!within(p.scale, 0.0, 1.0)) throw ConfigError("drift: scale_sigma must lie in 0..1; 0.01 is one per cent");
  if (!within(p.heading_rad_per_m, 0.0, 1.0))
    throw ConfigError("drift: heading_sigma_rad_per_m must lie in 0..1 rad/m");
  if (!within(p.tilt_rad, 0.0, 1.0) || !within(p.height_m, 0.0, 1e4) || !within(p.correlation_m, 0.0, 1e6))
    throw ConfigError(
        "drift: bounded components need 0 <= tilt_sigma_rad <= 1, 0 <= height_sigma_m <= 1e4 and "
        "0 <= correlation_m <= 1e6");
  if (p.bounded() && dim == 2)
    throw ConfigError("drift: tilt and height are bounded in space only; a plane has neither");
  if (p.bounded() != (p.correlation_m > 0.0))
    throw ConfigError("drift: bounded components need correlation_m > 0, and only they do");
  if (model == DriftModel::literal && (p.bounded() || p.constant()))
    throw ConfigError("drift: the literal model knows no constants and no bounded components; leave them 0");
}

}  // namespace

template <class G>
void validate(const DriftParams<G>& p) {
  if (!(p.gamma > 0.0)) throw ConfigError("drift: gamma must be > 0; 1 is the safe default");
  if (!p.rate.allFinite() || p.rate.minCoeff() < 0.0)
    throw ConfigError("drift: every rate must be >= 0 (m^2/m, rad^2/m)");
  if (!(p.landmark_inflation >= 1.0)) throw ConfigError("drift: landmark_inflation must be >= 1");
  const auto translation = p.rate.template head<G::Dim>();
  if (p.model == DriftModel::literal && (translation.array() != translation[0]).any())
    throw ConfigError(
        "drift: the literal model needs equal rates in x and y (and z), since its noise has no direction");
  const auto tilt = p.rate.template segment<G::Dof - G::Dim - 1>(G::Dim);  // roll and pitch; none in the plane
  const double yaw = p.rate[G::Dof - 1];
  if (p.model == DriftModel::literal && (tilt.array() != 0.0).any() && (tilt.array() != yaw).any())
    throw ConfigError("drift: the literal model needs equal rates of rotation, or none but about z");
  validate(p.persistent, G::Dim, p.model);
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
  if (params_.persistent.heading_rad_per_m > 0.0) state_.heading_lever += ds * pose.adjoint().col(G::Dof - 1);
  state_.stamp_s = stamp_s;
  state_.abscissa_m = abscissa_m;
  state_.pose = pose;
  return state_;
}

namespace {

// What a covariance of first order leaves out. The errors of a way are a random walk on the group, so that to second
// order their Log is sum xi_i + 1/2 sum_{i<j} [xi_i, xi_j]. Of independent xi, the brackets add 1/8 E[ad_x Q ad_x^T]
// with x ~ N(0, Q), which with Q = L L^T is 1/4 sum_{j<k} v v^T, v = [L_k, L_j].
template <class G>
typename G::Covariance second_order(const typename G::Covariance& Q) {
  const typename G::Covariance L = Q.llt().matrixL();
  typename G::Covariance sum = G::Covariance::Zero();
  for (int k = 1; k < G::Dof; ++k) {
    const typename G::Adjoint ad = G::ad(L.col(k));
    for (int j = 0; j < k; ++j) {
      const typename G::Tangent v = ad * L.col(j);
      sum += v * v.transpose();
    }
  }
  return 0.25 * sum;
}

}  // namespace

template <class G>
typename G::Covariance first_order_drift(const ChainState<G>& a, const ChainState<G>& b) {
  const typename G::Adjoint Ad = b.pose.inverse().adjoint();
  typename G::Tangent floor;
  floor.template head<G::Dim>().setConstant(1e-10);
  floor.template tail<G::Dof - G::Dim>().setConstant(1e-12);
  // Between anchors a SLAM may regain information, so that C_b - C_a is indefinite: nothing less than zero is meant.
  typename G::Covariance Q = positive_part(typename G::Covariance(Ad * (b.drift - a.drift) * Ad.transpose()));
  Q.diagonal() += floor;
  // Beside sigmas of kilometres the floor is less than rounding.
  if (Q.llt().info() != Eigen::Success) Q.diagonal().array() += 1e-12 * Q.diagonal().maxCoeff();
  return Q;
}

template <class G>
Increment<G> increment(const ChainState<G>& a, const ChainState<G>& b) {
  const typename G::Covariance Q = first_order_drift(a, b);
  const G motion = a.pose.inverse() * b.pose;
  Eigen::Matrix<double, G::Dof, 2> constants = Eigen::Matrix<double, G::Dof, 2>::Zero();
  constants.template topLeftCorner<G::Dim, 1>() = motion.rotation().transpose() * motion.translation();
  constants.col(1) = b.pose.inverse().adjoint() * (b.heading_lever - a.heading_lever);
  return {motion, Q + second_order<G>(Q), constants};
}

#define CONVOY_INSTANTIATE(G)                                                                    \
  template struct DriftParams<G>;                                                                \
  template void validate(const DriftParams<G>&);                                                 \
  template class DriftAccumulator<G>;                                                            \
  template typename G::Covariance first_order_drift(const ChainState<G>&, const ChainState<G>&); \
  template Increment<G> increment(const ChainState<G>&, const ChainState<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
