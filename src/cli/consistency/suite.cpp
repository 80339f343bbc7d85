#include "consistency/suite.hpp"

#include <convoy/config_error.hpp>
#include <convoy/map/ekf_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <memory>
#include <numeric>
#include <thread>

#include "consistency/ekf_slam.hpp"
#include "consistency/exact_model.hpp"
#include "consistency/literal_fit.hpp"
#include "consistency/page.hpp"
#include "consistency/parallel.hpp"
#include "report/svg_plot.hpp"
#include "scenario/table_file.hpp"

namespace convoy::cli::consistency {
namespace {

constexpr std::uint64_t calibration_offset = 1'000'003;
constexpr int calibration_runs = 40;

std::string percent(double share) { return fixed(100.0 * share, 1) + " %"; }

std::string noise_words(double noise) {
  return noise == 1.0 ? std::string() : ", noise x " + fixed(noise, noise == 0.25 ? 2 : noise < 1.0 ? 1 : 0);
}

std::string vehicle_words(int vehicles) {
  return std::to_string(vehicles) + (vehicles == 1 ? " vehicle" : " vehicles");
}

std::string interval_words(const Summary& s) {
  return "ANEES " + fixed(s.anees, 3) + " (" + fixed(s.anees_low, 3) + " to " + fixed(s.anees_high, 3) + ")";
}

// The suite as it grows.
class Suite {
 public:
  explicit Suite(const ConsistencyOptions& options) : start_(std::chrono::steady_clock::now()) {
    if (options.runs < 2)
      throw ConfigError("--runs " + std::to_string(options.runs) + ": an average takes two runs or more");
    result_.options = options;
    result_.calibration_seed = options.seed + calibration_offset;
    if (!options.only.empty()) result_.real_drift.left_out = "Real drift is left out by --only.";
  }

  ConsistencyResult measure() {
    // First: it takes a second, and a damaged file should not come up after minutes.
    plan("real drift", 2.0, [this] { real_drift_part(); });
    exact_part<SE2>();
    exact_part<SE3>();
    ekf_slam_part<SE2>();
    ekf_slam_part<SE3>();
    false_association_part();
    keep_what_is_asked_for();
    for (std::size_t done = 0; done < jobs_.size(); ++done) {
      tell_what_is_left(done);
      jobs_[done].measure();
    }
    return std::move(result_);
  }

 private:
  /// A scenario to measure; without a name, what follows from the ones before.
  struct Job {
    std::string name;
    double core_s = 0.0;  ///< what it takes on one core, about
    std::function<void()> measure;
  };

  void plan(std::string name, double core_s, std::function<void()> measure) {
    jobs_.push_back({std::move(name), core_s, std::move(measure)});
  }
  void conclude(std::function<void()> measure) { plan("", 0.0, std::move(measure)); }

  static std::string dimension(int dim) { return std::to_string(dim) + "-D"; }

  void keep_what_is_asked_for() {
    const std::string& only = result_.options.only;
    std::string names;
    for (const Job& job : jobs_)
      if (!job.name.empty()) names += "\n  " + job.name;
    std::erase_if(jobs_, [&](const Job& job) { return !job.name.empty() && job.name.find(only) == std::string::npos; });
    if (std::all_of(jobs_.begin(), jobs_.end(), [](const Job& job) { return job.name.empty(); }))
      throw ConfigError("--only '" + only + "': in the name of no scenario; they are:" + names);
  }

  // At first by what another machine took; then by how much of that is done.
  void tell_what_is_left(std::size_t done) const {
    if (!result_.options.progress || jobs_[done].name.empty()) return;
    const auto sum = [](double s, const Job& job) { return s + job.core_s; };
    const auto next = jobs_.begin() + static_cast<std::ptrdiff_t>(done);
    const double core_s_done = std::accumulate(jobs_.begin(), next, 0.0, sum);
    const double core_s_left = std::accumulate(next, jobs_.end(), 0.0, sum);
    const double so_far_s = seconds_so_far(), cores = std::max(1U, std::thread::hardware_concurrency());
    const double left_s = so_far_s < 2.0 ? core_s_left / cores : core_s_left * so_far_s / core_s_done;
    if (done > 0 && so_far_s < 2.0) return;
    const auto scenarios = std::count_if(next, jobs_.end(), [](const Job& job) { return !job.name.empty(); });
    std::printf("%6.1f s  %td %s to go, about %.0f s; now: %s\n", so_far_s, scenarios,
                scenarios == 1 ? "scenario" : "scenarios", std::ceil(left_s), jobs_[done].name.c_str());
    std::fflush(stdout);
  }

