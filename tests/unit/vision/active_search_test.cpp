// Drawn images whose geometry is known: is the true place found, and is what cannot be found refused?
#include <convoy/config_error.hpp>
#include <convoy/vision/active_search.hpp>
#include <convoy/vision/corner_detector.hpp>
#include <convoy/vision/patch_warp.hpp>

#include "drawn_scene.hpp"

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include <cmath>
#include <limits>
#include <numeric>

namespace convoy {
namespace {

using Status = PatchSearchResult::Status;

constexpr int width = 640, height = 480;
constexpr double nan_value = std::numeric_limits<double>::quiet_NaN();
const Eigen::Matrix2d identity = Eigen::Matrix2d::Identity();

ImagePyramid pyramid_of(const cv::Mat& image) {
  ImagePyramid pyramid(width, height);
  EXPECT_EQ(pyramid.set(image), ImagePyramid::Status::ok);
  return pyramid;
}

const cv::Mat& texture() {
  static const cv::Mat texture = test::random_texture(1600, 1400, 7);
  return texture;
}

const cv::Mat& reference_image() {
  static const cv::Mat image = test::draw(texture(), width, height, [](const Eigen::Vector2d& p) -> Eigen::Vector2d {
    return p + Eigen::Vector2d(480.0, 460.0);
  });
  return image;
}

std::vector<Corner> corners_of(const ImagePyramid& image) {
  CornerDetector detector(width, height);
  std::vector<int> cells(static_cast<std::size_t>(detector.cells()));
  std::iota(cells.begin(), cells.end(), 0);
  return detector.detect(image, cells, {});
}

/// What the second image is of the first: turned, scaled about its middle, exposed otherwise.
struct View {
  double scale = 1.0, turn_deg = 0.0, gain = 1.0, gamma = 1.0, noise = 1.0;
};

Eigen::Matrix2d now_from_ref(const View& view) {
  return view.scale * Eigen::Rotation2Dd(view.turn_deg * M_PI / 180.0).toRotationMatrix();
}

const Eigen::Vector2d middle(0.5 * width, 0.5 * height);

cv::Mat seen(const View& view) {
  const Eigen::Matrix2d back = now_from_ref(view).inverse();
  const cv::Mat drawn = test::draw(texture(), width, height, [&](const Eigen::Vector2d& p) -> Eigen::Vector2d {
    return middle + back * (p - middle) + Eigen::Vector2d(480.0, 460.0);
  });
  return test::exposed(drawn, view.gain, view.gamma, view.noise, 11);
}

struct Tally {
  int tried = 0, found = 0, right = 0;  // right: within half a pixel
  double largest_error_px = 0.0, squares = 0.0;
  double rms_px() const { return std::sqrt(squares / std::max(found, 1)); }
};

/// Every corner of the reference is looked for, from a prediction that is off by as much as `sigma_px` says.
Tally look_for_all(const View& view, double sigma_px, const Eigen::Matrix2d& assumed, ActiveSearch& search) {
  const ImagePyramid before = pyramid_of(test::exposed(reference_image(), 1.0, 1.0, 1.0, 3)),
                     now = pyramid_of(seen(view));
  cv::RNG random(5);
  Tally tally;
  for (const Corner& corner : corners_of(before)) {
    const Eigen::Vector2d truth = middle + now_from_ref(view) * (corner.pixel - middle);
    if (!(truth.x() > 15 && truth.y() > 15 && truth.x() < width - 15 && truth.y() < height - 15)) continue;
    const auto patch = ReferencePatch::take(before, corner.pixel);
    if (!patch || search.judge(*patch) != Status::found) continue;
    Eigen::Vector2d error(random.gaussian(sigma_px), random.gaussian(sigma_px));
    error *= std::min(1.0, 2.5 * sigma_px / error.norm());
    const PatchSearchResult result = search.find(now, *patch, {truth + error, sigma_px * sigma_px * identity, assumed});
    ++tally.tried;
    if (result.status != Status::found) continue;
    const double miss = (result.pixel - truth).norm();
    ++tally.found;
    tally.right += miss < 0.5;
    tally.largest_error_px = std::max(tally.largest_error_px, miss);
    tally.squares += miss * miss;
  }
  std::printf(
      "scale %.2f turn %.0f gain %.1f gamma %.1f noise %.0f sigma %.0f px: %d of %d found, %d right, rms %.3f px, max "
      "%.3f px\n",
      view.scale, view.turn_deg, view.gain, view.gamma, view.noise, sigma_px, tally.found, tally.tried, tally.right,
      tally.rms_px(), tally.largest_error_px);
  return tally;
}

void expect_all_found(const View& view, double sigma_px) {
  ActiveSearch search;
  const Tally tally = look_for_all(view, sigma_px, now_from_ref(view), search);
  EXPECT_GE(tally.tried, 30);
  EXPECT_GE(tally.found, 0.95 * tally.tried);
  EXPECT_LT(tally.largest_error_px, 0.5);
}

TEST(ActiveSearch, FindsTheTruePlaceWhateverTheScaleAndTurn) {
  for (const double scale : {0.7, 0.85, 1.0, 1.2, 1.4})
    for (const double turn_deg : {0.0, 20.0}) expect_all_found({scale, turn_deg}, 2.0);
}

TEST(ActiveSearch, DoesNotMindExposure) {
  expect_all_found({1.2, 10.0, 0.5, 1.0, 2.0}, 2.0);
  expect_all_found({1.2, 10.0, 1.0, 0.6, 2.0}, 2.0);
  expect_all_found({0.85, -10.0, 1.0, 1.8, 2.0}, 2.0);
}

TEST(ActiveSearch, DoesNotMindNoise) { expect_all_found({1.1, 5.0, 1.0, 1.0, 6.0}, 2.0); }

TEST(ActiveSearch, FindsFromCoarseToFine) {
  expect_all_found({1.0, 0.0}, 8.0);
  expect_all_found({1.2, 10.0}, 12.0);
  expect_all_found({0.8, -10.0}, 12.0);
}

TEST(ActiveSearch, WithoutTheWarpMuchIsLost) {
  const View view{1.4, 20.0};
  ActiveSearch search;
  const Tally tally = look_for_all(view, 2.0, identity, search);
  EXPECT_LT(tally.right, 0.3 * tally.tried);
}

TEST(ActiveSearch, GivesTheSameToTheBit) {
  ActiveSearch fresh, used;
  const View view{1.1, 5.0};
  look_for_all({0.8, 0.0}, 8.0, now_from_ref({0.8, 0.0}), used);
  const Tally a = look_for_all(view, 3.0, now_from_ref(view), fresh),
              b = look_for_all(view, 3.0, now_from_ref(view), used);
  EXPECT_EQ(a.squares, b.squares);
  EXPECT_EQ(a.found, b.found);
}

/// One feature that is easily found where it was.
struct OneFeature {
  OneFeature() : image(pyramid_of(reference_image())) {
    const auto corners = corners_of(image);
    const auto& best = *std::max_element(corners.begin(), corners.end(),
                                         [](const Corner& a, const Corner& b) { return a.strength < b.strength; });
    pixel = best.pixel;
    patch = *ReferencePatch::take(image, pixel);
  }
  Status look(const PatchPrediction& prediction) { return search.find(image, patch, prediction).status; }
  ImagePyramid image;
  Eigen::Vector2d pixel;
  ReferencePatch patch;
  ActiveSearch search;
};

TEST(ActiveSearch, FindsAFeatureWhereItWas) {
  OneFeature one;
  const PatchSearchResult result = one.search.find(one.image, one.patch, {one.pixel, 4.0 * identity, identity});
  ASSERT_EQ(result.status, Status::found);
  EXPECT_GT(result.score, 0.999);
  EXPECT_LT((result.pixel - one.pixel).norm(), 0.02);
  EXPECT_EQ(one.search.count(Status::found), 1U);
}

TEST(ActiveSearch, KeepsToTheEllipse) {
  OneFeature one;  // the gate's radius is 6.07 px
  EXPECT_EQ(one.look({one.pixel + Eigen::Vector2d(4.0, 4.0), 4.0 * identity, identity}), Status::found);
  EXPECT_NE(one.look({one.pixel + Eigen::Vector2d(5.0, 5.0), 4.0 * identity, identity}), Status::found);
}

TEST(ActiveSearch, FindsFromFarAtTheEdgeOfTheImage) {
  OneFeature one;  // comes to lie where, on the smallest image, the edge is nearer than half a template
  const Eigen::Vector2d truth(12.0, 200.0), shift = truth - one.pixel;
  const ImagePyramid now =
      pyramid_of(test::draw(texture(), width, height, [&](const Eigen::Vector2d& p) -> Eigen::Vector2d {
        return p - shift + Eigen::Vector2d(480.0, 460.0);
      }));
  const PatchSearchResult result = one.search.find(now, one.patch, {{32.0, 210.0}, 100.0 * identity, identity});
  ASSERT_EQ(result.status, Status::found);
  EXPECT_LT((result.pixel - truth).norm(), 0.3);
}

TEST(PatchTemplate, OfASmallerViewIsSmooth) {
  cv::Mat stripes(height, width, CV_8UC1, cv::Scalar(40));  // finer than the smaller view can show
  for (int x = 0; x < width; x += 2) stripes.col(x).setTo(200);
  const ReferencePatch patch = *ReferencePatch::take(pyramid_of(stripes), middle);
  PatchTemplate same, smaller;
  ASSERT_TRUE(same.warp(patch, identity, Eigen::Vector2d::Zero()));
  ASSERT_TRUE(smaller.warp(patch, 2.5 * identity, Eigen::Vector2d::Zero()));
  EXPECT_NEAR(same.contrast(), 80.0, 1.0);
  EXPECT_LT(smaller.contrast(), 1.0);
  EXPECT_FALSE(smaller.warp(patch, 20.0 * identity, Eigen::Vector2d::Zero()));
}

TEST(ActiveSearch, RefusesPredictionsThatAreNone) {
  OneFeature one;
  const Eigen::Matrix2d S = 4.0 * identity;
  EXPECT_EQ(one.look({{nan_value, 100.0}, S, identity}), Status::bad_prediction);
  EXPECT_EQ(one.look({{std::numeric_limits<double>::infinity(), 100.0}, S, identity}), Status::bad_prediction);
  EXPECT_EQ(one.look({one.pixel, nan_value * S, identity}), Status::bad_prediction);
  EXPECT_EQ(one.look({one.pixel, -S, identity}), Status::bad_prediction);
  EXPECT_EQ(one.look({one.pixel, Eigen::Matrix2d::Zero(), identity}), Status::bad_prediction);
  EXPECT_EQ(one.look({one.pixel, (Eigen::Matrix2d() << 1, 2, 2, 1).finished(), identity}), Status::bad_prediction);
  EXPECT_EQ(one.look({one.pixel, S, nan_value * identity}), Status::bad_prediction);
  EXPECT_EQ(one.search.count(Status::bad_prediction), 7U);
}

TEST(ActiveSearch, RefusesWhatIsOutOfReach) {
  OneFeature one;
  EXPECT_EQ(one.look({one.pixel, 1e300 * identity, identity}), Status::too_uncertain);
  EXPECT_EQ(one.look({one.pixel, 1e4 * identity, identity}), Status::too_uncertain);
  EXPECT_EQ(one.look({one.pixel, 4.0 * identity, 4.0 * identity}), Status::warp_too_strong);
  EXPECT_EQ(one.look({one.pixel, 4.0 * identity, 0.2 * identity}), Status::warp_too_strong);
  EXPECT_EQ(one.look({one.pixel, 4.0 * identity, Eigen::Vector2d(1, -1).asDiagonal()}), Status::warp_too_strong);
  EXPECT_EQ(one.look({one.pixel, 4.0 * identity, Eigen::Vector2d(2.5, 0.4).asDiagonal()}), Status::warp_too_strong);
  for (const Eigen::Vector2d& away : {Eigen::Vector2d(-50, 100), {700, 100}, {100, -50}, {100, 600}, {-1e300, 1e300}})
    EXPECT_EQ(one.look({away, 4.0 * identity, identity}), Status::out_of_image) << away.transpose();
}

TEST(ActiveSearch, SearchesThePartOfAnEllipseThatIsInTheImage) {
  OneFeature one;
  const Eigen::Vector2d beyond(-10.0, one.pixel.y());
  const Eigen::Matrix2d S = Eigen::Vector2d(400.0, 9.0).asDiagonal();  // reaches 60 px
  const Status status = one.look({beyond, S, identity});
  EXPECT_TRUE(status == Status::no_match || status == Status::at_edge) << to_string(status);
  const ReferencePatch at_edge = *ReferencePatch::take(one.image, {12.0, 200.0});
  const PatchSearchResult result = one.search.find(one.image, at_edge, {{2.0, 200.0}, 25.0 * identity, identity});
  ASSERT_EQ(result.status, Status::found);
  EXPECT_LT((result.pixel - Eigen::Vector2d(12.0, 200.0)).norm(), 0.05);
}

TEST(ActiveSearch, FindsNothingInBlankBlackAndWhiteImages) {
  OneFeature one;
  for (const int grey : {0, 128, 255}) {
    const ImagePyramid blank = pyramid_of(cv::Mat(height, width, CV_8UC1, cv::Scalar(grey)));
    const PatchSearchResult result = one.search.find(blank, one.patch, {one.pixel, 4.0 * identity, identity});
    EXPECT_EQ(result.status, Status::no_match);
    const auto patch = ReferencePatch::take(blank, {100, 100});
    ASSERT_TRUE(patch);
    const Status expected = grey == 128 ? Status::blank : Status::saturated;
    EXPECT_EQ(one.search.judge(*patch), expected);
    EXPECT_EQ(one.search.find(one.image, *patch, {{100, 100}, 4.0 * identity, identity}).status, expected);
  }
}

TEST(ActiveSearch, FindsNothingInAnotherScene) {
  OneFeature one;
  const cv::Mat other =
      test::draw(test::random_texture(700, 500, 99), width, height,
                 [](const Eigen::Vector2d& p) -> Eigen::Vector2d { return p + Eigen::Vector2d(20, 10); });
  int found = 0, tried = 0;
  const ImagePyramid elsewhere = pyramid_of(other);
  for (const Corner& corner : corners_of(one.image)) {
    const auto patch = ReferencePatch::take(one.image, corner.pixel);
    if (!patch) continue;
    ++tried;
    found += one.search.find(elsewhere, *patch, {corner.pixel, 4.0 * identity, identity}).status == Status::found;
  }
  std::printf("%d of %d found in another scene\n", found, tried);
  EXPECT_LE(found, 0.15 * tried);
}

TEST(ActiveSearch, AnImageOfAnotherSizeIsRefusedAndCounted) {
  OneFeature one;
  ImagePyramid image(width, height);
  EXPECT_EQ(one.search.find(image, one.patch, {one.pixel, 4.0 * identity, identity}).status, Status::bad_image);
  EXPECT_EQ(image.set(cv::Mat(height, width + 1, CV_8UC1, cv::Scalar(9))), ImagePyramid::Status::wrong_size);
  EXPECT_EQ(image.set(cv::Mat(height, width, CV_8UC3, cv::Scalar(9))), ImagePyramid::Status::not_grey);
  EXPECT_EQ(image.set(cv::Mat()), ImagePyramid::Status::empty);
  EXPECT_EQ(image.count(ImagePyramid::Status::wrong_size), 1U);
  EXPECT_FALSE(image.valid());
  EXPECT_FALSE(ReferencePatch::take(image, one.pixel));
  EXPECT_EQ(one.search.find(image, one.patch, {one.pixel, 4.0 * identity, identity}).status, Status::bad_image);
  EXPECT_EQ(one.search.count(Status::bad_image), 2U);
}

TEST(ActiveSearch, TakesNoPatchAtTheEdge) {
  OneFeature one;
  for (const Eigen::Vector2d& pixel :
       {Eigen::Vector2d(8.9, 100), {100, 8.9}, {width - 9.5, 100}, {nan_value, 100}, {1e300, 0}})
    EXPECT_FALSE(ReferencePatch::take(one.image, pixel));
  EXPECT_TRUE(ReferencePatch::take(one.image, {9.0, 9.0}));
}

TEST(ActiveSearch, ParametersOutOfRangeAreRefused) {
  for (const auto& spoil : std::vector<std::function<void(ActiveSearchParams&)>>{
           [](auto& p) { p.min_score = 1.0; }, [](auto& p) { p.gate_probability = 0.0; },
           [](auto& p) { p.coarse_above_px = nan_value; }, [](auto& p) { p.max_radius_px = 0.5; },
           [](auto& p) { p.min_contrast = 0.0; }, [](auto& p) { p.min_contrast_there = -1.0; },
           [](auto& p) { p.max_saturated = 1.1; }}) {
    ActiveSearchParams params;
    spoil(params);
    EXPECT_THROW(ActiveSearch{params}, ConfigError);
  }
  EXPECT_THROW(ImagePyramid(10, 480), ConfigError);
}

}  // namespace
}  // namespace convoy
