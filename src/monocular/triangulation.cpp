#include <convoy/monocular/bearing.hpp>
#include <convoy/monocular/triangulation.hpp>

#include <Eigen/LU>

#include <cmath>

namespace convoy {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

// rho from z x (R m + rho t) = 0, least squares.
struct InverseDepth {
  double along = 0.0, squared = 0.0;
  void add(const Vector3d& ray, const SE3& T_view_anchor, const Vector3d& bearing) {
    const Vector3d zt = ray.cross(T_view_anchor.translation());
    along -= zt.dot(ray.cross(T_view_anchor.rotation() * bearing));
    squared += zt.squaredNorm();
  }
  double value() const { return squared > 0.0 ? along / squared : 0.0; }
};

std::optional<Vector2d> seen(const CameraModel& camera, const SE3& T_view_anchor, const Vector3d& bearing, double rho) {
  const auto at = camera.project(T_view_anchor.rotation() * bearing + rho * T_view_anchor.translation());
  if (!at) return std::nullopt;
  return at->pixel;
}

}  // namespace

std::optional<Triangulation> triangulate(const CameraModel& camera, const std::vector<TrackView>& views,
                                         std::size_t anchor, double sigma_px) {
  Triangulation t;
  t.anchor = anchor;
  t.bearing = camera.ray(views[anchor].pixel);
  std::vector<SE3> T_view_anchor;
  InverseDepth first;
  for (const TrackView& v : views) {
    T_view_anchor.push_back(v.T_frame_camera.inverse() * views[anchor].T_frame_camera);
    first.add(camera.ray(v.pixel), T_view_anchor.back(), t.bearing);
  }
  t.inverse_depth = std::max(first.value(), 1e-4);
  for (int iteration = 0; iteration < 10; ++iteration) {
    Matrix3d JtJ = Matrix3d::Zero();
    Vector3d Jte = Vector3d::Zero();
    t.worst_px = 0.0;
    for (std::size_t k = 0; k < views.size(); ++k) {
      const Matrix3d R = T_view_anchor[k].rotation();
      const auto at = camera.project(R * t.bearing + t.inverse_depth * T_view_anchor[k].translation());
      if (!at) return std::nullopt;
      Eigen::Matrix<double, 2, 3> J;
      J.leftCols<2>() = at->jacobian * R * across(t.bearing);
      J.col(2) = at->jacobian * T_view_anchor[k].translation();
      const Vector2d e = views[k].pixel - at->pixel;
      JtJ += J.transpose() * J;
      Jte += J.transpose() * e;
      t.worst_px = std::max(t.worst_px, e.norm());
    }
    const Matrix3d cofactor = JtJ.inverse();
    const Vector3d step = cofactor * Jte;
    t.sigma_inverse_depth = sigma_px * std::sqrt(cofactor(2, 2));
    if (!step.allFinite() || !std::isfinite(t.sigma_inverse_depth)) return std::nullopt;
    if (step.head<2>().norm() < 1e-7 && std::abs(step[2]) < 1e-3 * t.sigma_inverse_depth)
      return t.inverse_depth > 0.0 ? std::optional(t) : std::nullopt;
    t.bearing = turned(t.bearing, step.head<2>());
    t.inverse_depth += step[2];
  }
  return std::nullopt;
}

std::vector<std::size_t> consistent_views(const CameraModel& camera, const std::vector<TrackView>& views,
                                          double tolerance_px) {
  std::vector<Vector3d> rays;
  for (const TrackView& v : views) rays.push_back(camera.ray(v.pixel));
  std::vector<std::size_t> best;
  for (std::size_t a = 0; a < views.size(); ++a) {
    std::vector<SE3> T_view_a;
    for (const TrackView& v : views) T_view_a.push_back(v.T_frame_camera.inverse() * views[a].T_frame_camera);
    for (std::size_t b = 0; b < a; ++b) {
      InverseDepth depth;
      depth.add(rays[b], T_view_a[b], rays[a]);
      if (!(depth.value() > 0.0)) continue;
      std::vector<std::size_t> agreeing;
      for (std::size_t k = 0; k < views.size(); ++k) {
        const auto pixel = seen(camera, T_view_a[k], rays[a], depth.value());
        if (pixel && (*pixel - views[k].pixel).norm() < tolerance_px) agreeing.push_back(k);
      }
      if (agreeing.size() > best.size()) best = std::move(agreeing);
    }
  }
  return best;
}

}  // namespace convoy