  double seconds_so_far() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  }

  int runs() const { return result_.options.runs; }
  std::uint64_t seed() const { return result_.options.seed; }

  const Row& add(Row row) {
    result_.rows.push_back(std::move(row));
    const Row& r = result_.rows.back();
    const double seconds = seconds_so_far();
    if (result_.options.progress) {
      std::printf("%6.1f s  %d-D %s, %s, %s: ANEES %.3f, coverage %.3f\n", seconds, r.dim, r.simulator.c_str(),
                  r.scenario.c_str(), r.model.c_str(), r.summary.anees, r.summary.coverage95);
      std::fflush(stdout);
    }
    return r;
  }

  // ---- facts drawn from the model

  template <class G>
  std::vector<RunSample> exact_samples(const ExactModelParams& params, const DriftParams<G>& drift,
                                       const Backend<G>& backend) {
    return each_run(runs(),
                    [&](int run) { return judge_stated(draw_exact_fleet(params, drift, seed(), run), backend); });
  }

  static std::string scenario_of(const ExactModelParams& p) {
    return to_string(p.path) + ", " + vehicle_words(p.vehicles) + noise_words(p.noise);
  }

  /// Scenarios that are judged together, and the same with wrong covariances.
  struct Pool {
    std::vector<Summary> judged, low, high;
  };

  template <class G>
  void plan_exact(const std::string& scenario, double core_s_per_run, std::function<void()> measure) {
    plan(dimension(G::Dim) + " exact model, " + scenario, core_s_per_run * runs(), std::move(measure));
  }

  template <class G>
  void exact_part() {
    const std::string dim = dimension(G::Dim);
    const auto pool = std::make_shared<Pool>();
    for (const ExactModelParams& params : exact_scenarios())
      plan_exact<G>(scenario_of(params), 0.02 * params.vehicles,
                    [this, params, pool] { exact_scenario<G>(params, *pool); });
    conclude([this, dim, pool] {
      if (pool->judged.empty()) return;
      demand_exact(dim, exact_verdict(pool->judged));
      control(dim + " covariance x 0.7", Side::overconfident, exact_verdict(pool->low));
      control(dim + " covariance x 1.5", Side::cautious, exact_verdict(pool->high));
    });
    plan_exact<G>(scenario_of({}) + ", baselines", 0.15, [this, dim] { exact_baselines<G>(dim); });
    persistent_part<G>(dim);
    far_with_full_drift<G>(dim);
  }

  template <class G>
  void exact_scenario(const ExactModelParams& params, Pool& pool) {
    const auto samples = exact_samples(params, matching_drift<G>(params, DriftModel::local), SparseMap<G>());
    pool.judged.push_back(summarise(samples, G::Dof, 1.0, seed()));
    pool.low.push_back(summarise(samples, G::Dof, 0.7, seed()));
    pool.high.push_back(summarise(samples, G::Dof, 1.5, seed()));
    add({"local, sparse map", G::Dim, "exact model", scenario_of(params), pool.judged.back(), true,
         "Facts drawn from the model: what is computed rightly is consistent."});
  }

  static std::vector<ExactModelParams> exact_scenarios() {
    std::vector<ExactModelParams> list;
    const auto scenario = [&](Path path, int vehicles, double noise) {
      ExactModelParams p;
      p.path = path;
      p.vehicles = vehicles;
      p.noise = noise;
      list.push_back(p);
    };
    for (const int vehicles : {1, 2}) {
      scenario(Path::straight, vehicles, 1.0);
      scenario(Path::loop, vehicles, 1.0);
      scenario(Path::figure_eight, vehicles, 1.0);
      scenario(Path::far_origin, vehicles, 0.25);
    }
    scenario(Path::loop, 5, 1.0);
    scenario(Path::loop, 2, 0.5);
    scenario(Path::loop, 2, 2.0);
    return list;
  }

