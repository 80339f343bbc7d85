#include <convoy/config_error.hpp>
#include <convoy/monocular/bearing.hpp>
#include <convoy/monocular/camera_model.hpp>

#include <Eigen/LU>

#include <algorithm>
#include <cmath>

namespace convoy {
namespace {

using Distortion = CameraCalibration::Distortion;

constexpr double widest_rad = 1.5;  // 86 degrees from the axis; what is seen further out has no place on a plane

void require(bool ok, const std::string& text) {
  if (!ok) throw ConfigError("camera calibration: " + text);
}

/// Of the image plane at unit focal length, by the point.
struct Distorted {
  Eigen::Vector2d at;
  Eigen::Matrix<double, 2, 3> jacobian;
};

// z > 0. The formulas are those of OpenCV, calib3d, "Detailed Description".
Distorted radial_tangential(const Eigen::Matrix<double, 5, 1>& k, const Eigen::Vector3d& p) {
  const double x = p.x() / p.z(), y = p.y() / p.z(), p1 = k[2], p2 = k[3];
  const double r2 = x * x + y * y;
  const double L = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
  const double dL = k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[4]);  // by r^2
  const double mixed = 2.0 * (x * y * dL + p1 * x + p2 * y);
  Eigen::Matrix2d J;
  J << L + 2.0 * x * x * dL + 2.0 * p1 * y + 6.0 * p2 * x, mixed, mixed,
      L + 2.0 * y * y * dL + 6.0 * p1 * y + 2.0 * p2 * x;
  Eigen::Matrix<double, 2, 3> onto_plane;
  onto_plane << 1.0, 0.0, -x, 0.0, 1.0, -y;
  return {{x * L + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), y * L + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y},
          J * onto_plane / p.z()};
}

// The formulas are those of OpenCV, "Fisheye camera model".
Distorted equidistant(const Eigen::Matrix<double, 5, 1>& k, const Eigen::Vector3d& p) {
  const double r = std::hypot(p.x(), p.y()), n2 = r * r + p.z() * p.z();
  Distorted d;
  d.at = p.head<2>() / p.z();
  d.jacobian << 1.0 / p.z(), 0.0, 0.0, 0.0, 1.0 / p.z(), 0.0;
  if (r < 1e-12 * p.z()) return d;
  const double a = std::atan2(r, p.z()), a2 = a * a;
  const double bent = a * (1.0 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3]))));
  const double slope = 1.0 + a2 * (3.0 * k[0] + a2 * (5.0 * k[1] + a2 * (7.0 * k[2] + a2 * 9.0 * k[3])));
  const double s = bent / r;
  const Eigen::Vector2d outwards = p.head<2>() / r;
  d.at = s * p.head<2>();
  d.jacobian.leftCols<2>() =
      s * Eigen::Matrix2d::Identity() + (slope * p.z() / n2 - s) * outwards * outwards.transpose();
  d.jacobian.col(2) = -slope * r / n2 * outwards;
  return d;
}

CameraModel::Projection projected(const CameraCalibration& c, const Eigen::Vector3d& point) {
  const Distorted d = c.distortion == Distortion::equidistant ? equidistant(c.coefficients, point)
                                                              : radial_tangential(c.coefficients, point);
  const Eigen::Vector2d focal(c.fx, c.fy);
  return {focal.cwiseProduct(d.at) + Eigen::Vector2d(c.cx, c.cy), focal.asDiagonal() * d.jacobian};
}

Eigen::Vector3d at_angle(double from_axis_rad, double direction_rad) {
  const double s = std::sin(from_axis_rad);
  return {s * std::cos(direction_rad), s * std::sin(direction_rad), std::cos(from_axis_rad)};
}

/// How far from the axis the image keeps its orientation, in whatever direction.
double unfolded_field(const CameraCalibration& c) {
  constexpr double step = 0.005;
  for (double angle = step; angle < widest_rad; angle += step)
    for (int i = 0; i < 32; ++i) {
      const Eigen::Vector3d ray = at_angle(angle, i * M_PI / 16.0);
      if (!((projected(c, ray).jacobian * across(ray)).determinant() > 1e-3 * c.fx * c.fy)) return angle - step;
    }
  return widest_rad;
}

