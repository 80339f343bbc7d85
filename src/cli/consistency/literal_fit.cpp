#include "consistency/literal_fit.hpp"

#include <Eigen/Cholesky>
#include <cmath>

namespace convoy::cli::consistency {
namespace {

template <class G>
struct Span {
  typename G::Tangent error;                           // Log(U^-1 T_a^-1 T_b)
  typename G::Covariance by_translation, by_rotation;  // covariance per unit rate of each
};

template <class G>
std::vector<Span<G>> spans_of(const std::vector<TrueTrack<G>>& tracks, double span_m) {
  std::vector<Span<G>> spans;
  for (const TrueTrack<G>& track : tracks) {
    if (track.steps.empty()) continue;
    std::size_t a = 0;
    for (std::size_t b = 1; b < track.steps.size(); ++b) {
      const TrueStep<G>&first = track.steps[a], &second = track.steps[b];
      const double ds = second.state.abscissa_m - first.state.abscissa_m;
      if (ds < span_m) continue;
      const G U = first.state.pose.inverse() * second.state.pose;
      const typename G::Adjoint Ad = second.state.pose.inverse().adjoint();
      typename G::Tangent translation = G::Tangent::Zero(), rotation = G::Tangent::Zero();
      translation.template head<G::Dim>().setConstant(ds);
      rotation.template tail<G::Dof - G::Dim>().setConstant(ds);
      spans.push_back({(U.inverse() * first.T_common_body.inverse() * second.T_common_body).Log(),
                       Ad * translation.asDiagonal() * Ad.transpose(), Ad * rotation.asDiagonal() * Ad.transpose()});
      a = b;
    }
  }
  return spans;
}

template <class G>
double cost(const std::vector<Span<G>>& spans, double log_translation, double log_rotation) {
  double sum = 0.0;
  for (const Span<G>& span : spans) {
    const typename G::Covariance C =
        std::exp(log_translation) * span.by_translation + std::exp(log_rotation) * span.by_rotation;
    const Eigen::LLT<typename G::Covariance> llt(C);
    for (Eigen::Index i = 0; i < C.rows(); ++i) sum += 2.0 * std::log(llt.matrixLLT()(i, i));
    sum += llt.matrixL().solve(span.error).squaredNorm();
  }
  return sum;
}

}  // namespace

template <class G>
DriftParams<G> fit_literal(const std::vector<TrueTrack<G>>& calibration, double span_m) {
  const std::vector<Span<G>> spans = spans_of(calibration, span_m);
  double best_translation = std::log(1e-3), best_rotation = std::log(1e-6);
  double best = cost<G>(spans, best_translation, best_rotation);
  for (double step = 2.0; step > 1e-3;) {  // pattern search: two unknowns, one smooth minimum
    bool better = false;
    for (const auto& [dt, dr] : {std::pair{step, 0.0}, {-step, 0.0}, {0.0, step}, {0.0, -step}}) {
      const double value = cost<G>(spans, best_translation + dt, best_rotation + dr);
      if (!(value < best)) continue;
      best = value;
      best_translation += dt;
      best_rotation += dr;
      better = true;
      break;
    }
    if (!better) step *= 0.5;
  }
  DriftParams<G> drift;
  drift.model = DriftModel::literal;
  drift.rate.template head<G::Dim>().setConstant(std::exp(best_translation));
  drift.rate.template tail<G::Dof - G::Dim>().setConstant(std::exp(best_rotation));
  return drift;
}

#define CONVOY_INSTANTIATE(G) template DriftParams<G> fit_literal(const std::vector<TrueTrack<G>>&, double);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli::consistency
