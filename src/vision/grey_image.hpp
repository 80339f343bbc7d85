#pragma once

#include <opencv2/core/mat.hpp>

#include <filesystem>
#include <string>

namespace convoy {

/// An image as all of convoy::vision wants it, or why there is none.
struct GreyImage {
  cv::Mat grey;     ///< CV_8UC1; empty if there is none
  std::string why;  ///< it is empty, and how to mend that
};

/// Of 8 bits; colour is converted.
GreyImage to_grey(const cv::Mat& picture);
GreyImage read_grey(const std::filesystem::path& file);

/// As above, of one size [px].
GreyImage of_size(GreyImage image, int width, int height);

}  // namespace convoy
