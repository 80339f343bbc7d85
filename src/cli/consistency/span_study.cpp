#include "consistency/span_study.hpp"

#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <cmath>

#include "consistency/literal_fit.hpp"

namespace convoy::cli::consistency {
namespace {

template <class G>
TrueTrack<G> track_of(const Recording<G>& recording) {
  TrueTrack<G> track;
  for (std::size_t k = 0; k < recording.truth.size(); ++k)
    track.steps.push_back({recording.slam.states[k], recording.truth[k]});
  return track;
}

// The states with the cumulative covariance of a model.
template <class G>
std::vector<ChainState<G>> accumulated(const Recording<G>& recording, const DriftParams<G>& drift) {
  DriftAccumulator<G> accumulator(drift);
  std::vector<ChainState<G>> states;
  for (const ChainState<G>& s : recording.slam.states)
    states.push_back(accumulator.advance(s.stamp_s, s.abscissa_m, s.pose, G::Covariance::Zero()));
  return states;
}

// First state at least `ahead_m` beyond state `from`; the number of states if there is none.
template <class G>
std::size_t ahead(const std::vector<ChainState<G>>& states, std::size_t from, double ahead_m) {
  std::size_t k = from;
  while (k < states.size() && states[k].abscissa_m - states[from].abscissa_m < ahead_m) ++k;
  return k;
}

struct ModelSum {
  double nees = 0.0, trace = 0.0;
  int inside = 0;
};

struct LengthSum {
  int spans = 0;
  double squared_position = 0.0, squared_rotation = 0.0;
  std::vector<ModelSum> models;
};

template <class G>
void add_fold(const Fold<G>& fold, double span_m, LengthSum& sum) {
  constexpr int D = G::Dof;
  const double limit = chi2_quantile(0.95, D);
  const auto& states = fold.judged.slam.states;
  const auto& models = fold.fitted.models;
  std::vector<std::vector<ChainState<G>>> of_model;
  for (const SpanModel<G>& model : models) of_model.push_back(accumulated(fold.judged, model.drift));
  sum.models.resize(models.size());
  for (std::size_t a = 0; a < states.size(); a = ahead(states, a, span_every_m)) {
    const std::size_t b = ahead(states, a, span_m);
    if (b >= states.size()) break;
    const Recording<G> span = part_of(fold.judged, a, b + 1);
    const ResidualGroup group = span_residuals(span.slam, span.truth, span_m, truth_sigma<G>());
    const typename G::Tangent e = group.r;
    ++sum.spans;
    sum.squared_position += e.template head<G::Dim>().squaredNorm();
    sum.squared_rotation += e.template tail<D - G::Dim>().squaredNorm();
    for (std::size_t m = 0; m < models.size(); ++m) {
      const typename G::Covariance fixed = group.fixed;
      const Eigen::Matrix<double, D, 2> U = group.constants.front();
      const typename G::Covariance V =
          symmetrised(typename G::Covariance(increment(of_model[m][a], of_model[m][b]).covariance + fixed +
                                             U * models[m].constants.asDiagonal() * U.transpose()));
      const double squared_distance = squared_mahalanobis(e, V);
      sum.models[m].nees += squared_distance / D;
      sum.models[m].inside += squared_distance <= limit ? 1 : 0;
      sum.models[m].trace += V.template topLeftCorner<G::Dim, G::Dim>().trace();
    }
  }
}

LagWords lag_of(const std::vector<Lag1>& lags) {
  // Over the folds: the mean by pairs, each component.
  LagWords words;
  Lag1 all;
  for (const Lag1& lag : lags) {
    if (lag.pairs == 0) continue;
    if (all.pairs == 0) all.rho = Eigen::VectorXd::Zero(lag.rho.size());
    all.rho += lag.pairs * lag.rho;
    all.pairs += lag.pairs;
  }
  if (all.pairs == 0) return words;
  all.rho /= all.pairs;
  Eigen::Index at = 0;
  all.rho.cwiseAbs().maxCoeff(&at);
  return {all.rho[at], all.pairs, all.alarm()};
}

}  // namespace

template <class G>
FitFigures figures_of(const FittedModels<G>& fitted) {
  const auto value = [](const VarianceFit& fit, VariancePart part) { return fit[part].value; };
  const VarianceFit &plain = fitted.plain, &with = fitted.with_constants;
  const typename G::Tangent literal = fitted.models.back().drift.rate;
  FitFigures f;
  f.plain_translation = value(plain, VariancePart::translation);
  f.plain_rotation = value(plain, VariancePart::rotation);
  f.translation = value(with, VariancePart::translation);
  f.rotation = value(with, VariancePart::rotation);
  f.scale = std::sqrt(value(with, VariancePart::scale));
  f.heading = std::sqrt(value(with, VariancePart::heading));
  f.literal_translation = literal[0];
  f.literal_rotation = literal[G::Dof - 1];
  for (std::size_t i = 0; i < fitted.chains.size(); ++i) {
    f.constants.emplace_back(fitted.chains[i], with.constants[i].front().mean);
    f.fitted_on += (i == 0 ? "" : ", ") + fitted.chains[i];
  }
  return f;
}

template <class G>
typename G::Tangent truth_sigma() {
  typename G::Tangent sigma;
  sigma.template head<G::Dim>().setConstant(0.05);
  sigma.template tail<G::Dof - G::Dim>().setConstant(5e-4);
  return sigma;
}

template <class G>
FittedModels<G> fit_models(const std::vector<Recording<G>>& calibration) {
  FittedModels<G> fitted;
  std::vector<ResidualGroup> groups;
  std::vector<TrueTrack<G>> tracks;
  for (const Recording<G>& recording : calibration) {
    groups.push_back(span_residuals(recording.slam, recording.truth, fit_span_m, truth_sigma<G>()));
    tracks.push_back(track_of(recording));
    fitted.chains.push_back(recording.name);
  }
  VarianceFitParams params;
  params.intervals = false;
  fitted.plain = fit_variances(groups, params);
  params.constants = true;
  fitted.with_constants = fit_variances(groups, params);
  const auto local = [](const char* name, const VarianceFit& fit) {
    SpanModel<G> model{name, {}};
    model.drift.rate.template head<G::Dim>().setConstant(fit[VariancePart::translation].value);
    model.drift.rate.template tail<G::Dof - G::Dim>().setConstant(fit[VariancePart::rotation].value);
    model.constants = {fit[VariancePart::scale].value, fit[VariancePart::heading].value};
    return model;
  };
  fitted.models.push_back({"local, shipped rates", {}});
  fitted.models.push_back(local("local, fitted rates", fitted.plain));
  fitted.models.push_back(local("local, fitted rates and constants", fitted.with_constants));
  fitted.models.push_back({"literal, fitted noise", fit_literal(tracks, fit_span_m)});
  return fitted;
}

template <class G>
SpanStudy study_spans(const std::vector<Fold<G>>& folds) {
  SpanStudy study;
  study.dim = G::Dim;
  std::vector<Lag1> plain, with_constants;
  for (const Fold<G>& fold : folds) {
    const auto& states = fold.judged.slam.states;
    study.name = fold.judged.name;
    study.scale = fold.judged.scale;
    study.length_m += states.back().abscissa_m - states.front().abscissa_m;
    study.fits.push_back(figures_of(fold.fitted));
    const std::vector<ResidualGroup> spans{
        span_residuals(fold.judged.slam, fold.judged.truth, fit_span_m, truth_sigma<G>())};
    plain.push_back(lag1_correlation(spans, fold.fitted.plain.theta()));
    with_constants.push_back(lag1_correlation(spans, fold.fitted.with_constants.theta()));
  }
  study.lag_plain = lag_of(plain);
  study.lag_constants = lag_of(with_constants);
  for (const SpanModel<G>& model : folds.front().fitted.models) study.models.push_back(model.name);
  for (const double span_m : span_lengths_m) {
    LengthSum sum;
    for (const Fold<G>& fold : folds) add_fold(fold, span_m, sum);
    if (sum.spans == 0) continue;
    const double n = sum.spans;
    SpanRow row{span_m, sum.spans, std::sqrt(sum.squared_position / n), std::sqrt(sum.squared_rotation / n), {}};
    for (const ModelSum& m : sum.models) row.models.push_back({m.nees / n, m.inside / n, std::sqrt(m.trace / n)});
    study.rows.push_back(std::move(row));
  }
  return study;
}

#define CONVOY_INSTANTIATE(G)                                            \
  template typename G::Tangent truth_sigma<G>();                         \
  template FittedModels<G> fit_models(const std::vector<Recording<G>>&); \
  template FitFigures figures_of(const FittedModels<G>&);                \
  template SpanStudy study_spans(const std::vector<Fold<G>>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli::consistency
