#include "calibrate.hpp"

#include <convoy/config_error.hpp>

#include <gtest/gtest.h>
#include <tinyxml2.h>

#include <cstdio>
#include <random>

#include "fake_run.hpp"

namespace convoy::cli {
namespace {

using nlohmann::json;

constexpr double rate_xy = 3e-4, rate_theta = 6e-6;  // true
constexpr double own_m = 0.05, inflation = 2.0;      // what a landmark states, and how much more its variance really is
constexpr std::uint64_t epoch = 1700000000;

DriftParams<SE2> params_of_the_run() {
  DriftParams<SE2> params;
  params.landmark_inflation = 1.5;
  return params;
}

/// A run of one vehicle: two laps of 340 m, a batch of 8 landmarks every 30 m, the second lap paired with the first.
class TwoLaps {
 public:
  TwoLaps(const std::filesystem::path& folder, std::uint64_t seed) : folder_(folder), random_(seed) {
    const std::filesystem::path own = vehicle_folder(folder, 1);
    drive();
    write_truth(truth_file(folder, 1), truth_);
    write_landmarks(folder / "truth" / "landmarks.csv", points_);
    test::write(own / "config.xml", "<convoy version=\"1\"/>\n");
    test::write(folder / "run.json",
                json{{"scenario", "street"}, {"vehicles", {1}}, {"common_frame_vehicle", 1}}.dump());
    test::write(own / "trajectory.csv", trajectory_);
    test::write(own / "labels.csv", labels_);
    test::write(own / "facts.jsonl", facts_);
    test::write(own / "map.json", json{{"map_digest", "0"},
                                       {"chains", json::array()},
                                       {"anchors", json::array()},
                                       {"landmarks", json::array()},
                                       {"associations", associations_}}
                                      .dump());
  }

 private:
  double normal(double sigma) { return std::normal_distribution<double>(0.0, sigma)(random_); }

  static json upper(const Eigen::MatrixXd& P) {
    json list = json::array();
    for (Eigen::Index i = 0; i < P.rows(); ++i)
      for (Eigen::Index j = i; j < P.cols(); ++j) list.push_back(P(i, j));
    return list;
  }

  void anchor(const ChainState<SE2>& state, std::uint32_t count) {
    facts_ += json{{"kind", "anchor"},
                   {"key", {1, epoch, anchors_++}},
                   {"stamp_s", state.stamp_s},
                   {"abscissa_m", state.abscissa_m},
                   {"slam", {state.pose.translation().x(), state.pose.translation().y(), state.pose.theta()}},
                   {"drift", upper(state.drift)},
                   {"first_landmark", landmarks_},
                   {"landmark_count", count}}
                  .dump() +
              "\n";
  }

  // The batch of a place: its points are the same on both laps.
  void batch(const ChainState<SE2>& state, const SE2& T_world_body, std::uint32_t place, bool second_lap) {
    json pairings = json::array();
    anchor(state, 8);
    for (std::uint32_t i = 0; i < 8; ++i) {
      const std::uint32_t id = 8 * place + i;
      if (!second_lap)
        points_.push_back({id, T_world_body * Eigen::Vector2d(4.0 * (i % 4) - 6.0 + normal(0.5),
                                                              i < 4 ? 5.0 + normal(1.0) : -5.0 + normal(1.0))});
      const double sigma = own_m * std::sqrt(inflation);
      const Eigen::Vector2d p =
          T_world_body.inverse() * points_[id].p_world_m + Eigen::Vector2d(normal(sigma), normal(sigma));
      facts_ += json{{"kind", "landmark"},
                     {"key", {1, epoch, landmarks_}},
                     {"anchor", anchors_ - 1},
                     {"position", {p.x(), p.y()}},
                     {"covariance", upper(1.5 * own_m * own_m * Eigen::Matrix2d::Identity())},
                     {"loading", std::vector<double>(24, 0.0)}}
                    .dump() +
                "\n";
      labels_ += std::to_string(landmarks_) + "," + std::to_string(epoch) + "," + std::to_string(id) + "\n";
      if (second_lap) pairings.push_back({1, epoch, first_lap_[id], 1, epoch, landmarks_});
      else first_lap_.push_back(landmarks_);
      ++landmarks_;
    }
    if (second_lap)
      associations_.push_back({{"author", 1}, {"t_s", state.stamp_s}, {"accepted", true}, {"pairings", pairings}});
  }