  void demand_exact(const std::string& dim, const ExactVerdict& v) {
    result_.demands.push_back({dim + " exact model: ANEES in the 95 % band", ">= 90 % of the steps",
                               percent(v.steps_in_band) + " of " + std::to_string(v.steps) + " steps",
                               v.steps_in_band >= 0.90, true, ""});
    result_.demands.push_back({dim + " exact model: poses within their 95 % ellipsoid", "93 to 97 %",
                               percent(v.coverage95), v.coverage95 >= 0.93 && v.coverage95 <= 0.97, true, ""});
  }

  void control(const std::string& what, Side side, const ExactVerdict& v) {
    result_.controls.push_back({what,
                                "ANEES " + fixed(v.anees, 3) + ", " + percent(v.steps_in_band) +
                                    " of the steps in band, coverage " + percent(v.coverage95),
                                side, fails_on(side, v)});
  }

  // The same loop and the same draws under the other models.
  template <class G>
  void exact_baselines(const std::string& dim) {
    const ExactModelParams params;
    const std::string scenario = scenario_of(params);
    const auto row = [&](const char* model, const std::vector<RunSample>& samples, const char* remark) {
      return add({model, G::Dim, "exact model", scenario, summarise(samples, G::Dof, 1.0, seed()), false, remark})
          .summary;
    };
    const DriftParams<G> local = matching_drift<G>(params, DriftModel::local);
    row("raw SLAM",
        each_run(runs(), [&](int run) { return judge_raw(draw_exact_fleet(params, local, seed(), run).tracks); }),
        "Each vehicle alone, behind its static bias: honest, and nothing is gained from meeting.");
    row("local, EKF map", exact_samples(params, local, EkfMap<G>()),
        "One linearisation around a start 22 m and 0.3 rad wide, and landmarks of a batch taken as independent.");
    const DriftParams<G> literal = matching_drift<G>(params, DriftModel::literal);
    const Summary s = row("literal, sparse map", exact_samples(params, literal, SparseMap<G>()),
                          "The paper's additive bias with the true rates: overconfident where the loop closes.");
    control(dim + " literal model on the loop", Side::overconfident, exact_verdict({s}));
    papers_own<G>(params, scenario);
    std::vector<TrueTrack<G>> tracks;
    for (int run = 0; run < calibration_runs; ++run)
      for (auto& track : draw_exact_fleet(params, local, result_.calibration_seed, run).tracks)
        tracks.push_back(std::move(track));
    row("literal, fitted noise, sparse map", exact_samples(params, fit_literal(tracks), SparseMap<G>()),
        "The additive bias with the constant covariance that fits 40 other runs of this very path best.");
  }

  template <class G>
  void papers_own(const ExactModelParams& params, const std::string& scenario) {
    const auto samples = exact_samples(params, matching_drift<G>(params, DriftModel::literal), EkfMap<G>());
    add({"literal, EKF map", G::Dim, "exact model", scenario, summarise(samples, G::Dof, 1.0, seed()), false,
         "The paper's own method."});
  }

  // Errors that are no random walk: constants that the map estimates, and in space components that are bounded. Whoever
  // does not say that they are there must fail.
  template <class G>
  void persistent_part(const std::string& dim) {
    ExactModelParams params;
    params.persistent.scale = 0.01;
    params.persistent.heading_rad_per_m = 3e-4;
    plan_persistent<G>(dim, params, "1 % scale and 0.3 mrad/m yaw", "its odometer's scale and turning are estimated");
    params.persistent = {};
    params.persistent.scale = 0.01;
    params.persistent.scales_landmarks = true;
    plan_persistent<G>(dim, params, "1 % scale, of landmarks, too", "it measures the world by its odometer");
    if (G::Dim == 2) return;
    params.persistent = {};
    params.persistent.tilt_rad = 0.01;
    params.persistent.height_m = 0.3;
    params.persistent.correlation_m = 50.0;
    plan_persistent<G>(dim, params, "tilt and height bounded",
                       "what is up and how high it is is measured all the time");
  }

  template <class G>
  void plan_persistent(const std::string& dim, const ExactModelParams& params, const std::string& words,
                       const char* remark) {
    plan_exact<G>(scenario_of(params) + ", " + words, 0.08,
                  [this, dim, params, words, remark] { persistent_rows<G>(dim, params, words, remark); });
  }

