// A corner is found, and found again in the same image.
#include <convoy/vision/active_search.hpp>
#include <convoy/vision/corner_detector.hpp>

#include <cstdio>
#include <numeric>

int main() {
  using namespace convoy;
  cv::Mat image(240, 320, CV_8UC1, cv::Scalar(50));
  image(cv::Rect(100, 80, 60, 70)).setTo(200);
  ImagePyramid pyramid(320, 240);
  if (pyramid.set(image) != ImagePyramid::Status::ok) return 1;
  CornerDetector detector(320, 240);
  std::vector<int> cells(static_cast<std::size_t>(detector.cells()));
  std::iota(cells.begin(), cells.end(), 0);
  const auto corners = detector.detect(pyramid, cells, {});
  if (corners.size() != 4) return 2;
  const auto patch = ReferencePatch::take(pyramid, corners[0].pixel);
  if (!patch) return 3;
  const auto found = ActiveSearch().find(
      pyramid, *patch, {corners[0].pixel, 4.0 * Eigen::Matrix2d::Identity(), Eigen::Matrix2d::Identity()});
  std::printf("a corner: %s\n", to_string(found.status));
  return found.status == PatchSearchResult::Status::found ? 0 : 4;
}
