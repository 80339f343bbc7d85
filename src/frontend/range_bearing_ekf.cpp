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

// J p, the derivative of a rotation of p.
Eigen::Vector2d turned(const Eigen::Vector2d& p) { return {-p.y(), p.x()}; }

// P with a copy of `size` rows and columns from `from` inserted at `at`.
Eigen::MatrixXd with_copy(const Eigen::MatrixXd& P, Eigen::Index from, Eigen::Index size, Eigen::Index at) {
  std::vector<Eigen::Index> order(static_cast<std::size_t>(P.rows()));
  std::iota(order.begin(), order.end(), Eigen::Index{0});
  std::vector<Eigen::Index> copied(static_cast<std::size_t>(size));
  std::iota(copied.begin(), copied.end(), from);
  order.insert(order.begin() + at, copied.begin(), copied.end());
  return P(order, order);
}

// Copies the rows and columns `keep` of P.
Eigen::MatrixXd submatrix(const Eigen::MatrixXd& P, const std::vector<Eigen::Index>& keep) {
  return P(keep, keep);
}

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
  require(p.min_parallax_rad >= 0 && p.max_sigma_m > 0, "needs min_parallax_rad >= 0 and max_sigma_m > 0");
  require(p.segment_length_m > 0 && p.max_segment_length_m >= p.segment_length_m && p.min_batch >= 1,
          "needs 0 < segment_length_m <= max_segment_length_m and min_batch >= 1");
}

RangeBearingEkf::RangeBearingEkf(const RangeBearingEkfParams& params)
    : params_(params), P_(Eigen::MatrixXd::Zero(3, 3)) {
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
  const auto it = std::find_if(tracks_.begin(), tracks_.end(), [&](const Track& t) { return t.id == track; });
  if (it != tracks_.end() && stamp_s < it->last_s + params_.min_sighting_interval_s) {
    ++counters_.sightings_thinned;
    return false;
  }
  bool used = true;
  if (it == tracks_.end()) add_track(track, range_m, bearing_rad);
  else used = update(static_cast<std::size_t>(it - tracks_.begin()), range_m, bearing_rad);
  ++(used ? counters_.sightings_used : counters_.sightings_gated);
  return used;
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
  pose_ = pose_ * SE2::Exp({distance_m, 0.0, angle_rad});
  const double length = std::abs(distance_m), angle = std::abs(angle_rad);
  abscissa_m_ += length;
  const auto square = [](double x) { return x * x; };
  Eigen::Vector3d variance(square(params_.sigma_along_per_sqrt_m) * length +
                               square(params_.sigma_along_per_sqrt_rad) * angle,
                           square(params_.sigma_across_per_sqrt_m) * length,
                           square(params_.sigma_heading_per_sqrt_m) * length +
                               square(params_.sigma_heading_per_sqrt_rad) * angle +
                               square(params_.sigma_heading_per_sqrt_s) * dt_s);
  // xi+ = xi + Ad_X w for the pose, xi_l+ = xi_l - J l^ w_theta for a landmark.
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero(P_.rows(), 3);
  G.topRows<3>() = pose_.adjoint();
  for (std::size_t i = 0; i < tracks_.size(); ++i) G.block<2, 1>(column(i), 2) = -turned(tracks_[i].position);
  P_.noalias() += G * variance.asDiagonal() * G.transpose();
}

Eigen::Matrix2d RangeBearingEkf::sighting_noise(double range_m) const {
  const double sigma_range = params_.sigma_range_m + params_.sigma_range_share * range_m;
  return Eigen::Vector2d(sigma_range * sigma_range, params_.sigma_bearing_rad * params_.sigma_bearing_rad).asDiagonal();
}

void RangeBearingEkf::add_track(std::uint64_t id, double range_m, double bearing_rad) {
  const Eigen::Vector2d ray(std::cos(bearing_rad), std::sin(bearing_rad));
  Track track;
  track.id = id;
  track.position = pose_ * Eigen::Vector2d(range_m * ray);
  track.sightings = 1;
  track.last_s = *stamp_s_;
  track.first_ray = wrap_angle(pose_.theta() + bearing_rad);
  tracks_.push_back(track);

  Eigen::Matrix2d polar;  // d(cartesian) / d(range, bearing)
  polar.col(0) = ray;
  polar.col(1) = range_m * turned(ray);
  const Eigen::Matrix2d A = pose_.rotation() * polar;
  // xi_l = xi_rho - R n: a copy of the position's rows and columns, put behind the other landmarks, before the clones.
  const Eigen::Index at = column(tracks_.size() - 1);
  P_ = with_copy(P_, 0, 2, at);
  P_.block<2, 2>(at, at) += A * sighting_noise(range_m) * A.transpose();
}