  template <class G>
  void persistent_rows(const std::string& dim, const ExactModelParams& params, const std::string& words,
                       const char* remark) {
    const std::string scenario = scenario_of(params) + ", " + words;
    DriftParams<G> drift = matching_drift<G>(params, DriftModel::local);
    const Summary told = summarise(exact_samples(params, drift, SparseMap<G>()), G::Dof, 1.0, seed());
    add({"local, sparse map", G::Dim, "exact model", scenario, told, true, std::string("Told: ") + remark + "."});
    drift.persistent = {};
    const Summary untold = summarise(exact_samples(params, drift, SparseMap<G>()), G::Dof, 1.0, seed());
    add({"local, persistent drift untold", G::Dim, "exact model", scenario, untold, false, "Taken for a random walk."});
    papers_own<G>(params, scenario);
    const ExactVerdict v = exact_verdict({told});
    result_.demands.push_back(
        {dim + " exact model, " + scenario + ": ANEES in the 95 % band, coverage", ">= 90 % of the steps, 93 to 97 %",
         percent(v.steps_in_band) + ", " + interval_words(told) + ", coverage " + percent(v.coverage95), v.consistent(),
         true, ""});
    control(dim + " " + words + ", untold", Side::overconfident, exact_verdict({untold}));
  }

  template <class G>
  void far_with_full_drift(const std::string& dim) {
    ExactModelParams params;
    params.path = Path::far_origin;
    params.vehicles = 1;
    plan_exact<G>(scenario_of(params), 0.02, [this, dim, params] { far_rows<G>(dim, params); });
  }

  template <class G>
  void far_rows(const std::string& dim, const ExactModelParams& params) {
    const Summary s = summarise(exact_samples(params, matching_drift<G>(params, DriftModel::local), SparseMap<G>()),
                                G::Dof, 1.0, seed());
    add({"local, sparse map", G::Dim, "exact model", scenario_of(params), s, true,
         "1.2 km without meeting anything, a node every few metres: each increment is right to second order, but a map "
         "adds them up to first."});
    papers_own<G>(params, scenario_of(params));
    const ExactVerdict v = exact_verdict({s});
    result_.demands.push_back(
        {dim + " exact model, " + scenario_of(params) + ": ANEES in the 95 % band, coverage",
         ">= 90 % of the steps, 93 to 97 %",
         percent(v.steps_in_band) + ", " + interval_words(s) + ", coverage " + percent(v.coverage95), v.consistent(),
         false,
         s.anees > 1.0
             ? "a map is linear between its nodes: second order in the heading drift (0.06 rad after 1 km); a "
               "quarter of the noise on the same path is in the table below"
             : ""});
  }

  // ---- sensors simulated, the rest real

  struct SlamScenario {
    std::string name;
    EkfSlamParams params;
    bool all_models;
    bool of_verdict;
    int max_runs = 1'000'000;
  };

  static std::vector<SlamScenario> slam_scenarios() {
    EkfSlamParams loop, eight, scale, outliers, lost, recovered, repeated;
    eight.path = Path::figure_eight;
    scale.scale_error = 0.01;
    scale.gyro_bias_rad_per_m = 2e-4;
    outliers.outliers = 0.02;
    lost.loss = 0.3;
    recovered.loss = 0.15;
    repeated.path = Path::straight;
    repeated.repeat_m = 20.0;
    return {{"loop, 2 vehicles", loop, true, true},
            {"loop, 2 vehicles, 1 % scale and 0.2 mrad/m yaw untold", scale, true, true},
            {"figure-eight, 2 vehicles", eight, false, true},
            {"loop, 2 vehicles, 2 % outlier sightings", outliers, false, false},
            {"loop, 2 vehicles, 30 % of the messages lost", lost, false, false},
            {"loop, 2 vehicles, 30 % lost and half of them recovered", recovered, false, false},
            {"straight street that repeats every 20 m, 2 vehicles", repeated, false, false, 40}};
  }

  // In space the estimator as it ships, on the loop; which baseline is how far off is told in the plane.
  static std::vector<SlamScenario> slam_scenarios_in_space() {
    std::vector<SlamScenario> list = slam_scenarios();
    list.resize(2);
    for (SlamScenario& scenario : list) scenario.all_models = false;
    return list;
  }

