// Camera images with the features that were found in them, a handful of a whole run, evenly spread.
#pragma once

#include <convoy/vision/monocular_slam.hpp>

#include <cstdint>
#include <filesystem>
#include <vector>

#include <opencv2/core/mat.hpp>

namespace convoy::cli {

/// Keeps every n-th image, n doubling as the run gets longer, and writes them at its end: nobody knows its length
/// before.
class FramePictures {
 public:
  /// Called for each image, in order. `number`: of the image, in the file's name.
  void look(std::uint64_t number, const cv::Mat& grey, const std::vector<TrackedFeature>& features);
  /// FOLDER/000123.png and so on. Throws ConfigError.
  void write(const std::filesystem::path& folder) const;

 private:
  static constexpr std::size_t most = 12;
  struct Picture {
    std::uint64_t number;
    cv::Mat drawn;
  };
  std::vector<Picture> pictures_;
  std::uint64_t seen_ = 0, every_ = 1;
};

/// The image in colour (small ones twice as large), with its features and a legend below it. CV_8UC3.
cv::Mat drawn(const cv::Mat& grey, const std::vector<TrackedFeature>& features);

}  // namespace convoy::cli
