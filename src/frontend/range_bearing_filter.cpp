#include <convoy/frontend/range_bearing_filter.hpp>
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

}  // namespace

void RangeBearingFilter::move(const SE2& step, const Eigen::Vector3d& variance) {
  pose_ = pose_ * step;
  // xi+ = xi + Ad_X w for the pose, xi_l+ = xi_l - J l^ w_theta for a landmark.
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero(P_.rows(), 3);
  G.topRows<3>() = pose_.adjoint();
  for (std::size_t i = 0; i < tracks_.size(); ++i) G.block<2, 1>(column(i), 2) = -turned(tracks_[i].position);
  P_.noalias() += G * variance.asDiagonal() * G.transpose();
}

void RangeBearingFilter::add(double stamp_s, std::uint64_t id, double range_m, double bearing_rad,
                             const Eigen::Matrix2d& noise) {
  const Eigen::Vector2d ray(std::cos(bearing_rad), std::sin(bearing_rad));
  RangeBearingTrack track;
  track.id = id;
  track.position = pose_ * Eigen::Vector2d(range_m * ray);
  track.sightings = 1;
  track.last_s = stamp_s;
  track.first_ray = wrap_angle(pose_.theta() + bearing_rad);
  tracks_.push_back(track);

  Eigen::Matrix2d polar;  // d(cartesian) / d(range, bearing)
  polar.col(0) = ray;
  polar.col(1) = range_m * turned(ray);
  const Eigen::Matrix2d A = pose_.rotation() * polar;
  // xi_l = xi_rho - R n: a copy of the position's rows and columns, put behind the other landmarks, before the clones.
  const Eigen::Index at = column(tracks_.size() - 1);
  P_ = with_copy(P_, 0, 2, at);
  P_.block<2, 2>(at, at) += A * noise * A.transpose();
}

void RangeBearingFilter::clone_pose(double stamp_s, double abscissa_m) {
  clones_.push_back({stamp_s, abscissa_m, pose_, {}});
  P_ = with_copy(P_, 0, 3, clone_column(clones_.size() - 1));
}

double RangeBearingFilter::update(std::size_t index, double stamp_s, double range_m, double bearing_rad,
                                  const Eigen::Matrix2d& noise, double gate, int nis_window) {
  RangeBearingTrack& track = tracks_[index];
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
  const Eigen::Matrix2d S = symmetrised(H * P_ * H.transpose() + noise);
  const double nis = squared_mahalanobis(innovation, S);
  if (!(nis < gate)) {
    ++track.rejections;
    return nis;
  }
  track.rejections = 0;
  ++track.sightings;
  track.last_s = stamp_s;
  track.nis.push_back(nis);
  if (track.nis.size() > static_cast<std::size_t>(nis_window)) track.nis.erase(track.nis.begin());
  correct(H, innovation, S);
  const double ray = wrap_angle(pose_.theta() + bearing_rad - track.first_ray);
  track.ray_low = std::min(track.ray_low, ray);
  track.ray_high = std::max(track.ray_high, ray);
  return nis;
}

void RangeBearingFilter::correct(const Eigen::MatrixXd& H, const Eigen::Vector2d& innovation, const Eigen::Matrix2d& S) {
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

void RangeBearingFilter::drop(const std::vector<std::size_t>& dropped) {
  std::vector<RangeBearingTrack> kept_tracks;
  std::vector<Eigen::Index> kept{0, 1, 2};
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    if (std::find(dropped.begin(), dropped.end(), i) != dropped.end()) continue;
    kept_tracks.push_back(std::move(tracks_[i]));
    kept.insert(kept.end(), {column(i), column(i) + 1});
  }
  for (Eigen::Index c = column(tracks_.size()); c < P_.rows(); ++c) kept.push_back(c);
  P_ = Eigen::MatrixXd(P_(kept, kept));
  tracks_ = std::move(kept_tracks);
}

// Of l' = R^T (l - t): xi_l' = R^T (xi_l - xi_rho).
Eigen::MatrixXd RangeBearingFilter::relative_covariance(const std::vector<std::size_t>& tracks) const {
  const auto n = 2 * static_cast<Eigen::Index>(tracks.size());
  const Eigen::Matrix2d Rt = pose_.rotation().transpose();
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(n, P_.rows());
  for (std::size_t k = 0; k < tracks.size(); ++k) {
    A.block<2, 2>(2 * static_cast<Eigen::Index>(k), column(tracks[k])) = Rt;
    A.block<2, 2>(2 * static_cast<Eigen::Index>(k), 0) = -Rt;
  }
  return symmetrised(Eigen::MatrixXd(A * P_ * A.transpose()));
}

// What is left is expressed relative to the new anchor, l' = R^T (l - t).
void RangeBearingFilter::rebase() {
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
  pose_ = SE2();
}

std::optional<std::size_t> RangeBearingFilter::find(std::uint64_t id) const {
  const auto it = std::find_if(tracks_.begin(), tracks_.end(), [&](const auto& t) { return t.id == id; });
  if (it == tracks_.end()) return std::nullopt;
  return static_cast<std::size_t>(it - tracks_.begin());
}

std::vector<PoseClone> RangeBearingFilter::clones() const {
  std::vector<PoseClone> clones = clones_;
  for (std::size_t i = 0; i < clones.size(); ++i)
    clones[i].covariance = P_.block<3, 3>(clone_column(i), clone_column(i));
  return clones;
}

}  // namespace convoy
