#include "calibrate.hpp"

#include <convoy/association/alignment.hpp>
#include <convoy/config_error.hpp>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "evaluate/run_folder.hpp"
#include "evaluate/truth.hpp"
#include "scenario/json_fault.hpp"
#include "scenario/table_file.hpp"

namespace convoy::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr double shortest_span_m = 10.0;

Key key_of(const json& list) { return {{list.at(0), list.at(1)}, list.at(2)}; }

template <class Matrix>
Matrix upper(const json& list) {
  Matrix P;
  std::size_t n = 0;
  for (Eigen::Index i = 0; i < P.rows(); ++i)
    for (Eigen::Index j = i; j < P.cols(); ++j) P(i, j) = P(j, i) = list.at(n++);
  return P;
}

AnchorFact<SE2> anchor_from(const json& line) {
  AnchorFact<SE2> fact;
  fact.key = key_of(line.at("key"));
  fact.state.stamp_s = line.at("stamp_s");
  fact.state.abscissa_m = line.at("abscissa_m");
  const json& pose = line.at("slam");
  fact.state.pose = SE2(pose.at(0), pose.at(1), pose.at(2));
  fact.state.drift = upper<SE2::Covariance>(line.at("drift"));
  fact.first_landmark = line.at("first_landmark");
  fact.landmark_count = line.at("landmark_count");
  return fact;
}

// With what the vehicle had put on top taken off again.
LandmarkFact<SE2> landmark_from(const json& line, double inflation) {
  LandmarkFact<SE2> fact;
  fact.key = key_of(line.at("key"));
  fact.anchor = line.at("anchor");
  fact.position = SE2::Point(line.at("position").at(0), line.at("position").at(1));
  fact.covariance = upper<SE2::PointCovariance>(line.at("covariance")) / inflation;
  const json& loading = line.at("loading");
  for (Eigen::Index i = 0; i < fact.loading.size(); ++i)
    fact.loading(i) = loading.at(static_cast<std::size_t>(i)).get<double>() / std::sqrt(inflation);
  return fact;
}

// One run as the estimator needs it.
struct Run {
  RunRecord<SE2> record;
  FactStore<SE2> store;
  bool loadings = true;
  std::map<VehicleId, DriftParams<SE2>> params;
  std::vector<VehicleId> vehicles;  // of `paths`
  std::vector<ChainId> chains;      // likewise
  std::vector<DrivenPath<SE2>> paths;
};

FactStore<SE2> read_facts(const fs::path& file, const std::map<VehicleId, DriftParams<SE2>>& params, bool& loadings) {
  FactStore<SE2> store;
  std::istringstream lines(read_text_file(file));
  std::size_t number = 0;
  for (std::string text; std::getline(lines, text);) {
    ++number;
    const auto refuse = [&](const std::string& what) {
      throw ConfigError(file.string() + ":" + std::to_string(number) + ": " + what + "; the run has to be repeated");
    };
    try {
      const json line = json::parse(text);
      Insertion insertion = Insertion::inserted;
      if (line.at("kind") == "anchor") insertion = store.insert(anchor_from(line));
      if (line.at("kind") == "landmark") {
        loadings = loadings && line.contains("loading");
        const auto known = params.find(key_of(line.at("key")).chain.vehicle);
        if (loadings)
          insertion = store.insert(landmark_from(line, known == params.end() ? 1.0 : known->second.landmark_inflation));
      }
      if (insertion != Insertion::inserted)
        refuse(std::string("no fact that can be used (") + to_string(insertion) + ")");
    } catch (const json::exception& error) {
      refuse("not what it should be: " + json_fault(error, text));
    }
  }
  return store;
}

