#include "grey_image.hpp"

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

namespace convoy {
namespace {

std::string size_text(int width, int height) { return std::to_string(width) + " x " + std::to_string(height); }

}  // namespace

GreyImage to_grey(const cv::Mat& picture) {
  GreyImage image;
  if (picture.empty()) image.why = "is no picture that can be read; it may be damaged";
  else if (picture.depth() != CV_8U) image.why = "does not have 8 bits per value; convert it to 8 bits";
  else if (picture.channels() == 1) image.grey = picture;
  else if (picture.channels() == 3 || picture.channels() == 4)
    cv::cvtColor(picture, image.grey, picture.channels() == 3 ? cv::COLOR_BGR2GRAY : cv::COLOR_BGRA2GRAY);
  else image.why = "has " + std::to_string(picture.channels()) + " channels; give grey, colour, or colour with alpha";
  return image;
}

GreyImage read_grey(const std::filesystem::path& file) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(file, error)) return {{}, "is not there"};
  try {
    return to_grey(cv::imread(file.string(), cv::IMREAD_UNCHANGED));
  } catch (const cv::Exception& fault) {  // too large, or no memory
    return {{}, "cannot be read: " + fault.err};
  }
}

GreyImage of_size(GreyImage image, int width, int height) {
  if (image.grey.empty() || (image.grey.cols == width && image.grey.rows == height)) return image;
  return {{},
          "is " + size_text(image.grey.cols, image.grey.rows) + ", those before it were " + size_text(width, height)};
}

}  // namespace convoy
