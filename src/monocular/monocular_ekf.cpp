#include <convoy/frontend/odometry_noise.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/monocular/monocular_ekf.hpp>

#include <algorithm>
#include <cmath>
#include <utility>

namespace convoy {

namespace {

const MonocularParams& checked(const MonocularParams& params) {
  validate(params);
  return params;
}

}  // namespace

MonocularEkf::MonocularEkf(const MonocularParams& params, const CameraModel& camera, const SE3& T_body_camera)
    : params_(checked(params)), filter_(params, camera, T_body_camera) {}

bool MonocularEkf::acceptable(double stamp_s) const {
  return std::isfinite(stamp_s) && (!stamp_s_ || stamp_s >= *stamp_s_);
}

bool MonocularEkf::on_odometry(double stamp_s, double v_mps, double omega_radps) {
  if (!acceptable(stamp_s) || !std::isfinite(v_mps) || !std::isfinite(omega_radps)) {
    ++filter_.counters().odometry_invalid;
    return false;
  }
  advance_to(stamp_s);
  v_mps_ = params_.distance_scale * v_mps;
  omega_radps_ = params_.angle_scale * omega_radps;
  return true;
}

bool MonocularEkf::on_time(double stamp_s) {
  if (!acceptable(stamp_s)) return false;
  advance_to(stamp_s);
  return true;
}

std::vector<FeaturePrediction> MonocularEkf::predictions(double stamp_s) {
  if (!acceptable(stamp_s)) {
    ++filter_.counters().frames_invalid;
    return {};
  }
  advance_to(stamp_s);
  apply_step();
  return filter_.predictions();
}

std::optional<FrameReport> MonocularEkf::update(double stamp_s, const std::vector<FeatureObservation>& observations) {
  if (!acceptable(stamp_s)) {
    ++filter_.counters().frames_invalid;
    return std::nullopt;
  }
  advance_to(stamp_s);
  apply_step();
  const FrameReport report = filter_.update(stamp_s, abscissa_m_, observations);
  std::erase_if(descriptors_, [this](const auto& d) { return !filter_.follows(d.first); });
  close_segment_if_due(true);
  return report;
}

bool MonocularEkf::describe(std::uint64_t track, const Descriptor& descriptor) {
  if (!filter_.follows(track)) return false;
  descriptors_[track] = descriptor;
  return true;
}

// Standing wheels say nothing about the bias of the yaw rate, nor does anything grow then.
void MonocularEkf::advance_to(double stamp_s) {
  if (stamp_s_) {
    const double dt = std::min(stamp_s - *stamp_s_, params_.max_odometry_gap_s);
    if (dt > 0.0 && (v_mps_ != 0.0 || omega_radps_ != 0.0)) {
      const double length = std::abs(v_mps_) * dt, angle = std::abs(omega_radps_) * dt;
      step_.append(v_mps_ * dt, (omega_radps_ - filter_.state().yaw_bias_radps()) * dt, dt,
                   odometry_variance<SE3>(params_, length, angle, dt));
      abscissa_m_ += length;
    }
  }
  stamp_s_ = stamp_s;
  close_segment_if_due(false);
}

void MonocularEkf::apply_step() { filter_.move(std::exchange(step_, {})); }

// Between frames only if no image has come for so long.
void MonocularEkf::close_segment_if_due(bool at_frame) {
  const double length = abscissa_m_ - anchor_abscissa_m_;
  if (length >= params_.max_segment_length_m) return close_segment(filter_.freezable(false));
  if (!at_frame || length < params_.segment_length_m) return;
  const std::vector<std::size_t> frozen = filter_.freezable(false);
  if (static_cast<int>(frozen.size()) >= params_.min_batch) close_segment(frozen);
}

void MonocularEkf::finish() {
  apply_step();
  close_segment(filter_.freezable(true));
}

void MonocularEkf::close_segment(const std::vector<std::size_t>& frozen) {
  apply_step();
  const MonocularState& slam = filter_.state();
  Segment<SE3> segment;
  segment.closing = state_of(stamp_s_.value_or(0.0), abscissa_m_, slam.pose(), slam.pose_covariance());
  const Eigen::MatrixXd joint = slam.relative_covariance(frozen);
  const auto loadings = shared_loadings<SE3>(joint);
  for (std::size_t k = 0; k < frozen.size(); ++k) {
    const std::uint64_t id = slam.landmarks()[frozen[k]].id;
    const auto at = 3 * static_cast<Eigen::Index>(k);
    const auto described = descriptors_.find(id);
    segment.landmarks.push_back({slam.pose().inverse() * slam.position(frozen[k]), joint.block<3, 3>(at, at),
                                 loadings[k], described == descriptors_.end() ? Descriptor{} : described->second, id});
  }
  for (std::size_t i = 0; i < slam.clones().size(); ++i) {
    const MonocularClone& clone = slam.clones()[i];
    const Eigen::Index at = slam.clone_column(i);
    if (clone.trail)
      segment.trail.push_back(
          state_of(clone.stamp_s, clone.abscissa_m, clone.pose, slam.covariance().block<6, 6>(at, at)));
  }
  filter_.freeze(abscissa_m_, frozen);
  std::erase_if(descriptors_, [this](const auto& d) { return !filter_.follows(d.first); });
  anchor_ = segment.closing.pose;
  anchor_drift_ = segment.closing.slam_drift;
  anchor_abscissa_m_ = abscissa_m_;
  segments_.push_back(std::move(segment));
}

FrontEndState<SE3> MonocularEkf::state_of(double stamp_s, double abscissa_m, const SE3& pose,
                                          const SE3::Covariance& P) const {
  const SE3::Adjoint Ad = anchor_.adjoint();
  return {stamp_s, abscissa_m, anchor_ * pose, symmetrised(SE3::Covariance(anchor_drift_ + Ad * P * Ad.transpose()))};
}

// The step since the last frame is made here, not by the filter, which moves once per frame.
FrontEndState<SE3> MonocularEkf::state() const {
  const MonocularState& slam = filter_.state();
  const SE3 pose = slam.pose() * step_.motion;
  const SE3::Adjoint Ad = pose.adjoint();
  Eigen::Matrix<double, 6, 8> F = Eigen::Matrix<double, 6, 8>::Zero();
  F.leftCols<6>().setIdentity();
  F.col(MonocularState::bias_column) = Ad * step_.by_bias;
  F.col(MonocularState::scale_column) = Ad * step_.by_scale;
  const SE3::Covariance P =
      F * slam.covariance().topLeftCorner<8, 8>() * F.transpose() + Ad * step_.noise * Ad.transpose();
  return state_of(stamp_s_.value_or(0.0), abscissa_m_, pose, P);
}

std::vector<Segment<SE3>> MonocularEkf::take_segments() { return std::exchange(segments_, {}); }

}  // namespace convoy
