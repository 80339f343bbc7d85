#include "scenario/gps_reference.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "evaluate/truth.hpp"

namespace convoy::cli {
namespace {

constexpr double trusted_share = 0.6;  // of the fixes, which the fit rests on before jumps are told apart
constexpr int fit_passes = 8;

struct PlacedFix {
  double driven_m = 0.0;
  Eigen::Vector2d local_m, antenna_m;
};

std::vector<PlacedFix> placed(const ReckonedPath& path, const std::vector<GpsFix>& fixes,
                              const GpsReferenceParams& params) {
  std::vector<PlacedFix> result;
  for (const GpsFix& fix : fixes) {
    if (fix.t_s < path.begin_s() || fix.t_s > path.end_s()) continue;
    const ReckonedPose pose = path.at(fix.t_s);
    if (!result.empty() && pose.driven_m - result.back().driven_m < params.fix_spacing_m) continue;
    result.push_back({pose.driven_m, pose.T_local_body * params.lever_m, fix.antenna_m});
  }
  return result;
}

class SpanFit {
 public:
  SpanFit(std::vector<PlacedFix> fixes, const GpsReferenceParams& params) : params_(params), fixes_(std::move(fixes)) {
    std::vector<PlacedFix> used = fixes_;
    for (int pass = 0; pass < fit_passes && fit(used); ++pass)
      used = nearest(static_cast<std::size_t>(std::ceil(trusted_share * static_cast<double>(fixes_.size()))));
    if (!T_world_local_) return;
    good_ = fixes_;
    std::erase_if(good_, [this](const PlacedFix& f) { return residual_m(f) > params_.max_residual_m; });
    fit(good_);
  }

  std::optional<SE2> at(double driven_m) const {
    const bool enough = T_world_local_ &&
                        static_cast<double>(good_.size()) >= params_.min_share * static_cast<double>(fixes_.size()) &&
                        good_.back().driven_m - good_.front().driven_m >= params_.min_spread_m &&
                        std::abs(closest(driven_m).driven_m - driven_m) <= params_.max_gap_m;
    return enough ? T_world_local_ : std::nullopt;
  }
  double residual_at(double driven_m) const { return residual_m(closest(driven_m)); }

 private:
  bool fit(const std::vector<PlacedFix>& fixes) {
    std::vector<Eigen::Vector2d> from, to;
    for (const PlacedFix& f : fixes) {
      from.push_back(f.local_m);
      to.push_back(f.antenna_m);
    }
    const auto fitted = fit_rigid<SE2>(from, to);
    T_world_local_ = fitted ? std::optional(fitted->T_to_from) : std::nullopt;
    return fitted.has_value();
  }
  double residual_m(const PlacedFix& f) const { return (*T_world_local_ * f.local_m - f.antenna_m).norm(); }
  std::vector<PlacedFix> nearest(std::size_t count) const {
    std::vector<PlacedFix> sorted = fixes_;
    std::stable_sort(sorted.begin(), sorted.end(),
                     [this](const PlacedFix& a, const PlacedFix& b) { return residual_m(a) < residual_m(b); });
    sorted.resize(count);
    return sorted;
  }
  const PlacedFix& closest(double driven_m) const {
    return *std::min_element(good_.begin(), good_.end(), [driven_m](const PlacedFix& a, const PlacedFix& b) {
      return std::abs(a.driven_m - driven_m) < std::abs(b.driven_m - driven_m);
    });
  }

  const GpsReferenceParams& params_;
  std::vector<PlacedFix> fixes_, good_;  // good_: without the jumps
  std::optional<SE2> T_world_local_;
};

}  // namespace

ReckonedPath::ReckonedPath(const std::vector<SensorEvent>& odometry) {
  for (const SensorEvent& event : odometry) {
    if (event.kind != SensorEvent::Kind::odometry) continue;
    const ReckonedPose before = poses_.empty() ? ReckonedPose{event.t_s, 0.0, SE2()} : at(event.t_s);
    poses_.push_back(before);
    velocities_.emplace_back(event.v_m_s, 0.0, event.omega_rad_s);
  }
}

ReckonedPose ReckonedPath::at(double t_s) const {
  const auto after = std::upper_bound(poses_.begin(), poses_.end(), t_s,
                                      [](double t, const ReckonedPose& pose) { return t < pose.t_s; });
  if (after == poses_.begin()) return poses_.front();
  const auto i = static_cast<std::size_t>(after - poses_.begin()) - 1;
  const double dt_s = t_s - poses_[i].t_s;
  return {t_s, poses_[i].driven_m + std::abs(velocities_[i][0]) * dt_s,
          poses_[i].T_local_body * SE2::Exp(dt_s * velocities_[i])};
}

GpsReference gps_reference(const ReckonedPath& path, const std::vector<GpsFix>& fixes, double period_s,
                           const GpsReferenceParams& params) {
  const std::vector<PlacedFix> all = placed(path, fixes, params);
  const auto by_way = [](const PlacedFix& fix, double driven_m) { return fix.driven_m < driven_m; };
  GpsReference reference;
  for (int k = 0; path.begin_s() + k * period_s <= path.end_s(); ++k) {
    const ReckonedPose pose = path.at(path.begin_s() + k * period_s);
    const auto from = std::lower_bound(all.begin(), all.end(), pose.driven_m - params.span_m, by_way);
    const auto to = std::lower_bound(from, all.end(), pose.driven_m + params.span_m, by_way);
    const SpanFit fit({from, to}, params);
    const auto T_world_local = fit.at(pose.driven_m);
    if (!T_world_local) continue;
    reference.poses.push_back({pose.t_s, *T_world_local * pose.T_local_body});
    reference.residuals_m.push_back(fit.residual_at(pose.driven_m));
  }
  return reference;
}

}  // namespace convoy::cli