// What the vehicle drove, with what its SLAM itself stated: the unknown rate and gamma of its configuration are taken
// off.
DrivenPath<SE2> driven_path(const std::vector<PoseRow<SE2>>& trajectory, const AnchorFact<SE2>* start,
                            const DriftParams<SE2>& params) {
  DrivenPath<SE2> path;
  if (start != nullptr) path.states.push_back(start->state);
  SE2::Covariance unknown = SE2::Covariance::Zero();
  for (const PoseRow<SE2>& row : trajectory) {
    if (!row.slam) continue;
    if (!path.states.empty() && row.abscissa_m <= path.states.back().abscissa_m &&
        row.t_s <= path.states.back().stamp_s)
      continue;
    ChainState<SE2> state{row.t_s, row.abscissa_m, row.slam->T};
    const SE2::Adjoint Ad = state.pose.adjoint();
    const double ds = path.states.empty() ? 0.0 : row.abscissa_m - path.states.back().abscissa_m;
    unknown += ds * Ad * params.rate.asDiagonal() * Ad.transpose();
    state.drift = (Ad * row.slam->P * Ad.transpose() - unknown) / params.gamma;
    path.states.push_back(state);
  }
  return path;
}

Run read_run_for_calibration(const fs::path& folder, const CalibrateOptions& options,
                             std::vector<std::string>& left_out) {
  Run run;
  if (run_dimension(folder) != 2)
    throw ConfigError(folder.string() + ": a run in space; calibrate learns from planar runs only");
  run.record = read_run<SE2>(folder);
  const VehicleRecord<SE2>* witness = run.record.first_survivor();
  if (witness == nullptr) throw ConfigError(folder.string() + ": no vehicle lived to the end of this run; repeat it");
  for (const VehicleRecord<SE2>& v : run.record.vehicles) {
    const fs::path config = vehicle_folder(folder, v.id) / "config.xml";
    run.params[v.id] = options.drift_of_config(config);
    if (run.params[v.id].model == DriftModel::literal)
      throw ConfigError(config.string() +
                        ": a run with the literal drift model, whose covariances are not those of the vehicle's "
                        "drift; repeat the run without --literal");
  }
  run.store = read_facts(vehicle_folder(folder, witness->id) / "facts.jsonl", run.params, run.loadings);
  if (!run.loadings)
    left_out.push_back(folder.string() + ": facts.jsonl without 'loading': landmarks and closures are not used");
  for (const VehicleRecord<SE2>& v : run.record.vehicles) {
    const AnchorFact<SE2>* start = nullptr;
    ChainId chain;
    for (const auto& [id, facts] : run.store.chains())  // the latest epoch is the one that wrote the trajectory
      if (id.vehicle == v.id) {
        chain = id;
        start = run.store.anchor({id, 0});
      }
    if (v.trajectory.empty() || chain.vehicle == 0) {
      left_out.push_back(folder.string() + ": vehicle " + std::to_string(v.id) + " left no trajectory");
      continue;
    }
    run.vehicles.push_back(v.id);
    run.chains.push_back(chain);
    run.paths.push_back(driven_path(v.trajectory, start, run.params[v.id]));
  }
  return run;
}

double length_of(const DrivenPath<SE2>& path) { return path.states.empty() ? 0.0 : path.states.back().abscissa_m; }

// The true pose of the odometer's body frame.
class TrueMotion {
 public:
  TrueMotion(const VehicleRecord<SE2>& vehicle, bool mounted) : vehicle_(vehicle) {
    if (const auto mount = mounted ? find_truth_mount(vehicle.truth) : std::nullopt)
      T_truth_body_ = mount->T_body_truth().inverse();
  }
  std::optional<SE2> operator()(double t_s) const {
    const auto T = truth_at(vehicle_.truth, t_s);
    if (!T) return std::nullopt;
    return *T * T_truth_body_;
  }

 private:
  const VehicleRecord<SE2>& vehicle_;
  SE2 T_truth_body_;
};

struct InflationSum {
  double chi2 = 0.0;
  int dof = 0;
};

