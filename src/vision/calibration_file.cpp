#include <convoy/config_error.hpp>
#include <convoy/text_fields.hpp>
#include <convoy/vision/calibration_file.hpp>

#include "yaml_file.hpp"

#include <Eigen/Dense>

#include <algorithm>

namespace convoy {
namespace {

using Distortion = CameraCalibration::Distortion;

constexpr const char* kind =
    "a calibration as OpenCV, ROS (camera_info) or Kalibr writes it: YAML with camera_matrix, or with intrinsics";

bool has(const YAML::Node& map, const char* key) { return map.IsMap() && map[key].IsDefined(); }

Distortion distortion_named(const YamlFile& file, const YAML::Node& node) {
  const std::string name = file.text(node, "distortion_model");
  for (const char* known : {"plumb_bob", "radtan", "radial-tangential", "none"})
    if (name == known) return Distortion::radial_tangential;
  for (const char* known : {"equidistant", "fisheye"})
    if (name == known) return Distortion::equidistant;
  file.refuse(node, "distortion_model " + TextFields::quoted(name) +
                        " is not known; calibrate with plumb_bob (radtan) or equidistant");
}

/// What is left out is zero; so may be what the model has no place for.
void set_coefficients(const YamlFile& file, const YAML::Node& node, const std::string& name, CameraCalibration& c) {
  const std::vector<double> values = file.numbers(node, name);
  const bool radial = c.distortion == Distortion::radial_tangential;
  const std::size_t most = radial ? 5 : 4;
  const bool whole = values.empty() || values.size() >= 4;
  if (!whole)
    file.refuse(node,
                name + " has " + std::to_string(values.size()) + " numbers; " +
                    (radial ? "plumb_bob (radtan) has k1, k2, p1, p2 and perhaps k3" : "equidistant has k1 to k4"));
  for (std::size_t i = most; i < values.size(); ++i)
    if (values[i] != 0.0)
      file.refuse(node,
                  name + " has " + std::to_string(values.size()) + " numbers, the model " + std::to_string(most) +
                      "; calibrate with plumb_bob (radtan) or equidistant, without a rational or thin prism model");
  for (std::size_t i = 0; i < std::min(most, values.size()); ++i)
    c.coefficients[static_cast<Eigen::Index>(i)] = values[i];
}

SE3 pose_of(const YamlFile& file, const YAML::Node& node, const std::string& name) {
  const std::vector<double> values = file.numbers(node, name, 16);
  const Eigen::Matrix4d T = Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(values.data());
  const Eigen::Matrix3d R = T.topLeftCorner<3, 3>();
  if ((T.row(3) - Eigen::RowVector4d(0, 0, 0, 1)).cwiseAbs().maxCoeff() > 1e-9)
    file.refuse(node, name + " is no transformation: its last row must be 0 0 0 1");
  constexpr double tolerance = 1e-3;  // files have six digits or fewer
  if ((R * R.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() > tolerance || R.determinant() < 0.0)
    file.refuse(node,
                name + " is no transformation: its upper left 3 x 3 must be a rotation (orthonormal, determinant 1)");
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return SE3::from_rotation(svd.matrixU() * svd.matrixV().transpose(), T.topRightCorner<3, 1>());
}

CameraFile from_camera_matrix(const YamlFile& file) {
  const YAML::Node& root = file.root();
  CameraFile camera;
  CameraCalibration& c = camera.calibration;
  c.width = file.whole_number(file.required(root, "image_width", "the width of the images [px]"), "image_width");
  c.height = file.whole_number(file.required(root, "image_height", "the height of the images [px]"), "image_height");
  const YAML::Node matrix = root["camera_matrix"];
  const std::vector<double> K = file.numbers(matrix, "camera_matrix", 9);
  if (K[1] != 0.0 || K[3] != 0.0 || K[6] != 0.0 || K[7] != 0.0 || K[8] != 1.0)
    file.refuse(matrix, "camera_matrix must be [fx 0 cx; 0 fy cy; 0 0 1]; calibrate without skew");
  c.fx = K[0], c.cx = K[2], c.fy = K[4], c.cy = K[5];
  if (has(root, "distortion_model")) c.distortion = distortion_named(file, root["distortion_model"]);
  else if (has(root, "fisheye_model") && file.whole_number(root["fisheye_model"], "fisheye_model") != 0)
    c.distortion = Distortion::equidistant;
  set_coefficients(file, file.required(root, "distortion_coefficients", "those of the lens (zeros, if there are none)"),
                   "distortion_coefficients", c);
  if (has(root, "T_body_camera")) camera.T_body_camera = pose_of(file, root["T_body_camera"], "T_body_camera");
  return camera;
}

/// T_camera_imu of a Kalibr file, by way of the cameras before it if need be; nothing if the file has none.
std::optional<SE3> from_imu(const YamlFile& file, const std::string& name, int number) {
  const YAML::Node camera = file.root()[name];
  if (has(camera, "T_cam_imu")) return pose_of(file, camera["T_cam_imu"], "T_cam_imu");
  const std::string before = "cam" + std::to_string(number - 1);
  if (number == 0 || !has(camera, "T_cn_cnm1") || !has(file.root(), before.c_str())) return std::nullopt;
  const std::optional<SE3> T_before_imu = from_imu(file, before, number - 1);
  if (!T_before_imu) return std::nullopt;
  return pose_of(file, camera["T_cn_cnm1"], "T_cn_cnm1") * *T_before_imu;
}

int number_of(const std::string& camera) {
  int number = 0;
  const char* end = camera.data() + camera.size();
  const bool named = camera.starts_with("cam") && camera.size() > 3;
  return named && std::from_chars(camera.data() + 3, end, number).ptr == end ? number : 0;
}

CameraFile from_intrinsics(const YamlFile& file, const YAML::Node& map) {
  CameraFile camera;
  CameraCalibration& c = camera.calibration;
  const YAML::Node model = file.required(map, "camera_model", "camera_model: pinhole");
  if (file.text(model, "camera_model") != "pinhole")
    file.refuse(model, "camera_model " + TextFields::quoted(model.Scalar()) +
                           " is not known; calibrate with pinhole-radtan or pinhole-equi");
  const auto f = file.numbers(file.required(map, "intrinsics", "[fx, fy, cx, cy]"), "intrinsics", 4);
  c.fx = f[0], c.fy = f[1], c.cx = f[2], c.cy = f[3];
  const YAML::Node size = file.required(map, "resolution", "[width, height] of the images [px]");
  const auto resolution = file.numbers(size, "resolution", 2);
  c.width = file.whole_number(size[0], "resolution");
  c.height = file.whole_number(size[1], "resolution");
  c.distortion =
      distortion_named(file, file.required(map, "distortion_model", "distortion_model: radtan, equidistant or none"));
  const char* coefficients = has(map, "distortion_coefficients") ? "distortion_coefficients" : "distortion_coeffs";
  if (map["distortion_model"].Scalar() != "none")
    set_coefficients(file, file.required(map, coefficients, "those of the lens"), coefficients, c);
  if (has(map, "T_body_camera")) camera.T_body_camera = pose_of(file, map["T_body_camera"], "T_body_camera");
  if (has(map, "T_BS")) camera.T_body_camera = pose_of(file, map["T_BS"], "T_BS");
  return camera;
}

CameraFile from_kalibr(const YamlFile& file, const std::string& name) {
  const YAML::Node map = file.required(file.root(), name, "a camera of that name, or name another one of the file");
  CameraFile camera = from_intrinsics(file, map);
  const std::optional<SE3> T_camera_imu = from_imu(file, name, number_of(name));
  if (T_camera_imu && !camera.T_body_camera) camera.T_body_camera = T_camera_imu->inverse();
  return camera;
}

CameraFile by_keys(const YamlFile& file, const std::string& camera) {
  const YAML::Node& root = file.root();
  if (has(root, "camera_matrix")) return from_camera_matrix(file);
  if (has(root, "intrinsics")) return from_intrinsics(file, root);
  if (has(root, camera.c_str()) || has(root, "cam0")) return from_kalibr(file, camera);
  file.refuse(root,
              std::string("no calibration of a camera: there is none of the keys camera_matrix (OpenCV, ROS), '") +
                  camera + "' (Kalibr) and intrinsics; give " + kind);
}

}  // namespace

CameraFile load_calibration(const std::filesystem::path& path, const std::string& camera) {
  const YamlFile file(path, kind);
  CameraFile found = by_keys(file, camera);
  try {
    validate(found.calibration);
  } catch (const ConfigError& error) {
    throw ConfigError(file.name() + ": " + error.what());
  }
  return found;
}

void expect_image_size(const CameraCalibration& calibration, int width, int height, const std::string& source) {
  if (width == calibration.width && height == calibration.height) return;
  const auto size = [](int w, int h) { return std::to_string(w) + " x " + std::to_string(h); };
  throw ConfigError(source + ": images are " + size(width, height) + ", the camera was calibrated with " +
                    size(calibration.width, calibration.height) +
                    "; calibrate it anew with images of that size, or name the calibration that belongs to them");
}

}  // namespace convoy
