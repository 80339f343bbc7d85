// Pictures as files.
#include <convoy/text_fields.hpp>

#include "grey_image.hpp"
#include "image_times.hpp"

#include <cctype>

namespace convoy {
namespace {

namespace fs = std::filesystem;

struct Frame {
  double stamp_s = 0.0;
  fs::path file;
};

bool is_picture(const fs::path& file) {
  std::string extension = file.extension().string();
  for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  for (const char* known : {".png", ".pgm", ".ppm", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"})
    if (extension == known) return true;
  return false;
}

bool is_number(const std::string& text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](unsigned char c) { return std::isdigit(c) != 0; });
}

/// 9.png is before 10.png, and b9.png after b10.png.
bool by_name(const fs::path& a, const fs::path& b) {
  const std::string x = a.stem().string(), y = b.stem().string();
  if (is_number(x) && is_number(y)) {
    const auto digits = [](const std::string& s) { return s.substr(std::min(s.find_first_not_of('0'), s.size())); };
    const std::string i = digits(x), j = digits(y);
    if (i.size() != j.size()) return i.size() < j.size();
    if (i != j) return i < j;
  }
  return a.filename() < b.filename();
}

std::vector<fs::path> pictures_in(const fs::path& folder) {
  std::error_code error;
  if (!fs::is_directory(folder, error))
    throw ConfigError(folder.string() + ": is no folder; give one with pictures in it");
  std::vector<fs::path> files;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, error))
    if (entry.is_regular_file(error) && is_picture(entry.path())) files.push_back(entry.path());
  if (files.empty()) throw ConfigError(folder.string() + ": holds no picture (png, pgm, ppm, jpg, bmp, tif)");
  std::sort(files.begin(), files.end(), by_name);
  return files;
}

std::vector<Frame> at_rate(const std::vector<fs::path>& files, double rate_hz) {
  std::vector<Frame> frames;
  for (std::size_t i = 0; i < files.size(); ++i) frames.push_back({static_cast<double>(i) / rate_hz, files[i]});
  return frames;
}

std::vector<Frame> named(const fs::path& folder, const fs::path& times, const std::vector<StampedName>& rows) {
  std::vector<Frame> frames;
  for (const StampedName& row : rows) {
    const std::string at = times.string() + ":" + std::to_string(row.line) + ": ";
    if (row.name.empty()) throw ConfigError(at + "names no picture, other lines do; name one on each");
    if (!fs::is_regular_file(folder / row.name))
      throw ConfigError(at + TextFields::quoted(row.name) + " is not in " + folder.string() + "; remove the line");
    frames.push_back({row.stamp_s, folder / row.name});
  }
  return frames;
}

std::vector<Frame> at_times(const fs::path& folder, const fs::path& times) {
  const std::vector<StampedName> rows = read_times(times);
  if (!rows.front().name.empty()) return named(folder, times, rows);
  const std::vector<fs::path> files = pictures_in(folder);
  if (rows.size() != files.size())
    throw ConfigError(times.string() + ": has " + std::to_string(rows.size()) + " stamps for the " +
                      std::to_string(files.size()) + " pictures of " + folder.string() +
                      "; there must be one for each");
  std::vector<Frame> frames;
  for (std::size_t i = 0; i < rows.size(); ++i) frames.push_back({rows[i].stamp_s, files[i]});
  return frames;
}

class ImageFolder final : public ImageSource {
 public:
  ImageFolder(const fs::path& folder, std::vector<Frame> frames) : name_(folder.string()), frames_(std::move(frames)) {
    const GreyImage first = read_grey(frames_.front().file);
    if (first.grey.empty()) throw ConfigError(frames_.front().file.string() + ": " + first.why);
    width_ = first.grey.cols;
    height_ = first.grey.rows;
  }

  SourceImage next() override {
    if (next_ == frames_.size()) return {};
    const Frame& frame = frames_[next_++];
    GreyImage image = of_size(read_grey(frame.file), width_, height_);
    if (!image.grey.empty()) return {SourceImage::Status::image, frame.stamp_s, std::move(image.grey), {}};
    ++refused_;
    return {SourceImage::Status::refused, frame.stamp_s, {}, frame.file.string() + ": " + image.why};
  }
  int width() const override { return width_; }
  int height() const override { return height_; }
  std::string name() const override { return name_; }
  std::uint64_t refused() const override { return refused_; }

 private:
  std::string name_;
  std::vector<Frame> frames_;
  std::size_t next_ = 0;
  int width_ = 0, height_ = 0;
  std::uint64_t refused_ = 0;
};

}  // namespace

std::unique_ptr<ImageSource> open_image_folder(const fs::path& folder, const ImageTimes& times) {
  if (!times.times.empty()) return std::make_unique<ImageFolder>(folder, at_times(folder, times.times));
  const std::vector<fs::path> files = pictures_in(folder);
  check_rate(times.rate_hz, folder.string());
  return std::make_unique<ImageFolder>(folder, at_rate(files, times.rate_hz));
}

}  // namespace convoy