  template <class G>
  void ekf_slam_part() {
    for (const SlamScenario& scenario : G::Dim == 2 ? slam_scenarios() : slam_scenarios_in_space())
      plan(dimension(G::Dim) + " EKF-SLAM, " + scenario.name, 1.2 * std::min(runs(), scenario.max_runs),
           [this, scenario] { ekf_slam_rows<G>(scenario); });
  }

  template <class G>
  void ekf_slam_rows(const SlamScenario& scenario) {
    const int count = std::min(runs(), scenario.max_runs);
    const auto driven = each_run(count, [&](int run) { return drive_ekf_slam<G>(scenario.params, seed(), run); });
    const auto row = [&](const char* model, const std::vector<RunSample>& samples, bool ours, const char* remark) {
      return add({model, G::Dim, "EKF-SLAM", scenario.name, summarise(samples, G::Dof, 1.0, seed()), ours, remark})
          .summary;
    };
    const auto judged = [&](const DriftParams<G>& drift, const Backend<G>& backend) {
      return each_run(count, [&](int run) {
        return judge_ekf_slam(driven[static_cast<std::size_t>(run)], scenario.params, drift, backend, seed(), run);
      });
    };
    row("raw SLAM",
        each_run(count, [&](int run) { return judge_raw(raw_tracks(driven[static_cast<std::size_t>(run)])); }), false,
        "Each vehicle's filter in its own start frame, behind its static bias.");
    demand_ekf_slam(G::Dim, scenario,
                    row("local, sparse map", judged({}, SparseMap<G>()), true, "What ships, with its defaults."));
    DriftParams<G> literal;
    literal.model = DriftModel::literal;
    row("literal, EKF map", judged(literal, EkfMap<G>()), false, "The paper's own method.");
    if (!scenario.all_models) return;
    row("literal, sparse map", judged(literal, SparseMap<G>()), false, "The paper's additive bias, default rates.");
    row("literal, fitted noise, sparse map", judged(fitted<G>(scenario.params), SparseMap<G>()), false,
        "The additive bias with the constant covariance that fits 40 other runs of this path best.");
    row("local, EKF map", judged({}, EkfMap<G>()), false, "Our drift model in the paper's filter.");
  }

  template <class G>
  DriftParams<G> fitted(const EkfSlamParams& params) {
    const auto calibration = each_run(calibration_runs, [&](int run) {
      return raw_tracks(drive_ekf_slam<G>(params, result_.calibration_seed, run));
    });
    std::vector<TrueTrack<G>> tracks;
    for (const auto& run : calibration) tracks.insert(tracks.end(), run.begin(), run.end());
    return fit_literal(tracks);
  }

  void demand_ekf_slam(int dim, const SlamScenario& scenario, const Summary& s) {
    const std::string what = dimension(dim) + " EKF-SLAM, " + scenario.name + ": ";
    const char* reason = s.anees < 0.6 ? "on the safe side: the default drift rate and landmark_inflation 2 come on "
                                         "top of noise that this SLAM states itself"
                                       : "";
    result_.demands.push_back({what + "ANEES with the defaults", "0.6 to 1.15", interval_words(s),
                               s.anees >= 0.6 && s.anees <= 1.15, scenario.of_verdict, reason});
    result_.demands.push_back(
        {what + "coverage", ">= 94 %", percent(s.coverage95), s.coverage95 >= 0.94, scenario.of_verdict, reason});
    if (scenario.params.repeat_m == 0.0)  // there, not to recognise each other is right
      result_.demands.push_back(
          {what + "runs in which the vehicles never recognise each other", "0",
           std::to_string(s.unlinked_runs) + " of " + std::to_string(s.runs), s.unlinked_runs == 0, false,
           scenario.params.loss > 0.0 ? "too few of the associations arrived to confirm each other" : ""});
    if (scenario.params.repeat_m == 0.0)
      result_.demands.push_back(
          {what + "distance between vehicles that have, RMSE", "<= 0.15 m", fixed(s.distance_rmse_m, 3) + " m",
           s.distance_rmse_m <= 0.15, scenario.of_verdict,
           scenario.params.loss > 0.0 ? "fewer places in common have arrived; the covariance says so" : ""});
    result_.demands.push_back({what + "classes that join different things", "0", std::to_string(s.false_fusions),
                               s.false_fusions == 0, false, reason});
  }

  // ---- recordings

