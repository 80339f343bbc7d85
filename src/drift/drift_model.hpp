// The drift of a SLAM as a state of its own (paper, Section II; DESIGN B1).
//
// What a SLAM reports as its motion between two anchors, U^ = X^_a^-1 X^_b, differs from the true motion by a small
// motion eta in the body frame: T_b = T_a * U^ * Exp(eta). Everybody who holds two anchors of a chain can compute the
// covariance of eta exactly, from the cumulative covariance C that each anchor carries:
//   C_k = C_{k-1} + Ad_{X^_k} Q_k Ad_{X^_k}^T,   Q_ab = Ad_{X^_b}^-1 (C_b - C_a) Ad_{X^_b}^-T          (DESIGN eq. 2)
// so a lost anchor costs nothing. The paper's literal model (eq. 3-4: an additive random walk of the bias with a
// constant covariance per metre) differs in one line only, the accumulation of C; see paper_bias.hpp for eq. 1-4 as
// written.
#pragma once

#include <convoy/submap/facts.hpp>

namespace convoy {

enum class DriftModel : std::uint8_t {
  local,  ///< drift happens where the vehicle is; the default
  /// The paper's eq. 3-4: P_b grows by ds * P_eps, wherever the vehicle is; in space likewise, with six components.
  /// Needs equal rates of translation, and equal rates of rotation or none but about z.
  literal,
};

template <class G>
struct DriftParams {
  DriftModel model = DriftModel::local;
  /// Factor on the covariance the SLAM itself states for its motion, > 0. 1 errs on the safe side (DESIGN B1).
  double gamma = 1.0;
  /// Variance per metre travelled of the drift the SLAM knows nothing of, order (rho, theta): m^2/m and rad^2/m, >= 0.
  /// With DriftModel::literal this is the diagonal of P_eps.
  typename G::Tangent rate = default_rate();
  /// Factor on the covariance of frozen landmarks, >= 1, for the correlations that independent facts neglect.
  double landmark_inflation = 2.0;
  /// Errors that are no random walk: constants of the odometer, which the map then estimates (DESIGN B1.3, F5), and
  /// bounded components. `up` is set by whoever hosts the SLAM. None with DriftModel::literal.
  PersistentDrift persistent = {};

  static typename G::Tangent default_rate();
};

/// Throws ConfigError when a value is out of its range.
template <class G>
void validate(const DriftParams<G>& params);

/// Accumulates C along the path of one chain.
template <class G>
class DriftAccumulator {
 public:
  explicit DriftAccumulator(const DriftParams<G>& params) : params_(params) { validate(params); }

  /// The state after a step of the SLAM. `slam_drift` is the cumulative covariance of the SLAM's own motion, slam
  /// frame (FrontEndState::slam_drift). Call once per step, abscissa not decreasing.
  ChainState<G> advance(double stamp_s, double abscissa_m, const G& pose, const typename G::Covariance& slam_drift);

 private:
  DriftParams<G> params_;
  ChainState<G> state_;
  typename G::Covariance unknown_ = G::Covariance::Zero();
};

/// Motion between two states of one chain and the covariance of its drift, right perturbation.
template <class G>
struct Increment {
  G motion;
  typename G::Covariance covariance;
  /// A_ab of DESIGN B1.3: what one unit of (kappa, g) adds to the motion, right perturbation. The second column is zero
  /// if the chain states no drift of its heading.
  Eigen::Matrix<double, G::Dof, 2> constants = Eigen::Matrix<double, G::Dof, 2>::Zero();
};

/// Q_ab of DESIGN eq. 2, a before b: of first order, and so additive along a chain. Kept positive definite by a floor
/// of (1e-5 m)^2 and (1e-6 rad)^2.
template <class G>
typename G::Covariance first_order_drift(const ChainState<G>& a, const ChainState<G>& b);

/// a before b. The covariance is that of the error's Log to second order (DESIGN B1.5), so that it holds for long ways,
/// too.
template <class G>
Increment<G> increment(const ChainState<G>& a, const ChainState<G>& b);

}  // namespace convoy