// Frozen landmarks against the true ones, batch by batch with their joint covariance.
InflationSum landmarks_against_truth(const Run& run) {
  InflationSum sum;
  std::map<std::uint32_t, Eigen::Vector2d> true_place;
  for (const TruthLandmark<SE2>& l : run.record.landmarks) true_place[l.id] = l.p_world_m;
  for (std::size_t p = 0; p < run.paths.size(); ++p) {
    const VehicleRecord<SE2>& v = *run.record.find(run.vehicles[p]);
    const TrueMotion truth(v, run.record.scenario == "mrclam");
    for (const auto& [anchor, indices] : run.store.chains().at(run.chains[p]).batches) {
      const Batch<SE2> batch = batch_of(run.store, {run.chains[p], anchor});
      const AnchorFact<SE2>* fact = run.store.anchor(batch.anchor);
      const auto T = fact == nullptr ? std::nullopt : truth(fact->state.stamp_s);
      if (!T) continue;
      std::vector<const LandmarkFact<SE2>*> known;
      Eigen::VectorXd r(2 * static_cast<Eigen::Index>(batch.landmarks.size()));
      for (const LandmarkFact<SE2>& l : batch.landmarks) {
        const auto track = v.track_of_landmark.find({l.key.chain.epoch, l.key.index});
        if (track == v.track_of_landmark.end() || !true_place.count(track->second)) continue;
        r.segment<2>(2 * static_cast<Eigen::Index>(known.size())) =
            l.position - T->inverse() * true_place[track->second];
        known.push_back(&l);
      }
      const auto n = static_cast<Eigen::Index>(known.size());
      Eigen::MatrixXd S(2 * n, 2 * n);
      for (Eigen::Index i = 0; i < n; ++i)
        for (Eigen::Index j = 0; j < n; ++j) {
          const auto &a = *known[static_cast<std::size_t>(i)], &b = *known[static_cast<std::size_t>(j)];
          S.block<2, 2>(2 * i, 2 * j) =
              i == j ? Eigen::Matrix2d(a.covariance) : Eigen::Matrix2d(a.loading * b.loading.transpose());
        }
      const Eigen::LLT<Eigen::MatrixXd> llt(S);
      if (n == 0 || llt.info() != Eigen::Success) continue;
      sum.chi2 += llt.matrixL().solve(r.head(2 * n)).squaredNorm();
      sum.dof += static_cast<int>(2 * n);
    }
  }
  return sum;
}

struct Aligned {
  Key batch_a, batch_b;
  Alignment<SE2> alignment;
};

// The accepted hypotheses of the run's map, aligned again with the covariances of the landmarks alone.
std::vector<Aligned> alignments_of(const Run& run) {
  std::vector<Aligned> all;
  for (const MapAssociation& association : run.record.first_survivor()->map->associations) {
    if (!association.accepted || association.pairings.empty()) continue;
    const auto anchor_of = [&](const Key& key) -> std::optional<Key> {
      const LandmarkFact<SE2>* l = run.store.landmark(key);
      return l == nullptr ? std::nullopt : std::optional(l->anchor_key());
    };
    const auto a = anchor_of(association.pairings.front().first), b = anchor_of(association.pairings.front().second);
    if (!a || !b) continue;
    const Batch<SE2> batch_a = batch_of(run.store, *a), batch_b = batch_of(run.store, *b);
    const auto place = [](const Batch<SE2>& batch, const Key& key) {
      const auto it =
          std::find_if(batch.landmarks.begin(), batch.landmarks.end(), [&](const auto& l) { return l.key == key; });
      return it == batch.landmarks.end() ? -1 : static_cast<int>(it - batch.landmarks.begin());
    };
    std::vector<IndexPairing> pairs;
    for (const auto& [i, j] : association.pairings)
      if (place(batch_a, i) >= 0 && place(batch_b, j) >= 0) pairs.emplace_back(place(batch_a, i), place(batch_b, j));
    if (pairs.size() < 3) continue;
    if (const auto alignment = align(batch_a, batch_b, pairs)) all.push_back({*a, *b, *alignment});
  }
  return all;
}

