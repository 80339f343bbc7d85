#include <convoy/config_error.hpp>
#include <convoy/drift/calibration.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

namespace convoy {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
using Theta = std::array<double, variance_part_count>;

std::size_t at(VariancePart part) { return static_cast<std::size_t>(part); }

// ---- the cumulative effect of unit parameters along one path, slam frame (eq. 2) ---------------------------------

template <class G>
struct Accumulated {
  typename G::Covariance slam = G::Covariance::Zero(), translation = G::Covariance::Zero(),
                         rotation = G::Covariance::Zero();
  Eigen::Matrix<double, G::Dof, 2> constants = Eigen::Matrix<double, G::Dof, 2>::Zero();
};

template <class G>
typename G::Tangent unit(bool translation) {
  typename G::Tangent d = G::Tangent::Zero();
  if (translation) d.template head<G::Dim>().setOnes();
  else d.template tail<G::Dof - G::Dim>().setOnes();
  return d;
}

template <class G>
std::vector<Accumulated<G>> accumulate(const DrivenPath<G>& path) {
  std::vector<Accumulated<G>> sums(path.states.size());
  for (std::size_t k = 1; k < path.states.size(); ++k) {
    const ChainState<G>&before = path.states[k - 1], &now = path.states[k];
    Accumulated<G> sum = sums[k - 1];
    const double ds = std::max(0.0, now.abscissa_m - before.abscissa_m);
    const typename G::Adjoint Ad = now.pose.adjoint();
    sum.slam = now.drift;
    sum.translation += ds * Ad * unit<G>(true).asDiagonal() * Ad.transpose();
    sum.rotation += ds * Ad * unit<G>(false).asDiagonal() * Ad.transpose();
    // A_k of F5: kappa stretches the step; g turns it about the body's z, half of it felt at the step's end.
    const G U = before.pose.inverse() * now.pose;
    typename G::Tangent yaw = G::Tangent::Zero();
    yaw[G::Dof - 1] = 1.0;
    typename G::Tangent stretch = G::Tangent::Zero(), turn = ds * yaw;
    stretch.template head<G::Dim>() = U.rotation().transpose() * U.translation();
    const typename G::PointJacobian about = G().act_jacobian(U.translation());  // how t moves when turned
    turn.template head<G::Dim>() += 0.5 * ds * U.rotation().transpose() * about.col(G::Dof - 1);
    sum.constants.col(0) += Ad * stretch;
    sum.constants.col(1) += Ad * turn;
    sums[k] = sum;
  }
  return sums;
}

ResidualGroup empty_group(Eigen::Index size, int block) {
  ResidualGroup group;
  group.block = block;
  group.r = Eigen::VectorXd::Zero(size);
  group.fixed = Eigen::MatrixXd::Zero(size, size);
  for (const VariancePart part : {VariancePart::gamma, VariancePart::translation, VariancePart::rotation})
    group.parts[at(part)] = Eigen::MatrixXd::Zero(size, size);
  return group;
}

// A part that moves nothing is left out, so that nobody looks for it. The constants become parts, too: one draw per
// chain.
void finish(ResidualGroup& group) {
  for (Eigen::MatrixXd& part : group.parts)
    if (part.size() != 0 && part.diagonal().maxCoeff() < 1e-11) part.resize(0, 0);  // (3 um)^2: rounding
  for (const Eigen::MatrixXd& U : group.constants)
    for (const auto& [part, column] : {std::pair(VariancePart::scale, 0), std::pair(VariancePart::heading, 1)}) {
      Eigen::MatrixXd& K = group.parts[at(part)];
      if (K.size() == 0) K = Eigen::MatrixXd::Zero(group.r.size(), group.r.size());
      K += U.col(column) * U.col(column).transpose();
    }
}

// ---- likelihood ----------------------------------------------------------------------------------------------------

Eigen::MatrixXd covariance_of(const ResidualGroup& group, const Theta& theta) {
  Eigen::MatrixXd V = group.fixed;
  for (std::size_t p = 0; p < theta.size(); ++p)
    if (group.parts[p].size() != 0) V += theta[p] * group.parts[p];
  return V;
}

// A fit with some parts free and the others held.
class Scoring {
 public:
  Scoring(const std::vector<ResidualGroup>& groups, std::vector<std::size_t> free)
      : groups_(groups), free_(std::move(free)) {}

  struct Result {
    Theta theta;
    double value = -infinity;
    bool converged = false;
  };