  void real_drift_part() {
    result_.real_drift = measure_real_drift(result_.options.data);
    if (!result_.options.progress) return;
    const RealDrift& drift = result_.real_drift;
    if (!drift.left_out.empty()) std::printf("%s\n", drift.left_out.c_str());
    for (const HalvesStudy& study : drift.halves)
      for (const HalvesRow& row : study.rows)
        if (row.fused && row.start != "unknown")
          std::printf("real drift, %s as two vehicles, %s: position %.2f m, ANEES %.2f, coverage %.2f\n",
                      study.name.c_str(), row.model.c_str(), row.ate_m, row.anees, row.coverage95);
    std::fflush(stdout);
  }

  // ---- associations that are geometrically perfect and wrong

  void false_association_part() {
    for (const bool agreeing : {false, true}) {
      const std::string scenario = agreeing ? "loop, a stretch of the street repeated: false sets that agree"
                                            : "loop, places that look alike: independent false sets";
      plan_exact<SE2>(scenario, 0.025, [this, scenario, agreeing] { false_association_rows(scenario, agreeing); });
    }
  }

  void false_association_rows(const std::string& scenario, bool agreeing) {
    ExactModelParams params;
    params.aliases = agreeing ? 1 : 3;
    params.alias_places = agreeing ? 3 : 1;
    const DriftParams<SE2> drift = matching_drift<SE2>(params, DriftModel::local);
    const auto samples = each_run(runs(), [&](int run) {
      return judge_global_map(draw_exact_fleet(params, drift, seed(), run), SparseMap<SE2>());
    });
    const Summary s =
        add({"local, sparse map", 2, "exact model", scenario, summarise(samples, SE2::Dof, 1.0, seed()), true,
             "False sets of pairs are geometrically perfect copies and stated beside the true ones."})
            .summary;
    const std::string share = std::to_string(s.true_dropped) + " of " + std::to_string(s.true_stated) + " (" +
                              percent(s.true_dropped / std::max(1.0, static_cast<double>(s.true_stated))) + ")";
    const std::string what = dimension(2) + " exact model, " + scenario;
    result_.demands.push_back({what + ": false fusions", "0",
                               std::to_string(s.false_fusions) + " of " + std::to_string(s.false_stated),
                               s.false_fusions == 0, false, ""});
    result_.demands.push_back(
        {what + ": true sets dropped", "<= 2 %", share, s.true_dropped <= 0.02 * s.true_stated, false, ""});
  }

  std::chrono::steady_clock::time_point start_;
  ConsistencyResult result_;
  std::vector<Job> jobs_;
};

}  // namespace

ExactVerdict exact_verdict(const std::vector<Summary>& scenarios) {
  ExactVerdict v;
  double in_band = 0.0, inside = 0.0, nees = 0.0, weight = 0.0;
  for (const Summary& s : scenarios) {
    v.steps += s.steps;
    in_band += s.steps_in_band * s.steps;
    const double poses = static_cast<double>(s.steps) * s.runs;
    inside += s.coverage95 * poses;
    nees += s.anees * poses;
    weight += poses;
  }
  if (v.steps == 0) return v;
  v.steps_in_band = in_band / v.steps;
  v.coverage95 = inside / weight;
  v.anees = nees / weight;
  return v;
}

bool fails_on(Side side, const ExactVerdict& v) {
  return !v.consistent() && (side == Side::overconfident ? v.anees > 1.0 : v.anees < 1.0);
}

const char* to_string(Side side) { return side == Side::overconfident ? "overconfident" : "cautious"; }

bool ConsistencyResult::judged() const {
  return !controls.empty() || std::any_of(demands.begin(), demands.end(), [](const Demand& d) { return d.of_verdict; });
}

bool ConsistencyResult::pass() const {
  return std::all_of(demands.begin(), demands.end(), [](const Demand& d) { return d.met || !d.of_verdict; }) &&
         std::all_of(controls.begin(), controls.end(), [](const Control& c) { return c.failed; });
}

bool ConsistencyResult::all_met() const {
  return pass() && std::all_of(demands.begin(), demands.end(), [](const Demand& d) { return d.met; });
}

std::string few_runs_words(int runs) {
  return std::to_string(runs) +
         " runs decide nothing, neither for nor against the estimator: chance alone makes it miss, "
         "and controls pass. The verdict means something from " +
         std::to_string(enough_runs) + " runs on.";
}