void RangeBearingEkf::clone_if_due() {
  if (params_.trail_spacing_m <= 0.0) return;
  const double last = clones_.empty() ? anchor_abscissa_m_ : clones_.back().abscissa_m;
  if (abscissa_m_ - last < params_.trail_spacing_m) return;
  clones_.push_back({*stamp_s_, abscissa_m_, pose_});
  P_ = with_copy(P_, 0, 3, clone_column(clones_.size() - 1));
}

bool RangeBearingEkf::update(std::size_t index, double range_m, double bearing_rad) {
  Track& track = tracks_[index];
  const Eigen::Matrix2d Rt = pose_.rotation().transpose();
  const Eigen::Vector2d y = Rt * (track.position - pose_.translation());
  const double range = std::max(y.norm(), 1e-3);
  Eigen::Matrix2d polar;  // d(range, bearing) / d(cartesian)
  polar.row(0) = y.transpose() / range;
  polar.row(1) = turned(y).transpose() / (range * range);
  const Eigen::Vector2d innovation(range_m - range, wrap_angle(bearing_rad - std::atan2(y.y(), y.x())));

  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(2, P_.rows());
  H.leftCols<2>() = -polar * Rt;
  H.middleCols<2>(column(index)) = polar * Rt;
  const Eigen::Matrix2d S = symmetrised(H * P_ * H.transpose() + sighting_noise(range));
  const double nis = squared_mahalanobis(innovation, S);
  if (!(nis < gate_chi2_)) {
    if (++track.rejections >= params_.max_rejections) {
      drop({index});
      ++counters_.tracks_dropped;
    }
    return false;
  }
  track.rejections = 0;
  ++track.sightings;
  track.last_s = *stamp_s_;
  track.nis.push_back(nis);
  if (track.nis.size() > static_cast<std::size_t>(params_.nis_window)) track.nis.erase(track.nis.begin());
  correct(H, innovation, S);
  note_ray(tracks_[index], bearing_rad);
  return true;
}

void RangeBearingEkf::correct(const Eigen::MatrixXd& H, const Eigen::Vector2d& innovation, const Eigen::Matrix2d& S) {
  const Eigen::MatrixXd PHt = P_ * H.transpose();
  const Eigen::MatrixXd K = PHt * S.inverse();
  const Eigen::VectorXd d = K * innovation;
  P_ = symmetrised(P_ - K * PHt.transpose());
  // Group retraction: pose <- Exp(d) pose, landmark <- R(d_theta) l + V d_l.
  pose_ = SE2::Exp(d.head<3>()) * pose_;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    const Eigen::Vector2d dl = d.segment<2>(column(i));
    tracks_[i].position = SE2::Exp({dl.x(), dl.y(), d[2]}) * tracks_[i].position;
  }
  for (std::size_t i = 0; i < clones_.size(); ++i)
    clones_[i].pose = SE2::Exp(d.segment<3>(clone_column(i))) * clones_[i].pose;
}

void RangeBearingEkf::note_ray(Track& track, double bearing_rad) const {
  const double ray = wrap_angle(pose_.theta() + bearing_rad - track.first_ray);
  track.ray_low = std::min(track.ray_low, ray);
  track.ray_high = std::max(track.ray_high, ray);
}

void RangeBearingEkf::drop(const std::vector<std::size_t>& dropped) {
  std::vector<Track> kept_tracks;
  std::vector<Eigen::Index> kept{0, 1, 2};
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    if (std::find(dropped.begin(), dropped.end(), i) != dropped.end()) continue;
    kept_tracks.push_back(std::move(tracks_[i]));
    kept.insert(kept.end(), {column(i), column(i) + 1});
  }
  for (Eigen::Index c = column(tracks_.size()); c < P_.rows(); ++c) kept.push_back(c);
  P_ = submatrix(P_, kept);
  tracks_ = std::move(kept_tracks);
}

