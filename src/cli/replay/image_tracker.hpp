// What can be done with images alone: features are followed by their patches from one image to the next. No filter, no
// scale, no pose; it says how well the images can be followed, and what that takes.
#pragma once

#include <convoy/vision/monocular_slam.hpp>

#include <cstdint>
#include <map>

namespace convoy::cli {

class ImageTracker {
 public:
  /// Of MonocularSlamParams: search, corners, features and new_features. Throws ConfigError.
  ImageTracker(const MonocularSlamParams& params, int width, int height);

  /// CV_8UC1 of that size. Of the report, `filter` says nothing.
  ImageReport follow(double stamp_s, const cv::Mat& grey);

 private:
  struct Track {
    ReferencePatch patch;
    Eigen::Vector2d pixel, velocity_px = Eigen::Vector2d::Zero();
    int misses = 0;  // in a row
  };
  void seek(ImageReport& report);
  void start(ImageReport& report);

  MonocularSlamParams params_;
  ImagePyramid pyramid_;
  ActiveSearch search_;
  CornerDetector corners_;
  std::map<std::uint64_t, Track> tracks_;
  std::uint64_t last_track_ = 0;
};

}  // namespace convoy::cli
