#include "evaluate/truth.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace convoy::cli {

std::optional<RigidFit> fit_rigid(const std::vector<Eigen::Vector2d>& from, const std::vector<Eigen::Vector2d>& to) {
  if (from.size() != to.size() || from.size() < 2) return std::nullopt;
  const auto count = static_cast<double>(from.size());
  Eigen::Vector2d from_mean = Eigen::Vector2d::Zero(), to_mean = Eigen::Vector2d::Zero();
  for (std::size_t i = 0; i < from.size(); ++i) {
    from_mean += from[i] / count;
    to_mean += to[i] / count;
  }
  double cosine = 0.0, sine = 0.0, from_spread = 0.0, to_spread = 0.0;
  for (std::size_t i = 0; i < from.size(); ++i) {
    const Eigen::Vector2d a = from[i] - from_mean, b = to[i] - to_mean;
    cosine += a.dot(b);
    sine += a.x() * b.y() - a.y() * b.x();
    from_spread += a.squaredNorm();
    to_spread += b.squaredNorm();
  }
  if (from_spread < 1e-12 || to_spread < 1e-12) return std::nullopt;
  const SE2 rotation(0.0, 0.0, std::atan2(sine, cosine));
  RigidFit fit{SE2(to_mean - rotation * from_mean, rotation.theta()), 0.0};
  for (std::size_t i = 0; i < from.size(); ++i) fit.rmse_m += (fit.T_to_from * from[i] - to[i]).squaredNorm() / count;
  fit.rmse_m = std::sqrt(fit.rmse_m);
  return fit;
}

SE2 interpolated(const SE2& T_a, const SE2& T_b, double share) {
  const SE2::Tangent step = (T_a.inverse() * T_b).Log();
  return T_a * SE2::Exp(share * step);
}

std::optional<SE2> truth_at(const std::vector<TruthPose>& truth, double t_s, double max_gap_s) {
  const auto after =
      std::lower_bound(truth.begin(), truth.end(), t_s, [](const TruthPose& pose, double t) { return pose.t_s < t; });
  if (after == truth.end()) return std::nullopt;
  if (after->t_s == t_s) return after->T_world_body;
  if (after == truth.begin() || after->t_s - std::prev(after)->t_s > max_gap_s) return std::nullopt;
  const TruthPose& before = *std::prev(after);
  return interpolated(before.T_world_body, after->T_world_body, (t_s - before.t_s) / (after->t_s - before.t_s));
}

std::optional<TruthMount> find_truth_mount(const std::vector<TruthPose>& truth) {
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

}  // namespace convoy::cli