  Result maximise(const Theta& start) const {
    Result best{start, log_likelihood(groups_, start), free_.empty()};
    double damping = 1e-3;
    for (int iteration = 0; iteration < 200 && !best.converged; ++iteration) {
      const auto [gradient, information] = derivatives(best.theta);
      bool improved = false;
      while (!improved && damping < 1e6) {
        Eigen::MatrixXd H = information;
        H.diagonal().array() += damping * (information.diagonal().array() + 1e-3);
        const Eigen::VectorXd step = H.ldlt().solve(gradient).cwiseMax(-1.5).cwiseMin(1.5);
        Theta theta = best.theta;
        for (std::size_t i = 0; i < free_.size(); ++i)
          theta[free_[i]] =
              std::clamp(theta[free_[i]] * std::exp(step[static_cast<Eigen::Index>(i)]), smallest, largest);
        const double value = log_likelihood(groups_, theta);
        improved = value > best.value;
        if (improved) {
          best.converged = value - best.value < 1e-7;
          best.theta = theta;
          best.value = value;
          damping = std::max(1e-6, damping * 0.2);
        } else {
          damping *= 6.0;
        }
      }
      if (!improved) best.converged = true;  // no direction is better
    }
    return best;
  }

 private:
  static constexpr double smallest = 1e-14, largest = 1e6;

  // Gradient and Fisher information for log theta: g_p = (r^T V^-1 D_p V^-1 r - tr(V^-1 D_p)) / 2, D_p = theta_p K_p,
  // F_pq = tr(V^-1 D_p V^-1 D_q) / 2.
  std::pair<Eigen::VectorXd, Eigen::MatrixXd> derivatives(const Theta& theta) const {
    const auto n = static_cast<Eigen::Index>(free_.size());
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(n);
    Eigen::MatrixXd information = Eigen::MatrixXd::Zero(n, n);
    for (const ResidualGroup& group : groups_) {
      const Eigen::LLT<Eigen::MatrixXd> llt(covariance_of(group, theta));
      const Eigen::VectorXd w = llt.solve(group.r);
      std::vector<Eigen::MatrixXd> VD(free_.size());
      for (std::size_t i = 0; i < free_.size(); ++i) {
        const Eigen::MatrixXd& K = group.parts[free_[i]];
        if (K.size() == 0) continue;
        VD[i] = theta[free_[i]] * llt.solve(K);
        gradient[static_cast<Eigen::Index>(i)] += 0.5 * (theta[free_[i]] * w.dot(K * w) - VD[i].trace());
        for (std::size_t j = 0; j <= i; ++j)
          if (VD[j].size() != 0) {
            const double f = 0.5 * VD[i].cwiseProduct(VD[j].transpose()).sum();
            information(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) += f;
            if (i != j) information(static_cast<Eigen::Index>(j), static_cast<Eigen::Index>(i)) += f;
          }
      }
    }
    return {gradient, information};
  }

  const std::vector<ResidualGroup>& groups_;
  std::vector<std::size_t> free_;
};

// Where the likelihood, maximised over the others, has fallen by `drop` beside the estimate of part p.
double profile_bound(const std::vector<ResidualGroup>& groups, const std::vector<std::size_t>& free, std::size_t p,
                     const Scoring::Result& best, double direction) {
  constexpr double drop = 0.5 * 3.841;  // chi2_1(0.95) / 2
  std::vector<std::size_t> others;
  for (const std::size_t q : free)
    if (q != p) others.push_back(q);
  const Scoring scoring(groups, others);
  const auto fall = [&](double log_factor) {
    Theta theta = best.theta;
    theta[p] *= std::exp(log_factor);
    return best.value - scoring.maximise(theta).value;
  };
  double inside = 0.0, outside = 0.25 * direction;
  while (fall(outside) < drop) {
    inside = outside;
    outside *= 2.0;
    if (outside < -12.0) return 0.0;
    if (outside > 60.0) return infinity;  // an estimate near zero has a long way to go
  }
  for (int i = 0; i < 16; ++i) {
    const double middle = 0.5 * (inside + outside);
    (fall(middle) < drop ? inside : outside) = middle;
  }
  return best.theta[p] * std::exp(0.5 * (inside + outside));
}

std::vector<ConstantsEstimate> constants_of(const ResidualGroup& group, const Theta& theta) {
  const Eigen::LLT<Eigen::MatrixXd> llt(covariance_of(group, theta));
  const Eigen::Vector2d prior(theta[at(VariancePart::scale)], theta[at(VariancePart::heading)]);
  std::vector<ConstantsEstimate> all;
  for (const Eigen::MatrixXd& U : group.constants) {
    const Eigen::Matrix2d P = prior.asDiagonal();
    const Eigen::Vector2d mean = P * U.transpose() * llt.solve(group.r);
    const Eigen::Matrix2d posterior = P - P * U.transpose() * llt.solve(U) * P;
    all.push_back({mean, posterior.diagonal().cwiseMax(0.0).cwiseSqrt()});
  }
  return all;
}

}  // namespace

