// MonocularFilter: how landmarks and clones come and go.
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/monocular/bearing.hpp>
#include <convoy/monocular/monocular_filter.hpp>

#include <Eigen/QR>

#include <algorithm>
#include <cmath>
#include <set>

namespace convoy {

using Eigen::Index;
using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;

// ---- candidates ----

void MonocularFilter::follow_candidates(const std::vector<FeatureObservation>& observations) {
  for (auto& [id, candidate] : candidates_) ++candidate.unseen;
  const SE3 T_anchor_camera = camera_pose();
  for (const FeatureObservation& o : observations) {
    if (tracks_.count(o.track) > 0) continue;
    const auto [at, is_new] = candidates_.try_emplace(o.track);
    Candidate& c = at->second;
    if (is_new) {
      c.T_anchor_first = T_anchor_camera;
      c.inverse_depth = 1.0 / params_.candidate_depth_m;
      c.sigma_inverse_depth = c.inverse_depth;
    } else {  // the guess is handed on
      const Vector3d p =
          T_anchor_camera.inverse() * (c.T_anchor_last * Vector3d(camera_.ray(c.last_pixel) / c.inverse_depth));
      if (p.z() > 0.0) c.inverse_depth = 1.0 / p.norm();
    }
    c.T_anchor_last = T_anchor_camera;
    c.last_pixel = o.pixel;
    c.unseen = 0;
  }
}

void MonocularFilter::clone_if_due(double stamp_s, double abscissa_m,
                                   const std::vector<FeatureObservation>& observations) {
  if (abscissa_m - clone_abscissa_m_ < params_.clone_spacing_m) return;
  const bool trail = params_.trail_spacing_m > 0.0 && abscissa_m - trail_abscissa_m_ >= params_.trail_spacing_m;
  const std::uint64_t clone = state_.clone_pose(stamp_s, abscissa_m, trail);
  clone_abscissa_m_ = abscissa_m;
  if (trail) trail_abscissa_m_ = abscissa_m;
  for (const FeatureObservation& o : observations) {
    const auto candidate = candidates_.find(o.track);
    if (candidate != candidates_.end()) candidate->second.pixels.push_back({clone, o.pixel});
  }
}

int MonocularFilter::start_landmarks() {
  if (state_.clones().empty()) return 0;
  const std::uint64_t newest = state_.clones().back().id;
  int started = 0;
  for (auto at = candidates_.begin(); at != candidates_.end();) {
    Candidate& c = at->second;
    bool done = c.unseen > 2, refused = false;
    const bool fresh = !c.pixels.empty() && c.pixels.back().clone == newest && c.unseen == 0;
    if (!done && fresh && static_cast<int>(state_.landmarks().size()) < params_.max_landmarks) {
      done = start(at->first, c, refused);
      if (done && !refused) ++started;
      if (refused) ++counters_.candidates_refused;
    }
    at = done ? candidates_.erase(at) : std::next(at);
  }
  counters_.landmarks_started += static_cast<std::uint64_t>(started);
  return started;
}

// True if it is a candidate no longer.
bool MonocularFilter::start(std::uint64_t id, Candidate& c, bool& refused) {
  std::vector<ClonePixel> pixels = c.pixels;
  const auto views_of = [this](const std::vector<ClonePixel>& some) {
    std::vector<TrackView> views;
    for (const ClonePixel& p : some)
      views.push_back({state_.clones()[state_.clone_index(p.clone)].pose * state_.T_body_camera(), p.pixel});
    return views;
  };
  const auto few = [this](const auto& some) { return some.size() < static_cast<std::size_t>(params_.min_views); };
  if (few(pixels)) return false;
  const double tolerance_px = 4.0 * params_.sigma_pixel;
  auto t = triangulate(camera_, views_of(pixels), anchor_of(pixels), params_.sigma_pixel);
  if (!t || t->worst_px > tolerance_px) {
    const auto consistent = consistent_views(camera_, views_of(pixels), tolerance_px);
    std::vector<ClonePixel> some;
    for (const std::size_t k : consistent) some.push_back(pixels[k]);
    if (few(some) || 5 * some.size() < 3 * pixels.size()) {
      refused = static_cast<int>(pixels.size()) >= params_.max_window - 1;
      return refused;
    }
    pixels = std::move(some);
    t = triangulate(camera_, views_of(pixels), anchor_of(pixels), params_.sigma_pixel);
    if (!t || t->worst_px > tolerance_px) return false;
  }
  c.sigma_inverse_depth = std::min(c.sigma_inverse_depth, std::max(t->sigma_inverse_depth, 0.02 * c.inverse_depth));
  const bool unclear = t->sigma_inverse_depth > params_.max_depth_share * t->inverse_depth;
  if (unclear || t->inverse_depth * params_.max_landmark_distance_m < 1.0) return false;
  refused = !add(id, c, pixels, *t);
  return true;
}

// The newest view of a clone that has landmarks already, so that few clones must stay.
std::size_t MonocularFilter::anchor_of(const std::vector<ClonePixel>& pixels) const {
  for (std::size_t k = pixels.size(); k-- > 0;)
    for (const MonocularLandmark& l : state_.landmarks())
      if (l.clone == pixels[k].clone) return k;
  return pixels.size() - 1;
}

// r = H_x x + H_f f + n. Of Q^T r, with H_f = Q [U; 0], the first three rows say where the landmark is, the rest says
// something about the clones alone (Mourikis 2007; Li & Mourikis 2013).
bool MonocularFilter::add(std::uint64_t id, const Candidate& candidate, const std::vector<ClonePixel>& pixels,
                          const Triangulation& t) {
  const std::size_t anchor = state_.clone_index(pixels[t.anchor].clone);
  const SE3 T_anchor_first = state_.clones()[anchor].pose * state_.T_body_camera();
  const Vector3d point = T_anchor_first * Vector3d(t.bearing / t.inverse_depth);
  const auto rows = 2 * static_cast<Index>(pixels.size());
  std::vector<Index> columns;  // of the clones
  MatrixXd H(rows, 6 * static_cast<Index>(pixels.size()));
  H.setZero();
  Eigen::Matrix<double, Eigen::Dynamic, 3> Hf(rows, 3);
  VectorXd r(rows);
  for (std::size_t k = 0; k < pixels.size(); ++k) {
    const std::size_t clone = state_.clone_index(pixels[k].clone);
    const SE3 T_view_anchor = (state_.clones()[clone].pose * state_.T_body_camera()).inverse();
    const SE3 T_view_first = T_view_anchor * T_anchor_first;
    const Matrix3d R = T_view_first.rotation();
    const auto at = camera_.project(R * t.bearing + t.inverse_depth * T_view_first.translation());
    if (!at) return false;
    const Index row = 2 * static_cast<Index>(k);
    PixelJacobian6 by_anchor;
    by_anchor.leftCols<3>() = t.inverse_depth * at->jacobian * T_view_anchor.rotation();
    by_anchor.rightCols<3>() = -by_anchor.leftCols<3>() * skew(point);
    H.block<2, 6>(row, 6 * static_cast<Index>(t.anchor)) += by_anchor;
    H.block<2, 6>(row, 6 * static_cast<Index>(k)) -= by_anchor;
    Hf.block<2, 2>(row, 0) = at->jacobian * R * across(t.bearing);
    Hf.block<2, 1>(row, 2) = at->jacobian * T_view_first.translation();
    r.segment<2>(row) = pixels[k].pixel - at->pixel;
    for (Index c = 0; c < 6; ++c) columns.push_back(state_.clone_column(clone) + c);
  }
  const Eigen::HouseholderQR<Eigen::Matrix<double, Eigen::Dynamic, 3>> qr(Hf);
  const MatrixXd QtH = qr.householderQ().adjoint() * H;
  const VectorXd Qtr = qr.householderQ().adjoint() * r;
  const double R2 = params_.sigma_pixel * params_.sigma_pixel;

  const MatrixXd Ho = QtH.bottomRows(rows - 3);
  MatrixXd PHt = state_.covariance()(Eigen::all, columns) * Ho.transpose();
  MatrixXd S = Ho * PHt(columns, Eigen::all);
  S.diagonal().array() += R2;
  const Eigen::LLT<MatrixXd> llt(S);
  const VectorXd rest = Qtr.tail(rows - 3);
  if (!(rest.dot(llt.solve(rest)) < chi2_quantile(params_.candidate_confidence, static_cast<double>(rows - 3))))
    return false;

  const Matrix3d U = qr.matrixQR().topRows<3>().triangularView<Eigen::Upper>();
  const Matrix3d Ui = U.inverse();
  const Eigen::Matrix<double, 3, Eigen::Dynamic> A = Ui * QtH.topRows<3>();
  const Eigen::Matrix<double, 3, Eigen::Dynamic> AP = A * state_.covariance()(columns, Eigen::all);
  const Matrix3d F = AP(Eigen::all, columns) * A.transpose() + R2 * Ui * Ui.transpose();
  const Vector3d shift = Ui * Qtr.head<3>();
  const Index at = MonocularState::landmark_column(state_.landmarks().size());
  state_.add({id, pixels[t.anchor].clone, {}, turned(t.bearing, shift.head<2>()), t.inverse_depth + shift[2]}, AP,
             symmetrised(F));
  MatrixXd grown(PHt.rows() + 3, PHt.cols());  // the landmark's rows: Cov(f, x) Ho^T = -A P Ho^T
  grown.topRows(at) = PHt.topRows(at);
  grown.middleRows<3>(at) = -A * PHt(columns, Eigen::all);
  grown.bottomRows(PHt.rows() - at) = PHt.bottomRows(PHt.rows() - at);
  state_.correct(grown, llt, rest);
  Track& track = tracks_[id];
  track.T_anchor_first = candidate.T_anchor_first;
  track.sightings = static_cast<int>(pixels.size());
  return true;
}

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
    if (behind || forgotten || track.rejections >= params_.max_rejections) dropped.push_back(i);
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
