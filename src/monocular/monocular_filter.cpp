#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/monocular/bearing.hpp>
#include <convoy/monocular/monocular_filter.hpp>

#include <algorithm>
#include <cmath>
#include <set>

namespace convoy {

using Eigen::Index;
using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;

MonocularFilter::MonocularFilter(const MonocularParams& params, const CameraModel& camera, const SE3& T_body_camera)
    : params_(params),
      camera_(camera),
      state_(T_body_camera, params.sigma_yaw_bias_radps, params.sigma_scale),
      slip_monitor_(params.slip_window, params.slip_threshold) {
  search_.gate_chi2 = chi2_quantile(0.999, 2.0);
  search_.inlier_chi2 = chi2_quantile(params.inlier, 2.0);
  search_.rescue_chi2 = chi2_quantile(params.rescue, 2.0);
}

void MonocularFilter::move(const OdometryStep& step) {
  if (!step.moved()) return;
  const double walk = params_.sigma_yaw_bias_walk_per_sqrt_s;
  state_.move(step, walk * walk * step.moving_s);
  step_.append(step);
  if (slipping_ == 0) return;
  --slipping_;
  ++counters_.slip_frames;
  state_.inflate(slip_variance());
}

SE3::Tangent MonocularFilter::slip_variance() const {
  const auto square = [](double x) { return x * x; };
  SE3::Tangent variance = SE3::Tangent::Zero();
  variance[0] = square(params_.slip_share * step_.length_m);
  variance[1] = 0.1 * variance[0];
  variance[5] = square(params_.slip_yaw_rad + params_.slip_share * step_.angle_rad);
  return variance;
}

// ---- prediction ----

std::vector<FeaturePrediction> MonocularFilter::predictions() const {
  std::vector<FeaturePrediction> all;
  const SE3 T_camera_anchor = camera_pose().inverse();
  for (std::size_t i = 0; i < state_.landmarks().size(); ++i) {
    const auto view = view_of(state_, i, camera_, state_.pose());
    if (!view || !camera_.in_image(view->pixel)) continue;
    const Track& track = tracks_.at(state_.landmarks()[i].id);
    FeaturePrediction p;
    p.track = state_.landmarks()[i].id;
    p.pixel = view->pixel;
    p.covariance = joint_innovation(state_, {*view}, params_.sigma_pixel).S;
    p.p_camera = T_camera_anchor * state_.position(i);
    p.T_camera_first = T_camera_anchor * track.T_anchor_first;
    p.landmark = true;
    p.converged = converges(i);
    all.push_back(p);
  }
  for (const auto& [id, candidate] : candidates_) {
    const FeaturePrediction p = prediction_of(id, candidate);
    if (p.p_camera.z() > 0.0 && camera_.in_image(p.pixel)) all.push_back(p);
  }
  return all;
}

// From where it was seen last, with its depth and the motion since as uncertain as they are.
FeaturePrediction MonocularFilter::prediction_of(std::uint64_t id, const Candidate& c) const {
  FeaturePrediction p;
  const SE3 T_camera_anchor = camera_pose().inverse();
  const SE3 T_camera_last = T_camera_anchor * c.T_anchor_last;
  const Vector3d ray = camera_.ray(c.last_pixel);
  p.track = id;
  p.T_camera_first = T_camera_anchor * c.T_anchor_first;
  p.p_camera = T_camera_last * Vector3d(ray / c.inverse_depth);
  const auto at = camera_.project(p.p_camera);
  if (!at) {
    p.p_camera.setZero();
    return p;
  }
  p.pixel = at->pixel;
  const Vector2d by_depth = at->jacobian * T_camera_last.translation() * (1.0 / c.inverse_depth);
  const Matrix3d R_camera_body = state_.T_body_camera().rotation().transpose();
  const PixelJacobian6 by_step =
      -at->jacobian * R_camera_body * SE3().act_jacobian(state_.T_body_camera() * p.p_camera);
  p.covariance = 2.0 * params_.sigma_pixel * params_.sigma_pixel * Matrix2d::Identity() +
                 by_depth * by_depth.transpose() * std::pow(c.sigma_inverse_depth, 2) +
                 (1 + c.unseen) * by_step * step_.noise * by_step.transpose();
  return p;
}

// ---- update ----

std::vector<FeatureObservation> MonocularFilter::valid(const std::vector<FeatureObservation>& observations) {
  std::vector<FeatureObservation> some;
  std::set<std::uint64_t> tracks;
  for (const FeatureObservation& o : observations) {
    const bool seen = camera_.in_image(o.pixel) && camera_.project(camera_.ray(o.pixel));
    if (seen && tracks.insert(o.track).second) some.push_back(o);
  }
  counters_.observations_invalid += observations.size() - some.size();
  return some;
}

MonocularFilter::Matches MonocularFilter::match(const std::vector<FeatureObservation>& observations) const {
  Matches m;
  for (const FeatureObservation& o : observations) {
    const auto landmark = state_.find_landmark(o.track);
    if (!landmark) continue;
    const auto view = view_of(state_, *landmark, camera_, state_.pose());
    if (!view) continue;
    m.matches.push_back({*landmark, o.pixel - view->pixel});
    m.views.push_back(*view);
  }
  return m;
}

VectorXd MonocularFilter::Matches::innovations() const {
  VectorXd r(2 * static_cast<Index>(matches.size()));
  for (std::size_t k = 0; k < matches.size(); ++k) r.segment<2>(2 * static_cast<Index>(k)) = matches[k].innovation;
  return r;
}

FrameReport MonocularFilter::update(double stamp_s, double abscissa_m,
                                    const std::vector<FeatureObservation>& observations) {
  FrameReport report;
  ++counters_.frames;
  const std::vector<FeatureObservation> seen = valid(observations);
  const Matches matches = match(seen);
  report.matched = static_cast<int>(matches.matches.size());
  JointInnovation joint = joint_innovation(state_, matches.views, params_.sigma_pixel);
  if (!step_.moved() && stands(matches, joint.S)) {
    report.standstill = true;
    ++counters_.standstill_frames;
    return report;
  }
  const std::vector<std::size_t> inliers = select(matches, joint, report);
  report.inliers = static_cast<int>(inliers.size());
  note(matches, inliers, joint.S);
  const SE3 predicted = state_.pose();
  if (!inliers.empty()) correct(matches, inliers, joint, report);
  const SE3 correction = predicted.inverse() * state_.pose();
  const double path_m = std::max(step_.length_m, (step_.motion * correction).translation().norm());
  report.contradicted = report.inliers >= params_.min_inliers && contradicts(correction, path_m);
  count_failure(report, seen.size(), path_m);
  follow_candidates(seen);
  clone_if_due(stamp_s, abscissa_m, seen);
  report.started = start_landmarks();
  tidy();
  step_ = {};
  return report;
}

// The wheels say so, and the image does not say otherwise: more looks at the same scene say nothing new, since their
// errors are the same.
bool MonocularFilter::stands(const Matches& matches, const MatrixXd& S) const {
  std::size_t outside = 0;
  for (std::size_t k = 0; k < matches.matches.size(); ++k) {
    const Index at = 2 * static_cast<Index>(k);
    const Matrix2d own = S.block<2, 2>(at, at);
    if (!(squared_mahalanobis(matches.matches[k].innovation, own) < search_.rescue_chi2)) ++outside;
  }
  return 2 * outside <= matches.matches.size() ||
         matches.matches.size() < static_cast<std::size_t>(params_.min_inliers);
}

// If most matches disagree with the odometer, perhaps they agree with each other on another step.
std::vector<std::size_t> MonocularFilter::select(const Matches& matches, JointInnovation& joint, FrameReport& report) {
  const VectorXd r = matches.innovations();
  std::vector<std::size_t> inliers = find_inliers(r, joint.S, search_);
  if (matches.matches.size() < static_cast<std::size_t>(params_.min_inliers) ||
      2 * inliers.size() > matches.matches.size())
    return inliers;
  SE3::Tangent variance = slip_variance();
  const double least_m = 0.05;  // standing wheels slip, too
  variance[0] += least_m * least_m;
  const MatrixXd A = times(matches.views, state_.step_jacobian());
  const MatrixXd S = joint.S + A * variance.asDiagonal() * A.transpose();
  std::vector<std::size_t> others = find_inliers(r, S, search_);
  if (2 * others.size() < 3 * inliers.size() || others.size() < static_cast<std::size_t>(params_.min_inliers))
    return inliers;
  state_.inflate(variance);
  joint = joint_innovation(state_, matches.views, params_.sigma_pixel);
  report.slip = true;
  ++counters_.slip_frames;
  return others;
}

void MonocularFilter::note(const Matches& matches, const std::vector<std::size_t>& inliers, const MatrixXd& S) {
  for (auto& [id, track] : tracks_) ++track.unseen;
  for (std::size_t k = 0; k < matches.matches.size(); ++k) {
    Track& track = tracks_.at(state_.landmarks()[matches.matches[k].landmark].id);
    if (!std::binary_search(inliers.begin(), inliers.end(), k)) {
      ++track.rejections;
      ++track.all_rejections;
      ++counters_.observations_outlying;
      continue;
    }
    const Index at = 2 * static_cast<Index>(k);
    const Eigen::LLT<Matrix2d> llt(Matrix2d(S.block<2, 2>(at, at)));
    track.innovations.push_back(llt.matrixL().solve(matches.matches[k].innovation));
    if (track.innovations.size() > static_cast<std::size_t>(params_.nis_window))
      track.innovations.erase(track.innovations.begin());
    track.rejections = track.unseen = 0;
    ++track.sightings;
    ++track.confirmations;
    ++counters_.observations_used;
  }
}

void MonocularFilter::correct(const Matches& matches, const std::vector<std::size_t>& inliers,
                              const JointInnovation& joint, FrameReport& report) {
  const std::vector<Index> rows = pixel_rows(inliers);
  const Eigen::LLT<MatrixXd> S(MatrixXd(joint.S(rows, rows)));
  const VectorXd r = matches.innovations()(rows);
  Matches used;
  for (const std::size_t k : inliers) used.views.push_back(matches.views[k]);
  if (step_.moved() && !report.slip && slipping_ == 0) score_slip(used, S, r);
  MatrixXd PHt = joint.PHt(Eigen::all, rows);
  state_.correct(PHt, S, r);
}

// The score test of one more metre, or one more radian, in the last step.
void MonocularFilter::score_slip(const Matches& inliers, const Eigen::LLT<MatrixXd>& S, const VectorXd& innovation) {
  const MatrixXd A = S.matrixL().solve(times(inliers.views, state_.step_jacobian()));
  const VectorXd whitened = S.matrixL().solve(innovation);
  const auto score = [&](Index axis) { return A.col(axis).dot(whitened) / std::max(A.col(axis).norm(), 1e-9); };
  if (slip_monitor_.slips({score(0), score(5)})) slipping_ = params_.slip_window;
}

// By a part of the way that no noise of an odometer explains, but a wheel that slips.
bool MonocularFilter::contradicts(const SE3& correction, double path_m) const {
  constexpr double share = 0.25, least_m = 0.05;
  const SE3::Tangent off = correction.Log();
  return std::abs(off[0]) > std::max(least_m, share * path_m) || std::abs(off[5]) > params_.slip_yaw_rad;
}

// An image with little in it says nothing, not even that something is wrong. Wheels slip for a moment: where more of
// the way is doubtful than not, the filter follows one of two that contradict each other, and cannot know which. An
// odometer that stands while the camera moves drives no way, but that of the images.
void MonocularFilter::count_failure(const FrameReport& report, std::size_t observations, double path_m) {
  if (observations < static_cast<std::size_t>(params_.min_inliers)) return;
  const bool fails = report.inliers < params_.min_inliers || 4 * report.inliers < report.matched;
  const int change = fails || report.contradicted ? 1 : -1;
  doubtful_.frames = std::max(0, doubtful_.frames + change);
  doubtful_.path_m = std::max(0.0, doubtful_.path_m + change * path_m);
  counters_.contradicted_frames += report.contradicted;
  counters_.failing_frames += fails;
  failing_ = fails ? Doubt{failing_.frames + 1, failing_.path_m + step_.length_m} : Doubt{};
}

}  // namespace convoy
