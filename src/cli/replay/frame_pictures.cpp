#include "replay/frame_pictures.hpp"

#include <convoy/config_error.hpp>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include <cmath>
#include <cstdio>
#include <string>

namespace convoy::cli {

namespace {

struct Kind {
  const char* name;
  cv::Scalar color;  // blue, green, red
};
constexpr int kinds = 4;
const Kind kind_of_feature[kinds] = {
    {"new", {200, 200, 200}}, {"candidate", {0, 165, 255}}, {"landmark", {255, 120, 30}}, {"converged", {60, 200, 60}}};
constexpr int legend_px = 28, legend_width_px = 480;

int kind_of(const TrackedFeature& f) {
  if (f.converged) return 3;
  if (f.landmark) return 2;
  return f.score == 0.0 ? 0 : 1;
}

// Eighths of a pixel of the picture: what was found lies between pixels.
cv::Point in_eighths(const Eigen::Vector2d& pixel, int scale) {
  const Eigen::Vector2d p = (8.0 * (scale * (pixel.array() + 0.5) - 0.5)).matrix();
  return {static_cast<int>(std::lround(p.x())), static_cast<int>(std::lround(p.y()))};
}

void draw_legend(cv::Mat& image, const int (&counts)[kinds]) {
  const int y = image.rows - legend_px / 2;
  int x = 12;
  for (int k = 0; k < kinds; ++k) {
    cv::circle(image, {x, y}, 5, kind_of_feature[k].color, 2, cv::LINE_AA);
    const std::string text = std::string(kind_of_feature[k].name) + " " + std::to_string(counts[k]);
    cv::putText(image, text, {x + 10, y + 4}, cv::FONT_HERSHEY_SIMPLEX, 0.4, {255, 255, 255}, 1, cv::LINE_AA);
    x += 24 + cv::getTextSize(text, cv::FONT_HERSHEY_SIMPLEX, 0.4, 1, nullptr).width;
  }
}

}  // namespace

cv::Mat drawn(const cv::Mat& grey, const std::vector<TrackedFeature>& features) {
  const int scale = grey.cols < legend_width_px ? 2 : 1;
  cv::Mat large, image(scale * grey.rows + legend_px, scale * grey.cols, CV_8UC3, cv::Scalar(30, 30, 30));
  cv::resize(grey, large, {}, scale, scale, cv::INTER_LINEAR);
  cv::cvtColor(large, image.rowRange(0, large.rows), cv::COLOR_GRAY2BGR);
  int counts[kinds] = {};
  for (const TrackedFeature& f : features) {
    const int kind = kind_of(f);
    ++counts[kind];
    cv::circle(image, in_eighths(f.pixel, scale), 8 * 5, kind_of_feature[kind].color, 2, cv::LINE_AA, 3);
  }
  draw_legend(image, counts);
  return image;
}

void FramePictures::look(std::uint64_t number, const cv::Mat& grey, const std::vector<TrackedFeature>& features) {
  if (seen_++ % every_ != 0) return;
  if (pictures_.size() == most) {
    for (std::size_t i = 0; i < most / 2; ++i) pictures_[i] = pictures_[2 * i];
    pictures_.resize(most / 2);
    every_ *= 2;
    if ((seen_ - 1) % every_ != 0) return;
  }
  pictures_.push_back({number, drawn(grey, features)});
}

void FramePictures::write(const std::filesystem::path& folder) const {
  std::error_code ignored;
  std::filesystem::create_directories(folder, ignored);
  for (const Picture& picture : pictures_) {
    char name[32];
    std::snprintf(name, sizeof name, "%06llu.png", static_cast<unsigned long long>(picture.number));
    const std::string file = (folder / name).string();
    if (!cv::imwrite(file, picture.drawn)) throw ConfigError(file + ": cannot be written; is the disk full?");
  }
}

}  // namespace convoy::cli
