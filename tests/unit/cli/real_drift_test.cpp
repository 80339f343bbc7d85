// Real drift: reading recordings, models fitted to drives whose drift is known, and the recordings themselves if they
// are there.
#include "consistency/real_drift.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <tinyxml2.h>
#include <convoy/config_error.hpp>

#include <cstdlib>
#include <optional>

#include "../../support/data_folder.hpp"
#include "consistency/draw.hpp"
#include "consistency/real_drift_page.hpp"
#include "fake_run.hpp"

namespace convoy::cli::consistency {
namespace {

namespace fs = std::filesystem;
using test::config_error_of;
using test::TemporaryFolder;
using testing::HasSubstr;

// ---- reading

const std::string at_origin = "1 0 0 0 0 1 0 0 0 0 1 0\n";
// The camera has moved 3 m along its z (forward), 1 m along x (right), 0.5 m along y (down), and turned left by a right
// angle.
const std::string turned_left = "0 0 -1 1 0 1 0 0.5 1 0 0 3\n";

TEST(KittiPoses, AreReadInTheBodyFrame) {
  const TemporaryFolder folder;
  test::write(folder / "00.txt", at_origin + turned_left);
  const auto poses = read_kitti_poses(folder / "00.txt");
  ASSERT_EQ(poses.size(), 2U);
  EXPECT_EQ(poses[1].frame, 1U);
  EXPECT_TRUE(poses[1].T_start_body.translation().isApprox(Eigen::Vector3d(3.0, -1.0, -0.5)));
  EXPECT_TRUE(
      poses[1].T_start_body.rotation().col(0).isApprox(Eigen::Vector3d::UnitY(), 1e-12));  // forward is now left
  const SE2 plane = on_plane(poses[1].T_start_body);
  EXPECT_NEAR(plane.theta(), M_PI / 2.0, 1e-12);
  EXPECT_TRUE(plane.translation().isApprox(Eigen::Vector2d(3.0, -1.0)));
}

TEST(KittiPoses, MayNameTheirFrames) {
  const TemporaryFolder folder;
  test::write(folder / "slam.txt", "2 " + at_origin + "5 " + turned_left);
  const auto poses = read_kitti_poses(folder / "slam.txt");
  ASSERT_EQ(poses.size(), 2U);
  EXPECT_EQ(poses[0].frame, 2U);
  EXPECT_EQ(poses[1].frame, 5U);
}

struct Damage {
  const char* content;
  const char* message;
};
class DamagedKittiPoses : public testing::TestWithParam<Damage> {};

TEST_P(DamagedKittiPoses, AreRefusedWithFileAndLine) {
  const TemporaryFolder folder;
  test::write(folder / "05.txt", GetParam().content);
  EXPECT_THAT(config_error_of([&] { read_kitti_poses(folder / "05.txt"); }),
              HasSubstr(std::string("05.txt:") + GetParam().message));
}

INSTANTIATE_TEST_SUITE_P(
    KittiPoses, DamagedKittiPoses,
    testing::Values(Damage{"", " holds no pose"}, Damage{"1 0 0 0 0 1 0 0 0 0 1\n", "1: the line has 11 fields"},
                    Damage{"1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 0 7\n", "2: the line has 13 fields"},
                    Damage{"1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0", "2: the last line has no line end"},
                    Damage{"1 0 0 far 0 1 0 0 0 0 1 0\n", "1: field 4 is 'far'"},
                    Damage{"1 0 0 nan 0 1 0 0 0 0 1 0\n", "1: field 4 is 'nan'"},
                    Damage{"1 0 0 0 0 1 0 0 0 0 1.1 0\n", "1: the first three columns of the pose are no rotation"},
                    Damage{"1 0 0 0 0 1 0 0 0 0 -1 0\n", "1: the first three columns of the pose are no rotation"},
                    Damage{"3 1 0 0 0 0 1 0 0 0 0 1 0\n3 1 0 0 0 0 1 0 0 0 0 1 0\n",
                           "2: frame 3 does not follow frame 3"},
                    Damage{"-3 1 0 0 0 0 1 0 0 0 0 1 0\n", "1: field 1 is '-3'"}));

std::vector<FramePose> straight(int frames, double step_m) {
  std::vector<FramePose> poses;
  for (int k = 0; k < frames; ++k)
    poses.push_back({static_cast<std::uint32_t>(k), SE3(SE3::Quaternion(1, 0, 0, 0), {step_m * k, 0.0, 0.0})});
  return poses;
}

TEST(Recording, TakesItsScaleFromTheFirstMetres) {
  std::vector<FramePose> slow = straight(301, 0.05);
  slow.erase(slow.begin(), slow.begin() + 2);  // starts late, as recordings do
  const Recording<SE3> scaled = recording_of("slow", slow, straight(301, 1.0), 100.0);
  EXPECT_NEAR(scaled.scale, 20.0, 1e-9);
  EXPECT_NEAR(scaled.slam.states.back().abscissa_m, 298.0, 1e-9);
  EXPECT_NEAR(scaled.truth.front().translation().x(), 2.0, 1e-12);
  EXPECT_NEAR(recording_of("as it is", slow, straight(301, 1.0), 0.0).slam.states.back().abscissa_m, 14.9, 1e-9);
}

TEST(Recording, RefusesWhatDoesNotFitTheTruth) {
  EXPECT_THAT(config_error_of([] { recording_of("long", straight(12, 1.0), straight(10, 1.0), 0.0); }),
              HasSubstr("long: the truth has no frame 10"));
  EXPECT_THAT(config_error_of([] { recording_of("short", straight(50, 1.0), straight(50, 1.0), 100.0); }),
              HasSubstr("short: does not cover the first 100 m"));
  EXPECT_THAT(config_error_of([] { recording_of("parked", straight(200, 0.0), straight(200, 1.0), 100.0); }),
              HasSubstr("parked: does not cover the first 100 m"));
}

// A left turn of a body whose origin is 1.2 m before the axle: it moves to the left as it turns.
std::vector<FramePose> turning(int frames) {
  std::vector<FramePose> poses{{0, SE3()}};
  for (int k = 1; k < frames; ++k) {
    SE3::Tangent step;
    step << 1.0, 1.2 * 0.03, 0.0, 0.0, 0.0, 0.03;
    poses.push_back({static_cast<std::uint32_t>(k), poses.back().T_start_body * SE3::Exp(step)});
  }
  return poses;
}

std::string graph_of(const std::vector<FramePose>& truth, double left) {
  std::string text;
  for (std::size_t k = 1; k < truth.size(); ++k) {
    const SE2 z = on_plane(truth[k - 1].T_start_body).inverse() * on_plane(truth[k].T_start_body);
    text += "EDGE_SE2 " + std::to_string(k - 1) + " " + std::to_string(k);
    for (const double value : {z.translation().x(), left * z.translation().y(), z.theta()}) {
      text += ' ';
      append_number(text, value);
    }
    text += " 1 0 0 1 0 1\n";
  }
  return text;
}

TEST(GraphOdometry, IsLeftForwardWhateverItsFileSays) {
  const auto truth = turning(40);
  for (const double left : {1.0, -1.0}) {
    const G2oFile graph = parse_g2o(graph_of(truth, left), "graph");
    const LateralSense sense = lateral_sense(graph, truth);
    EXPECT_EQ(sense.mirrored(), left < 0.0);
    EXPECT_NEAR(sense.true_m_per_rad, left * sense.said_m_per_rad, 1e-9);
    EXPECT_GT(sense.true_m_per_rad, 1.0);
    const Recording<SE2> odometry = odometry_of("turn", graph, "graph", truth);
    const SE2 end = on_plane(truth.back().T_start_body);
    EXPECT_LT((end.inverse() * odometry.slam.states.back().pose).Log().norm(), 1e-9);
    EXPECT_EQ(odometry.truth.size(), truth.size());
  }
}

TEST(GraphOdometry, RefusesAGraphThatIsNotTheSequence) {
  const auto truth = turning(5);
  EXPECT_THAT(config_error_of([&] {
                odometry_of("gap", parse_g2o("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 0 2 2 0 0 1 0 0 1 0 1\n", "g"),
                            "g", truth);
              }),
              HasSubstr("g: no edge from vertex 1 to the next one"));
  EXPECT_THAT(
      config_error_of([&] { odometry_of("ids", parse_g2o("EDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n", "g"), "g", truth); }),
      HasSubstr("g: vertex 1 is no frame of the truth"));
  EXPECT_THAT(config_error_of([&] { odometry_of("long", parse_g2o(graph_of(turning(6), 1.0), "g"), "g", truth); }),
              HasSubstr("g: vertex 5 is no frame of the truth"));
}

TEST(Recording, ChainsStartAtTheirOrigin) {
  const auto truth = turning(60);
  const Recording<SE2> whole = odometry_of("turn", parse_g2o(graph_of(truth, 1.0), "g"), "g", truth);
  const std::size_t middle = middle_of(whole);
  EXPECT_NEAR(static_cast<double>(middle), 29.5, 1.0);
  const Recording<SE2> part = part_of(whole, middle, 60), chain = chain_of(whole, middle, 60);
  EXPECT_EQ(part.slam.states.front().abscissa_m, whole.slam.states[middle].abscissa_m);
  EXPECT_EQ(chain.slam.states.front().abscissa_m, 0.0);
  EXPECT_LT(chain.slam.states.front().pose.Log().norm(), 1e-12);
  const SE2 by_part = part.slam.states.front().pose.inverse() * part.slam.states.back().pose;
  EXPECT_LT((by_part.inverse() * chain.slam.states.back().pose).Log().norm(), 1e-9);
}

// ---- drift that is known

constexpr double rate_m2_per_m = 5e-3, rate_rad2_per_m = 5e-7;

// A winding drive of 1200 m in steps of 2 m, its drift drawn from the model: white, and constants of the chain.
template <class G>
Recording<G> drawn(std::uint32_t run, double scale_sigma, double heading_sigma_rad_per_m) {
  Draw draw(1, run, 40 + G::Dim);
  const double kappa = scale_sigma * draw.normal(), g = heading_sigma_rad_per_m * draw.normal();
  Recording<G> recording;
  recording.name = "drawn " + std::to_string(run);
  G T, X;
  double said_m = 0.0;
  for (int k = 0; k <= 600; ++k) {
    ChainState<G> state;
    state.abscissa_m = said_m;
    state.pose = X;
    recording.slam.states.push_back(state);
    const typename G::Tangent noise = truth_sigma<G>().cwiseProduct(draw.template unit_normal<G::Dof>());
    recording.truth.push_back(T * G::Exp(noise));
    typename G::Tangent said = G::Tangent::Zero(), yaw = G::Tangent::Zero(), eta;
    said[0] = 2.0;
    said[G::Dof - 1] = 0.04 * std::sin(0.02 * k);
    yaw[G::Dof - 1] = 2.0 * g;
    eta.template head<G::Dim>().setConstant(std::sqrt(2.0 * rate_m2_per_m));
    eta.template tail<G::Dof - G::Dim>().setConstant(std::sqrt(2.0 * rate_rad2_per_m));
    eta = eta.cwiseProduct(draw.template unit_normal<G::Dof>()).eval();
    typename G::Tangent stretched = said;
    stretched.template head<G::Dim>() *= 1.0 + kappa;
    X = X * G::Exp(said);
    T = T * G::Exp(stretched + yaw) * G::Exp(eta);
    said_m += 2.0;
  }
  return recording;
}

template <class G>
SpanStudy study_of_drawn(double scale_sigma, double heading_sigma_rad_per_m) {
  std::vector<Recording<G>> calibration;
  for (std::uint32_t run = 0; run < 12; ++run)
    calibration.push_back(drawn<G>(run, scale_sigma, heading_sigma_rad_per_m));
  const FittedModels<G> fitted = fit_models(calibration);
  std::vector<Fold<G>> folds;
  for (std::uint32_t run = 100; run < 140; ++run)
    folds.push_back({drawn<G>(run, scale_sigma, heading_sigma_rad_per_m), fitted});
  return study_spans(folds);
}

template <class G>
class KnownDrift : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(KnownDrift, Groups);

constexpr std::size_t shipped = 0, rates = 1, with_constants = 2, literal = 3;

TYPED_TEST(KnownDrift, WhiteNoiseIsCoveredByItsRates) {
  const SpanStudy study = study_of_drawn<TypeParam>(0.0, 0.0);
  EXPECT_NEAR(study.fits[0].plain_translation / rate_m2_per_m, 1.0, 0.35);
  EXPECT_NEAR(study.fits[0].plain_rotation / rate_rad2_per_m, 1.0, 0.25);
  ASSERT_EQ(study.rows.size(), std::size(span_lengths_m));
  for (const SpanRow& row : study.rows) {
    EXPECT_NEAR(row.models[rates].anees, 1.0, 0.2) << row.span_m;
    EXPECT_GE(row.models[rates].coverage95, 0.91) << row.span_m;
    EXPECT_NEAR(row.models[rates].predicted_position_m / row.position_rmse_m, 1.0, 0.25) << row.span_m;
    EXPECT_GT(row.models[shipped].anees, 2.5) << row.span_m;
  }
  EXPECT_FALSE(study.lag_plain.alarm) << study.lag_plain.largest;
}

TYPED_TEST(KnownDrift, ConstantsAreCoveredOnlyByAModelThatHasThem) {
  const double scale = 0.02, heading = 1e-4;
  const SpanStudy study = study_of_drawn<TypeParam>(scale, heading);
  EXPECT_NEAR(study.fits[0].scale / scale, 1.0, 0.45);  // a standard deviation from 12 draws
  EXPECT_NEAR(study.fits[0].heading / heading, 1.0, 0.45);
  EXPECT_NEAR(study.fits[0].rotation / rate_rad2_per_m, 1.0, 0.25);
  const auto at = [&](double span_m) {
    for (const SpanRow& row : study.rows)
      if (row.span_m == span_m) return row;
    throw std::logic_error("no such span");
  };
  for (const SpanRow& row : study.rows) {
    EXPECT_GE(row.models[with_constants].coverage95, 0.9) << row.span_m;
    EXPECT_NEAR(row.models[with_constants].anees, 1.0, 0.45) << row.span_m;
  }
  EXPECT_GT(at(800.0).models[rates].anees, 1.5);
  EXPECT_LT(at(800.0).models[rates].coverage95, 0.8);
  EXPECT_GT(at(800.0).models[rates].anees, 1.4 * at(50.0).models[rates].anees);
  EXPECT_TRUE(study.lag_plain.alarm) << study.lag_plain.largest;
  EXPECT_FALSE(study.lag_constants.alarm) << study.lag_constants.largest;
}

// Two laps of a circle by odometry whose drift is drawn, the second lap recognising the first one.
RealGraph laps(std::uint32_t run) {
  Draw draw(2, run, 50);
  RealGraph graph;
  graph.name = "laps " + std::to_string(run);
  const int frames = 760, lap = 377;
  const double radius_m = 60.0;
  SE2 T;
  const auto edge = [&](int from, int to, const SE2& z, const Eigen::Vector3d& sigma) {
    const Eigen::Matrix3d information = sigma.cwiseAbs2().cwiseInverse().asDiagonal();
    graph.graph.edges.push_back({from, to, {z.translation().x(), z.translation().y(), z.theta()}, information});
  };
  std::vector<FramePose> truth;
  for (int k = 0; k < frames; ++k) {
    graph.graph.vertices.push_back({static_cast<std::uint64_t>(k), {}});
    const SE2 at = SE2::Exp({static_cast<double>(k), 0.0, k / radius_m});
    truth.push_back({static_cast<std::uint32_t>(k),
                     SE3(SE3::Quaternion(std::cos(0.5 * at.theta()), 0.0, 0.0, std::sin(0.5 * at.theta())),
                         {at.translation().x(), at.translation().y(), 0.0})});
  }
  const Eigen::Vector3d drift(std::sqrt(rate_m2_per_m), std::sqrt(rate_m2_per_m), std::sqrt(rate_rad2_per_m));
  const Eigen::Vector3d loop(0.05, 0.05, 0.002);
  const auto noise = [&](const Eigen::Vector3d& sigma) { return SE2::Exp(sigma.cwiseProduct(draw.unit_normal<3>())); };
  const auto between = [&](int a, int b) {
    return on_plane(truth[static_cast<std::size_t>(a)].T_start_body).inverse() *
           on_plane(truth[static_cast<std::size_t>(b)].T_start_body);
  };
  for (int k = 1; k < frames; ++k) edge(k - 1, k, between(k - 1, k) * noise(drift), drift);
  for (int k = lap + 30; k < frames; k += 15) edge(k, k - lap, between(k, k - lap) * noise(loop), loop);
  graph.odometry = odometry_of(graph.name, graph.graph, graph.name, truth);
  return graph;
}

TEST(TwoHalves, OfKnownDriftAreFusedConsistently) {
  const std::vector<RealGraph> others{laps(0), laps(1), laps(2), laps(3)};
  double anees = 0.0;
  const int runs = 10;
  for (std::uint32_t run = 10; run < 10 + runs; ++run) {
    const HalvesStudy study = study_halves(laps(run), others);
    EXPECT_GT(study.loops.crossing, 15);
    EXPECT_NEAR(study.loops.anees, 1.0, 0.7);
    EXPECT_EQ(study.rows.size(), 11U);
    for (const HalvesRow& row : study.rows) {
      if (row.model != "local, fitted rates") continue;
      EXPECT_TRUE(row.linked) << row.start;
      EXPECT_EQ(row.stated, study.loops.edges);
      EXPECT_GE(row.accepted, 0.8 * row.stated) << row.left_out;
      EXPECT_LT(row.ate_m, 4.0);
      EXPECT_LT(row.distance_rmse_m, 3.0);
      if (row.start != "unknown") anees += row.anees / runs;
    }
    for (const HalvesRow& row : study.rows)
      if (row.model == "local, shipped rates") {
        EXPECT_GT(row.anees, 5.0);
      }
  }
  EXPECT_GT(anees, 0.6);
  EXPECT_LT(anees, 1.4);
}

// ---- where the recordings are

/// Sets CONVOY_DATA_DIR for a test, or takes it away.
class DataVariable {
 public:
  explicit DataVariable(const char* value) {
    if (const char* before = std::getenv("CONVOY_DATA_DIR")) before_ = before;
    if (value) ::setenv("CONVOY_DATA_DIR", value, 1);
    else ::unsetenv("CONVOY_DATA_DIR");
  }
  ~DataVariable() {
    if (before_) ::setenv("CONVOY_DATA_DIR", before_->c_str(), 1);
    else ::unsetenv("CONVOY_DATA_DIR");
  }

