#include <convoy/config_error.hpp>
#include <convoy/frontend/range_bearing_ekf.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

namespace convoy {
namespace {

void require(bool ok, const char* text) {
  if (!ok) throw ConfigError(std::string("range-bearing front end: ") + text);
}

}  // namespace

void validate(const RangeBearingEkfParams& p) {
  require(p.sigma_along_per_sqrt_m >= 0 && p.sigma_along_per_sqrt_rad >= 0 && p.sigma_across_per_sqrt_m >= 0 && p.sigma_heading_per_sqrt_m >= 0 &&
              p.sigma_heading_per_sqrt_rad >= 0 && p.sigma_heading_per_sqrt_s >= 0,
          "odometry sigmas must be >= 0");
  require(p.sigma_range_m > 0 && p.sigma_range_share >= 0 && p.sigma_bearing_rad > 0, "sighting sigmas must be > 0");
  require(p.distance_scale > 0 && p.angle_scale > 0, "odometry scales must be > 0; 1 means calibrated");
  require(p.min_sighting_interval_s >= 0 && p.trail_spacing_m >= 0, "intervals and spacings must be >= 0");
  require(p.gate > 0 && p.gate < 1 && p.nis_confidence > 0 && p.nis_confidence < 1, "confidences must lie in (0, 1)");
  require(p.max_rejections >= 1 && p.min_sightings >= 2 && p.nis_window >= 1, "counts must be positive");
  require(p.min_range_m > 0 && p.max_range_m > p.min_range_m, "needs 0 < min_range_m < max_range_m");
  require(p.max_odometry_gap_s > 0, "max_odometry_gap_s must be > 0");
  require(p.max_remembered >= 0, "max_remembered must be >= 0; 0 holds the live pose by the tracked landmarks alone");
  require(p.min_parallax_rad >= 0 && p.max_sigma_m > 0, "needs min_parallax_rad >= 0 and max_sigma_m > 0");
  require(p.segment_length_m > 0 && p.max_segment_length_m >= p.segment_length_m && p.min_batch >= 1,
          "needs 0 < segment_length_m <= max_segment_length_m and min_batch >= 1");
}

RangeBearingEkf::RangeBearingEkf(const RangeBearingEkfParams& params) : params_(params) {
  validate(params);
  gate_chi2_ = chi2_quantile(params.gate, 2);
}

bool RangeBearingEkf::on_odometry(double stamp_s, double v_mps, double omega_radps) {
  const bool valid = std::isfinite(stamp_s) && std::isfinite(v_mps) && std::isfinite(omega_radps) &&
                     (!stamp_s_ || stamp_s >= *stamp_s_);
  if (!valid) {
    ++counters_.odometry_invalid;
    return false;
  }
  advance_to(stamp_s);
  v_mps_ = params_.distance_scale * v_mps;
  omega_radps_ = params_.angle_scale * omega_radps;
  return true;
}

bool RangeBearingEkf::on_sighting(double stamp_s, std::uint64_t track, double range_m, double bearing_rad) {
  const bool valid = std::isfinite(stamp_s) && std::isfinite(bearing_rad) && range_m >= params_.min_range_m &&
                     range_m <= params_.max_range_m && (!stamp_s_ || stamp_s >= *stamp_s_);
  if (!valid) {
    ++counters_.sightings_invalid;
    return false;
  }
  advance_to(stamp_s);
  if (params_.max_remembered > 0) remember(track, range_m, bearing_rad);
  const auto known = filter_.find(track);
  if (known && stamp_s < filter_.tracks()[*known].last_s + params_.min_sighting_interval_s) {
    ++counters_.sightings_thinned;
    return false;
  }
  bool used = true;
  if (!known) {
    filter_.add(stamp_s, track, range_m, bearing_rad, sighting_noise(range_m));
  } else {
    used = filter_.update(*known, stamp_s, range_m, bearing_rad, sighting_noise(filter_.predicted_range(*known)),
                          gate_chi2_, params_.nis_window) < gate_chi2_;
    if (filter_.tracks()[*known].rejections >= params_.max_rejections) {
      filter_.drop({*known});
      ++counters_.tracks_dropped;
    }
  }
  ++(used ? counters_.sightings_used : counters_.sightings_gated);
  return used;
}

bool RangeBearingEkf::on_time(double stamp_s) {
  if (!std::isfinite(stamp_s) || (stamp_s_ && stamp_s < *stamp_s_)) return false;
  advance_to(stamp_s);
  return true;
}

void RangeBearingEkf::remember(std::uint64_t id, double range_m, double bearing_rad) {
  const auto known = memory_.find(id);
  if (known && *stamp_s_ < memory_.tracks()[*known].last_s + params_.min_sighting_interval_s) return;
  if (!known) {
    memory_.add(*stamp_s_, id, range_m, bearing_rad, sighting_noise(range_m));
    if (static_cast<int>(memory_.tracks().size()) <= params_.max_remembered) return;
    const auto& tracks = memory_.tracks();
    const auto oldest = std::min_element(tracks.begin(), tracks.end(), [](const auto& a, const auto& b) { return a.last_s < b.last_s; });
    memory_.drop({static_cast<std::size_t>(oldest - tracks.begin())});
    return;
  }
  memory_.update(*known, *stamp_s_, range_m, bearing_rad, sighting_noise(memory_.predicted_range(*known)), gate_chi2_,
                 params_.nis_window);
  if (memory_.tracks()[*known].rejections >= params_.max_rejections) memory_.drop({*known});
}

void RangeBearingEkf::advance_to(double stamp_s) {
  if (stamp_s_) {
    const double dt = std::min(stamp_s - *stamp_s_, params_.max_odometry_gap_s);
    if (dt > 0.0 && (v_mps_ != 0.0 || omega_radps_ != 0.0)) move(v_mps_ * dt, omega_radps_ * dt, dt);
  }
  stamp_s_ = stamp_s;
  clone_if_due();
  close_segment_if_due();
}

void RangeBearingEkf::move(double distance_m, double angle_rad, double dt_s) {
  const double length = std::abs(distance_m), angle = std::abs(angle_rad);
  abscissa_m_ += length;
  const auto square = [](double x) { return x * x; };
  const Eigen::Vector3d variance(square(params_.sigma_along_per_sqrt_m) * length +
                                     square(params_.sigma_along_per_sqrt_rad) * angle,
                                 square(params_.sigma_across_per_sqrt_m) * length,
                                 square(params_.sigma_heading_per_sqrt_m) * length +
                                     square(params_.sigma_heading_per_sqrt_rad) * angle +
                                     square(params_.sigma_heading_per_sqrt_s) * dt_s);
  const SE2 step = SE2::Exp({distance_m, 0.0, angle_rad});
  filter_.move(step, variance);
  if (params_.max_remembered > 0) memory_.move(step, variance);
}

Eigen::Matrix2d RangeBearingEkf::sighting_noise(double range_m) const {
  const double sigma_range = params_.sigma_range_m + params_.sigma_range_share * range_m;
  return Eigen::Vector2d(sigma_range * sigma_range, params_.sigma_bearing_rad * params_.sigma_bearing_rad).asDiagonal();
}

void RangeBearingEkf::clone_if_due() {
  if (params_.trail_spacing_m <= 0.0 || abscissa_m_ - clone_abscissa_m_ < params_.trail_spacing_m) return;
  filter_.clone_pose(*stamp_s_, abscissa_m_);
  clone_abscissa_m_ = abscissa_m_;
}

bool RangeBearingEkf::may_freeze(std::size_t index) const {
  const RangeBearingTrack& track = filter_.tracks()[index];
  if (track.sightings < params_.min_sightings || track.ray_high - track.ray_low < params_.min_parallax_rad) return false;
  const double nis = std::accumulate(track.nis.begin(), track.nis.end(), 0.0);
  if (nis > chi2_quantile(params_.nis_confidence, 2.0 * static_cast<double>(track.nis.size()))) return false;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(Eigen::Matrix2d(filter_.relative_covariance({index})),
                                                             Eigen::EigenvaluesOnly);
  return eigen.eigenvalues().maxCoeff() <= params_.max_sigma_m * params_.max_sigma_m;
}

std::vector<std::size_t> RangeBearingEkf::freezable() const {
  std::vector<std::size_t> tracks;
  for (std::size_t i = 0; i < filter_.tracks().size(); ++i)
    if (may_freeze(i)) tracks.push_back(i);
  return tracks;
}

void RangeBearingEkf::close_segment_if_due() {
  const double length = abscissa_m_ - anchor_abscissa_m_;
  if (length < params_.segment_length_m) return;
  const std::vector<std::size_t> frozen = freezable();
  if (static_cast<int>(frozen.size()) >= params_.min_batch || length >= params_.max_segment_length_m)
    close_segment(frozen);
}

void RangeBearingEkf::close_segment(const std::vector<std::size_t>& frozen) {
  Segment<SE2> segment;
  segment.closing = state_of(stamp_s_.value_or(0.0), abscissa_m_, filter_.pose(), filter_.pose_covariance());
  const Eigen::MatrixXd joint = filter_.relative_covariance(frozen);
  const auto loadings = shared_loadings<SE2>(joint);
  for (std::size_t k = 0; k < frozen.size(); ++k) {
    const RangeBearingTrack& track = filter_.tracks()[frozen[k]];
    const auto at = 2 * static_cast<Eigen::Index>(k);
    segment.landmarks.push_back(
        {filter_.pose().inverse() * track.position, joint.block<2, 2>(at, at), loadings[k], {}, track.id});
  }
  for (const PoseClone& clone : filter_.clones())
    segment.trail.push_back(state_of(clone.stamp_s, clone.abscissa_m, clone.pose, clone.covariance));
  counters_.landmarks_frozen += frozen.size();
  filter_.drop(frozen);
  filter_.rebase();  // the current pose becomes the anchor
  memory_.rebase();
  anchor_ = segment.closing.pose;
  anchor_drift_ = segment.closing.slam_drift;
  anchor_abscissa_m_ = clone_abscissa_m_ = abscissa_m_;
  segments_.push_back(std::move(segment));
}

FrontEndState<SE2> RangeBearingEkf::state_of(double stamp_s, double abscissa_m, const SE2& pose,
                                             const SE2::Covariance& P) const {
  const SE2::Adjoint Ad = anchor_.adjoint();
  return {stamp_s, abscissa_m, anchor_ * pose,
          symmetrised(SE2::Covariance(anchor_drift_ + Ad * P * Ad.transpose()))};
}

FrontEndState<SE2> RangeBearingEkf::state() const {
  const RangeBearingFilter& live = params_.max_remembered > 0 ? memory_ : filter_;
  return state_of(stamp_s_.value_or(0.0), abscissa_m_, live.pose(), live.pose_covariance());
}

FrontEndState<SE2> RangeBearingEkf::exportable_state() const {
  return state_of(stamp_s_.value_or(0.0), abscissa_m_, filter_.pose(), filter_.pose_covariance());
}

RelativeLandmarks<SE2> RangeBearingEkf::remembered() const {
  RelativeLandmarks<SE2> known;
  const SE2 T_body_anchor = memory_.pose().inverse();
  for (const RangeBearingTrack& track : memory_.tracks()) {
    known.tracks.push_back(track.id);
    known.positions.push_back(T_body_anchor * track.position);
  }
  std::vector<std::size_t> all(known.tracks.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  known.covariance = memory_.relative_covariance(all);
  return known;
}

std::vector<Segment<SE2>> RangeBearingEkf::take_segments() { return std::exchange(segments_, {}); }

}  // namespace convoy
