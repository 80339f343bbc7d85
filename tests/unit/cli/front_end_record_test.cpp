#include "evaluate/front_end_record.hpp"

#include <convoy/config_error.hpp>

#include <gtest/gtest.h>

#include "fake_run.hpp"
#include "report/front_end_section.hpp"

namespace convoy::cli {
namespace {

using test::config_error_of;

/// A drive straight ahead, 1 m from image to image, whose estimate is `scale` as long as the truth.
struct StraightDrive {
  std::vector<FrontEndFrame> frames;
  std::vector<TruthPose<SE3>> truth;

  explicit StraightDrive(double length_m, double scale = 1.0, double odometry_scale = 1.0) {
    const SE3 T_world_start = SE3::Exp((SE3::Tangent() << 5, 6, 7, 0.1, 0.2, 2.0).finished());
    for (int k = 0; k <= static_cast<int>(length_m); ++k) {
      FrontEndFrame f;
      f.t_s = 0.1 * k;
      f.epoch = 1;
      f.path_m = scale * k;
      f.T_start_body = ahead(scale * k);
      f.T_start_odometry = ahead(odometry_scale * k);
      f.took_ms = k;
      f.sought = 50;
      f.tracked = static_cast<std::uint32_t>(k);
      f.started = 2;
      f.exported = static_cast<std::uint32_t>(2 * k);
      frames.push_back(f);
      truth.push_back({f.t_s, T_world_start * ahead(k)});
    }
  }
  static SE3 ahead(double x_m) { return SE3::Exp((SE3::Tangent() << x_m, 0, 0, 0, 0, 0).finished()); }
};

TEST(FrontEndRecord, IsReadBackAsItWasWritten) {
  const test::TemporaryFolder folder;
  const StraightDrive drive(20.0, 1.01);
  write_front_end(folder / "front_end.csv", drive.frames);
  const auto read = read_front_end(folder / "front_end.csv");
  ASSERT_EQ(read.size(), drive.frames.size());
  const FrontEndFrame &a = read[7], &b = drive.frames[7];
  EXPECT_EQ(a.t_s, b.t_s);
  EXPECT_EQ(a.epoch, b.epoch);
  EXPECT_EQ(a.T_start_body.translation(), b.T_start_body.translation());
  EXPECT_EQ(a.T_start_odometry.translation(), b.T_start_odometry.translation());
  EXPECT_EQ(a.took_ms, b.took_ms);
  EXPECT_EQ(a.tracked, b.tracked);
  EXPECT_EQ(a.exported, b.exported);
}

TEST(FrontEndRecord, ADamagedFileIsRefusedWithItsLine) {
  const test::TemporaryFolder folder;
  const auto file = folder / "front_end.csv";
  write_front_end(file, StraightDrive(3.0).frames);
  const std::string text = test::read(file);
  test::write(file, text.substr(0, text.size() - 5));
  EXPECT_NE(config_error_of([&] { read_front_end(file); }).find("front_end.csv:5: "), std::string::npos);
  EXPECT_EQ(read_front_end(file, true).size(), 3U);
  test::write(file, text + text.substr(text.rfind('\n', text.size() - 2) + 1));
  EXPECT_NE(config_error_of([&] { read_front_end(file); }).find("front_end.csv:6: time does not grow"),
            std::string::npos);
}

TEST(FrontEndRecord, DriftIsOfTheTrueDistanceAndNothingIsFitted) {
  const StraightDrive drive(250.0, 1.01, 0.98);
  const auto m = judge_front_end(drive.frames, drive.truth);
  EXPECT_NEAR(m.at("drift_percent").get<double>(), 1.0, 1e-9);
  EXPECT_NEAR(m.at("odometry_drift_percent").get<double>(), 2.0, 1e-9);
  EXPECT_NEAR(m.at("drift_percent_100m").get<double>(), 1.0, 1e-9);
  EXPECT_EQ(m.at("drift_parts_100m"), 16);  // beginning at 0 m, 10 m, ... 150 m
  EXPECT_NEAR(m.at("exports_per_100m").get<double>(), 100.0 * 500 / 252.5, 1e-9);
  EXPECT_EQ(m.at("lost_epochs"), 0);
}

TEST(FrontEndRecord, QuantilesAreOfAllImagesAndTracksOfAllButTheFirst) {
  const auto m = judge_front_end(StraightDrive(100.0).frames, {});
  EXPECT_EQ(m.at("frames"), 101);
  EXPECT_EQ(m.at("ms_p50"), 50.0);
  EXPECT_EQ(m.at("ms_p95"), 95.0);
  EXPECT_EQ(m.at("ms_max"), 100.0);
  EXPECT_EQ(m.at("tracked_p50"), 51);
  EXPECT_EQ(m.at("frames_without_tracks"), 0);
  EXPECT_NEAR(m.at("track_length_mean").get<double>(), (5050.0 + 202.0) / 202.0, 1e-9);
}

TEST(FrontEndRecord, OfAFleetLengthsAndErrorsAreSummedUpFirst) {
  const StraightDrive a(305.0, 1.01), b(105.0, 0.95);
  const auto m = judge_front_ends({{a.frames, a.truth}, {b.frames, b.truth}, {}});
  EXPECT_EQ(m.at("frames"), 412);
  EXPECT_EQ(m.at("ms_max"), 305.0);
  EXPECT_NEAR(m.at("drift_percent").get<double>(), (3.05 + 5.25) / 4.1, 1e-9);
  EXPECT_NEAR(m.at("path_m").get<double>(), 308.05 + 99.75, 1e-9);
  EXPECT_NEAR(m.at("exports_per_100m").get<double>(), 100.0 * (610 + 210) / (308.05 + 99.75), 1e-9);
  EXPECT_EQ(m.at("drift_parts_100m"), 21 + 1);  // beginning at 0 m, 10 m, ... 200 m, and at 0 m
  EXPECT_TRUE(judge_front_ends({{}, {}}).is_null());
}

TEST(FrontEndRecord, APlanarPoseInSpaceTurnsAboutTheVertical) {
  const SE2 a(1.0, 2.0, 0.7), b(-3.0, 0.5, -2.9);
  EXPECT_LT((in_space(a) * in_space(b) * in_space(a * b).inverse()).Log().norm(), 1e-12);
  EXPECT_EQ(in_space(a).translation(), Eigen::Vector3d(1.0, 2.0, 0.0));
}

TEST(FrontEndRecord, WhatDoesNotExistIsNull) {
  EXPECT_TRUE(judge_front_end({}, {}).is_null());
  const auto without_truth = judge_front_end(StraightDrive(50.0).frames, {});
  EXPECT_TRUE(without_truth.at("drift_percent").is_null());
  EXPECT_TRUE(without_truth.at("exports_per_100m").is_number());
  StraightDrive images(50.0);
  for (FrontEndFrame& f : images.frames) f.epoch = 0;
  const auto alone = judge_front_end(images.frames, images.truth);
  for (const char* key : {"drift_percent", "exports_per_100m", "path_m", "lost_epochs"})
    EXPECT_TRUE(alone.at(key).is_null()) << key;
  const StraightDrive brief(50.0);
  EXPECT_TRUE(judge_front_end(brief.frames, brief.truth).at("drift_percent_100m").is_null());
}

TEST(FrontEndRecord, EachNewEpochIsALoss) {
  StraightDrive drive(30.0);
  for (std::size_t i = 10; i < drive.frames.size(); ++i) drive.frames[i].epoch = i < 20 ? 2 : 3;
  EXPECT_EQ(judge_front_end(drive.frames, drive.truth).at("lost_epochs"), 2);
}

TEST(FrontEndSection, OfAFleetShowsEachVehicle) {
  const StraightDrive a(120.0, 1.01), b(150.0);
  const nlohmann::json vehicles = {{{"id", 4}, {"front_end", judge_front_end(a.frames, a.truth)}},
                                   {{"id", 7}, {"front_end", judge_front_end(b.frames, b.truth)}}};
  const std::vector<FrontEndDrive> drives{{a.frames, a.truth}, {b.frames, b.truth}};
  const std::string section = front_end_section(judge_front_ends(drives), vehicles, drives);
  for (const char* words : {"<h2>Vehicle 4</h2>", "<h2>Vehicle 7</h2>", "off by 1.00 %", "off by 0.00 %"})
    EXPECT_NE(section.find(words), std::string::npos) << words;
  EXPECT_EQ(section.find("and heights"), std::string::npos) << "a planar fleet has none";
}

TEST(FrontEndSection, ShowsPathAndPicturesOfARecordingAndNoPathWithoutAnOdometer) {
  const test::TemporaryFolder folder;
  for (int k = 0; k < 9; ++k) test::write(folder / "frames" / ("00000" + std::to_string(k) + ".png"), "");
  StraightDrive drive(120.0, 1.01);
  const std::string section =
      front_end_section(judge_front_end(drive.frames, drive.truth), drive.frames, drive.truth, folder.path());
  EXPECT_NE(section.find("<h3>Path</h3>"), std::string::npos);
  EXPECT_NE(section.find("off by 1.00 %"), std::string::npos);
  std::size_t pictures = 0;
  for (std::size_t at = section.find("<img "); at != std::string::npos; at = section.find("<img ", at + 1)) ++pictures;
  EXPECT_EQ(pictures, 6U);
  for (FrontEndFrame& f : drive.frames) f.epoch = 0;
  const std::string alone = front_end_section(judge_front_end(drive.frames, {}), drive.frames, {}, folder.path());
  EXPECT_EQ(alone.find("<h3>Path</h3>"), std::string::npos);
  EXPECT_NE(alone.find("<h3>Time and features</h3>"), std::string::npos);
}

}  // namespace
}  // namespace convoy::cli