 private:
  std::optional<std::string> before_;
};

TEST(RealDrift, IsLeftOutWithALineWithoutRecordings) {
  const TemporaryFolder folder;
  for (const char* value : {static_cast<const char*>(nullptr), folder.path().c_str()}) {
    const DataVariable variable(value);
    const RealDrift drift = measure_real_drift({});
    EXPECT_THAT(drift.left_out, HasSubstr("--data DIR or CONVOY_DATA_DIR"));
    EXPECT_THAT(real_drift_section(drift), HasSubstr("--data DIR"));
    EXPECT_TRUE(to_json(drift).is_array());
    EXPECT_TRUE(to_json(drift).empty());
  }
  EXPECT_THAT(config_error_of([&] { measure_real_drift(folder.path()); }),
              HasSubstr("holds no folder kitti_trajectories"));
  EXPECT_THAT(config_error_of([&] { measure_real_drift(folder / "nowhere"); }), HasSubstr("nowhere: no such folder"));
  const DataVariable empty(folder.path().c_str());
  EXPECT_THAT(measure_real_drift({}).left_out,
              HasSubstr("(CONVOY_DATA_DIR: " + folder.path().string() + ": holds no folder kitti_trajectories)"));
}

TEST(RealDrift, NamesTheFileThatIsDamaged) {
  const TemporaryFolder folder;
  test::write(folder / "kitti_trajectories/gt/09.txt", at_origin + "1 0 0\n");
  test::write(folder / "kitti_trajectories/slam_estimates/example_1_09.txt", at_origin);
  EXPECT_THAT(config_error_of([&] { measure_real_drift(folder.path()); }),
              HasSubstr("gt/09.txt:2: the line has 3 fields"));
}

std::optional<fs::path> recordings() {
  const fs::path root = convoy::test::data_folder();
  for (const char* file : {"kitti_trajectories/gt/05.txt", "kitti_trajectories/slam_estimates/example_0_09.txt",
                           "pose_graphs/single/kitti_05.g2o", "pose_graphs/single/kitti_06.g2o"})
    if (!fs::exists(root / file)) return std::nullopt;
  return root;
}

TEST(RealDrift, OfKittisVehicle) {
  const auto root = recordings();
  if (!root)
    GTEST_SKIP()
        << "no KITTI recordings; set CONVOY_DATA_DIR to the folder that holds kitti_trajectories and pose_graphs";
  const RealDrift drift = measure_real_drift(*root);
  const auto find = [](const auto& studies, const std::string& name) -> const auto& {
    for (const auto& study : studies)
      if (study.name == name) return study;
    throw std::logic_error("no study " + name);
  };
  const auto at = [](const SpanStudy& study, double span_m) -> const SpanRow& {
    for (const SpanRow& row : study.rows)
      if (row.span_m == span_m) return row;
    throw std::logic_error("no such span");
  };

  // Few spans cover nothing: the page says which lengths do.
  const std::string html = real_drift_section(drift);
  EXPECT_THAT(html, HasSubstr("KITTI 05 (2‑D)</td><td class=\"text\">none</td>"));  // shipped rates
  EXPECT_THAT(html, HasSubstr("25 to 800 m"));

  // A monocular SLAM: no scale of its own, and what it has wanders.
  const SpanStudy& mono = find(drift.spans, "example_0_09");
  EXPECT_NEAR(mono.scale, 20.0, 1.0);
  EXPECT_GT(at(mono, 400.0).models[rates].anees, 1.2);
  EXPECT_LT(at(mono, 400.0).models[rates].coverage95, 0.9);
  EXPECT_GE(at(mono, 400.0).models[with_constants].coverage95, 0.9);
  EXPECT_GT(mono.lag_plain.largest, 0.4);

  // Odometry: the heading turns at a rate of its own, always to the same side.
  const SpanStudy& five = find(drift.spans, "KITTI 05");
  EXPECT_GE(at(five, 100.0).models[rates].coverage95, 0.9);
  EXPECT_LT(at(five, 800.0).models[rates].coverage95, 0.4);
  EXPECT_LT(at(five, 800.0).models[literal].coverage95, 0.4);
  EXPECT_GE(at(five, 800.0).models[with_constants].coverage95, 0.95);
  EXPECT_LT(at(five, 800.0).models[with_constants].anees, 1.2);
  EXPECT_TRUE(five.lag_plain.alarm);
  for (const auto& [name, constants] : five.fits[0].constants) {
    EXPECT_LT(constants[1], -2e-5) << name;
    EXPECT_GT(constants[1], -2e-4) << name;
  }
  for (const SpanStudy& study : drift.spans)  // nothing of what a SLAM states is there to help them
    for (const SpanRow& row : study.rows) EXPECT_GT(row.models[shipped].anees, 3.0) << study.name;
  ASSERT_FALSE(drift.lateral.empty());
  for (const auto& [name, sense] : drift.lateral) EXPECT_TRUE(sense.mirrored()) << name;

  for (const char* name : {"KITTI 05", "KITTI 06"}) {
    const HalvesStudy& study = find(drift.halves, name);
    EXPECT_LT(study.loops.median_error_m, 0.05) << "as good as the truth";
    double alone_m = 0.0;
    for (const HalvesRow& row : study.rows) {
      if (row.model == "dead reckoning, local, fitted rates") alone_m = row.distance_rmse_m;
      if (row.model == "local, shipped rates") {
        EXPECT_GT(row.anees, 50.0) << name;
      }
      if (row.model != "local, fitted rates") continue;
      EXPECT_TRUE(row.linked) << name << ", start " << row.start;
      EXPECT_GT(row.anees, 0.6) << name;
      EXPECT_LT(row.anees, 1.8) << name;
      EXPECT_GE(row.coverage95, 0.93) << name;
      EXPECT_LT(row.ate_m, 3.5) << name;
      EXPECT_LT(row.distance_rmse_m, 0.25 * alone_m) << name;
      EXPECT_GE(row.accepted, 0.85 * row.stated) << name;
    }
    EXPECT_GT(alone_m, 10.0) << name;
  }

  tinyxml2::XMLDocument page;
  EXPECT_EQ(page.Parse(html.c_str()), tinyxml2::XML_SUCCESS) << page.ErrorStr();
  const auto json = to_json(drift);
  int halves = 0, spans = 0;
  for (const auto& entry : json) {
    halves += entry.at("kind") == "halves";
    spans += entry.at("kind") == "spans";
  }
  EXPECT_EQ(halves, 22);
  EXPECT_GT(spans, 100);
  EXPECT_EQ(json, to_json(measure_real_drift(*root)));  // same files, same bits
}

}  // namespace
}  // namespace convoy::cli::consistency
