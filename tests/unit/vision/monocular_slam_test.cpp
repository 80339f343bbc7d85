// The front end with eyes, on images of a street whose geometry is known.
#include <convoy/config_error.hpp>
#include <convoy/vision/monocular_slam.hpp>

#include "drawn_scene.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace convoy {
namespace {

constexpr double speed_mps = 2.5, frame_s = 0.1, odometry_s = 0.05;

CameraCalibration small_camera() {
  CameraCalibration c;
  c.width = 320;
  c.height = 240;
  c.fx = c.fy = 185.0;
  c.cx = 159.5;
  c.cy = 119.5;
  return c;
}

SE3 mounted() {
  Eigen::Matrix3d R;
  R << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  return SE3::from_rotation(R, {1.0, 0.0, 1.4});
}

/// A straight street along x, from -5 to 75 m: ground, and walls 4 m to the left and 3 m to the right, 6 m high.
class Street {
 public:
  Street() : texture_(test::random_texture(80 * px_per_m, 19 * px_per_m, 7)) {}

  cv::Mat seen_from(const SE3& T_world_camera) const {
    const CameraModel camera(small_camera());
    const auto place = [&](const Eigen::Vector2d& pixel) -> Eigen::Vector2d {
      const Eigen::Vector3d ray = T_world_camera.rotation() * camera.ray(pixel), p = T_world_camera.translation();
      const double to_ground = ray.z() < 0.0 ? -p.z() / ray.z() : 1e9;
      const double to_wall = ray.y() > 0.0 ? (left_m - p.y()) / ray.y() : (right_m - p.y()) / ray.y();
      const Eigen::Vector3d hit = p + std::min(to_ground, to_wall) * ray;
      const double across = to_ground < to_wall ? 12.0 + hit.y() - right_m : hit.y() > 0.0 ? hit.z() : 6.0 + hit.z();
      const bool sky = to_ground >= to_wall && hit.z() > 6.0;
      return sky ? Eigen::Vector2d(-1, -1) : px_per_m * Eigen::Vector2d(hit.x() + 5.0, across);
    };
    return test::draw(texture_, 320, 240, place, 2);
  }

  /// To the nearest surface [m].
  static double distance(const Eigen::Vector3d& point) {
    return std::min({std::abs(point.z()), std::abs(point.y() - left_m), std::abs(point.y() - right_m)});
  }

 private:
  static constexpr int px_per_m = 24;
  static constexpr double left_m = 4.0, right_m = -3.0;
  cv::Mat texture_;
};

const Street& street() {
  static const Street it;
  return it;
}

/// Drives along the street, and keeps what is exported.
class Drive {
 public:
  explicit Drive(const MonocularSlamParams& params = {}) : slam(params, small_camera(), mounted()) {
    slam.on_report([this](const ImageReport& report, const cv::Mat&) { reports.push_back(report); });
    slam.on_odometry(0.0, 0.0, 0.0);
  }

  SE3 truth() const { return SE3::from_rotation(Eigen::Matrix3d::Identity(), {x_m, 0.0, 0.0}); }

  /// One frame of driving on; nothing is seen in a frame that the camera drops.
  void step(double speed = speed_mps, const std::function<cv::Mat(const cv::Mat&)>& change = {}, bool dropped = false) {
    for (int i = 0; i < 2; ++i) {
      t_s += odometry_s;
      x_m += speed * odometry_s;
      const double noise_m = speed == 0.0 ? 0.0 : 0.0005 * std::normal_distribution<>()(random_);
      slam.on_odometry(t_s, odometer * (speed * odometry_s + noise_m), 0.001 * std::normal_distribution<>()(random_));
    }
    if (!dropped) {
      const cv::Mat image = test::exposed(street().seen_from(truth() * mounted()), 1.0, 1.0, 2.0, ++seed_);
      slam.on_image(t_s, change ? change(image) : image);
    }
    for (auto& segment : slam.take_segments()) segments.push_back(std::move(segment));
  }
  void finish() {
    slam.finish();
    for (auto& segment : slam.take_segments()) segments.push_back(std::move(segment));
  }
  double error_m() const { return (slam.state().pose.translation() - truth().translation()).norm(); }
  std::size_t exported() const {
    std::size_t count = 0;
    for (const auto& segment : segments) count += segment.landmarks.size();
    return count;
  }