std::optional<std::pair<int, int>> state_of(const Run& run, const Key& anchor) {
  const auto chain = std::find(run.chains.begin(), run.chains.end(), anchor.chain);
  const AnchorFact<SE2>* fact = run.store.anchor(anchor);
  if (chain == run.chains.end() || fact == nullptr) return std::nullopt;
  const auto path = chain - run.chains.begin();
  const auto& states = run.paths[static_cast<std::size_t>(path)].states;
  for (std::size_t k = 0; k < states.size(); ++k)  // by the pose: the anchor's row, and no other of the same moment
    if (states[k].abscissa_m == fact->state.abscissa_m &&
        (states[k].pose.inverse() * fact->state.pose).Log().norm() < 1e-9)
      return std::pair(static_cast<int>(path), static_cast<int>(k));
  return std::nullopt;
}

std::vector<Closure<SE2>> closures_of(const Run& run, const std::vector<Aligned>& alignments, double inflation) {
  std::vector<std::pair<double, Closure<SE2>>> timed;
  for (const Aligned& a : alignments) {
    const auto one = state_of(run, a.batch_a), other = state_of(run, a.batch_b);
    if (!one || !other) continue;
    const double closed_s =
        std::max(run.store.anchor(a.batch_a)->state.stamp_s, run.store.anchor(a.batch_b)->state.stamp_s);
    timed.push_back({closed_s,
                     {one->first, one->second, other->first, other->second, a.alignment.T_a_b,
                      inflation * a.alignment.covariance()}});
  }
  std::stable_sort(timed.begin(), timed.end(), [](const auto& x, const auto& y) { return x.first < y.first; });
  std::vector<Closure<SE2>> closures;
  for (auto& [t, closure] : timed) closures.push_back(closure);
  return closures;
}

bool has_truth(const Run& run) {
  return !run.record.pose_tolerance && std::all_of(run.vehicles.begin(), run.vehicles.end(),
                                                   [&](VehicleId id) { return !run.record.find(id)->truth.empty(); });
}

class Calibrator {
 public:
  explicit Calibrator(const CalibrateOptions& options) : options_(options) {
    if (options.runs.empty()) throw ConfigError("calibrate: name at least one run folder");
    if (!(options.span_m >= shortest_span_m))
      throw ConfigError("calibrate: --span must be 10 m or more; shorter spans see single increments");
    std::set<fs::path> read;
    for (const fs::path& folder : options.runs)
      if (read.insert(fs::weakly_canonical(folder)).second)
        runs_.push_back(read_run_for_calibration(folder, options, result_.left_out));
      else result_.left_out.push_back(folder.string() + ": named twice, and counted once");
  }

  CalibrationResult run() {
    const bool truth = std::all_of(runs_.begin(), runs_.end(), has_truth);
    if (options_.by == "truth" && !truth)
      throw ConfigError(
          "calibrate: --by truth, and not every run has a folder 'truth' with poses that are more than a coarse "
          "measurement; leave those runs out, or use --by closures");
    result_.by_truth = options_.by == "truth" || (options_.by == "auto" && truth);
    for (const Run& run : runs_) result_.by_truth ? learn_by_truth(run) : learn_by_closures(run);
    result_.landmark_inflation = inflation_estimate(inflation_.chi2, inflation_.dof);
    result_.fit = fit_variances(groups_);
    const PartEstimate& gamma = result_.fit[VariancePart::gamma];
    const bool safe = gamma.known && gamma.low <= 1.0 && 1.0 <= gamma.high;
    result_.with_constants = fit_variances(groups_, {.constants = true});
    const bool constants = result_.constants_found();
    result_.given =
        safe || constants ? fit_variances(groups_, {.constants = constants, .hold_gamma = safe}) : result_.fit;
    result_.lag1 = lag1_correlation(groups_, result_.fit.theta());
    return std::move(result_);
  }

 private:
  void add(InflationSum sum) {
    inflation_.chi2 += sum.chi2;
    inflation_.dof += sum.dof;
  }