const char* to_string(VariancePart part) {
  switch (part) {
    case VariancePart::gamma: return "gamma";
    case VariancePart::translation: return "rate of translation";
    case VariancePart::rotation: return "rate of rotation";
    case VariancePart::scale: return "variance of the scale";
    case VariancePart::heading: return "variance of the heading rate";
  }
  return "unknown";
}

template <class G>
ResidualGroup span_residuals(const DrivenPath<G>& path, const std::vector<G>& truth, double span_m,
                             const typename G::Tangent& truth_sigma) {
  constexpr int D = G::Dof;
  std::vector<std::size_t> ends;
  if (!path.states.empty() && truth.size() == path.states.size()) ends.push_back(0);
  for (std::size_t k = 1; k < truth.size() && !ends.empty(); ++k)
    if (path.states[k].abscissa_m - path.states[ends.back()].abscissa_m >= span_m) ends.push_back(k);
  const auto spans = static_cast<Eigen::Index>(ends.empty() ? 0 : ends.size() - 1);
  ResidualGroup group = empty_group(spans * D, D);
  const std::vector<Accumulated<G>> sums = accumulate(path);
  Eigen::MatrixXd U = Eigen::MatrixXd::Zero(spans * D, 2);
  const typename G::Covariance truth_noise = truth_sigma.cwiseAbs2().asDiagonal();
  for (Eigen::Index n = 0; n < spans; ++n) {
    const std::size_t a = ends[static_cast<std::size_t>(n)], b = ends[static_cast<std::size_t>(n) + 1];
    const G motion = path.states[a].pose.inverse() * path.states[b].pose, true_motion = truth[a].inverse() * truth[b];
    const typename G::Adjoint back = path.states[b].pose.inverse().adjoint(), over = true_motion.inverse().adjoint();
    group.r.segment<D>(n * D) = (motion.inverse() * true_motion).Log();
    const auto set = [&](VariancePart part, const typename G::Covariance& C) {
      group.parts[at(part)].template block<D, D>(n * D, n * D) =
          positive_part(typename G::Covariance(back * C * back.transpose()));
    };
    set(VariancePart::gamma, sums[b].slam - sums[a].slam);
    set(VariancePart::translation, sums[b].translation - sums[a].translation);
    set(VariancePart::rotation, sums[b].rotation - sums[a].rotation);
    U.middleRows<D>(n * D) = back * (sums[b].constants - sums[a].constants);
    group.fixed.block<D, D>(n * D, n * D) = truth_noise + over * truth_noise * over.transpose();
    if (n > 0) {  // the pose between two spans is in both: e_n = .. + d_b, e_{n+1} = .. - Ad d_a
      const Eigen::Matrix<double, D, D> cross = -over * truth_noise;
      group.fixed.block<D, D>(n * D, (n - 1) * D) = cross;
      group.fixed.block<D, D>((n - 1) * D, n * D) = cross.transpose();
    }
  }
  if (spans > 0) group.constants.push_back(U);
  finish(group);
  return group;
}

