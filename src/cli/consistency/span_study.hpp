// Real drift over spans of what was driven: does the covariance that a drift model predicts for a span hold its error?
#pragma once

#include <convoy/drift/drift_model.hpp>

#include <string>
#include <utility>
#include <vector>

#include "consistency/kitti_data.hpp"

namespace convoy::cli::consistency {

inline constexpr double fit_span_m = 80.0;    ///< of the spans that rates are fitted to (DESIGN B6)
inline constexpr double span_every_m = 25.0;  ///< judged spans begin so far apart: they overlap, and are correlated
inline constexpr double span_lengths_m[] = {25.0, 50.0, 100.0, 200.0, 400.0, 800.0};

/// What the truth itself is uncertain by, each pose: 5 cm and 0.5 mrad (a GPS/INS receiver with a base station).
template <class G>
typename G::Tangent truth_sigma();

/// A model of the drift of a chain: rates, and the variances of its constants (scale, heading rate per metre).
template <class G>
struct SpanModel {
  std::string name;
  DriftParams<G> drift;
  Eigen::Vector2d constants = Eigen::Vector2d::Zero();  ///< s_kappa^2, s_g^2 [(rad/m)^2]; zero: none
};

/// The models of the study, fitted to recordings that are not judged: shipped local rates, fitted local rates, fitted
/// local rates and constants, fitted literal noise; in this order.
template <class G>
struct FittedModels {
  std::vector<SpanModel<G>> models;
  VarianceFit plain, with_constants;
  std::vector<std::string> chains;  ///< names of the recordings; their constants stand in with_constants, same order
};
template <class G>
FittedModels<G> fit_models(const std::vector<Recording<G>>& calibration);

/// What a fit has found: rates [m^2/m, rad^2/m] and the one-sigma of the constants [1, rad/m].
struct FitFigures {
  std::string fitted_on;
  double plain_translation = 0.0, plain_rotation = 0.0;                  ///< local, rates alone
  double translation = 0.0, rotation = 0.0, scale = 0.0, heading = 0.0;  ///< local, rates and constants
  double literal_translation = 0.0, literal_rotation = 0.0;
  std::vector<std::pair<std::string, Eigen::Vector2d>> constants;  ///< (kappa, g) of each recording that was fitted
};
template <class G>
FitFigures figures_of(const FittedModels<G>& fitted);

/// A part of a recording, and the models that were fitted without it.
template <class G>
struct Fold {
  Recording<G> judged;
  FittedModels<G> fitted;
};

struct SpanFigure {
  double anees = 0.0, coverage95 = 0.0;
  double predicted_position_m = 0.0;  ///< root mean trace of the predicted position covariance
};

struct SpanRow {
  double span_m = 0.0;
  int spans = 0;
  double position_rmse_m = 0.0, rotation_rmse_rad = 0.0;
  std::vector<SpanFigure> models;
};

/// Correlation of neighbouring whitened spans of `fit_span_m` of the judged parts, by the fitted rates (and constants).
struct LagWords {
  double largest = 0.0;  ///< the component with the largest |rho|
  int pairs = 0;
  bool alarm = false;
};

struct SpanStudy {
  std::string name;
  std::string about;      ///< what recording it is
  std::string fitted_on;  ///< what the rates were fitted to, in words
  int dim = 3;
  double length_m = 0.0, scale = 1.0;
  std::vector<std::string> models;
  std::vector<FitFigures> fits;  ///< per fold
  LagWords lag_plain, lag_constants;
  std::vector<SpanRow> rows;  ///< one per length for which there is a span
};

/// All folds together. Spans lie within one fold each.
template <class G>
SpanStudy study_spans(const std::vector<Fold<G>>& folds);

}  // namespace convoy::cli::consistency
