// The consistency suite as a test: fixed seeds, printed; the model must pass it and wrong covariances and models must
// fail.
#include <convoy/config_error.hpp>
#include <convoy/map/sparse_map.hpp>

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>

#include "consistency/ekf_slam.hpp"
#include "consistency/exact_model.hpp"
#include "consistency/literal_fit.hpp"
#include "consistency/page.hpp"
#include "consistency/parallel.hpp"
#include "consistency/suite.hpp"

namespace convoy::cli::consistency {
namespace {

constexpr std::uint64_t seed = 1, calibration_seed = 1000004;
constexpr int runs = 200, slam_runs = 60;

void print(const char* what, const Summary& s) {
  std::printf(
      "seed %d: %s: %d runs, ANEES %.3f (%.3f to %.3f), %.3f of the steps in band, coverage %.4f, position %.3f m, "
      "distance %.3f m, false fusions %d of %d, true dropped %d of %d\n",
      static_cast<int>(seed), what, s.runs, s.anees, s.anees_low, s.anees_high, s.steps_in_band, s.coverage95,
      s.pos_rmse_m, s.distance_rmse_m, s.false_fusions, s.false_stated, s.true_dropped, s.true_stated);
}

template <class G>
std::vector<RunSample> exact(const ExactModelParams& params, DriftModel model = DriftModel::local) {
  const DriftParams<G> drift = matching_drift<G>(params, model);
  return each_run(runs,
                  [&](int run) { return judge_stated(draw_exact_fleet(params, drift, seed, run), SparseMap<G>()); });
}

ExactModelParams on(Path path, int vehicles, double noise = 1.0) {
  ExactModelParams p;
  p.path = path;
  p.vehicles = vehicles;
  p.noise = noise;
  return p;
}

// What every scenario of the exact model has to satisfy together, and the same with wrong covariances.
template <class G>
void expect_consistent_and_controls_to_fail(const std::vector<ExactModelParams>& scenarios) {
  std::vector<Summary> judged, low, high;
  for (const ExactModelParams& p : scenarios) {
    const auto samples = exact<G>(p);
    judged.push_back(summarise(samples, G::Dof));
    low.push_back(summarise(samples, G::Dof, 0.7));
    high.push_back(summarise(samples, G::Dof, 1.5));
    print(to_string(p.path).c_str(), judged.back());
  }
  int stated = 0, dropped = 0;
  for (const Summary& s : judged) {
    stated += s.true_stated;
    dropped += s.true_dropped;
  }
  EXPECT_GT(stated, 1000);
  EXPECT_LE(dropped, 0.02 * stated);
  const ExactVerdict v = exact_verdict(judged);
  EXPECT_TRUE(v.consistent()) << v.steps_in_band << " of " << v.steps << " steps in band, coverage " << v.coverage95;
  EXPECT_FALSE(exact_verdict(low).consistent());
  EXPECT_FALSE(exact_verdict(high).consistent());
}

TEST(Consistency, ExactModelInThePlane) {
  expect_consistent_and_controls_to_fail<SE2>({on(Path::straight, 1), on(Path::loop, 1), on(Path::loop, 2),
                                               on(Path::figure_eight, 2), on(Path::far_origin, 1, 0.25),
                                               on(Path::loop, 2, 0.5), on(Path::loop, 2, 2.0)});
}

TEST(Consistency, ExactModelInSpace) {
  expect_consistent_and_controls_to_fail<SE3>({on(Path::straight, 1), on(Path::loop, 1), on(Path::loop, 2),
                                               on(Path::figure_eight, 1), on(Path::far_origin, 1, 0.25)});
}

TEST(Consistency, LiteralModelFailsOnTheLoop) {
  for (const int vehicles : {1, 2}) {
    const Summary plane = summarise(exact<SE2>(on(Path::loop, vehicles), DriftModel::literal), 3);
    print("literal, plane", plane);
    EXPECT_FALSE(exact_verdict({plane}).consistent());
    EXPECT_GT(plane.anees_low, 3.0) << "overconfident";
  }
  const Summary space = summarise(exact<SE3>(on(Path::loop, 1), DriftModel::literal), 6);
  print("literal, space", space);
  EXPECT_FALSE(exact_verdict({space}).consistent());
}

struct Simulated {
  Summary raw, local;
};

template <class G>
Simulated simulate(const EkfSlamParams& params, const char* what) {
  const auto driven = each_run(slam_runs, [&](int run) { return drive_ekf_slam<G>(params, seed, run); });
  const auto at = [&](int run) -> const SlamRun<G>& { return driven[static_cast<std::size_t>(run)]; };
  Simulated s;
  s.raw = summarise(each_run(slam_runs, [&](int run) { return judge_raw(raw_tracks(at(run))); }), G::Dof);
  s.local = summarise(
      each_run(slam_runs, [&](int run) { return judge_ekf_slam(at(run), params, {}, SparseMap<G>(), seed, run); }),
      G::Dof);
  print(what, s.local);
  return s;
}

TEST(Consistency, EkfSlamWithDefaults) {
  const Simulated s = simulate<SE2>({}, "EKF-SLAM");
  EXPECT_GE(s.local.anees, 0.6);
  EXPECT_LE(s.local.anees, 1.15);
  EXPECT_GE(s.local.coverage95, 0.94);
  EXPECT_LE(s.local.distance_rmse_m, 0.15);
  EXPECT_EQ(s.local.false_fusions, 0);
  EXPECT_GT(s.local.true_stated, 10 * slam_runs);  // they did meet ...
  EXPECT_EQ(s.local.unlinked_runs, 0);             // ... all of them
  EXPECT_GT(s.raw.distance_rmse_m, 20.0 * s.local.distance_rmse_m);
}

TEST(Consistency, EkfSlamWithScaleAndYawUntold) {
  EkfSlamParams params;
  params.scale_error = 0.01;
  params.gyro_bias_rad_per_m = 2e-4;
  const Simulated s = simulate<SE2>(params, "EKF-SLAM, scale and yaw");
  EXPECT_LE(s.local.anees, 1.15);
  EXPECT_GE(s.local.coverage95, 0.94);
  EXPECT_LE(s.local.distance_rmse_m, 0.15);
}

TEST(Consistency, EkfSlamInSpaceWithDefaults) {
  const Simulated s = simulate<SE3>({}, "EKF-SLAM, space");
  EXPECT_GE(s.local.anees, 0.6);
  EXPECT_LE(s.local.anees, 1.15);
  EXPECT_GE(s.local.coverage95, 0.94);
  EXPECT_LE(s.local.distance_rmse_m, 0.15);
  EXPECT_EQ(s.local.false_fusions, 0);
  EXPECT_GT(s.local.true_stated, 10 * slam_runs);
  EXPECT_EQ(s.local.unlinked_runs, 0);
}

TEST(Consistency, EkfSlamInSpaceWithScaleAndYawUntold) {
  EkfSlamParams params;
  params.scale_error = 0.01;
  params.gyro_bias_rad_per_m = 2e-4;
  const Simulated s = simulate<SE3>(params, "EKF-SLAM, space, scale and yaw");
  EXPECT_LE(s.local.anees, 1.15);
  EXPECT_GE(s.local.coverage95, 0.94);
  EXPECT_LE(s.local.distance_rmse_m, 0.15);
}

TEST(Consistency, EkfSlamOverALossyNetwork) {
  EkfSlamParams params;
  params.loss = 0.3;
  const Simulated s = simulate<SE2>(params, "EKF-SLAM, 30 % lost");
  EXPECT_LE(s.local.anees, 1.15);
  EXPECT_GE(s.local.coverage95, 0.94);
  EXPECT_LE(s.local.distance_rmse_m,
            0.1 * s.raw.distance_rmse_m);  // half of the batches arrive: less is known, and it says so
  EXPECT_LE(s.local.unlinked_runs, 2);
}

TEST(Consistency, NoFalseSetEntersTheMap) {
  for (const bool agreeing : {false, true}) {
    ExactModelParams params;
    params.aliases = agreeing ? 1 : 3;
    params.alias_places = agreeing ? 3 : 1;
    const DriftParams<SE2> drift = matching_drift<SE2>(params, DriftModel::local);
    const Summary s = summarise(
        each_run(
            runs / 4,
            [&](int run) { return judge_global_map(draw_exact_fleet(params, drift, seed, run), SparseMap<SE2>()); }),
        3);
    print(agreeing ? "false sets that agree" : "independent false sets", s);
    EXPECT_GT(s.false_stated, runs / 4);
    EXPECT_EQ(s.false_fusions, 0);
    EXPECT_LE(s.true_dropped, 0.02 * s.true_stated);
  }
}

// Every shift by a period fits, and where the vehicles start one period apart the false one lines batches up whole, the
// true one splits each over two. With the first batches alone, with some, and with all: nothing is fused wrongly, and
// the vehicles stay apart rather than being put where they might be.
TEST(Consistency, AStreetThatRepeatsItselfIsNotGuessed) {
  for (const auto& [repeat_m, gap_m] : {std::pair(20.0, 20.0), std::pair(30.0, 20.0), std::pair(30.0, 30.0)}) {
    EkfSlamParams params;
    params.path = Path::straight;
    params.repeat_m = repeat_m;
    params.gap_m = gap_m;
    const auto driven = each_run(slam_runs / 2, [&](int run) { return drive_ekf_slam<SE2>(params, seed, run); });
    for (const std::size_t batches : {1U, 2U, 4U, 100U}) {
      const Summary s = summarise(each_run(slam_runs / 2,
                                           [&](int run) {
                                             SlamRun<SE2> begun = driven[static_cast<std::size_t>(run)];
                                             for (SlamRun<SE2>::Vehicle& v : begun.vehicles) {
                                               const std::size_t count = std::min(batches, v.segments.size());
                                               v.segments.resize(count);
                                               v.truth.resize(count);
                                             }
                                             return judge_ekf_slam(begun, params, {}, SparseMap<SE2>(), seed, run);
                                           }),
                                  3);
      print(("a street that repeats itself, batches: " + std::to_string(batches)).c_str(), s);
      EXPECT_GT(s.false_stated, slam_runs / 4) << "no double was ever seen";
      EXPECT_EQ(s.false_fusions, 0);
      EXPECT_LE(s.anees,
                1.5);  // with few batches these are 60 draws from static biases: 1 +- 0.2; a wrong fusion: hundreds
      EXPECT_GE(s.coverage95, 0.9);
    }
  }
}

TEST(ConsistencyParts, FitFindsTheRatesOfTheLiteralModel) {
  // Tracks drawn from the literal model itself, on a straight along which Ad_X is known.
  const double translation = 3e-3, rotation = 2e-6;
  std::vector<TrueTrack<SE2>> tracks;
  for (int run = 0; run < 60; ++run) {
    Draw draw(seed, static_cast<std::uint32_t>(run), 7);
    TrueTrack<SE2> track;
    SE2 T, X;
    for (int k = 0; k <= 40; ++k) {
      track.steps.push_back({{10.0 * k, 10.0 * k, X, SE2::Covariance::Zero()}, T});
      const SE2 X_next = X * SE2::Exp({10.0, 0.0, 0.05});
      const SE2::Tangent eps =
          Eigen::Vector3d(std::sqrt(10.0 * translation), std::sqrt(10.0 * translation), std::sqrt(10.0 * rotation))
              .cwiseProduct(draw.unit_normal<3>());
      T = T * (X.inverse() * X_next) * SE2::Exp(X_next.inverse().adjoint() * eps);
      X = X_next;
    }
    tracks.push_back(track);
  }
  const DriftParams<SE2> fit = fit_literal(tracks);
  EXPECT_NEAR(fit.rate[0] / translation, 1.0, 0.25);
  EXPECT_NEAR(fit.rate[2] / rotation, 1.0, 0.25);
}

TEST(ConsistencyParts, SummaryOfKnownNumbers) {
  std::vector<RunSample> samples(2);
  samples[0].poses = {{0, 0, 5.0, 3.0, 1.0}, {0, 1, 10.0, 30.0, 2.0}};
  samples[1].poses = {{0, 0, 5.0, 6.0, 3.0}, {0, 1, 10.0, 60.0, 4.0}};
  samples[0].distance_errors_m = {3.0, -4.0};
  const Summary s = summarise(samples, 3);
  EXPECT_DOUBLE_EQ(s.anees, (3.0 + 30.0 + 6.0 + 60.0) / 12.0);
  EXPECT_DOUBLE_EQ(s.coverage95, 0.5);
  EXPECT_DOUBLE_EQ(s.steps_in_band, 0.5);  // 9 is inside chi-square(6), 90 is not
  EXPECT_DOUBLE_EQ(s.pos_rmse_m, std::sqrt(30.0 / 4.0));
  EXPECT_DOUBLE_EQ(s.distance_rmse_m, std::sqrt(12.5));
  EXPECT_LE(s.anees_low, s.anees);
  EXPECT_GE(s.anees_high, s.anees);
  EXPECT_DOUBLE_EQ(summarise(samples, 3, 2.0).anees, s.anees / 2.0);
}

TEST(ConsistencyParts, SameSeedSameBits) {
  const ExactModelParams params;
  const auto drift = matching_drift<SE2>(params, DriftModel::local);
  const auto a =
      each_run(6, [&](int run) { return judge_stated(draw_exact_fleet(params, drift, 3, run), SparseMap<SE2>()); });
  for (int run = 5; run >= 0; --run) {  // in another order, on one thread
    const RunSample b = judge_stated(draw_exact_fleet(params, drift, 3, run), SparseMap<SE2>());
    ASSERT_EQ(a[static_cast<std::size_t>(run)].poses.size(), b.poses.size());
    for (std::size_t k = 0; k < b.poses.size(); ++k)
      EXPECT_EQ(a[static_cast<std::size_t>(run)].poses[k].squared_distance, b.poses[k].squared_distance);
  }
  EXPECT_NE(a[0].poses[5].squared_distance, a[1].poses[5].squared_distance);
}

TEST(ConsistencyParts, CommandWritesJsonAndPage) {
  const auto folder = std::filesystem::temp_directory_path() / ("convoy_consistency_" + std::to_string(::getpid()));
  ConsistencyOptions options;
  options.runs = 2;
  options.out = folder;
  const int status = run_consistency(options);
  std::ifstream json_file(folder / "consistency.json"), page_file(folder / "consistency.html");
  const auto json = nlohmann::json::parse(json_file);
  EXPECT_TRUE(json.at("pass").is_null());  // two runs decide nothing
  EXPECT_EQ(status, 0);
  std::set<std::pair<int, std::string>> models;
  for (const auto& row : json.at("rows")) {
    for (const char* key : {"scenario", "runs", "anees", "anees_low", "anees_high", "steps_in_band", "coverage95",
                            "pos_rmse_m", "distance_rmse_m", "false_fusions", "true_dropped"})
      EXPECT_TRUE(row.contains(key)) << key;
    models.insert({row.at("dim").get<int>(), row.at("model").get<std::string>()});
  }
  for (const int dim : {2, 3})
    for (const char* model : {"raw SLAM", "literal, sparse map", "literal, EKF map",
                              "literal, fitted noise, sparse map", "local, EKF map", "local, sparse map"})
      EXPECT_TRUE(models.count({dim, model})) << dim << " " << model;
  std::set<std::string> controls;
  for (const auto& control : json.at("controls")) controls.insert(control.at("what").get<std::string>());
  for (const std::string dim : {"2-D ", "3-D "})
    for (const char* what : {"covariance x 0.7", "covariance x 1.5", "literal model on the loop"})
      EXPECT_TRUE(controls.count(dim + what)) << dim << what;
  EXPECT_TRUE(json.at("real_drift").is_array());
  const std::string page{std::istreambuf_iterator<char>(page_file), {}};
  EXPECT_NE(page.find("Negative controls"), std::string::npos);
  EXPECT_NE(page.find("<h2>Real drift</h2>"), std::string::npos);
  EXPECT_NE(page.find("<svg"), std::string::npos);
  EXPECT_EQ(page.find("http://"), page.find("http://www.w3.org/"));  // nothing to fetch
  std::filesystem::remove_all(folder);
  options.runs = 1;
  EXPECT_THROW(measure_consistency(options), ConfigError);
}

TEST(ConsistencyParts, AControlFailsOnItsOwnSideAlone) {
  ExactVerdict v;
  v.steps = 10;
  v.steps_in_band = 0.5;
  v.coverage95 = 0.95;
  v.anees = 0.7;
  EXPECT_FALSE(fails_on(Side::overconfident, v));
  EXPECT_TRUE(fails_on(Side::cautious, v));
  v.anees = 1.4;
  EXPECT_TRUE(fails_on(Side::overconfident, v));
  EXPECT_FALSE(fails_on(Side::cautious, v));
  v.steps_in_band = 1.0;
  EXPECT_FALSE(fails_on(Side::overconfident, v));
}

TEST(ConsistencyParts, FewRunsAreSaidToDecideNothing) {
  ConsistencyResult result;
  EXPECT_NE(consistency_page(result).find("Nothing that was measured belongs to the verdict"), std::string::npos);
  result.demands.push_back({"d", "a", "m", true, true, ""});
  result.options.runs = enough_runs;
  EXPECT_TRUE(to_json(result)["enough_runs"].get<bool>());
  EXPECT_EQ(consistency_page(result).find("decide nothing"), std::string::npos);
  result.options.runs = enough_runs - 1;
  EXPECT_FALSE(to_json(result)["enough_runs"].get<bool>());
  EXPECT_NE(consistency_page(result).find(few_runs_words(enough_runs - 1)), std::string::npos);
}

TEST(ConsistencyParts, OnlyWhatIsAskedForIsMeasured) {
  ConsistencyOptions options;
  options.runs = 2;
  options.progress = false;
  options.only = "2-D exact model, figure-eight";
  const ConsistencyResult result = measure_consistency(options);
  ASSERT_EQ(result.rows.size(), 2U);  // of one vehicle and of two
  for (const Row& row : result.rows) {
    EXPECT_EQ(row.dim, 2);
    EXPECT_EQ(row.scenario.substr(0, 12), "figure-eight");
  }
  EXPECT_EQ(result.demands.size(), 2U);  // judged together
  EXPECT_EQ(result.controls.size(), 2U);
  EXPECT_EQ(to_json(result)["only"], options.only);
  EXPECT_NE(consistency_page(result).find(options.only), std::string::npos);
  EXPECT_NE(result.real_drift.left_out.find("by --only"), std::string::npos);
  options.only = "4-D";
  try {
    measure_consistency(options);
    FAIL();
  } catch (const ConfigError& error) {
    const std::string what = error.what();
    EXPECT_NE(what.find("--only '4-D': in the name of no scenario"), std::string::npos) << what;
    EXPECT_NE(what.find("\n  3-D EKF-SLAM, loop, 2 vehicles\n"), std::string::npos) << what;
  }
}

TEST(ConsistencyParts, VerdictNeedsTheControlsToFail) {
  ConsistencyResult result;
  EXPECT_TRUE(to_json(result)["pass"].is_null());  // nothing was judged
  result.demands.push_back({"only beside", "a", "m", false, false, ""});
  EXPECT_TRUE(to_json(result)["pass"].is_null());
  EXPECT_EQ(consistency_page(result).find("passes"), std::string::npos);
  result.demands = {{"d", "a", "m", true, true, ""}};
  EXPECT_EQ(consistency_page(result).find("control fails"), std::string::npos);  // there is none
  result.controls.push_back({"c", "m", Side::overconfident, true});
  EXPECT_TRUE(result.pass());
  EXPECT_TRUE(result.all_met());
  EXPECT_TRUE(to_json(result)["pass"].get<bool>());
  result.demands.push_back({"beside", "a", "m", false, false, "known"});
  EXPECT_TRUE(result.pass());
  EXPECT_FALSE(result.all_met());
  EXPECT_NE(consistency_page(result).find("miss"), std::string::npos);
  EXPECT_EQ(to_json(result)["demands"][0]["reason"], "");
  EXPECT_EQ(to_json(result)["demands"][1]["reason"], "known");  // why a miss is one
  result.controls.push_back({"c2", "m", Side::cautious, false});
  EXPECT_FALSE(result.pass());
  EXPECT_FALSE(to_json(result)["pass"].get<bool>());
  result.controls.pop_back();
  result.demands.push_back({"d2", "a", "m", false, true, ""});
  EXPECT_FALSE(result.pass());
}

}  // namespace
}  // namespace convoy::cli::consistency
