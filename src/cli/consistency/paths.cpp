#include "consistency/paths.hpp"

#include <algorithm>
#include <cmath>

namespace convoy::cli::consistency {
namespace {

constexpr double overlap_m = 60.0;  // driven twice at the end
constexpr double ahead_m = 100.0;   // how far beyond the drive the world of a straight goes on

SE2 on_circle(double circumference_m, double abscissa_m) {
  return SE2::Exp({abscissa_m, 0.0, 2.0 * M_PI * abscissa_m / circumference_m});
}

SE2 planar_pose(Path path, double s) {
  switch (path) {
    case Path::straight: return {s, 0.0, 0.0};
    case Path::loop: return on_circle(340.0, s);
    case Path::figure_eight: return on_circle(std::fmod(s, 400.0) < 200.0 ? 200.0 : -200.0, s);
    case Path::far_origin: return s < 1000.0 ? SE2(s, 0.0, 0.0) : SE2(1000.0, 0.0, 0.0) * on_circle(200.0, s - 1000.0);
  }
  return {};
}

}  // namespace

std::string to_string(Path path) {
  switch (path) {
    case Path::straight: return "straight";
    case Path::loop: return "loop";
    case Path::figure_eight: return "figure-eight";
    case Path::far_origin: return "far origin";
  }
  return "unknown";
}

double length_m(Path path) { return path == Path::straight ? 400.0 : distinct_length_m(path) + overlap_m; }

double distinct_length_m(Path path) {
  switch (path) {
    case Path::straight: return 400.0 + ahead_m;
    case Path::loop: return 340.0;
    case Path::figure_eight: return 400.0;
    case Path::far_origin: return 1200.0;
  }
  return 0.0;
}

double curvature_per_m(Path path, double s) {
  switch (path) {
    case Path::straight: return 0.0;
    case Path::loop: return 2.0 * M_PI / 340.0;
    case Path::figure_eight: return 2.0 * M_PI / (std::fmod(s, 400.0) < 200.0 ? 200.0 : -200.0);
    case Path::far_origin: return s < 1000.0 ? 0.0 : 2.0 * M_PI / 200.0;
  }
  return 0.0;
}

template <class G>
G pose_on(Path path, double s) {
  const SE2 planar = planar_pose(path, s);
  if constexpr (G::Dim == 2) {
    return planar;
  } else {
    // A function of the place, so that the path comes back to where it was.
    const double x = planar.translation().x(), y = planar.translation().y();
    SE3::Tangent yaw = SE3::Tangent::Zero(), tilt = SE3::Tangent::Zero();
    yaw[5] = planar.theta();
    tilt[3] = 0.05 * std::sin(x / 25.0);
    tilt[4] = 0.08 * std::cos(y / 30.0);
    return SE3::from_rotation((SE3::Exp(yaw) * SE3::Exp(tilt)).rotation(),
                              {x, y, 4.0 * std::sin(x / 40.0) + 2.0 * std::cos(y / 30.0)});
  }
}

template <class G>
std::vector<typename G::Point> points_along(Path path, double per_metre, double spacing_m, Draw& draw) {
  const double length = distinct_length_m(path);
  const int wanted = static_cast<int>(std::lround(per_metre * length));
  std::vector<typename G::Point> points;
  for (int tries = 0; static_cast<int>(points.size()) < wanted && tries < 20 * wanted; ++tries) {
    const double s = draw.uniform(0.0, length);
    const double aside = draw.uniform(4.0, 15.0) * (draw.uniform() < 0.5 ? -1.0 : 1.0);
    typename G::Point offset = G::Point::Zero();
    offset[1] = aside;
    if constexpr (G::Dim == 3) offset[2] = draw.uniform(-3.0, 6.0);
    const typename G::Point point = pose_on<G>(path, s) * offset;
    const bool apart = std::all_of(points.begin(), points.end(),
                                   [&](const auto& other) { return (other - point).norm() >= spacing_m; });
    if (apart) points.push_back(point);
  }
  return points;
}

#define CONVOY_INSTANTIATE(G)          \
  template G pose_on<G>(Path, double); \
  template std::vector<G::Point> points_along<G>(Path, double, double, Draw&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli::consistency