  MonocularSlam slam;
  std::vector<ImageReport> reports;
  std::vector<Segment<SE3>> segments;
  double t_s = 0.0, x_m = 0.0;
  double odometer = 1.0;  ///< what it says, of what it should say

 private:
  std::mt19937_64 random_{5};
  std::uint64_t seed_ = 0;
};

TEST(MonocularSlam, FollowsAStreetAndExportsWhatIsThere) {
  Drive drive;
  for (int i = 0; i < 130; ++i) drive.step();
  drive.finish();
  const double driven_m = drive.x_m;
  EXPECT_LT(drive.error_m(), 0.005 * driven_m);
  EXPECT_GT(drive.exported(), 1.5 * driven_m);
  double nees = 0.0;
  std::size_t described = 0, off = 0;
  for (const auto& segment : drive.segments) {
    for (const auto& landmark : segment.landmarks) {
      const Eigen::Vector3d at = segment.closing.pose * landmark.position;
      const double sigma_m = std::sqrt(landmark.covariance.trace());
      off += Street::distance(at) > 3.0 * sigma_m + 0.1;
      described += landmark.descriptor.kind == Descriptor::Kind::patch_8x8_4bit;
    }
    const SE3 T_slam_true = SE3::from_rotation(Eigen::Matrix3d::Identity(), {segment.closing.abscissa_m, 0, 0});
    nees = std::max(nees, std::abs((segment.closing.pose.inverse() * T_slam_true).Log()[5]));
  }
  EXPECT_LT(nees, 0.01);
  EXPECT_LE(off, drive.exported() / 20);
  EXPECT_GE(described, drive.exported() * 3 / 5) << "of this small camera, what is 31 m away has no descriptor";
  EXPECT_EQ(drive.slam.counters().images, 130U);
  EXPECT_FALSE(drive.slam.lost());
}

TEST(MonocularSlam, TheSameImagesGiveTheSameResultToTheBit) {
  Drive a, b;
  for (Drive* drive : {&a, &b})
    for (int i = 0; i < 40; ++i) drive->step();
  EXPECT_EQ(a.slam.state().pose.translation(), b.slam.state().pose.translation());
  EXPECT_EQ(a.slam.state().slam_drift, b.slam.state().slam_drift);
  EXPECT_EQ(a.slam.counters().tracks_started, b.slam.counters().tracks_started);
}

TEST(MonocularSlam, AnImageWaitsForItsOdometry) {
  Drive drive;
  const cv::Mat image = street().seen_from(drive.truth() * mounted());
  EXPECT_TRUE(drive.slam.on_image(0.08, image));
  EXPECT_TRUE(drive.reports.empty());
  drive.slam.on_odometry(0.05, 0.1, 0.0);
  EXPECT_TRUE(drive.reports.empty());
  drive.slam.on_odometry(0.10, 0.1, 0.0);
  ASSERT_EQ(drive.reports.size(), 1U);
  EXPECT_EQ(drive.reports[0].stamp_s, 0.08);
  EXPECT_NEAR(drive.slam.state().abscissa_m, 0.16, 1e-12);
  const int most = MonocularSlamParams{}.max_waiting_images;
  for (int i = 0; i <= most; ++i) EXPECT_TRUE(drive.slam.on_image(0.2 + 0.1 * i, image));
  EXPECT_EQ(drive.slam.counters().images_refused, 1U) << "the odometer is silent";
}

TEST(MonocularSlam, OdometryWaitsForAnImageThatComesLate) {
  Drive drive;
  const cv::Mat image = street().seen_from(drive.truth() * mounted());
  for (int k = 1; k <= 6; ++k) drive.slam.on_odometry(0.05 * k, 0.1, 0.0);
  EXPECT_TRUE(drive.slam.on_image(0.12, image)) << "0.18 s after it was taken";
  ASSERT_EQ(drive.reports.size(), 1U);
  EXPECT_NEAR(drive.slam.state().abscissa_m, 0.24, 1e-12);
  for (int k = 7; k <= 12; ++k) drive.slam.on_odometry(0.05 * k, 0.1, 0.0);
  EXPECT_FALSE(drive.slam.on_image(0.3, image)) << "longer than it may be";
  drive.finish();
  EXPECT_NEAR(drive.slam.state().abscissa_m, 1.2, 1e-12);
  EXPECT_NEAR(drive.slam.state().stamp_s, 0.6, 1e-12);
}

TEST(MonocularSlam, RefusesAndCountsWhatItCannotUse) {
  Drive drive;
  const cv::Mat image = street().seen_from(drive.truth() * mounted());
  EXPECT_FALSE(drive.slam.on_image(0.1, cv::Mat()));
  EXPECT_FALSE(drive.slam.on_image(0.1, cv::Mat(240, 320, CV_8UC3, cv::Scalar(0))));
  EXPECT_FALSE(drive.slam.on_image(0.1, cv::Mat(480, 640, CV_8UC1, cv::Scalar(0))));
  EXPECT_FALSE(drive.slam.on_image(std::nan(""), image));
  EXPECT_FALSE(drive.slam.on_image(-1.0, image));
  EXPECT_TRUE(drive.slam.on_image(0.1, image));
  EXPECT_FALSE(drive.slam.on_image(0.1, image)) << "twice";
  EXPECT_EQ(drive.slam.counters().images_refused, 6U);
  EXPECT_FALSE(drive.slam.on_odometry(0.0, 0.1, 0.0)) << "not later";
  EXPECT_FALSE(drive.slam.on_odometry(0.2, std::nan(""), 0.0));
  EXPECT_FALSE(drive.slam.on_odometry(0.2, 0.1, INFINITY));
  EXPECT_EQ(drive.slam.counters().odometry_refused, 3U);
}

TEST(MonocularSlam, BlankAndSaturatedAndLostFramesAreDrivenThrough) {
  Drive drive;
  for (int i = 0; i < 100; ++i) {
    const auto blank = [](const cv::Mat& image) { return cv::Mat(image.size(), CV_8UC1, cv::Scalar(40)); };
    const auto saturated = [](const cv::Mat& image) { return cv::Mat(image.size(), CV_8UC1, cv::Scalar(255)); };
    if (i == 30 || i == 31) drive.step(speed_mps, blank);
    else if (i == 45) drive.step(speed_mps, saturated);
    else drive.step(speed_mps, {}, i >= 60 && i < 70);  // a second
  }
  drive.finish();
  EXPECT_FALSE(drive.slam.lost());
  EXPECT_EQ(drive.slam.counters().images, 90U);
  EXPECT_LT(drive.error_m(), 0.01 * drive.x_m);
  EXPECT_GT(drive.exported(), 20U);
}

TEST(MonocularSlam, AChangeOfExposureLosesNoTracks) {
  Drive drive;
  for (int i = 0; i < 40; ++i) {
    const auto brighter = [](const cv::Mat& image) { return test::exposed(image, 1.3, 0.8, 0.0, 1); };
    drive.step(speed_mps, i < 25 ? std::function<cv::Mat(const cv::Mat&)>() : brighter);
  }
  EXPECT_GT(drive.reports[25].filter.inliers, drive.reports[24].filter.inliers / 2);
  EXPECT_LT(drive.error_m(), 0.01 * drive.x_m);
}

TEST(MonocularSlam, StandingStillTellsNothingNew) {
  Drive drive;
  for (int i = 0; i < 30; ++i) drive.step();
  const auto before = drive.slam.state();
  for (int i = 0; i < 50; ++i) drive.step(0.0);
  EXPECT_EQ(drive.slam.state().pose.translation(), before.pose.translation());
  EXPECT_EQ(drive.slam.state().slam_drift, before.slam_drift);
  EXPECT_GE(drive.slam.filter().counters().standstill_frames, 49U);
  for (int i = 0; i < 30; ++i) drive.step();
  EXPECT_LT(drive.error_m(), 0.01 * drive.x_m);
}

TEST(MonocularSlam, ImagesThatMakeNoSenseLoseItAndItBeginsAnew) {
  Drive drive;
  for (int i = 0; i < 40; ++i) drive.step();
  // Another street at each frame has corners, but none of them stays.
  const auto jumping = [&](const cv::Mat&) {
    return street().seen_from(
        SE3::from_rotation(Eigen::Matrix3d::Identity(),
                           {drive.x_m + 0.4 * std::sin(40.0 * drive.t_s), 0.8 * std::sin(90.0 * drive.t_s), 0.0}) *
        mounted());
  };
  for (int i = 0; i < 150 && !drive.slam.lost(); ++i) drive.step(speed_mps, jumping);
  ASSERT_TRUE(drive.slam.lost());
  drive.slam.restart();
  EXPECT_FALSE(drive.slam.lost());
  EXPECT_EQ(drive.slam.state().abscissa_m, 0.0);
  EXPECT_EQ(drive.slam.counters().restarts, 1U);
  const double restarted_m = drive.x_m;
  for (int i = 0; i < 30; ++i) drive.step();
  EXPECT_NEAR(drive.slam.state().pose.translation().x(), drive.x_m - restarted_m, 0.1);
}

TEST(MonocularSlam, AFrozenImageIsADroppedOneAndLosesItAfterTheUsualLimit) {
  Drive drive;
  cv::Mat stuck;
  const auto frozen = [&](const cv::Mat& image) {
    if (stuck.empty()) stuck = image.clone();
    return stuck;
  };
  for (int i = 0; i < 30; ++i) drive.step();
  for (int i = 0; i < 31; ++i) drive.step(4.0, frozen);
  EXPECT_FALSE(drive.slam.lost());
  EXPECT_EQ(drive.slam.counters().images_frozen, 30U);
  EXPECT_EQ(drive.slam.counters().images, 31U);
  EXPECT_LT(drive.error_m(), 0.02 * drive.x_m) << "the odometer goes on alone";
  for (int i = 0; i < 35 && !drive.slam.lost(); ++i) drive.step(4.0, frozen);
  ASSERT_TRUE(drive.slam.lost());
  EXPECT_LT(drive.error_m(), 0.02 * drive.x_m);
  drive.slam.restart();
  EXPECT_FALSE(drive.slam.lost());
  const double restarted_m = drive.x_m;
  for (int i = 0; i < 10; ++i) drive.step(4.0, frozen);
  EXPECT_EQ(drive.reports.size(), 31U) << "frozen still";
  for (int i = 0; i < 30; ++i) drive.step();
  EXPECT_EQ(drive.reports.size(), 61U);
  EXPECT_NEAR(drive.slam.state().pose.translation().x(), drive.x_m - restarted_m, 0.2);
  EXPECT_FALSE(drive.slam.lost());
}

TEST(MonocularSlam, TheSameImageWhileItStandsIsNoFault) {
  Drive drive;
  for (int i = 0; i < 20; ++i) drive.step();
  cv::Mat stuck;
  for (int i = 0; i < 40; ++i)
    drive.step(0.0, [&](const cv::Mat& image) {
      if (stuck.empty()) stuck = image.clone();
      return stuck;
    });
  for (int i = 0; i < 20; ++i) drive.step();
  EXPECT_EQ(drive.slam.counters().images_frozen, 0U);
  EXPECT_EQ(drive.slam.counters().images, 80U);
  EXPECT_LT(drive.error_m(), 0.01 * drive.x_m);
}

/// Drives until it is lost, 40 m at most. [m]
double lost_after(Drive& drive, double speed, const std::function<cv::Mat(const cv::Mat&)>& change = {}) {
  const double from_m = drive.x_m;
  while (!drive.slam.lost() && drive.x_m < from_m + 40.0) drive.step(speed, change);
  return drive.x_m - from_m;
}

TEST(MonocularSlam, AReversedOdometerLosesIt) {
  for (const double speed : {1.0, 4.0}) {
    Drive drive;
    for (int i = 0; i < 40; ++i) drive.step();
    drive.odometer = -1.0;
    const double after_m = lost_after(drive, speed);
    const MonocularCounters& c = drive.slam.filter().counters();
    std::printf("%.1f m/s: lost after %.1f m, %llu frames contradicted, %llu failing, %llu slipping, off by %.2f m\n",
                speed, after_m, static_cast<unsigned long long>(c.contradicted_frames),
                static_cast<unsigned long long>(c.failing_frames), static_cast<unsigned long long>(c.slip_frames),
                drive.error_m());
    EXPECT_TRUE(drive.slam.lost()) << speed;
    EXPECT_LT(after_m, 25.0) << speed;
  }
}

TEST(MonocularSlam, ASceneThatStandsWhileTheWheelsTurnLosesIt) {
  Drive drive;
  for (int i = 0; i < 40; ++i) drive.step();
  const cv::Mat scene = street().seen_from(drive.truth() * mounted());
  std::uint64_t seed = 1000;
  const double after_m =
      lost_after(drive, 4.0, [&](const cv::Mat&) { return test::exposed(scene, 1.0, 1.0, 2.0, ++seed); });
  EXPECT_TRUE(drive.slam.lost());
  const MonocularCounters& c = drive.slam.filter().counters();
  std::printf("lost after %.1f m, %llu frames contradicted, %llu failing\n", after_m,
              static_cast<unsigned long long>(c.contradicted_frames),
              static_cast<unsigned long long>(c.failing_frames));
  EXPECT_EQ(drive.slam.counters().images_frozen, 0U) << "no two of them are the same";
  EXPECT_LT(after_m, 25.0);
}

TEST(MonocularSlam, WheelsThatSlipForASecondDoNot) {
  for (const double says : {0.8, 1.25}) {
    Drive drive;
    for (int i = 0; i < 120; ++i) {
      drive.odometer = i % 40 >= 30 ? says : 1.0;
      drive.step();
      ASSERT_FALSE(drive.slam.lost()) << i;
    }
    std::printf("slip %.2f: %llu slip frames, %llu contradicted, off by %.2f m\n", says,
                static_cast<unsigned long long>(drive.slam.filter().counters().slip_frames),
                static_cast<unsigned long long>(drive.slam.filter().counters().contradicted_frames), drive.error_m());
    EXPECT_LT(drive.error_m(), 0.05 * drive.x_m) << says;
  }
}

TEST(MonocularSlam, ParametersOutOfRangeAreNamed) {
  MonocularSlamParams params;
  params.features = 3;
  EXPECT_THROW(MonocularSlam(params, small_camera(), mounted()), RangeError);
  params = {};
  params.candidate_length_m = 0.0;
  EXPECT_THROW(MonocularSlam(params, small_camera(), mounted()), RangeError);
  params = {};
  params.max_waiting_images = 0;
  EXPECT_THROW(MonocularSlam(params, small_camera(), mounted()), RangeError);
  CameraCalibration camera = small_camera();
  camera.fx = -1.0;
  EXPECT_THROW(MonocularSlam({}, camera, mounted()), ConfigError);
}

}  // namespace
}  // namespace convoy
