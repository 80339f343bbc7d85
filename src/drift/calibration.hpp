// Learning the drift noise (DESIGN B6): gamma, the rates of unknown drift, and the constants of an odometer, from what
// drives ended up with: against the truth over spans, or, without truth, against the accepted closures.
//
// Both are one problem. Residuals r ~ N(0, V), V = fixed + sum_p theta_p K_p: zero-mean noise whose covariance is
// linear in what is looked for. theta = (gamma, rate of translation, rate of rotation, s_kappa^2, s_g^2); parts that
// say nothing (a SLAM that states no covariance; a model without constants) stay at their start.
#pragma once

#include <convoy/drift/drift_model.hpp>

#include <Eigen/Core>
#include <array>
#include <vector>

namespace convoy {

/// The components of variance that are looked for; the index of each in VarianceFit.
enum class VariancePart : std::uint8_t {
  gamma = 0,        ///< factor on what the SLAM itself states
  translation = 1,  ///< m^2/m, the same in every direction
  rotation = 2,     ///< rad^2/m, the same about every axis
  scale = 3,        ///< s_kappa^2: of the relative error of all distances of one chain (F5)
  heading = 4,      ///< s_g^2, (rad/m)^2: of a heading error per metre of one chain (F5)
};
inline constexpr int variance_part_count = 5;
const char* to_string(VariancePart part);

/// Residuals whose errors may be correlated with each other, and not with those of any other group: those of one run.
struct ResidualGroup {
  Eigen::VectorXd r;      ///< blocks of Dof: whitened, of right perturbations, in the order of driving
  Eigen::MatrixXd fixed;  ///< covariance that is known
  std::array<Eigen::MatrixXd, variance_part_count> parts;  ///< K_p; empty: says nothing
  /// What one unit of (kappa, g) of each chain moves r by. N x 2 each.
  std::vector<Eigen::MatrixXd> constants;
  int block = 3;  ///< Dof
};

/// What was driven: states in small steps (a metre or so), the first one the start; `drift` is the cumulative
/// covariance that the SLAM itself states, slam frame, without any factor or rate of ours.
template <class G>
struct DrivenPath {
  std::vector<ChainState<G>> states;
};

/// Residuals e = Log(U^_ab^-1 T_a^-1 T_b) against the truth, over consecutive spans of at least `span_m`: single
/// increments would ignore that neighbouring ones are correlated. `truth`: one pose per state, any frame.
/// `truth_sigma`: of the truth, each pose, order (rho, theta). Empty if the path is shorter than a span.
template <class G>
ResidualGroup span_residuals(const DrivenPath<G>& path, const std::vector<G>& truth, double span_m,
                             const typename G::Tangent& truth_sigma);

/// "From state a of one path to state b of another (or the same) it is z": an accepted hypothesis' alignment.
template <class G>
struct Closure {
  int path_a = 0, state_a = 0, path_b = 0, state_b = 0;
  G T_a_b;
  typename G::Covariance covariance = G::Covariance::Zero();  ///< of a right perturbation of T_a_b
};

/// Residuals r = Log(z^-1 T_a^-1 T_b) of closures against dead reckoning, before anything is fused. Where the paths
/// start relative to each other is taken as unknown (30 m, 1 rad about what the first closures say), so that static
/// biases do not matter. One group per call, correlations between closures that share road included.
template <class G>
ResidualGroup closure_residuals(const std::vector<DrivenPath<G>>& paths, const std::vector<Closure<G>>& closures);

struct PartEstimate {
  bool known = false;  ///< false: the residuals say nothing of it
  double value = 0.0;
  double low = 0.0, high = 0.0;  ///< 95 %, profile likelihood; low 0 / high infinite: not bounded on that side
};

/// Posterior of the constants of one chain.
struct ConstantsEstimate {
  Eigen::Vector2d mean =
      Eigen::Vector2d::Zero();  ///< (kappa, g): true distance is (1 + kappa) times what was said; g [rad/m]
  Eigen::Vector2d sigma = Eigen::Vector2d::Zero();
};

struct VarianceFit {
  std::array<PartEstimate, variance_part_count> parts;
  double log_likelihood = 0.0;
  int residuals = 0;  ///< number of scalars
  double chi2 = 0.0;  ///< sum r^T V^-1 r at the estimate; about `residuals`
  bool converged = false;
  std::vector<std::vector<ConstantsEstimate>> constants;  ///< per group, per chain; empty if not fitted
  const PartEstimate& operator[](VariancePart part) const { return parts[static_cast<std::size_t>(part)]; }
  std::array<double, variance_part_count> theta() const;
};

struct VarianceFitParams {
  bool constants = false;   ///< look for s_kappa, s_g, too
  bool hold_gamma = false;  ///< at its start
  bool intervals = true;
  std::array<double, variance_part_count> start{1.0, 1e-4, 1e-6, 1e-4, 1e-7};
};

/// Maximum likelihood by Fisher scoring on log theta; deterministic. Throws ConfigError if no residual is there.
VarianceFit fit_variances(const std::vector<ResidualGroup>& groups, const VarianceFitParams& params = {});

/// log density of all groups at theta; -infinity if a covariance is not positive definite.
double log_likelihood(const std::vector<ResidualGroup>& groups, const std::array<double, variance_part_count>& theta);

/// Is the drift white? Correlation of each component of whitened residuals with the one before it.
struct Lag1 {
  Eigen::VectorXd rho;  ///< per component, order (rho, theta)
  int pairs = 0;
  /// Some |rho| > 0.3, and by more than chance allows: 0.3 is one sigma of eleven pairs, so that small sets are judged
  /// by 2.6 / sqrt(pairs). Then a constant is at work, or anchors are too close.
  bool alarm() const;
};
inline constexpr double lag1_limit = 0.3;
Lag1 lag1_correlation(const std::vector<ResidualGroup>& groups, const std::array<double, variance_part_count>& theta);

/// A factor on covariances from the chi-square they give: sum / dof, with its 95 % interval.
PartEstimate inflation_estimate(double chi2, int dof);

}  // namespace convoy