template <class G>
ResidualGroup closure_residuals(const std::vector<DrivenPath<G>>& paths, const std::vector<Closure<G>>& closures) {
  constexpr int D = G::Dof;
  using Matrix = Eigen::Matrix<double, D, D>;
  const auto state = [&](int path, int index) -> const G& {
    return paths[static_cast<std::size_t>(path)].states[static_cast<std::size_t>(index)].pose;
  };

  // Where each path starts: the first of each connected component at the identity, the others by the first closure that
  // reaches them.
  std::map<int, G> base;
  for (const Closure<G>& first : closures) {
    if (base.count(first.path_a)) continue;
    if (!base.count(first.path_b)) base[first.path_a] = G();
    for (bool progress = true; progress;) {
      progress = false;
      for (const Closure<G>& c : closures) {
        if (base.count(c.path_a) == base.count(c.path_b)) continue;
        progress = true;
        const G Xa = state(c.path_a, c.state_a), Xb = state(c.path_b, c.state_b);
        if (base.count(c.path_a)) base[c.path_b] = base[c.path_a] * Xa * c.T_a_b * Xb.inverse();
        else base[c.path_a] = base[c.path_b] * Xb * c.T_a_b.inverse() * Xa.inverse();
      }
    }
  }

  // r = -n - a_b + Ad_{T_ab^-1} a_a, where a = Ad_{X^^-1} eps is the drift of a path up to there (eps: slam frame).
  struct Term {
    int path, state;
    Matrix A;
  };
  std::vector<std::array<Term, 2>> terms;
  const auto n = static_cast<Eigen::Index>(closures.size());
  ResidualGroup group = empty_group(n * D, D);
  std::vector<std::vector<Accumulated<G>>> sums;
  for (const DrivenPath<G>& path : paths) sums.push_back(accumulate(path));
  for (Eigen::Index i = 0; i < n; ++i) {
    const Closure<G>& c = closures[static_cast<std::size_t>(i)];
    const G Xa = state(c.path_a, c.state_a), Xb = state(c.path_b, c.state_b);
    const bool same = c.path_a == c.path_b;
    const G T_a_b = same ? Xa.inverse() * Xb : (base[c.path_a] * Xa).inverse() * base[c.path_b] * Xb;
    group.r.segment<D>(i * D) = (c.T_a_b.inverse() * T_a_b).Log();
    const Matrix to_b = T_a_b.inverse().adjoint();
    terms.push_back(
        {Term{c.path_a, c.state_a, to_b * Xa.inverse().adjoint()}, Term{c.path_b, c.state_b, -Xb.inverse().adjoint()}});
    group.fixed.block<D, D>(i * D, i * D) += c.covariance;
  }
  Matrix diffuse = Matrix::Identity();
  diffuse.diagonal().template head<G::Dim>().setConstant(900.0);
  const auto same_chain = [&](Eigen::Index i) {
    return closures[static_cast<std::size_t>(i)].path_a == closures[static_cast<std::size_t>(i)].path_b;
  };
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index j = 0; j <= i; ++j) {
      Matrix known = Matrix::Zero(), slam = Matrix::Zero(), translation = Matrix::Zero(), rotation = Matrix::Zero();
      for (const Term& s : terms[static_cast<std::size_t>(i)])
        for (const Term& t : terms[static_cast<std::size_t>(j)]) {
          if (s.path != t.path) continue;
          const Accumulated<G>& sum =
              sums[static_cast<std::size_t>(s.path)][static_cast<std::size_t>(std::min(s.state, t.state))];
          if (!same_chain(i) && !same_chain(j)) known += s.A * diffuse * t.A.transpose();
          slam += s.A * sum.slam * t.A.transpose();
          translation += s.A * sum.translation * t.A.transpose();
          rotation += s.A * sum.rotation * t.A.transpose();
        }
      const auto put = [&](Eigen::MatrixXd& M, const Matrix& value) {
        M.block<D, D>(i * D, j * D) += i == j ? symmetrised(value) : value;
        if (i != j) M.block<D, D>(j * D, i * D) += value.transpose();
      };
      put(group.fixed, known);
      put(group.parts[at(VariancePart::gamma)], slam);
      put(group.parts[at(VariancePart::translation)], translation);
      put(group.parts[at(VariancePart::rotation)], rotation);
    }
  for (std::size_t p = 0; p < paths.size(); ++p) {
    Eigen::MatrixXd U = Eigen::MatrixXd::Zero(n * D, 2);
    for (Eigen::Index i = 0; i < n; ++i)
      for (const Term& t : terms[static_cast<std::size_t>(i)])
        if (t.path == static_cast<int>(p))
          U.middleRows<D>(i * D) += t.A * sums[p][static_cast<std::size_t>(t.state)].constants;
    group.constants.push_back(U);
  }
  if (n == 0) group.constants.clear();
  finish(group);
  return group;
}

std::array<double, variance_part_count> VarianceFit::theta() const {
  Theta theta{};
  for (std::size_t p = 0; p < theta.size(); ++p) theta[p] = parts[p].value;
  return theta;
}