  void drive() {
    DriftAccumulator<SE2> accumulator(params_of_the_run());
    ChainState<SE2> state;
    SE2 truth(10.0, 20.0, 0.3);
    trajectory_ = std::string(trajectory_header<SE2>) + "\n";
    labels_ = std::string(labels_header) + "\n";
    anchor(state, 0);
    for (int k = 0; k <= 680; ++k) {
      if (k > 0) {
        const SE2 U = SE2::Exp({1.0, 0.0, k % 170 < 50 ? M_PI / 50.0 : 0.0});
        state = accumulator.advance(0.1 * k, k, state.pose * U, SE2::Covariance::Zero());
        truth = truth * U *
                SE2::Exp({normal(std::sqrt(rate_xy)), normal(std::sqrt(rate_xy)), normal(std::sqrt(rate_theta))});
      }
      truth_.push_back({0.1 * k, truth});
      if (k > 0 && k % 340 % 30 == 15) batch(state, truth, static_cast<std::uint32_t>(k % 340 / 30), k > 340);
      const SE2::Adjoint Ad = state.pose.inverse().adjoint();
      const PoseEstimate<SE2> slam{state.pose, Ad * state.drift * Ad.transpose()};
      std::string row;
      append_number(row, state.stamp_s);
      row += ",";
      append_number(row, state.abscissa_m);
      trajectory_ += row + "," + test::csv_pose<SE2>(slam) + "," + test::csv_pose<SE2>(std::nullopt) + "\n";
    }
  }

