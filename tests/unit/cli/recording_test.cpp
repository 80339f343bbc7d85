#include "replay/recording.hpp"

#include <convoy/config_error.hpp>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include <algorithm>
#include <map>

#include "fake_run.hpp"
#include "replay/frame_pictures.hpp"
#include "replay/image_tracker.hpp"

namespace convoy::cli {
namespace {

namespace fs = std::filesystem;
using test::config_error_of;

/// Blocks of grey at random, all of them `shift_px` further to the right.
cv::Mat blocks(int width, int height, int shift_px) {
  constexpr int block_px = 7;
  const CounterRng draw(3, 0, 0);
  cv::Mat image(height, width, CV_8UC1);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const int column = (x - shift_px + 100 * block_px) / block_px, row = y / block_px;
      image.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(
          40.0 + 170.0 * draw.uniform(static_cast<std::uint32_t>(column), static_cast<std::uint32_t>(row)));
    }
  return image;
}

const std::string camera =
    "image_width: 320\nimage_height: 240\ncamera_matrix: [200, 0, 160, 0, 200, 120, 0, 0, 1]\n"
    "distortion_coefficients: [0, 0, 0, 0, 0]\n";
const std::string mount = "T_body_camera: [0, 0, 1, 1.7, -1, 0, 0, 0, 0, -1, 0, 1.4, 0, 0, 0, 1]\n";

/// A recording of a user's own: three images, columns in an order of its own.
class Images : public testing::Test {
 protected:
  void SetUp() override {
    fs::create_directories(folder_ / "images");
    for (int k = 0; k < 3; ++k)
      cv::imwrite((folder_ / "images" / (std::to_string(k) + ".png")).string(), blocks(320, 240, 3 * k));
    write("camera.yaml", camera + mount);
    write("frames.csv", "frame,stamp_s\n0,1000.1\n1,1000.2\n2,1000.3\n");
    write("odometry.csv", "yaw_rate_radps,stamp_s,distance_m\n0.1,1000.05,0\n0.1,1000.15,0.2\n0.2,1000.35,0.4\n");
  }
  void write(const std::string& name, const std::string& text) { test::write(folder_ / name, text); }
  Recording open(double rate_hz = 0.0) { return open_images(folder_.path(), rate_hz); }
  void expect_refusal(const std::string& words) {
    const std::string error = config_error_of([this] { open(); });
    EXPECT_NE(error.find(words), std::string::npos) << error;
  }