double log_likelihood(const std::vector<ResidualGroup>& groups, const std::array<double, variance_part_count>& theta) {
  double value = 0.0;
  for (const ResidualGroup& group : groups) {
    const Eigen::LLT<Eigen::MatrixXd> llt(covariance_of(group, theta));
    if (llt.info() != Eigen::Success) return -infinity;
    const double log_det = 2.0 * llt.matrixLLT().diagonal().array().log().sum();
    value -= 0.5 * (log_det + llt.matrixL().solve(group.r).squaredNorm() +
                    static_cast<double>(group.r.size()) * std::log(2.0 * M_PI));
  }
  return value;
}

VarianceFit fit_variances(const std::vector<ResidualGroup>& groups, const VarianceFitParams& params) {
  VarianceFit fit;
  for (const ResidualGroup& group : groups) fit.residuals += static_cast<int>(group.r.size());
  if (fit.residuals == 0)
    throw ConfigError("calibration: no residual to learn from; drive further than one span, or until loops close");
  std::vector<std::size_t> free;
  Theta start = params.start;
  for (std::size_t p = 0; p < start.size(); ++p) {
    const bool constant = p >= at(VariancePart::scale);
    const bool there =
        std::any_of(groups.begin(), groups.end(), [&](const ResidualGroup& g) { return g.parts[p].size() != 0; });
    const bool held = params.hold_gamma && p == at(VariancePart::gamma);
    if (there && !held && (!constant || params.constants)) free.push_back(p);
    else if (constant) start[p] = 0.0;
  }
  const Scoring::Result best = Scoring(groups, free).maximise(start);
  fit.converged = best.converged;
  fit.log_likelihood = best.value;
  for (std::size_t p = 0; p < start.size(); ++p) fit.parts[p] = {false, best.theta[p], 0.0, infinity};
  for (const std::size_t p : free) {
    fit.parts[p].known = true;
    if (!params.intervals) continue;
    fit.parts[p].low = profile_bound(groups, free, p, best, -1.0);
    fit.parts[p].high = profile_bound(groups, free, p, best, 1.0);
  }
  for (const ResidualGroup& group : groups) {
    const Eigen::LLT<Eigen::MatrixXd> llt(covariance_of(group, best.theta));
    fit.chi2 += llt.matrixL().solve(group.r).squaredNorm();
    if (params.constants) fit.constants.push_back(constants_of(group, best.theta));
  }
  return fit;
}

bool Lag1::alarm() const {
  if (pairs < 4) return false;
  return rho.cwiseAbs().maxCoeff() > std::max(lag1_limit, 2.6 / std::sqrt(static_cast<double>(pairs)));
}

Lag1 lag1_correlation(const std::vector<ResidualGroup>& groups, const std::array<double, variance_part_count>& theta) {
  Lag1 lag;
  Eigen::VectorXd products, squares;
  for (const ResidualGroup& group : groups) {
    const Eigen::Index D = group.block;
    if (products.size() != D) lag.rho = products = squares = Eigen::VectorXd::Zero(D);
    const Eigen::LLT<Eigen::MatrixXd> llt(covariance_of(group, theta));
    if (llt.info() != Eigen::Success) continue;
    const Eigen::VectorXd w = llt.matrixL().solve(group.r);  // in the order of driving: innovations
    for (Eigen::Index k = D; k + D <= w.size(); k += D) {
      products += w.segment(k, D).cwiseProduct(w.segment(k - D, D));
      squares += 0.5 * (w.segment(k, D).cwiseAbs2() + w.segment(k - D, D).cwiseAbs2());
      ++lag.pairs;
    }
  }
  for (Eigen::Index d = 0; d < products.size(); ++d) lag.rho[d] = squares[d] > 0.0 ? products[d] / squares[d] : 0.0;
  return lag;
}

PartEstimate inflation_estimate(double chi2, int dof) {
  if (dof <= 0 || !(chi2 > 0.0)) return {};
  return {true, chi2 / dof, chi2 / chi2_quantile(0.975, dof), chi2 / chi2_quantile(0.025, dof)};
}

#define CONVOY_INSTANTIATE(G)                                                                \
  template ResidualGroup span_residuals(const DrivenPath<G>&, const std::vector<G>&, double, \
                                        const typename G::Tangent&);                         \
  template ResidualGroup closure_residuals(const std::vector<DrivenPath<G>>&, const std::vector<Closure<G>>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
