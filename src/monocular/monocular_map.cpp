// MonocularFilter: what stays in the state, and what leaves it.
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/monocular/monocular_filter.hpp>

#include <algorithm>
#include <cmath>
#include <set>

namespace convoy {

using Eigen::Index;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

// ---- what stays ----

// 4 sigma_d cos(alpha) / d, alpha between the ray it was started along and the one it is seen along (Civera 2007).
double MonocularFilter::linearity(std::size_t i) const {
  const MonocularLandmark& l = state_.landmarks()[i];
  const Index at = MonocularState::landmark_column(i) + 2;
  const double sigma_m = std::sqrt(state_.covariance()(at, at)) / (l.inverse_depth * l.inverse_depth);
  const SE3 T_anchor_first = state_.clones()[state_.clone_index(l.clone)].pose * state_.T_body_camera();
  const Vector3d ray = state_.position(i) - camera_pose().translation();
  const double cosine = ray.normalized().dot(T_anchor_first.rotation() * l.bearing);
  return 4.0 * sigma_m * std::abs(cosine) / ray.norm();
}

bool MonocularFilter::converges(std::size_t i) const {
  const MonocularLandmark& l = state_.landmarks()[i];
  return l.clone == 0 && tracks_.at(l.id).sightings >= params_.min_sightings;
}

void MonocularFilter::tidy() {
  std::vector<std::size_t> dropped;
  for (std::size_t i = 0; i < state_.landmarks().size(); ++i) {
    const MonocularLandmark& l = state_.landmarks()[i];
    const Track& track = tracks_.at(l.id);
    const bool behind = l.clone != 0 && !(l.inverse_depth > 1e-4);
    const bool forgotten = track.unseen > params_.max_unseen_frames && !converges(i);
    // It was matched where it should not have been, and is not seen any more.
    const bool misfit = track.rejections > 1 && track.unseen >= track.rejections + params_.frozen_after_frames;
    if (behind || forgotten || misfit || track.rejections >= params_.max_rejections) dropped.push_back(i);
    else if (l.clone != 0 && linearity(i) < params_.linearity) state_.make_point(i);
  }
  counters_.landmarks_dropped += dropped.size();
  drop_landmarks(dropped);
  drop_clones();
}

void MonocularFilter::drop_landmarks(const std::vector<std::size_t>& landmarks) {
  for (const std::size_t i : landmarks) tracks_.erase(state_.landmarks()[i].id);
  state_.drop(landmarks, {});
}

void MonocularFilter::drop_clones() {
  std::set<std::uint64_t> needed;
  for (const MonocularLandmark& l : state_.landmarks()) needed.insert(l.clone);
  std::vector<std::size_t> dropped;
  const std::vector<MonocularClone>& clones = state_.clones();
  const auto window = static_cast<std::size_t>(params_.max_window);
  for (std::size_t i = 0; i + window < clones.size(); ++i)
    if (!clones[i].trail && needed.count(clones[i].id) == 0) dropped.push_back(i);
  state_.drop({}, dropped);
  const std::uint64_t oldest = clones.size() > window ? clones[clones.size() - window].id : 0;
  for (auto& [id, c] : candidates_)
    std::erase_if(c.pixels, [&](const ClonePixel& p) { return p.clone < oldest || !state_.has_clone(p.clone); });
}

// ---- freezing ----

bool MonocularFilter::may_freeze(std::size_t i) const {
  if (!converges(i)) return false;
  const Track& track = tracks_.at(state_.landmarks()[i].id);
  if (track.confirmations < params_.min_confirmations || track.all_rejections > track.confirmations) return false;
  if (track.rejections > 1) return false;  // it left while it did not fit
  const auto n = static_cast<double>(track.innovations.size());
  double nis = 0.0;
  Vector2d sum = Vector2d::Zero();
  for (const Vector2d& w : track.innovations) {
    nis += w.squaredNorm();
    sum += w;
  }
  if (n > 0.0 && nis > chi2_quantile(params_.nis_confidence, 2.0 * n)) return false;
  if (n > 0.0 && sum.squaredNorm() / n > chi2_quantile(params_.nis_confidence, 2.0)) return false;
  const Matrix3d P = state_.relative_covariance({i});
  return eigenvalues(P).maxCoeff() <= params_.max_sigma_m * params_.max_sigma_m;
}

std::vector<std::size_t> MonocularFilter::freezable(bool also_in_view) const {
  std::vector<std::size_t> landmarks;
  for (std::size_t i = 0; i < state_.landmarks().size(); ++i) {
    const bool left = tracks_.at(state_.landmarks()[i].id).unseen >= params_.frozen_after_frames;
    if ((also_in_view || left) && may_freeze(i)) landmarks.push_back(i);
  }
  return landmarks;
}

void MonocularFilter::freeze(double abscissa_m, const std::vector<std::size_t>& landmarks) {
  trail_abscissa_m_ = abscissa_m;
  std::vector<std::size_t> gone;
  for (std::size_t i = 0; i < state_.landmarks().size(); ++i) {
    const bool frozen = std::binary_search(landmarks.begin(), landmarks.end(), i);
    const bool left = tracks_.at(state_.landmarks()[i].id).unseen > params_.max_unseen_frames;
    if (frozen || (left && converges(i))) gone.push_back(i);
  }
  counters_.landmarks_frozen += landmarks.size();
  counters_.landmarks_unfit += gone.size() - landmarks.size();
  const SE3 T_new_old = state_.pose().inverse();
  drop_landmarks(gone);
  state_.rebase();
  for (auto& [id, track] : tracks_) track.T_anchor_first = T_new_old * track.T_anchor_first;
  for (auto& [id, c] : candidates_) {
    c.T_anchor_first = T_new_old * c.T_anchor_first;
    c.T_anchor_last = T_new_old * c.T_anchor_last;
  }
}

}  // namespace convoy
