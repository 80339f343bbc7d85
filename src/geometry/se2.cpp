#include <convoy/geometry/se2.hpp>

#include <Eigen/LU>
#include <cmath>

namespace convoy {
namespace {

struct ArcCoefficients {
  double a, b;
};
/// sin(w)/w and (1 - cos w)/w, by series near zero.
ArcCoefficients arc_coefficients(double w) {
  if (std::abs(w) < 1e-5) return {1.0 - w * w / 6.0, 0.5 * w - w * w * w / 24.0};
  const double half = std::sin(0.5 * w);  // 1 - cos w without cancellation
  return {std::sin(w) / w, 2.0 * half * half / w};
}

}  // namespace

SE2::Adjoint SE2::adjoint() const {
  Adjoint A = Adjoint::Identity();
  A.topLeftCorner<2, 2>() = rotation();
  A(0, 2) = t_.y();
  A(1, 2) = -t_.x();
  return A;
}

SE2::Adjoint SE2::ad(const Tangent& d) {
  Adjoint A;
  A << 0.0, -d[2], d[1], d[2], 0.0, -d[0], 0.0, 0.0, 0.0;
  return A;
}

SE2 SE2::Exp(const Tangent& d) {
  const auto [a, b] = arc_coefficients(d[2]);
  return {a * d[0] - b * d[1], b * d[0] + a * d[1], d[2]};
}

SE2::Tangent SE2::Log() const {
  const auto [a, b] = arc_coefficients(theta_);
  const double n = a * a + b * b;
  return {(a * t_.x() + b * t_.y()) / n, (-b * t_.x() + a * t_.y()) / n, theta_};
}

SE2::PointJacobian SE2::act_jacobian(const Point& p) const {
  PointJacobian H;
  const Eigen::Matrix2d R = rotation();
  H.leftCols<2>() = R;
  H.col(2) = R * Point(-p.y(), p.x());
  return H;
}

SE2::Adjoint SE2::right_jacobian_inverse(const Tangent& d) {
  // Jr(d) of SE(2) in closed form: [[sin(w)/w, (1-cos w)/w, *], [-(1-cos w)/w, sin(w)/w, *], [0, 0, 1]].
  const double w = d[2];
  const auto [a, b] = arc_coefficients(w);
  double p, q;  // p = (w - sin w) / w^2, q = (1 - cos w) / w^2
  if (std::abs(w) < 1e-3) {
    p = w / 6.0 - w * w * w / 120.0;
    q = 0.5 - w * w / 24.0;
  } else {
    p = (w - std::sin(w)) / (w * w);
    q = b / w;
  }
  Eigen::Matrix3d J;
  J << a, b, p * d[0] - q * d[1], -b, a, q * d[0] + p * d[1], 0, 0, 1;
  return J.inverse();
}

}  // namespace convoy
