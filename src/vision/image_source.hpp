// ImageSource: the images of one camera, in order, from wherever they are kept. All have one size and are grey, 8 bits;
// colour is converted.
//
// What cannot be used at all is a ConfigError when a source is opened. A single image that cannot be used later (gone,
// damaged, of another size) is a frame that the camera lost: next() says when and why, and goes on.
#pragma once

#include <opencv2/core/mat.hpp>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

namespace convoy {

struct SourceImage {
  enum class Status : std::uint8_t {
    image,    ///< grey is there
    refused,  ///< a frame that cannot be used; `why` says what was wrong
    end,      ///< there are no more
  };
  Status status = Status::end;
  double stamp_s = 0.0;  ///< grows from frame to frame, refused ones included; its zero is that of the source
  cv::Mat grey;          ///< CV_8UC1, of the source's width() and height(); owned by nobody else
  std::string why;
};

class ImageSource {
 public:
  virtual ~ImageSource() = default;
  virtual SourceImage next() = 0;
  /// Of all images [px]. Compare it with the calibration: expect_image_size().
  virtual int width() const = 0;
  virtual int height() const = 0;
  /// What errors call it.
  virtual std::string name() const = 0;
  /// Frames that next() refused up to now.
  virtual std::uint64_t refused() const = 0;
};

/// When images were taken. By `times` if it is given, else by `rate_hz`, the first one at 0 s.
struct ImageTimes {
  double rate_hz = 0.0;  ///< (0, 10000]; 0: not told, which a video file may do without
  /// A text file with a line per image: its stamp [s] (or date and time of day, as KITTI's raw data has it), and
  /// perhaps its name in the folder; or a CSV file whose header has a column stamp_s (frames.csv of `convoy sim
  /// --record`). Lines that begin with # say nothing. Stamps must grow.
  std::filesystem::path times;
};

/// All pictures of a folder (png, pgm, ppm, jpg, bmp, tif) by name; numbers count as numbers. Throws ConfigError.
std::unique_ptr<ImageSource> open_image_folder(const std::filesystem::path& folder, const ImageTimes& times);

/// A video file that OpenCV can decode; without a rate, by its own. Throws ConfigError.
std::unique_ptr<ImageSource> open_video(const std::filesystem::path& file, const ImageTimes& times = {});

}  // namespace convoy