double angle_from_axis(const Eigen::Vector3d& p) { return std::atan2(std::hypot(p.x(), p.y()), p.z()); }

/// Newton on the sphere; each step stays in the field and is halved until it helps.
Eigen::Vector3d unprojected(const CameraCalibration& c, double field_rad, const Eigen::Vector2d& pixel) {
  const Eigen::Vector2d plane((pixel.x() - c.cx) / c.fx, (pixel.y() - c.cy) / c.fy);
  const double start =
      std::min(c.distortion == Distortion::equidistant ? plane.norm() : std::atan(plane.norm()), 0.98 * field_rad);
  Eigen::Vector3d ray = at_angle(start, std::atan2(plane.y(), plane.x()));
  CameraModel::Projection at = projected(c, ray);
  double error = (pixel - at.pixel).norm();
  for (int iteration = 0; iteration < 50 && error > 1e-10; ++iteration) {
    const Eigen::Matrix<double, 3, 2> B = across(ray);
    Eigen::Vector3d step = B * (at.jacobian * B).inverse() * (pixel - at.pixel);
    step *= std::min(1.0, 0.5 / step.norm());
    for (int half = 0;; ++half, step *= 0.5) {
      if (half == 30 || !step.allFinite()) return ray;
      const Eigen::Vector3d next = (ray + step).normalized();
      if (angle_from_axis(next) > field_rad) continue;
      const CameraModel::Projection there = projected(c, next);
      if (!((pixel - there.pixel).norm() < error)) continue;
      ray = next;
      at = there;
      error = (pixel - at.pixel).norm();
      break;
    }
  }
  return ray;
}

// A fisheye's image may have corners that nothing is seen in, since its field ends before them; that is no fold.
bool folds_within_the_image(const CameraCalibration& c, double field_rad) {
  constexpr int steps = 32;
  if (field_rad >= widest_rad) return false;
  for (int i = 0; i < steps; ++i)
    for (int side = 0; side < 4; ++side) {
      const double along = static_cast<double>(i) / (steps - 1);
      const double x = (side == 0 ? 0.0 : side == 1 ? 1.0 : along) * (c.width - 1);
      const double y = (side == 2 ? 0.0 : side == 3 ? 1.0 : along) * (c.height - 1);
      const Eigen::Vector3d ray = unprojected(c, field_rad, {x, y});
      if (!((projected(c, ray).pixel - Eigen::Vector2d(x, y)).norm() < 1e-6)) return true;
    }
  return false;
}

}  // namespace

void validate(const CameraCalibration& c) {
  require(c.width >= 16 && c.width <= 16384 && c.height >= 16 && c.height <= 16384,
          "width and height must each lie in 16..16384 px");
  require(std::isfinite(c.fx) && c.fx > 0.0 && std::isfinite(c.fy) && c.fy > 0.0,
          "the focal lengths fx and fy must be finite and > 0");
  require(c.cx >= 0.0 && c.cx <= c.width - 1.0 && c.cy >= 0.0 && c.cy <= c.height - 1.0,
          "the principal point (cx, cy) must lie in the image");
  require(c.coefficients.allFinite(), "the distortion coefficients must be finite");
  require(!folds_within_the_image(c, unfolded_field(c)),
          "the distortion folds the image back onto itself; check the coefficients and their order, the image "
          "size, and which distortion model they belong to");
}

CameraModel::CameraModel(const CameraCalibration& calibration) : calibration_(calibration) {
  validate(calibration);
  max_angle_rad_ = unfolded_field(calibration);
}

std::optional<CameraModel::Projection> CameraModel::project(const Eigen::Vector3d& point) const {
  if (!point.allFinite() || !(point.z() > 0.0) || angle_from_axis(point) > max_angle_rad_) return std::nullopt;
  return projected(calibration_, point);
}

Eigen::Vector3d CameraModel::ray(const Eigen::Vector2d& pixel) const {
  return unprojected(calibration_, max_angle_rad_, pixel);
}

bool CameraModel::in_image(const Eigen::Vector2d& pixel, double margin_px) const {
  return pixel.x() >= margin_px && pixel.y() >= margin_px && pixel.x() <= calibration_.width - 1.0 - margin_px &&
         pixel.y() <= calibration_.height - 1.0 - margin_px;
}

}  // namespace convoy