// Of l' = R^T (l - t): xi_l' = R^T (xi_l - xi_rho).
Eigen::MatrixXd RangeBearingEkf::relative_covariance(const std::vector<std::size_t>& tracks) const {
  const auto n = 2 * static_cast<Eigen::Index>(tracks.size());
  const Eigen::Matrix2d Rt = pose_.rotation().transpose();
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(n, P_.rows());
  for (std::size_t k = 0; k < tracks.size(); ++k) {
    A.block<2, 2>(2 * static_cast<Eigen::Index>(k), column(tracks[k])) = Rt;
    A.block<2, 2>(2 * static_cast<Eigen::Index>(k), 0) = -Rt;
  }
  return symmetrised(Eigen::MatrixXd(A * P_ * A.transpose()));
}

bool RangeBearingEkf::may_freeze(std::size_t index) const {
  const Track& track = tracks_[index];
  if (track.sightings < params_.min_sightings || track.ray_high - track.ray_low < params_.min_parallax_rad) return false;
  const double nis = std::accumulate(track.nis.begin(), track.nis.end(), 0.0);
  if (nis > chi2_quantile(params_.nis_confidence, 2.0 * static_cast<double>(track.nis.size()))) return false;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(Eigen::Matrix2d(relative_covariance({index})), Eigen::EigenvaluesOnly);
  return eigen.eigenvalues().maxCoeff() <= params_.max_sigma_m * params_.max_sigma_m;
}

std::vector<std::size_t> RangeBearingEkf::freezable() const {
  std::vector<std::size_t> tracks;
  for (std::size_t i = 0; i < tracks_.size(); ++i)
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
  segment.closing = state();
  const Eigen::MatrixXd joint = relative_covariance(frozen);
  const auto loadings = shared_loadings<SE2>(joint);
  for (std::size_t k = 0; k < frozen.size(); ++k) {
    const Track& track = tracks_[frozen[k]];
    const auto at = 2 * static_cast<Eigen::Index>(k);
    segment.landmarks.push_back(
        {pose_.inverse() * track.position, joint.block<2, 2>(at, at), loadings[k], {}, track.id});
  }
  for (std::size_t i = 0; i < clones_.size(); ++i) {
    const Eigen::Index c = clone_column(i);
    segment.trail.push_back(
        state_of(clones_[i].stamp_s, clones_[i].abscissa_m, clones_[i].pose, P_.block<3, 3>(c, c)));
  }
  counters_.landmarks_frozen += frozen.size();
  segments_.push_back(std::move(segment));
  drop(frozen);
  rebase();
}

// The current pose becomes the anchor: what is left is expressed relative to it, l' = R^T (l - t).
void RangeBearingEkf::rebase() {
  const FrontEndState<SE2> here = state();
  const Eigen::Matrix2d Rt = pose_.rotation().transpose();
  clones_.clear();
  const Eigen::Index n = column(tracks_.size());
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(n, n);  // xi_l' = R^T (xi_l - xi_rho); the pose is exact now
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    A.block<2, 2>(column(i), column(i)) = Rt;
    A.block<2, 2>(column(i), 0) = -Rt;
    tracks_[i].position = pose_.inverse() * tracks_[i].position;
    tracks_[i].first_ray = wrap_angle(tracks_[i].first_ray - pose_.theta());
  }
  P_ = symmetrised(Eigen::MatrixXd(A * P_.topLeftCorner(n, n) * A.transpose()));
  anchor_ = here.pose;
  anchor_drift_ = here.slam_drift;
  anchor_abscissa_m_ = abscissa_m_;
  pose_ = SE2();
}

FrontEndState<SE2> RangeBearingEkf::state_of(double stamp_s, double abscissa_m, const SE2& pose,
                                             const SE2::Covariance& P) const {
  const SE2::Adjoint Ad = anchor_.adjoint();
  return {stamp_s, abscissa_m, anchor_ * pose,
          symmetrised(SE2::Covariance(anchor_drift_ + Ad * P * Ad.transpose()))};
}

FrontEndState<SE2> RangeBearingEkf::state() const {
  return state_of(stamp_s_.value_or(0.0), abscissa_m_, pose_, P_.topLeftCorner<3, 3>());
}

std::vector<Segment<SE2>> RangeBearingEkf::take_segments() { return std::exchange(segments_, {}); }

}  // namespace convoy