ConsistencyResult measure_consistency(const ConsistencyOptions& options) { return Suite(options).measure(); }

nlohmann::ordered_json to_json(const ConsistencyResult& result) {
  using json = nlohmann::ordered_json;
  json out{{"runs", result.options.runs},
           {"seed", result.options.seed},
           {"calibration_seed", result.calibration_seed},
           {"bootstrap_seed", result.options.seed},
           {"enough_runs", result.enough_runs()},
           {"only", result.options.only},
           {"pass", result.decided() ? json(result.pass()) : json(nullptr)},
           {"all_met", result.decided() ? json(result.all_met()) : json(nullptr)},
           {"rows", json::array()},
           {"demands", json::array()},
           {"controls", json::array()}};
  for (const Row& row : result.rows) {
    const Summary& s = row.summary;
    json distance = s.distance_rmse_m;
    if (!std::isfinite(s.distance_rmse_m)) distance = nullptr;
    out["rows"].push_back(json{{"model", row.model},
                               {"dim", row.dim},
                               {"simulator", row.simulator},
                               {"scenario", row.scenario},
                               {"runs", s.runs},
                               {"anees", s.anees},
                               {"anees_low", s.anees_low},
                               {"anees_high", s.anees_high},
                               {"steps_in_band", s.steps_in_band},
                               {"coverage95", s.coverage95},
                               {"pos_rmse_m", s.pos_rmse_m},
                               {"distance_rmse_m", distance},
                               {"false_fusions", s.false_fusions},
                               {"true_dropped", s.true_dropped},
                               {"true_stated", s.true_stated},
                               {"false_stated", s.false_stated},
                               {"unlinked_runs", s.unlinked_runs}});
  }
  for (const Demand& d : result.demands)
    out["demands"].push_back(json{{"what", d.what},
                                  {"asked", d.asked},
                                  {"measured", d.measured},
                                  {"met", d.met},
                                  {"of_verdict", d.of_verdict},
                                  {"reason", d.met ? "" : d.reason}});
  for (const Control& c : result.controls)
    out["controls"].push_back(json{
        {"what", c.what}, {"must_be", to_string(c.side)}, {"measured", c.measured}, {"failed_as_it_must", c.failed}});
  out["real_drift"] = to_json(result.real_drift);
  return out;
}

namespace {

std::string verdict_words(const ConsistencyResult& result) {
  if (!result.judged()) return "measured; nothing of it belongs to the verdict";
  if (!result.enough_runs()) return "no verdict: " + few_runs_words(result.options.runs);
  if (!result.pass()) return "does NOT pass: see the misses above";
  return std::string(result.options.only.empty() ? "consistent: " : "consistent as far as --only goes: ") +
         "the model passes" + (result.controls.empty() ? "" : " and every control fails");
}

const char* met_words(const Demand& d) {
  if (d.met) return "met ";
  return d.of_verdict ? "MISS" : "miss, beside the verdict";
}

}  // namespace

int run_consistency(const ConsistencyOptions& options) {
  expect_writable(options.out);
  const ConsistencyResult result = measure_consistency(options);
  write_text_file(options.out / "consistency.json", to_json(result).dump(2) + "\n");
  write_text_file(options.out / "consistency.html", consistency_page(result));
  std::printf("seed %llu, calibration seed %llu, %d runs per scenario\n", static_cast<unsigned long long>(options.seed),
              static_cast<unsigned long long>(result.calibration_seed), options.runs);
  for (const Demand& d : result.demands)
    std::printf("%s  %s: %s (asked: %s)%s\n", met_words(d), d.what.c_str(), d.measured.c_str(), d.asked.c_str(),
                d.met || d.reason.empty() ? "" : ("; " + d.reason).c_str());
  for (const Control& c : result.controls)
    std::printf("%s  control %s, must be %s: %s\n", c.failed ? "fails, as it must" : "DOES NOT FAIL AS IT MUST",
                c.what.c_str(), to_string(c.side), c.measured.c_str());
  std::printf("%s; %s\n", verdict_words(result).c_str(), (options.out / "consistency.html").c_str());
  return !result.decided() || result.pass() ? 0 : 1;
}

}  // namespace convoy::cli::consistency