  std::filesystem::path folder_;
  std::mt19937_64 random_;
  std::vector<TruthPose<SE2>> truth_;
  std::vector<TruthLandmark<SE2>> points_;
  std::vector<std::uint32_t> first_lap_;
  std::string trajectory_, labels_, facts_;
  json associations_ = json::array();
  std::uint32_t anchors_ = 0, landmarks_ = 0;
};

CalibrateOptions options_for(const test::TemporaryFolder& folder, int runs, const std::string& by) {
  CalibrateOptions options;
  options.by = by;
  options.drift_of_config = [](const std::filesystem::path&) { return params_of_the_run(); };
  for (int run = 0; run < runs; ++run) {
    options.runs.push_back(folder / ("run" + std::to_string(run)));
    if (!std::filesystem::exists(options.runs.back()))
      TwoLaps(options.runs.back(), 500 + static_cast<std::uint64_t>(run));
  }
  return options;
}

TEST(Calibrate, FindsWhatIsTrueByTruthAndByClosures) {
  const test::TemporaryFolder folder;
  for (const std::string by : {"truth", "closures"}) {
    const CalibrationResult r = calibrate(options_for(folder, 10, by));
    std::printf("%s", calibration_text(r).c_str());
    EXPECT_EQ(r.by_truth, by == "truth");
    EXPECT_TRUE(r.fit.converged);
    EXPECT_FALSE(r.fit[VariancePart::gamma].known);  // this SLAM states nothing
    EXPECT_NEAR(r.fit[VariancePart::translation].value / rate_xy, 1.0, 0.6) << by;
    EXPECT_NEAR(r.fit[VariancePart::rotation].value / rate_theta, 1.0, 0.5) << by;
    EXPECT_LT(r.fit[VariancePart::rotation].low, rate_theta) << by;
    EXPECT_GT(r.fit[VariancePart::rotation].high, rate_theta) << by;
    EXPECT_NEAR(r.landmark_inflation.value, inflation, 0.2) << by;
    EXPECT_EQ(r.closures, by == "truth" ? 0U : 110U);
  }
}

TEST(Calibrate, AutoTakesTheTruthIfAllRunsHaveIt) {
  const test::TemporaryFolder folder;
  CalibrateOptions options = options_for(folder, 2, "auto");
  EXPECT_TRUE(calibrate(options).by_truth);
  std::filesystem::remove_all(options.runs[1] / "truth");
  EXPECT_FALSE(calibrate(options).by_truth);
  options.by = "truth";
  EXPECT_NE(test::config_error_of([&] { calibrate(options); }).find("truth"), std::string::npos);
}

TEST(Calibrate, ARunThatIsNamedTwiceCountsOnce) {
  const test::TemporaryFolder folder;
  CalibrateOptions options = options_for(folder, 1, "truth");
  const CalibrationResult once = calibrate(options);
  options.runs.push_back(options.runs[0] / "../" / options.runs[0].filename());
  const CalibrationResult twice = calibrate(options);
  EXPECT_EQ(twice.drives.size(), once.drives.size());
  EXPECT_EQ(twice.fit.residuals, once.fit.residuals);
  EXPECT_NE(calibration_text(twice).find("named twice, and counted once"), std::string::npos);
}

TEST(Calibrate, AnUnusableOutIsToldBeforeTheWork) {
  const test::TemporaryFolder folder;
  test::write(folder / "file", "");
  CalibrateOptions options;
  options.runs = {folder / "nowhere"};
  options.out = folder / "file" / "drift.xml";
  EXPECT_NE(test::config_error_of([&] { run_calibrate(options); }).find("nothing can be written there"),
            std::string::npos);
}

TEST(Calibrate, AnOutWithoutAFolderIsWrittenHere) {
  CalibrateOptions options;
  options.runs = {"nowhere"};
  options.out = "drift.xml";
  const std::string fault = test::config_error_of([&] { run_calibrate(options); });
  EXPECT_EQ(fault.find("nothing can be written there"), std::string::npos) << fault;
  EXPECT_NE(fault.find("nowhere"), std::string::npos) << fault;
}

TEST(Calibrate, TheFragmentIsAnElementThatSaysWhatWasFound) {
  const test::TemporaryFolder folder;
  CalibrateOptions options = options_for(folder, 2, "auto");
  options.out = folder / "drift.xml";
  ASSERT_EQ(run_calibrate(options), 0);
  const CalibrationResult r = calibrate(options);
  tinyxml2::XMLDocument document;
  ASSERT_EQ(document.Parse(test::read(options.out).c_str()), tinyxml2::XML_SUCCESS);
  const auto* drift = document.FirstChildElement("drift");
  ASSERT_NE(drift, nullptr);
  EXPECT_DOUBLE_EQ(drift->DoubleAttribute("gamma"), 1.0);
  EXPECT_DOUBLE_EQ(drift->DoubleAttribute("rate_x_m2_per_m"), r.given[VariancePart::translation].value);
  EXPECT_DOUBLE_EQ(drift->DoubleAttribute("rate_y_m2_per_m"), r.given[VariancePart::translation].value);
  EXPECT_DOUBLE_EQ(drift->DoubleAttribute("rate_theta_rad2_per_m"), r.given[VariancePart::rotation].value);
  EXPECT_DOUBLE_EQ(drift->DoubleAttribute("landmark_inflation"), r.landmark_inflation.value);
}

TEST(Calibrate, RefusesWhatItCannotUse) {
  const test::TemporaryFolder folder;
  CalibrateOptions options = options_for(folder, 1, "auto");
  const auto error = [&] { return test::config_error_of([&] { calibrate(options); }); };
  options.span_m = 5.0;
  EXPECT_NE(error().find("--span"), std::string::npos);
  options.span_m = 80.0;
  options.drift_of_config = [](const std::filesystem::path&) {
    DriftParams<SE2> literal;
    literal.model = DriftModel::literal;
    return literal;
  };
  EXPECT_NE(error().find("--literal"), std::string::npos);
  options = options_for(folder, 1, "auto");
  test::write(vehicle_folder(options.runs[0], 1) / "facts.jsonl", "{\"kind\": \"anchor\"}\n");
  EXPECT_NE(error().find("facts.jsonl:1"), std::string::npos);
  options.runs.clear();
  EXPECT_NE(error().find("run folder"), std::string::npos);
}

}  // namespace
}  // namespace convoy::cli