  void learn_by_truth(const Run& run) {
    for (std::size_t p = 0; p < run.paths.size(); ++p) {
      const TrueMotion true_motion(*run.record.find(run.vehicles[p]), run.record.scenario == "mrclam");
      DrivenPath<SE2> seen;
      std::vector<SE2> truth;
      for (const ChainState<SE2>& state : run.paths[p].states)
        if (const auto T = true_motion(state.stamp_s)) {
          seen.states.push_back(state);
          truth.push_back(*T);
        }
      const double length_m = length_of(seen);
      const double span_m = std::min(options_.span_m, 0.999 * length_m / 3.0);
      if (span_m < shortest_span_m) {
        left_out(run, p, "drove less than 30 m");
        continue;
      }
      const SE2::Tangent sigma(options_.truth_sigma_m, options_.truth_sigma_m, options_.truth_sigma_rad);
      ResidualGroup group = span_residuals(seen, truth, span_m, sigma);
      if (group.r.size() == 0) continue;
      result_.span_m = result_.span_m == 0.0 ? span_m : std::min(result_.span_m, span_m);
      result_.drives.push_back({run.record.folder.string(), run.vehicles[p], length_m, groups_.size(), 0});
      groups_.push_back(std::move(group));
    }
    if (run.loadings) add(landmarks_against_truth(run));
  }

  void learn_by_closures(const Run& run) {
    if (!run.loadings) return;
    const std::vector<Aligned> alignments = alignments_of(run);
    InflationSum sum;
    for (const Aligned& a : alignments) {
      sum.chi2 += a.alignment.chi2;
      sum.dof += a.alignment.dof;
    }
    add(sum);
    const double inflation = sum.dof > 0 ? std::max(1.0, sum.chi2 / sum.dof) : 1.0;
    const std::vector<Closure<SE2>> closures = closures_of(run, alignments, inflation);
    if (closures.empty()) {
      result_.left_out.push_back(run.record.folder.string() + ": no accepted closure");
      return;
    }
    result_.closures += closures.size();
    for (std::size_t p = 0; p < run.paths.size(); ++p)
      result_.drives.push_back(
          {run.record.folder.string(), run.vehicles[p], length_of(run.paths[p]), groups_.size(), p});
    groups_.push_back(closure_residuals(run.paths, closures));
  }

  void left_out(const Run& run, std::size_t p, const std::string& why) {
    result_.left_out.push_back(run.record.folder.string() + ": vehicle " + std::to_string(run.vehicles[p]) + " " + why);
  }

  const CalibrateOptions& options_;
  std::vector<Run> runs_;
  std::vector<ResidualGroup> groups_;
  InflationSum inflation_;
  CalibrationResult result_;
};

std::string short_number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", value);
  return text;
}

// What the data do not tell from zero is given at the upper end of its interval: that errs on the safe side.
double safe_value(const PartEstimate& e) { return e.known && e.low == 0.0 && std::isfinite(e.high) ? e.high : e.value; }

std::string with_interval(const PartEstimate& e) {
  if (!e.known) return "not observable";
  const std::string high = std::isinf(e.high) ? "unbounded" : short_number(e.high);
  return short_number(e.value) + "  [" + short_number(e.low) + ", " + high + "]";
}

}  // namespace

CalibrationResult calibrate(const CalibrateOptions& options) { return Calibrator(options).run(); }

std::string drift_fragment(const CalibrationResult& r) {
  const auto number = [](double value) {
    std::string text;
    append_number(text, value);
    return text;
  };
  const std::string xy = number(safe_value(r.given[VariancePart::translation]));
  std::string text = "<!-- convoy calibrate, " + std::string(r.by_truth ? "by truth" : "by closures") + ", " +
                     std::to_string(r.drives.size()) + " drives; 95 % intervals: gamma " +
                     with_interval(r.fit[VariancePart::gamma]) + "; rate_x, rate_y " +
                     with_interval(r.given[VariancePart::translation]) + "; rate_theta " +
                     with_interval(r.given[VariancePart::rotation]) + "; landmark_inflation " +
                     with_interval(r.landmark_inflation) + ", never taken below 1 -->\n";
  text += "<drift gamma=\"" + number(std::max(1e-3, safe_value(r.given[VariancePart::gamma]))) +
          "\" rate_x_m2_per_m=\"" + xy + "\" rate_y_m2_per_m=\"" + xy + "\" rate_theta_rad2_per_m=\"" +
          number(safe_value(r.given[VariancePart::rotation])) + "\"";
  if (r.constants_found()) {
    const auto sigma = [&](VariancePart part) { return number(std::min(1.0, std::sqrt(safe_value(r.given[part])))); };
    text += " scale_sigma=\"" + sigma(VariancePart::scale) + "\" heading_sigma_rad_per_m=\"" +
            sigma(VariancePart::heading) + "\"";
  }
  if (r.landmark_inflation.known)
    text += " landmark_inflation=\"" + number(std::max(1.0, r.landmark_inflation.value)) + "\"";
  return text + "/>\n";
}

