#include <convoy/text_fields.hpp>
#include <convoy/vision/kitti_sequence.hpp>

#include <optional>

namespace convoy {
namespace {

namespace fs = std::filesystem;

constexpr double odometry_rate_hz = 10.0;

/// The 3 x 4 projection of a rectified camera: what follows `key`, or the row of that number in a file without keys.
/// Leaves `fields` at its line.
std::optional<std::size_t> find_projection(TextFields& fields, const std::string& key, int row) {
  for (int at = 0; fields.next_line();) {
    if (fields.empty()) continue;
    if (fields[0] == key) return 1;
    if (fields[0].find(':') == std::string_view::npos && fields.size() == 12 && at++ == row) return 0;
  }
  return std::nullopt;
}

CameraCalibration read_projection(const fs::path& file, const std::string& key, int row, const ImageSource& images) {
  const std::string kind = "KITTI's calibration with a row " + key;
  const std::string text = read_text(file, kind);
  TextFields fields(text, file.string(), kind);
  const std::optional<std::size_t> start = find_projection(fields, key, row);
  if (!start) throw ConfigError(file.string() + ": has no row " + key + "; give " + kind);
  if (fields.size() != *start + 12) fields.refuse(key + " must have 12 numbers");
  CameraCalibration c;
  c.width = images.width(), c.height = images.height();
  c.fx = fields.number(*start), c.cx = fields.number(*start + 2);
  c.fy = fields.number(*start + 5), c.cy = fields.number(*start + 6);
  try {
    validate(c);
  } catch (const ConfigError& error) {
    fields.refuse(std::string(error.what()) + "; is it the calibration of these images?");
  }
  return c;
}

KittiSequence open_odometry(const fs::path& folder, int camera) {
  KittiSequence sequence;
  ImageTimes times{odometry_rate_hz, {}};
  if (fs::exists(folder / "times.txt")) times.times = folder / "times.txt";
  sequence.images = open_image_folder(folder / ("image_" + std::to_string(camera)), times);
  const std::string key = "P" + std::to_string(camera) + ":";
  sequence.calibration = read_projection(folder / "calib.txt", key, camera, *sequence.images);
  return sequence;
}

KittiSequence open_raw(const fs::path& folder, int camera) {
  KittiSequence sequence;
  const std::string number = "0" + std::to_string(camera);
  const fs::path images = folder / ("image_" + number);
  sequence.images = open_image_folder(images / "data", {0.0, images / "timestamps.txt"});
  fs::path calibration = folder / "calib_cam_to_cam.txt";
  if (!fs::exists(calibration)) calibration = folder / ".." / calibration.filename();
  sequence.calibration = read_projection(calibration, "P_rect_" + number + ":", camera, *sequence.images);
  return sequence;
}

}  // namespace

KittiSequence open_kitti(const fs::path& folder, int camera) {
  if (camera < 0 || camera > 3) throw RangeError("KITTI", "camera", camera, "lie in 0..3");
  if (fs::is_directory(folder / ("image_" + std::to_string(camera)))) return open_odometry(folder, camera);
  if (fs::is_directory(folder / ("image_0" + std::to_string(camera)) / "data")) return open_raw(folder, camera);
  throw ConfigError(folder.string() + ": is no drive of KITTI; give a folder that holds image_" +
                    std::to_string(camera) + " (odometry) or image_0" + std::to_string(camera) + "/data (raw)");
}

}  // namespace convoy
