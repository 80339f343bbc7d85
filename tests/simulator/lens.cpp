#include "lens.hpp"

#include <Eigen/LU>

#include <cmath>
#include <stdexcept>
#include <string>

namespace convoy::simulator {
namespace {

constexpr double kSteepest = 3.0;  // tan of 72 degrees off the axis; frames are rendered onto a plane

Eigen::Vector2d distorted(const LensParams& params, const Eigen::Vector2d& ray) {
  const auto& k = params.coefficients;
  const double r2 = ray.squaredNorm();
  if (params.distortion == Distortion::kEquidistant) {
    const double r = std::sqrt(r2), angle = std::atan(r), a2 = angle * angle;
    if (r < 1e-9) return ray;
    return ray * (angle / r * (1.0 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3])))));
  }
  const double radial = 1.0 + r2 * (k[0] + r2 * k[1]), x = ray.x(), y = ray.y();
  return {x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
          y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y};
}

Eigen::Matrix2d slope_of(const LensParams& params, const Eigen::Vector2d& ray) {
  constexpr double h = 1e-6;
  Eigen::Matrix2d slope;
  for (int i = 0; i < 2; ++i) {
    const Eigen::Vector2d step = Eigen::Vector2d::Unit(i) * h;
    slope.col(i) = (distorted(params, ray + step) - distorted(params, ray - step)) / (2.0 * h);
  }
  return slope;
}

Eigen::Vector2d undistorted(const LensParams& params, const Eigen::Vector2d& wanted) {
  Eigen::Vector2d ray = wanted;
  for (int i = 0; i < 30; ++i) {
    const Eigen::Vector2d error = distorted(params, ray) - wanted;
    if (error.squaredNorm() < 1e-26) break;
    ray -= slope_of(params, ray).inverse() * error;
  }
  return ray;
}

Eigen::Vector2d on_plane(const LensParams& params, const Eigen::Vector2d& pixel) {
  return {(pixel.x() - params.cx) / params.fx, (pixel.y() - params.cy) / params.fy};
}

void require(bool good, const std::string& what) {
  if (!good) throw std::invalid_argument("LensParams: " + what);
}

template <typename Visit>
void along_border(const LensParams& params, const Visit& visit) {
  for (int x = -1; x <= params.width; ++x)
    for (const int y : {-1, params.height}) visit(Eigen::Vector2d(x, y));
  for (int y = -1; y <= params.height; ++y)
    for (const int x : {-1, params.width}) visit(Eigen::Vector2d(x, y));
}

}  // namespace

void LensParams::validate() const {
  require(width >= 16 && width <= 4096, "width is " + std::to_string(width) + "; give 16 to 4096 px");
  require(height >= 16 && height <= 4096, "height is " + std::to_string(height) + "; give 16 to 4096 px");
  require(std::isfinite(fx) && fx > 0.0, "fx is " + std::to_string(fx) + "; give a focal length above 0 px");
  require(std::isfinite(fy) && fy > 0.0, "fy is " + std::to_string(fy) + "; give a focal length above 0 px");
  require(cx >= 0.0 && cx <= width - 1, "cx is " + std::to_string(cx) + "; give 0 to width - 1 px");
  require(cy >= 0.0 && cy <= height - 1, "cy is " + std::to_string(cy) + "; give 0 to height - 1 px");
  for (const double k : coefficients) require(std::isfinite(k), "a coefficient is not finite; give finite ones");
  along_border(*this, [this](const Eigen::Vector2d& pixel) {
    const std::string where = "pixel (" + std::to_string(static_cast<int>(pixel.x())) + ", " +
                              std::to_string(static_cast<int>(pixel.y())) + ") ";
    const Eigen::Vector2d wanted = on_plane(*this, pixel), ray = undistorted(*this, wanted);
    const bool unique = (distorted(*this, ray) - wanted).norm() < 1e-9;
    require(
        unique && ray.norm() < kSteepest,
        where +
            "sees nothing, or what is more than 71 degrees off the axis; lengthen fx and fy or lessen coefficients");
    for (int part = 1; part <= 10; ++part)
      require(slope_of(*this, ray * (part / 10.0)).determinant() > 1e-3,
              where + "lies where the distortion folds back; lessen coefficients");
  });
}

LensParams LensParams::pinhole(int width_px, int height_px, double focal_px) {
  LensParams params;
  params.width = width_px, params.height = height_px;
  params.fx = params.fy = focal_px;
  params.cx = (width_px - 1) / 2.0, params.cy = (height_px - 1) / 2.0;
  params.coefficients = {};
  return params;
}

LensParams LensParams::small() {
  LensParams params;
  params.width = 512, params.height = 384;
  params.fx = params.fy = 296.0;
  params.cx = 255.5, params.cy = 191.5;
  return params;
}

Lens::Lens(const LensParams& params) : params_(params) {
  params_.validate();
  along_border(params_, [this](const Eigen::Vector2d& pixel) {
    largest_slope_ = std::max(largest_slope_, ray_of(pixel).norm());
  });
  largest_slope_ *= 1.02;
}

std::optional<Eigen::Vector2d> Lens::pixel_of(const Eigen::Vector3d& p_camera) const {
  if (!(p_camera.z() > 1e-6)) return std::nullopt;
  const Eigen::Vector2d ray = p_camera.head<2>() / p_camera.z();
  if (!(ray.norm() <= largest_slope_)) return std::nullopt;
  const Eigen::Vector2d plane = distorted(params_, ray);
  return Eigen::Vector2d(params_.fx * plane.x() + params_.cx, params_.fy * plane.y() + params_.cy);
}

Eigen::Vector2d Lens::ray_of(const Eigen::Vector2d& pixel) const {
  return undistorted(params_, on_plane(params_, pixel));
}

bool Lens::in_frame(const Eigen::Vector2d& pixel) const {
  return pixel.x() >= -0.5 && pixel.x() < params_.width - 0.5 && pixel.y() >= -0.5 && pixel.y() < params_.height - 0.5;
}

}  // namespace convoy::simulator