std::string calibration_text(const CalibrationResult& r) {
  std::string text;
  const auto line = [&](const std::string& what, const std::string& value) {
    text += what + std::string(what.size() < 34 ? 34 - what.size() : 1, ' ') + value + "\n";
  };
  line(r.by_truth ? "against the truth" : "without truth",
       r.by_truth ? std::to_string(r.fit.residuals / 3) + " spans of " + short_number(r.span_m) + " m or more, " +
                        std::to_string(r.drives.size()) + " drives"
                  : std::to_string(r.closures) + " accepted closures, " + std::to_string(r.drives.size()) + " drives");
  line("", "best value  [95 % interval]; the element takes what is not told from zero at its upper end, gamma as 1 as");
  line("", "long as its interval holds 1 and never below 0.001, and landmark_inflation never below 1");
  line("gamma", with_interval(r.fit[VariancePart::gamma]));
  line("rate of x, y [m^2/m]", with_interval(r.fit[VariancePart::translation]));
  line("rate of heading [rad^2/m]", with_interval(r.fit[VariancePart::rotation]));
  if (r.fit[VariancePart::gamma].known && !r.given[VariancePart::gamma].known)
    line("with gamma = 1 (its interval holds it)", with_interval(r.given[VariancePart::translation]) + " m^2/m, " +
                                                       with_interval(r.given[VariancePart::rotation]) + " rad^2/m");
  line("landmark inflation f", with_interval(r.landmark_inflation));
  line("chi-square / residuals",
       short_number(r.fit.chi2 / r.fit.residuals) + (r.fit.converged ? "" : "  (did not converge)"));
  const double gain = std::max(0.0, 2.0 * (r.with_constants.log_likelihood - r.fit.log_likelihood));
  line("constants (kappa, g) explain",
       "2 dlogL = " + short_number(gain) +
           (r.constants_found() ? ": they are there, and the element states them" : ": nothing that chance would not"));
  for (const CalibratedDrive& d : r.drives) {
    const ConstantsEstimate& c = r.with_constants.constants[d.constants_group][d.constants_chain];
    line("  " + d.run + " vehicle " + std::to_string(d.vehicle),
         "kappa " + short_number(c.mean[0]) + " +- " + short_number(c.sigma[0]) + ", g " + short_number(c.mean[1]) +
             " +- " + short_number(c.sigma[1]) + " rad/m, " + short_number(d.length_m) + " m");
  }
  line("with constants: rates", with_interval(r.with_constants[VariancePart::translation]) + " m^2/m, " +
                                    with_interval(r.with_constants[VariancePart::rotation]) + " rad^2/m");
  if (r.lag1 && r.lag1->pairs > 0) {
    std::string rho;
    for (Eigen::Index i = 0; i < r.lag1->rho.size(); ++i) rho += (i ? ", " : "") + short_number(r.lag1->rho[i]);
    line("lag-1 correlation (x, y, heading)",
         rho + " of " + std::to_string(r.lag1->pairs) + " pairs" +
             (r.lag1->alarm() ? "  ALARM: drift is not white; correct the constants, or space anchors further" : ""));
  }
  for (const std::string& what : r.left_out) line("left out", what);
  return text;
}

int run_calibrate(const CalibrateOptions& options) {
  if (!options.out.empty()) expect_writable(options.out.parent_path());
  const CalibrationResult result = calibrate(options);
  std::printf("%s%s", calibration_text(result).c_str(), drift_fragment(result).c_str());
  if (!options.out.empty()) write_text_file(options.out, drift_fragment(result));
  return 0;
}

}  // namespace convoy::cli
