// What the front end does with an image of 640 x 480, on one thread: finding corners, looking for features, warping
// their patches, describing them. Baselines: OpenCV's corners of the whole image, and its matchTemplate on the same
// windows.
#include <convoy/vision/active_search.hpp>
#include <convoy/vision/corner_detector.hpp>
#include <convoy/vision/patch_descriptor.hpp>
#include <convoy/vision/patch_warp.hpp>

#include <Eigen/Geometry>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgproc.hpp>

#include <numeric>

#include "ratio.hpp"

namespace {

using namespace convoy;

constexpr int width = 640, height = 480;
constexpr std::size_t features = 60;

/// Noise of all sizes.
cv::Mat scene() {
  cv::setNumThreads(1);
  cv::RNG random(3);
  cv::Mat sum(height, width, CV_32FC1, cv::Scalar(128));
  for (int step = 3; step <= 48; step *= 2) {
    cv::Mat coarse(height / step + 2, width / step + 2, CV_32FC1), fine;
    random.fill(coarse, cv::RNG::NORMAL, 0.0, 20.0);
    cv::resize(coarse, fine, sum.size(), 0, 0, cv::INTER_CUBIC);
    sum += fine;
  }
  cv::Mat image;
  sum.convertTo(image, CV_8UC1);
  return image;
}

ImagePyramid pyramid_of(const cv::Mat& image) {
  ImagePyramid pyramid(width, height);
  if (pyramid.set(image) != ImagePyramid::Status::ok) std::abort();
  return pyramid;
}

std::vector<Eigen::Vector2d> corners_of(const ImagePyramid& image) {
  CornerDetector detector(width, height);
  std::vector<int> cells(static_cast<std::size_t>(detector.cells()));
  std::iota(cells.begin(), cells.end(), 0);
  std::vector<Eigen::Vector2d> pixels;
  for (const Corner& corner : detector.detect(image, cells, {})) pixels.push_back(corner.pixel);
  pixels.resize(std::min(pixels.size(), features));
  return pixels;
}

void opencv_corners(const cv::Mat& image) {
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(image, corners, 80, 0.01, 15.0, cv::noArray(), 7);
  benchmark::DoNotOptimize(corners.data());
}

/// Argument: in how many of the 80 cells a corner is wanted.
void BM_detect(benchmark::State& state) {
  const cv::Mat image = scene();
  const ImagePyramid pyramid = pyramid_of(image);
  CornerDetector detector(width, height);
  std::vector<int> cells(static_cast<std::size_t>(state.range(0)));
  for (std::size_t i = 0; i < cells.size(); ++i) cells[i] = static_cast<int>(i) * 80 / static_cast<int>(cells.size());
  std::size_t found = 0;
  bench::against(
      state, "cv::goodFeaturesToTrack of the whole image", [&] { found = detector.detect(pyramid, cells, {}).size(); },
      [&] { opencv_corners(image); });
  state.counters["found"] = static_cast<double>(found);
}
BENCHMARK(BM_detect)->Arg(8)->Arg(20)->Arg(80)->Unit(benchmark::kMillisecond);

void BM_pyramid(benchmark::State& state) {
  const cv::Mat image = scene();
  ImagePyramid pyramid(width, height);
  cv::Mat half, quarter;
  bench::against(
      state, "cv::resize (INTER_AREA) twice", [&] { benchmark::DoNotOptimize(pyramid.set(image)); },
      [&] {
        cv::resize(image, half, {}, 0.5, 0.5, cv::INTER_AREA);
        cv::resize(half, quarter, {}, 0.5, 0.5, cv::INTER_AREA);
      });
}
BENCHMARK(BM_pyramid)->Unit(benchmark::kMillisecond);

/// Argument: radius of the gate [px]. 60 features, each in another frame that is noisier, 3 px from where it is
/// expected.
void BM_search(benchmark::State& state) {
  const cv::Mat image = scene();
  cv::Mat noise(height, width, CV_8UC1), next;
  cv::RNG(5).fill(noise, cv::RNG::UNIFORM, 0, 8);
  next = image + noise;
  const ImagePyramid before = pyramid_of(image), now = pyramid_of(next);
  const auto pixels = corners_of(before);
  std::vector<ReferencePatch> patches;
  for (const auto& pixel : pixels) patches.push_back(*ReferencePatch::take(before, pixel));
  const double radius_px = static_cast<double>(state.range(0)), sigma_px = radius_px / 3.0349;  // 99 %
  const Eigen::Matrix2d covariance = sigma_px * sigma_px * Eigen::Matrix2d::Identity();
  const Eigen::Matrix2d turned = Eigen::Rotation2Dd(0.02).toRotationMatrix();
  ActiveSearch search;
  std::size_t found = 0;
  const auto by_search = [&] {
    found = 0;
    for (std::size_t i = 0; i < patches.size(); ++i) {
      const PatchPrediction prediction{pixels[i] + Eigen::Vector2d(2.0, -2.2), covariance, turned};
      found += search.find(now, patches[i], prediction).status == PatchSearchResult::Status::found;
    }
  };
  const auto by_opencv = [&] {
    const cv::Rect whole(0, 0, width, height);
    for (const auto& pixel : pixels) {
      const int x = static_cast<int>(pixel.x()), y = static_cast<int>(pixel.y());
      const int reach = static_cast<int>(radius_px) + 5;
      const cv::Mat window = next(cv::Rect(x + 2 - reach, y - 2 - reach, 2 * reach + 1, 2 * reach + 1) & whole);
      cv::Mat scores;
      cv::matchTemplate(window, image(cv::Rect(x - 5, y - 5, 11, 11)), scores, cv::TM_CCOEFF_NORMED);
      cv::Point best;
      cv::minMaxLoc(scores, nullptr, nullptr, nullptr, &best);
      benchmark::DoNotOptimize(best);
    }
  };
  bench::against(state, "cv::matchTemplate on the same windows, whole pixels, no warp", by_search, by_opencv);
  state.counters["found"] = static_cast<double>(found);
  if (found < patches.size() * 9 / 10) state.SkipWithError("features were not found");
}
BENCHMARK(BM_search)->Arg(6)->Arg(16)->Arg(40)->Unit(benchmark::kMillisecond);

/// 60 affine warps and their templates.
void BM_warp(benchmark::State& state) {
  const cv::Mat image = scene();
  const ImagePyramid pyramid = pyramid_of(image);
  const auto pixels = corners_of(pyramid);
  std::vector<ReferencePatch> patches;
  for (const auto& pixel : pixels) patches.push_back(*ReferencePatch::take(pyramid, pixel));
  CameraCalibration calibration;
  calibration.width = width, calibration.height = height;
  calibration.fx = calibration.fy = 400.0, calibration.cx = 319.5, calibration.cy = 239.5;
  const CameraModel camera(calibration);
  const SE3 motion = SE3::Exp((SE3::Tangent() << 0.02, 0.0, -0.2, 0.0, 0.01, 0.01).finished());
  const auto by_warp = [&] {
    for (const ReferencePatch& patch : patches) {
      const auto warp = warp_of_plane(camera, patch.pixel(), 0.1, motion);
      PatchTemplate wanted;
      benchmark::DoNotOptimize(warp && wanted.warp(patch, warp->now_from_ref.inverse(), Eigen::Vector2d::Zero()));
    }
  };
  const auto by_opencv = [&] {
    for (const auto& pixel : pixels) {
      const cv::Mat affine = (cv::Mat_<double>(2, 3) << 1.02, 0.01, pixel.x() - 5.0, -0.01, 1.02, pixel.y() - 5.0);
      cv::Mat warped;
      cv::warpAffine(image, warped, affine, {11, 11}, cv::INTER_LINEAR | cv::WARP_INVERSE_MAP);
      benchmark::DoNotOptimize(warped.data);
    }
  };
  bench::against(state, "cv::warpAffine of as many patches, the transformation given", by_warp, by_opencv);
}
BENCHMARK(BM_warp)->Unit(benchmark::kMillisecond);

/// One landmark, 24 px wide.
void BM_describe(benchmark::State& state) {
  const cv::Mat image = scene();
  const ImagePyramid pyramid = pyramid_of(image);
  const Eigen::Vector2d pixel(320.3, 240.6);
  if (describe(pyramid, pixel, 16.0, 384.0).status != DescriptorResult::Status::made)
    state.SkipWithError("none is made");
  bench::against(
      state, "cv::GaussianBlur and cv::resize of the same piece",
      [&] { benchmark::DoNotOptimize(describe(pyramid, pixel, 16.0, 384.0)); },
      [&] {
        cv::Mat smooth, small;
        cv::GaussianBlur(image(cv::Rect(304, 224, 32, 32)), smooth, {0, 0}, 1.8);
        cv::resize(smooth(cv::Rect(4, 4, 24, 24)), small, {8, 8});
        benchmark::DoNotOptimize(small.data);
      });
}
BENCHMARK(BM_describe)->Unit(benchmark::kMicrosecond);

}  // namespace
