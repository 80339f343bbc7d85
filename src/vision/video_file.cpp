// Pictures out of a video file.
#include <convoy/config_error.hpp>

#include "grey_image.hpp"
#include "image_times.hpp"

#include <opencv2/core.hpp>
#include <opencv2/videoio.hpp>

#include <cmath>

namespace convoy {
namespace {

class VideoFile final : public ImageSource {
 public:
  VideoFile(const std::filesystem::path& file, const ImageTimes& times) : name_(file.string()) {
    std::error_code error;
    // OpenCV would take other names for a pattern of pictures, a camera or an address.
    if (!std::filesystem::is_regular_file(file, error)) throw ConfigError(name_ + ": is no file; give a video");
    if (!read_into(first_, file))
      throw ConfigError(name_ + ": is no video that can be decoded; convert it, e.g. to MJPEG");
    if (first_.grey.empty()) throw ConfigError(name_ + ": its first picture " + first_.why);
    width_ = first_.grey.cols;
    height_ = first_.grey.rows;
    set_times(times);
  }

  SourceImage next() override {
    GreyImage image;
    if (count_ == 0) {
      image = std::move(first_);
    } else {
      cv::Mat picture;
      if (!read(picture)) return {};
      image = of_size(to_grey(picture.clone()), width_, height_);  // the decoder writes over its own
    }
    if (!stamps_.empty() && count_ == stamps_.size()) return {};
    const double stamp_s = stamps_.empty() ? static_cast<double>(count_) / rate_hz_ : stamps_[count_].stamp_s;
    ++count_;
    if (!image.grey.empty()) return {SourceImage::Status::image, stamp_s, std::move(image.grey), {}};
    ++refused_;
    return {SourceImage::Status::refused, stamp_s, {}, name_ + ": picture " + std::to_string(count_) + " " + image.why};
  }
  int width() const override { return width_; }
  int height() const override { return height_; }
  std::string name() const override { return name_; }
  std::uint64_t refused() const override { return refused_; }

 private:
  bool read(cv::Mat& picture) {
    try {
      return video_.read(picture);
    } catch (const cv::Exception&) {  // damaged: what follows cannot be found
      return false;
    }
  }

  bool open(const std::string& file) {
    for (const int decoder : {cv::CAP_FFMPEG, cv::CAP_OPENCV_MJPEG}) {  // others take files for other things, too
      try {
        if (video_.open(file, decoder)) return true;
      } catch (const cv::Exception&) {  // the next one
      }
    }
    return false;
  }

  bool read_into(GreyImage& image, const std::filesystem::path& file) {
    if (!open(file.string())) return false;
    cv::Mat picture;
    if (!read(picture)) return false;
    image = to_grey(picture.clone());
    return true;
  }

  void set_times(const ImageTimes& times) {
    if (!times.times.empty()) {
      stamps_ = read_times(times.times);
      return;
    }
    rate_hz_ = times.rate_hz != 0.0 ? times.rate_hz : video_.get(cv::CAP_PROP_FPS);
    if (times.rate_hz == 0.0 && !(rate_hz_ > 0.0 && rate_hz_ <= 1e4))
      throw ConfigError(name_ + ": does not say how many pictures there are in a second; give a rate");
    check_rate(rate_hz_, name_);
  }

  std::string name_;
  cv::VideoCapture video_;
  GreyImage first_;
  std::vector<StampedName> stamps_;
  double rate_hz_ = 0.0;
  std::size_t count_ = 0;  // pictures that next() has told of
  int width_ = 0, height_ = 0;
  std::uint64_t refused_ = 0;
};

}  // namespace

std::unique_ptr<ImageSource> open_video(const std::filesystem::path& file, const ImageTimes& times) {
  return std::make_unique<VideoFile>(file, times);
}

}  // namespace convoy
