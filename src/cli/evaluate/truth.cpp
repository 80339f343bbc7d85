#include "evaluate/truth.hpp"

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>

namespace convoy::cli {

namespace {

/// The rotation R with b_i = R a_i, in the least squares sense; empty if it is not fixed.
std::optional<SE2> best_rotation(const std::vector<Eigen::Vector2d>& a, const std::vector<Eigen::Vector2d>& b) {
  double cosine = 0.0, sine = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    cosine += a[i].dot(b[i]);
    sine += a[i].x() * b[i].y() - a[i].y() * b[i].x();
  }
  return SE2(0.0, 0.0, std::atan2(sine, cosine));
}
/// Kabsch, A solution for the best rotation to relate two sets of vectors, Acta Cryst. A 32, 1976.
std::optional<SE3> best_rotation(const std::vector<Eigen::Vector3d>& a, const std::vector<Eigen::Vector3d>& b) {
  Eigen::Matrix3d sum_ba = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < a.size(); ++i) sum_ba += b[i] * a[i].transpose();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(sum_ba, Eigen::ComputeFullU | Eigen::ComputeFullV);
  if (svd.singularValues()[1] < 1e-9 * svd.singularValues()[0]) return std::nullopt;  // on one line
  const Eigen::Matrix3d U = svd.matrixU(), V = svd.matrixV();
  const Eigen::Vector3d proper(1.0, 1.0, U.determinant() * V.determinant() < 0.0 ? -1.0 : 1.0);
  return SE3::from_rotation(U * proper.asDiagonal() * V.transpose(), Eigen::Vector3d::Zero());
}

}  // namespace

template <class G>
std::optional<RigidFit<G>> fit_rigid(const std::vector<typename G::Point>& from,
                                     const std::vector<typename G::Point>& to) {
  using Point = typename G::Point;
  if (from.size() != to.size() || from.size() < 2) return std::nullopt;
  const auto count = static_cast<double>(from.size());
  Point from_mean = Point::Zero(), to_mean = Point::Zero();
  for (std::size_t i = 0; i < from.size(); ++i) {
    from_mean += from[i] / count;
    to_mean += to[i] / count;
  }
  std::vector<Point> a, b;
  double from_spread = 0.0, to_spread = 0.0;
  for (std::size_t i = 0; i < from.size(); ++i) {
    a.push_back(from[i] - from_mean);
    b.push_back(to[i] - to_mean);
    from_spread += a.back().squaredNorm();
    to_spread += b.back().squaredNorm();
  }
  if (from_spread < 1e-12 || to_spread < 1e-12) return std::nullopt;
  const auto rotation = best_rotation(a, b);
  if (!rotation) return std::nullopt;
  const G shift = G::from_rotation(G().rotation(), to_mean - *rotation * from_mean);
  RigidFit<G> fit{shift * *rotation, 0.0};
  for (std::size_t i = 0; i < from.size(); ++i) fit.rmse_m += (fit.T_to_from * from[i] - to[i]).squaredNorm() / count;
  fit.rmse_m = std::sqrt(fit.rmse_m);
  return fit;
}

template <class G>
G interpolated(const G& T_a, const G& T_b, double share) {
  const typename G::Tangent step = (T_a.inverse() * T_b).Log();
  return T_a * G::Exp(share * step);
}

template <class G>
std::optional<G> truth_at(const std::vector<TruthPose<G>>& truth, double t_s, double max_gap_s) {
  const auto after = std::lower_bound(truth.begin(), truth.end(), t_s,
                                      [](const TruthPose<G>& pose, double t) { return pose.t_s < t; });
  if (after == truth.end()) return std::nullopt;
  if (after->t_s == t_s) return after->T_world_body;
  if (after == truth.begin() || after->t_s - std::prev(after)->t_s > max_gap_s) return std::nullopt;
  const TruthPose<G>& before = *std::prev(after);
  return interpolated(before.T_world_body, after->T_world_body, (t_s - before.t_s) / (after->t_s - before.t_s));
}

std::optional<TruthMount> find_truth_mount(const std::vector<TruthPose<SE2>>& truth) {
  constexpr double window_s = 0.5;
  std::vector<SE2::Tangent> steps;
  for (double t = truth.empty() ? 0.0 : truth.front().t_s; !truth.empty() && t < truth.back().t_s; t += window_s) {
    const auto begin = truth_at(truth, t), end = truth_at(truth, t + window_s);
    if (!begin || !end) continue;
    const SE2::Tangent step = (begin->inverse() * *end).Log();
    if (std::abs(step[0]) > 0.01 || std::abs(step[2]) > 0.02) steps.push_back(step);
  }
  Eigen::Vector2d solution = Eigen::Vector2d::Zero();  // -tan(heading), forward / cos(heading)
  for (int pass = 0; pass < 4; ++pass) {
    if (steps.size() < 20) return std::nullopt;
    Eigen::Matrix2d H = Eigen::Matrix2d::Zero();
    Eigen::Vector2d g = Eigen::Vector2d::Zero();
    for (const auto& step : steps) {
      const Eigen::Vector2d a(step[0], step[2]);
      H += a * a.transpose();
      g += a * step[1];
    }
    if (H(0, 0) < 1e-6) return std::nullopt;
    if (H.determinant() < 1e-6 * H(0, 0) * H(0, 0))  // hardly a turn: the heading alone can be told
      solution = {g[0] / H(0, 0), 0.0};
    else solution = H.inverse() * g;
    const auto residual = [&](const SE2::Tangent& step) {
      return std::abs(step[1] - solution[0] * step[0] - solution[1] * step[2]);
    };
    std::vector<double> residuals;
    for (const auto& step : steps) residuals.push_back(residual(step));
    std::nth_element(residuals.begin(), residuals.begin() + static_cast<std::ptrdiff_t>(residuals.size() / 2),
                     residuals.end());
    const double limit = std::max(1e-9, 4.5 * residuals[residuals.size() / 2]);  // 3 sigma of a normal
    std::erase_if(steps, [&](const auto& step) { return residual(step) > limit; });
  }
  const double heading = std::atan(-solution[0]);
  return TruthMount{solution[1] * std::cos(heading), heading};
}

#define CONVOY_INSTANTIATE(G)                                                                                   \
  template std::optional<RigidFit<G>> fit_rigid<G>(const std::vector<G::Point>&, const std::vector<G::Point>&); \
  template G interpolated(const G&, const G&, double);                                                          \
  template std::optional<G> truth_at(const std::vector<TruthPose<G>>&, double, double);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