  test::TemporaryFolder folder_;
};

TEST_F(Images, AnOwnRecordingIsReadAndItsTimesCountFromAWholeSecond) {
  Recording recording = open();
  EXPECT_EQ(recording.start_stamp_s, 1000.0);
  ASSERT_EQ(recording.odometry.size(), 3U);
  EXPECT_NEAR(recording.odometry[2].stamp_s, 0.35, 1e-9);
  EXPECT_EQ(recording.odometry[2].distance_m, 0.4);
  EXPECT_EQ(recording.odometry[2].yaw_rate_radps, 0.2);
  EXPECT_NEAR(recording.next_image().stamp_s, 0.1, 1e-9);
  EXPECT_NEAR(recording.T_body_camera.translation().x(), 1.7, 1e-12);
  EXPECT_TRUE(recording.truth.empty());
  EXPECT_TRUE(recording.notice.empty());
}

TEST_F(Images, ADriveBeginsWhereItsTruthDoes) {
  write("truth.csv",
        "time_s,x_m,y_m,z_m,qw,qx,qy,qz\n1000.1,1,2,3,1,0,0,0\n1000.2,1,2,3,1,0,0,0\n1000.4,2,2,3,1,0,0,0\n");
  const Recording recording = open();
  ASSERT_EQ(recording.truth.size(), 3U);
  EXPECT_NEAR(recording.truth.front().t_s, 0.1, 1e-9);
  ASSERT_EQ(recording.odometry.size(), 2U);
  EXPECT_NEAR(recording.odometry.front().stamp_s, 0.15, 1e-9);
}

TEST_F(Images, WithoutAnOdometerThereAreImagesAloneAndThatIsSaid) {
  fs::remove(folder_ / "odometry.csv");
  fs::remove(folder_ / "camera.yaml");
  const Recording recording = open();
  EXPECT_TRUE(recording.odometry.empty());
  EXPECT_NE(recording.notice.find("no odometry.csv"), std::string::npos);
}

TEST_F(Images, WhatCannotBeUsedIsNamedWithItsMend) {
  write("odometry.csv", "stamp_s,distance_m,yaw_rate_radps\n0.1,0,0\n0.2,x,0\n");
  expect_refusal("odometry.csv:3: field 2 is 'x'; it must be a finite number");
  write("odometry.csv", "stamp_s,distance_m,yaw_rate_radps\n0.1,0,0\n0.1,0,0\n");
  expect_refusal("odometry.csv:3: stamp_s is not later");
  write("odometry.csv", "stamp_s,distance_m\n0.1,0\n");
  expect_refusal("odometry.csv:1: has no column gyro_yaw_rate_radps or wheels_yaw_rate_radps or yaw_rate_radps");
  write("odometry.csv", "");
  expect_refusal("odometry.csv:1: has no column stamp_s");
  write("odometry.csv", "stamp_s,distance_m,yaw_rate_radps\n0.1,0,0\n");
  expect_refusal("odometry.csv: has fewer than two readings");
}

TEST_F(Images, ACameraThatDoesNotFitIsNamed) {
  write("camera.yaml", camera);
  expect_refusal("camera.yaml: does not say where the camera sits on the vehicle; add T_body_camera");
  std::string other = camera + mount;
  other.replace(other.find("320"), 3, "640");
  write("camera.yaml", other);
  expect_refusal("images are 320 x 240, the camera was calibrated with 640 x 240");
  fs::remove(folder_ / "camera.yaml");
  expect_refusal("camera.yaml: no such file");
}

TEST_F(Images, AFolderThatIsNoRecordingIsRefused) {
  fs::remove(folder_ / "frames.csv");
  expect_refusal("says nowhere when its images were taken");
  EXPECT_EQ(open(10.0).odometry.size(), 3U);
  fs::remove_all(folder_ / "images");
  fs::create_directories(folder_ / "images");
  write("frames.csv", "frame,stamp_s\n0,1\n");
  expect_refusal("images: holds no picture");
  fs::create_directories(folder_ / "parent");
  fs::rename(folder_ / "images", folder_ / "parent/images");
  fs::rename(folder_ / "odometry.csv", folder_ / "parent/odometry.csv");
  expect_refusal("holds the recordings of vehicles; give that of one of them");
  const std::string error = config_error_of([&] { open_images(folder_ / "nowhere", 0.0); });
  EXPECT_NE(error.find("nowhere: is no folder"), std::string::npos) << error;
}

// ---- KITTI ----

std::string kitti_pose(double x, double y, double z) {
  return "1 0 0 " + std::to_string(x) + " 0 1 0 " + std::to_string(y) + " 0 0 1 " + std::to_string(z) + "\n";
}

class Kitti : public testing::Test {
 protected:
  void SetUp() override {
    fs::create_directories(folder_ / "image_0");
    std::string poses;
    for (int k = 0; k < 4; ++k) {
      cv::imwrite((folder_ / "image_0" / ("00000" + std::to_string(k) + ".png")).string(), blocks(320, 240, 3 * k));
      poses += kitti_pose(0.0, -0.02 * k, 1.0 * k);  // the camera looks down a little
    }
    test::write(folder_ / "poses.txt", poses);
    test::write(folder_ / "calib.txt", "P0: 200 0 160 0 0 200 120 0 0 0 1 0\n");
  }
  void expect_refusal(const std::string& words) {
    const std::string error = config_error_of([this] { open_kitti_drive(folder_.path()); });
    EXPECT_NE(error.find(words), std::string::npos) << error;
  }
  test::TemporaryFolder folder_;
};

TEST_F(Kitti, TheOdometerIsMadeOfTheTruthAndThatIsSaid) {
  const Recording recording = open_kitti_drive(folder_.path());
  ASSERT_EQ(recording.odometry.size(), 4U);
  for (std::size_t k = 1; k < 4; ++k) {
    EXPECT_NEAR(recording.odometry[k].distance_m, 1.0002, 0.02);
    EXPECT_NE(recording.odometry[k].distance_m, recording.odometry[1 + k % 3].distance_m);
  }
  EXPECT_NE(recording.notice.find("made from the true poses, with 0.5 % noise"), std::string::npos);
  const SE3 step = recording.truth[0].T_world_body.inverse() * recording.truth[3].T_world_body;
  EXPECT_NEAR(step.translation().y(), 0.0, 1e-9);  // straight ahead in the body's frame, whatever the camera's angle
  EXPECT_NEAR(step.translation().z(), 0.0, 1e-9);
  EXPECT_GT(step.translation().x(), 3.0);
}

TEST_F(Kitti, PosesThatDoNotFitAreNamed) {
  test::write(folder_ / "poses.txt", kitti_pose(0, 0, 0) + kitti_pose(0, 0, 1));
  expect_refusal("poses.txt: has 2 poses for 4 images");
  test::write(folder_ / "poses.txt", kitti_pose(0, 0, 0) + "1 2 3\n");
  expect_refusal("poses.txt:2: the line has 3 numbers, a pose has 12");
  test::write(folder_ / "poses.txt", "1 1 0 0 0 1 0 0 0 0 1 0\n");
  expect_refusal("poses.txt:1: the first three columns are no rotation");
  fs::remove(folder_ / "poses.txt");
  expect_refusal("poses.txt: no such file");
  fs::remove_all(folder_ / "image_0");
  expect_refusal("is no drive of KITTI's odometry benchmark");
}

TEST(OdometerFromTruth, TurnsAndDrivesBackAsTheTruthDoes) {
  std::vector<TruthPose<SE3>> truth{{0.0, SE3()}};
  truth.push_back({0.5, SE3::Exp((SE3::Tangent() << 1, 0, 0, 0, 0, 0.1).finished())});
  truth.push_back({1.0, truth[1].T_world_body * SE3::Exp((SE3::Tangent() << -2, 0, 0, 0, 0, 0).finished())});
  const auto exact = odometer_from_truth(truth, 0.0, 1), noisy = odometer_from_truth(truth, 0.01, 1);
  EXPECT_NEAR(exact[1].distance_m, 1.0, 1e-9);
  EXPECT_NEAR(exact[1].yaw_rate_radps, 0.2, 1e-9);
  EXPECT_NEAR(exact[2].distance_m, -2.0, 1e-9);
  EXPECT_NE(noisy[1].distance_m, exact[1].distance_m);
  EXPECT_NEAR(noisy[1].distance_m, 1.0, 0.05);
  EXPECT_EQ(odometer_from_truth(truth, 0.01, 1)[2].distance_m, noisy[2].distance_m);
  EXPECT_NE(odometer_from_truth(truth, 0.01, 2)[2].distance_m, noisy[2].distance_m);
}

// ---- pictures and images alone ----

TEST(FramePictures, AreAHandfulEvenlySpread) {
  const test::TemporaryFolder folder;
  FramePictures pictures;
  const cv::Mat grey = blocks(64, 48, 0);
  for (std::uint64_t k = 0; k < 1000; ++k) pictures.look(k, grey, {});
  pictures.write(folder / "frames");
  std::vector<std::string> names;
  for (const auto& entry : fs::directory_iterator(folder / "frames")) names.push_back(entry.path().filename().string());
  std::sort(names.begin(), names.end());
  ASSERT_EQ(names.size(), 8U);
  EXPECT_EQ(names[0], "000000.png");
  EXPECT_EQ(names[1], "000128.png");
  EXPECT_EQ(names[7], "000896.png");
}

TEST(FramePictures, TellKindsOfFeaturesApart) {
  const auto color_at = [](const TrackedFeature& feature) {
    const cv::Mat image = drawn(cv::Mat(100, 480, CV_8UC1, cv::Scalar(0)), {feature});
    return image.at<cv::Vec3b>(50, 55);  // on the ring
  };
  TrackedFeature candidate{1, {50, 50}, 0.9}, landmark = candidate, converged = candidate, fresh = candidate;
  landmark.landmark = converged.landmark = converged.converged = true;
  fresh.score = 0.0;
  const std::vector<cv::Vec3b> colors{color_at(candidate), color_at(landmark), color_at(converged), color_at(fresh)};
  for (std::size_t i = 0; i < colors.size(); ++i) {
    EXPECT_NE(colors[i], cv::Vec3b(0, 0, 0));
    for (std::size_t j = 0; j < i; ++j) EXPECT_NE(colors[i], colors[j]);
  }
}

TEST(ImageTracker, FollowsWhatMovesThroughTheImages) {
  ImageTracker tracker({}, 320, 240);
  std::map<std::uint64_t, Eigen::Vector2d> before;
  int followed = 0, right = 0;
  for (int k = 0; k < 10; ++k) {
    const ImageReport report = tracker.follow(0.1 * k, blocks(320, 240, 3 * k));
    for (const TrackedFeature& f : report.features) {
      if (f.score > 0.0 && before.contains(f.track)) {
        ++followed;
        right += (f.pixel - before[f.track] - Eigen::Vector2d(3.0, 0.0)).norm() < 0.2;
      }
      before[f.track] = f.pixel;
    }
  }
  EXPECT_GT(followed, 100);
  EXPECT_GE(right, 0.95 * followed);
}

}  // namespace
}  // namespace convoy::cli
