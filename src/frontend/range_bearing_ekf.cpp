#include <convoy/config_error.hpp>
#include <convoy/frontend/odometry_noise.hpp>
#include <convoy/frontend/range_bearing_ekf.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/polar.hpp>

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
  require(p.sigma_along_per_sqrt_m >= 0 && p.sigma_along_per_sqrt_rad >= 0 && p.sigma_across_per_sqrt_m >= 0 &&
              p.sigma_heading_per_sqrt_m >= 0 && p.sigma_heading_per_sqrt_rad >= 0 && p.sigma_heading_per_sqrt_s >= 0 &&
              p.sigma_vertical_per_sqrt_m >= 0 && p.sigma_tilt_per_sqrt_m >= 0,
          "odometry sigmas must be >= 0");
  require(p.sigma_range_m > 0 && p.sigma_range_share >= 0 && p.sigma_bearing_rad > 0 && p.sigma_elevation_rad > 0,
          "sighting sigmas must be > 0");
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

template <class G>
RangeBearingEkf<G>::RangeBearingEkf(const RangeBearingEkfParams& params) : params_(params) {
  validate(params);
  gate_chi2_ = chi2_quantile(params.gate, G::Dim);
}

template <class G>
bool RangeBearingEkf<G>::on_odometry(double stamp_s, double v_mps, double omega_radps) {
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

template <class G>
bool RangeBearingEkf<G>::on_sighting(double stamp_s, std::uint64_t track, const typename G::Point& polar) {
  const bool below_zenith = G::Dim == 2 || std::abs(polar[G::Dim - 1]) <= 0.5 * M_PI;
  const bool valid = std::isfinite(stamp_s) && polar.allFinite() && below_zenith && polar[0] >= params_.min_range_m &&
                     polar[0] <= params_.max_range_m && (!stamp_s_ || stamp_s >= *stamp_s_);
  if (!valid) {
    ++counters_.sightings_invalid;
    return false;
  }
  advance_to(stamp_s);
  if (params_.max_remembered > 0) remember(track, polar);
  const auto known = filter_.find(track);
  if (known && stamp_s < filter_.tracks()[*known].last_s + params_.min_sighting_interval_s) {
    ++counters_.sightings_thinned;
    return false;
  }
  bool used = true;
  if (!known) {
    filter_.add(stamp_s, track, polar, params_.sighting_noise<G>(polar[0]));
  } else {
    used = filter_.update(*known, stamp_s, polar, params_.sighting_noise<G>(filter_.predicted_range(*known)),
                          gate_chi2_, params_.nis_window) < gate_chi2_;
    if (filter_.tracks()[*known].rejections >= params_.max_rejections) {
      filter_.drop({*known});
      ++counters_.tracks_dropped;
    }
  }
  ++(used ? counters_.sightings_used : counters_.sightings_gated);
  return used;
}

template <class G>
bool RangeBearingEkf<G>::on_time(double stamp_s) {
  if (!std::isfinite(stamp_s) || (stamp_s_ && stamp_s < *stamp_s_)) return false;
  advance_to(stamp_s);
  return true;
}

template <class G>
void RangeBearingEkf<G>::remember(std::uint64_t id, const typename G::Point& polar) {
  const auto known = memory_.find(id);
  if (known && *stamp_s_ < memory_.tracks()[*known].last_s + params_.min_sighting_interval_s) return;
  if (!known) {
    memory_.add(*stamp_s_, id, polar, params_.sighting_noise<G>(polar[0]));
    if (static_cast<int>(memory_.tracks().size()) <= params_.max_remembered) return;
    const auto& tracks = memory_.tracks();
    const auto oldest = std::min_element(tracks.begin(), tracks.end(),
                                         [](const auto& a, const auto& b) { return a.last_s < b.last_s; });
    memory_.drop({static_cast<std::size_t>(oldest - tracks.begin())});
    return;
  }
  memory_.update(*known, *stamp_s_, polar, params_.sighting_noise<G>(memory_.predicted_range(*known)), gate_chi2_,
                 params_.nis_window);
  if (memory_.tracks()[*known].rejections >= params_.max_rejections) memory_.drop({*known});
}

template <class G>
void RangeBearingEkf<G>::advance_to(double stamp_s) {
  if (stamp_s_) {
    const double dt = std::min(stamp_s - *stamp_s_, params_.max_odometry_gap_s);
    if (dt > 0.0 && (v_mps_ != 0.0 || omega_radps_ != 0.0)) move(v_mps_ * dt, omega_radps_ * dt, dt);
  }
  stamp_s_ = stamp_s;
  clone_if_due();
  close_segment_if_due();
}

template <class G>
void RangeBearingEkf<G>::move(double distance_m, double angle_rad, double dt_s) {
  const double length = std::abs(distance_m);
  abscissa_m_ += length;
  typename G::Tangent motion = G::Tangent::Zero();
  motion[0] = distance_m;
  motion[G::Dof - 1] = angle_rad;
  const typename G::Tangent variance = odometry_variance<G>(params_, length, std::abs(angle_rad), dt_s);
  const G step = G::Exp(motion);
  filter_.move(step, variance);
  if (params_.max_remembered > 0) memory_.move(step, variance);
}

template <class G>
void RangeBearingEkf<G>::clone_if_due() {
  if (params_.trail_spacing_m <= 0.0 || abscissa_m_ - clone_abscissa_m_ < params_.trail_spacing_m) return;
  filter_.clone_pose(*stamp_s_, abscissa_m_);
  clone_abscissa_m_ = abscissa_m_;
}

template <class G>
bool RangeBearingEkf<G>::may_freeze(std::size_t index) const {
  const RangeBearingTrack<G>& track = filter_.tracks()[index];
  if (track.sightings < params_.min_sightings || track.parallax_rad < params_.min_parallax_rad) return false;
  const double nis = std::accumulate(track.nis.begin(), track.nis.end(), 0.0);
  if (nis > chi2_quantile(params_.nis_confidence, G::Dim * static_cast<double>(track.nis.size()))) return false;
  const typename G::PointCovariance P = filter_.relative_covariance({index});
  return eigenvalues(P).maxCoeff() <= params_.max_sigma_m * params_.max_sigma_m;
}

template <class G>
std::vector<std::size_t> RangeBearingEkf<G>::freezable() const {
  std::vector<std::size_t> tracks;
  for (std::size_t i = 0; i < filter_.tracks().size(); ++i)
    if (may_freeze(i)) tracks.push_back(i);
  return tracks;
}

template <class G>
void RangeBearingEkf<G>::close_segment_if_due() {
  const double length = abscissa_m_ - anchor_abscissa_m_;
  if (length < params_.segment_length_m) return;
  const std::vector<std::size_t> frozen = freezable();
  if (static_cast<int>(frozen.size()) >= params_.min_batch || length >= params_.max_segment_length_m)
    close_segment(frozen);
}

template <class G>
void RangeBearingEkf<G>::close_segment(const std::vector<std::size_t>& frozen) {
  Segment<G> segment;
  segment.closing = state_of(stamp_s_.value_or(0.0), abscissa_m_, filter_.pose(), filter_.pose_covariance());
  const Eigen::MatrixXd joint = filter_.relative_covariance(frozen);
  const auto loadings = shared_loadings<G>(joint);
  for (std::size_t k = 0; k < frozen.size(); ++k) {
    const RangeBearingTrack<G>& track = filter_.tracks()[frozen[k]];
    const auto at = G::Dim * static_cast<Eigen::Index>(k);
    segment.landmarks.push_back({filter_.pose().inverse() * track.position,
                                 joint.template block<G::Dim, G::Dim>(at, at),
                                 loadings[k],
                                 {},
                                 track.id});
  }
  for (const PoseClone<G>& clone : filter_.clones())
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

template <class G>
FrontEndState<G> RangeBearingEkf<G>::state_of(double stamp_s, double abscissa_m, const G& pose,
                                              const typename G::Covariance& P) const {
  const typename G::Adjoint Ad = anchor_.adjoint();
  return {stamp_s, abscissa_m, anchor_ * pose,
          symmetrised(typename G::Covariance(anchor_drift_ + Ad * P * Ad.transpose()))};
}

template <class G>
FrontEndState<G> RangeBearingEkf<G>::state() const {
  const RangeBearingFilter<G>& live = params_.max_remembered > 0 ? memory_ : filter_;
  return state_of(stamp_s_.value_or(0.0), abscissa_m_, live.pose(), live.pose_covariance());
}

template <class G>
FrontEndState<G> RangeBearingEkf<G>::exportable_state() const {
  return state_of(stamp_s_.value_or(0.0), abscissa_m_, filter_.pose(), filter_.pose_covariance());
}

template <class G>
RelativeLandmarks<G> RangeBearingEkf<G>::remembered() const {
  RelativeLandmarks<G> known;
  const G T_body_anchor = memory_.pose().inverse();
  for (const RangeBearingTrack<G>& track : memory_.tracks()) {
    known.tracks.push_back(track.id);
    known.positions.push_back(T_body_anchor * track.position);
  }
  std::vector<std::size_t> all(known.tracks.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  known.covariance = memory_.relative_covariance(all);
  return known;
}

template <class G>
std::vector<Segment<G>> RangeBearingEkf<G>::take_segments() {
  return std::exchange(segments_, {});
}

#define CONVOY_INSTANTIATE(G) template class RangeBearingEkf<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
