#include "camera_file.hpp"

#include "sim_error.hpp"
#include "whole_file.hpp"

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include <algorithm>
#include <cmath>

namespace convoy::simulator {
namespace {

cv::Mat matrix_of(const Eigen::Isometry3d& pose) {
  cv::Mat matrix(4, 4, CV_64F);
  for (int row = 0; row < 4; ++row)
    for (int column = 0; column < 4; ++column) matrix.at<double>(row, column) = pose.matrix()(row, column);
  return matrix;
}

cv::Mat read_matrix(const cv::FileStorage& in, const std::string& file, const char* name, int rows, int columns) {
  cv::Mat matrix;
  in[name] >> matrix;
  if (matrix.rows != rows || matrix.cols != columns || matrix.type() != CV_64F || !cv::checkRange(matrix))
    throw SetUpError(file + ": '" + name + "' is no " + std::to_string(rows) + " x " + std::to_string(columns) +
                     " matrix of doubles");
  return matrix;
}

}  // namespace

void save_camera(const CameraData& camera, const std::filesystem::path& file) {
  cv::FileStorage out(".yaml", cv::FileStorage::WRITE | cv::FileStorage::FORMAT_YAML | cv::FileStorage::MEMORY);
  const cv::Mat lens = (cv::Mat_<double>(3, 3) << camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1);
  cv::Mat distortion(1, 5, CV_64F);
  std::copy(camera.distortion.begin(), camera.distortion.end(), distortion.ptr<double>());
  out << "image_width" << camera.width << "image_height" << camera.height << "rate_hz" << camera.rate_hz;
  out << "camera_matrix" << lens << "distortion_coefficients" << distortion;
  out << "T_body_camera" << matrix_of(camera.T_body_camera);
  write_whole(file, out.releaseAndGetString());
}

CameraData load_camera(const std::filesystem::path& path) {
  const std::string file = path.string();
  CameraData camera;
  try {
    const cv::FileStorage in(file, cv::FileStorage::READ);
    if (!in.isOpened()) throw SetUpError(file + " cannot be read; is the folder a recording of convoy sim?");
    in["image_width"] >> camera.width;
    in["image_height"] >> camera.height;
    in["rate_hz"] >> camera.rate_hz;
    if (camera.width < 1 || camera.width > 1280 || camera.height < 1 || camera.height > 1024)
      throw SetUpError(file + ": image_width must lie in [1, 1280] and image_height in [1, 1024]");
    if (!(camera.rate_hz > 0.0 && camera.rate_hz <= 1000.0)) throw SetUpError(file + ": rate_hz must lie in (0, 1000]");
    const cv::Mat lens = read_matrix(in, file, "camera_matrix", 3, 3);
    camera.fx = lens.at<double>(0, 0);
    camera.fy = lens.at<double>(1, 1);
    if (!(camera.fx > 0.0 && camera.fy > 0.0))
      throw SetUpError(file + ": the focal lengths in 'camera_matrix' must be above 0");
    camera.cx = lens.at<double>(0, 2);
    camera.cy = lens.at<double>(1, 2);
    const cv::Mat distortion = read_matrix(in, file, "distortion_coefficients", 1, 5);
    std::copy_n(distortion.ptr<double>(), 5, camera.distortion.begin());
    const cv::Mat pose = read_matrix(in, file, "T_body_camera", 4, 4);
    for (int row = 0; row < 4; ++row)
      for (int column = 0; column < 4; ++column)
        camera.T_body_camera.matrix()(row, column) = pose.at<double>(row, column);
  } catch (const cv::Exception& error) {
    throw SetUpError(file + " is empty, or no YAML as OpenCV writes it (" + error.err + ")");
  }
  return camera;
}

void expect_room_for_picture(const std::filesystem::path& file) {
  if (file.extension() != ".png") throw SetUpError(file.string() + ": the name of a picture must end in .png");
  const std::filesystem::path folder = file.has_parent_path() ? file.parent_path() : ".";
  if (!std::filesystem::is_directory(folder))
    throw SetUpError(file.string() + " cannot be written: there is no folder " + folder.string());
}

void save_picture(const std::filesystem::path& file, int width, int height, const std::vector<std::uint8_t>& grey) {
  const cv::Mat picture(height, width, CV_8U, const_cast<std::uint8_t*>(grey.data()));
  // Noise does not become smaller by more effort.
  const std::vector<int> fast{cv::IMWRITE_PNG_COMPRESSION, 1};
  std::vector<std::uint8_t> png;
  // cv::imwrite does not say that it has written half of it.
  if (!cv::imencode(".png", picture, png, fast)) throw SetUpError(file.string() + " cannot be made a PNG file");
  write_whole(file, {reinterpret_cast<const char*>(png.data()), png.size()});
}

std::vector<std::uint8_t> load_picture(const std::filesystem::path& file, int width, int height) {
  const cv::Mat picture = cv::imread(file.string(), cv::IMREAD_GRAYSCALE);
  if (picture.empty()) throw SetUpError(file.string() + " is no picture that can be read");
  if (picture.cols != width || picture.rows != height)
    throw SetUpError(file.string() + " is " + std::to_string(picture.cols) + " x " + std::to_string(picture.rows) +
                     ", not " + std::to_string(width) + " x " + std::to_string(height) + " as camera.yaml says");
  std::vector<std::uint8_t> grey;
  grey.reserve(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  for (int row = 0; row < height; ++row) grey.insert(grey.end(), picture.ptr(row), picture.ptr(row) + width);
  return grey;
}

}  // namespace convoy::simulator
