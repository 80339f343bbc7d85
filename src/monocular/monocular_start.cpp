// MonocularFilter: how landmarks start, late.
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/monocular/bearing.hpp>
#include <convoy/monocular/monocular_filter.hpp>

#include <Eigen/LU>
#include <Eigen/QR>

#include <algorithm>

namespace convoy {

using Eigen::Index;
using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

/// r = H_x x + H_f f + n of a candidate's pixels, x the errors of the clones that saw it, f that of the landmark.
struct MonocularFilter::Linearised {
  MatrixXd by_clones;                                    // 2k x 6k
  Eigen::Matrix<double, Eigen::Dynamic, 3> by_landmark;  // 2k x 3
  VectorXd residual;                                     // 2k
  std::vector<Index> columns;                            // of the clones in the state, 6k
};

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

// Where the pixels meet; those that do not fit are left out, if they are few.
std::optional<Triangulation> MonocularFilter::fit(std::vector<ClonePixel>& pixels) const {
  const double tolerance_px = 4.0 * params_.sigma_pixel;
  const auto triangulated = [&]() -> std::optional<Triangulation> {
    const auto t = triangulate(camera_, views_of(pixels), anchor_of(pixels), params_.sigma_pixel);
    return t && t->worst_px <= tolerance_px ? t : std::nullopt;
  };
  if (const auto t = triangulated()) return t;
  std::vector<ClonePixel> some;
  for (const std::size_t k : consistent_views(camera_, views_of(pixels), tolerance_px)) some.push_back(pixels[k]);
  if (some.size() < static_cast<std::size_t>(params_.min_views) || 5 * some.size() < 3 * pixels.size())
    return std::nullopt;
  pixels = std::move(some);
  return triangulated();
}

std::vector<TrackView> MonocularFilter::views_of(const std::vector<ClonePixel>& pixels) const {
  std::vector<TrackView> views;
  for (const ClonePixel& p : pixels)
    views.push_back({state_.clones()[state_.clone_index(p.clone)].pose * state_.T_body_camera(), p.pixel});
  return views;
}

// True if it is a candidate no longer.
bool MonocularFilter::start(std::uint64_t id, Candidate& c, bool& refused) {
  std::vector<ClonePixel> pixels = c.pixels;
  if (pixels.size() < static_cast<std::size_t>(params_.min_views)) return false;
  const auto t = fit(pixels);
  if (!t) {
    refused = static_cast<int>(pixels.size()) + 1 >= params_.max_window;
    return refused;
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

std::optional<MonocularFilter::Linearised> MonocularFilter::linearise(const std::vector<ClonePixel>& pixels,
                                                                      const Triangulation& t) const {
  const std::size_t anchor = state_.clone_index(pixels[t.anchor].clone);
  const SE3 T_anchor_first = state_.clones()[anchor].pose * state_.T_body_camera();
  const Matrix3d cross = skew(T_anchor_first * Vector3d(t.bearing / t.inverse_depth));
  const auto count = static_cast<Index>(pixels.size());
  Linearised lin{MatrixXd::Zero(2 * count, 6 * count), MatrixXd(2 * count, 3), VectorXd(2 * count), {}};
  for (std::size_t k = 0; k < pixels.size(); ++k) {
    const std::size_t clone = state_.clone_index(pixels[k].clone);
    const SE3 T_view_anchor = (state_.clones()[clone].pose * state_.T_body_camera()).inverse();
    const SE3 T_view_first = T_view_anchor * T_anchor_first;
    const Matrix3d R = T_view_first.rotation();
    const auto at = camera_.project(R * t.bearing + t.inverse_depth * T_view_first.translation());
    if (!at) return std::nullopt;
    const Index row = 2 * static_cast<Index>(k);
    PixelJacobian6 by_anchor;
    by_anchor.leftCols<3>() = t.inverse_depth * at->jacobian * T_view_anchor.rotation();
    by_anchor.rightCols<3>() = -by_anchor.leftCols<3>() * cross;
    lin.by_clones.block<2, 6>(row, 6 * static_cast<Index>(t.anchor)) += by_anchor;
    lin.by_clones.block<2, 6>(row, 3 * row) -= by_anchor;
    lin.by_landmark.block<2, 2>(row, 0) = at->jacobian * R * across(t.bearing);
    lin.by_landmark.block<2, 1>(row, 2) = at->jacobian * T_view_first.translation();
    lin.residual.segment<2>(row) = pixels[k].pixel - at->pixel;
    for (Index c = 0; c < 6; ++c) lin.columns.push_back(state_.clone_column(clone) + c);
  }
  return lin;
}

// Of Q^T r, with H_f = Q [U; 0], the first three rows say where the landmark is, the rest says something about the
// clones alone (Mourikis & Roumeliotis 2007; Li & Mourikis 2013).
bool MonocularFilter::add(std::uint64_t id, const Candidate& candidate, const std::vector<ClonePixel>& pixels,
                          const Triangulation& t) {
  const auto lin = linearise(pixels, t);
  if (!lin) return false;
  const Index rest = lin->residual.size() - 3;
  const Eigen::HouseholderQR<Eigen::Matrix<double, Eigen::Dynamic, 3>> qr(lin->by_landmark);
  const MatrixXd QtH = qr.householderQ().adjoint() * lin->by_clones;
  const VectorXd Qtr = qr.householderQ().adjoint() * lin->residual;
  const double noise = params_.sigma_pixel * params_.sigma_pixel;
  const MatrixXd Px = state_.covariance()(Eigen::all, lin->columns);

  const MatrixXd Ho = QtH.bottomRows(rest);
  const MatrixXd PHt = Px * Ho.transpose();
  MatrixXd S = Ho * PHt(lin->columns, Eigen::all);
  S.diagonal().array() += noise;
  const Eigen::LLT<MatrixXd> llt(S);
  const double nis = llt.matrixL().solve(Qtr.tail(rest)).squaredNorm();
  if (!(nis < chi2_quantile(params_.candidate_confidence, static_cast<double>(rest)))) return false;

  const Matrix3d U = qr.matrixQR().topRows<3>().triangularView<Eigen::Upper>();
  const Matrix3d Ui = U.inverse();
  const Eigen::Matrix<double, 3, Eigen::Dynamic> A = Ui * QtH.topRows<3>();
  const Eigen::Matrix<double, 3, Eigen::Dynamic> AP = A * Px.transpose();
  const Matrix3d F = AP(Eigen::all, lin->columns) * A.transpose() + noise * Ui * Ui.transpose();
  const Vector3d shift = Ui * Qtr.head<3>();
  const Index at = MonocularState::landmark_column(state_.landmarks().size());
  state_.add({id, pixels[t.anchor].clone, {}, turned(t.bearing, shift.head<2>()), t.inverse_depth + shift[2]}, AP,
             symmetrised(F));
  MatrixXd grown(PHt.rows() + 3, rest);  // with the landmark's rows: Cov(f, x) Ho^T = -A P Ho^T
  grown.topRows(at) = PHt.topRows(at);
  grown.middleRows<3>(at) = -A * PHt(lin->columns, Eigen::all);
  grown.bottomRows(PHt.rows() - at) = PHt.bottomRows(PHt.rows() - at);
  state_.correct(grown, llt, Qtr.tail(rest));
  Track& track = tracks_[id];
  track.T_anchor_first = candidate.T_anchor_first;
  track.sightings = static_cast<int>(pixels.size());
  return true;
}

}  // namespace convoy
