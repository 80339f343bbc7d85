#include <convoy/frontend/range_bearing_filter.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/polar.hpp>

#include <algorithm>
#include <numeric>
#include <utility>

namespace convoy {
namespace {

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

template <class G>
void RangeBearingFilter<G>::move(const G& step, const typename G::Tangent& variance) {
  constexpr int Turn = G::Dof - G::Dim;
  pose_ = pose_ * step;
  // xi+ = xi + Ad_X w for the pose, of which theta moves a landmark against itself: xi_l+ = xi_l - theta x l^.
  const typename G::Adjoint Ad = pose_.adjoint();
  Eigen::MatrixXd N = Eigen::MatrixXd::Zero(P_.rows(), G::Dof);
  N.template topRows<G::Dof>() = Ad;
  for (std::size_t i = 0; i < tracks_.size(); ++i)
    N.template block<G::Dim, Turn>(column(i), G::Dim) =
        -G().act_jacobian(tracks_[i].position).template rightCols<Turn>() * Ad.template bottomRightCorner<Turn, Turn>();
  P_.noalias() += N * variance.asDiagonal() * N.transpose();
}

template <class G>
void RangeBearingFilter<G>::add(double stamp_s, std::uint64_t id, const Polar& sighting, const PolarNoise& noise) {
  const typename G::Point ray = ray_of(sighting);
  RangeBearingTrack<G> track;
  track.id = id;
  track.position = pose_ * typename G::Point(sighting[0] * ray);
  track.sightings = 1;
  track.last_s = stamp_s;
  track.ray_a = track.ray_b = pose_.rotation() * ray;
  tracks_.push_back(track);

  const typename G::PointCovariance A = pose_.rotation() * point_jacobian(sighting);
  // xi_l = xi_rho - R n: a copy of the position's rows and columns, put behind the other landmarks, before the clones.
  const Eigen::Index at = column(tracks_.size() - 1);
  P_ = with_copy(P_, 0, G::Dim, at);
  P_.template block<G::Dim, G::Dim>(at, at) += A * noise * A.transpose();
}

template <class G>
void RangeBearingFilter<G>::clone_pose(double stamp_s, double abscissa_m) {
  clones_.push_back({stamp_s, abscissa_m, pose_, G::Covariance::Zero()});
  P_ = with_copy(P_, 0, G::Dof, clone_column(clones_.size() - 1));
}

template <class G>
double RangeBearingFilter<G>::update(std::size_t index, double stamp_s, const Polar& sighting, const PolarNoise& noise,
                                     double gate, int nis_window) {
  RangeBearingTrack<G>& track = tracks_[index];
  const typename G::PointCovariance Rt = pose_.rotation().transpose();
  const typename G::Point y = Rt * (track.position - pose_.translation());
  const typename G::PointCovariance polar = polar_jacobian(y);
  const Polar innovation = polar_difference<G::Dim>(sighting, polar_of(y));

  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(G::Dim, P_.rows());
  H.template leftCols<G::Dim>() = -polar * Rt;
  H.template middleCols<G::Dim>(column(index)) = polar * Rt;
  const PolarNoise S = symmetrised(H * P_ * H.transpose() + noise);
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
  widen_parallax(track, pose_.rotation() * ray_of(sighting));
  return nis;
}

template <class G>
void RangeBearingFilter<G>::widen_parallax(RangeBearingTrack<G>& track, const typename G::Point& ray) {
  const double to_a = angle_between(track.ray_a, ray), to_b = angle_between(track.ray_b, ray);
  if (std::max(to_a, to_b) <= track.parallax_rad) return;
  track.parallax_rad = std::max(to_a, to_b);
  (to_a > to_b ? track.ray_b : track.ray_a) = ray;
}

template <class G>
void RangeBearingFilter<G>::correct(const Eigen::MatrixXd& H, const Polar& innovation, const PolarNoise& S) {
  const Eigen::MatrixXd PHt = P_ * H.transpose();
  const Eigen::MatrixXd K = PHt * S.inverse();
  const Eigen::VectorXd d = K * innovation;
  P_ = symmetrised(P_ - K * PHt.transpose());
  // Group retraction: pose <- Exp(d) pose, landmark <- R(d_theta) l + V d_l.
  typename G::Tangent d_landmark = d.template head<G::Dof>();
  pose_ = G::Exp(d_landmark) * pose_;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    d_landmark.template head<G::Dim>() = d.template segment<G::Dim>(column(i));
    tracks_[i].position = G::Exp(d_landmark) * tracks_[i].position;
  }
  for (std::size_t i = 0; i < clones_.size(); ++i)
    clones_[i].pose = G::Exp(d.template segment<G::Dof>(clone_column(i))) * clones_[i].pose;
}

template <class G>
void RangeBearingFilter<G>::drop(const std::vector<std::size_t>& dropped) {
  std::vector<RangeBearingTrack<G>> kept_tracks;
  std::vector<Eigen::Index> kept(G::Dof);
  std::iota(kept.begin(), kept.end(), Eigen::Index{0});
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    if (std::find(dropped.begin(), dropped.end(), i) != dropped.end()) continue;
    kept_tracks.push_back(std::move(tracks_[i]));
    for (Eigen::Index c = column(i); c < column(i + 1); ++c) kept.push_back(c);
  }
  for (Eigen::Index c = column(tracks_.size()); c < P_.rows(); ++c) kept.push_back(c);
  P_ = Eigen::MatrixXd(P_(kept, kept));
  tracks_ = std::move(kept_tracks);
}

// Of l' = R^T (l - t): xi_l' = R^T (xi_l - xi_rho).
template <class G>
Eigen::MatrixXd RangeBearingFilter<G>::relative_covariance(const std::vector<std::size_t>& tracks) const {
  const auto n = G::Dim * static_cast<Eigen::Index>(tracks.size());
  const typename G::PointCovariance Rt = pose_.rotation().transpose();
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(n, P_.rows());
  for (std::size_t k = 0; k < tracks.size(); ++k) {
    const Eigen::Index row = G::Dim * static_cast<Eigen::Index>(k);
    A.template block<G::Dim, G::Dim>(row, column(tracks[k])) = Rt;
    A.template block<G::Dim, G::Dim>(row, 0) = -Rt;
  }
  return symmetrised(Eigen::MatrixXd(A * P_ * A.transpose()));
}

// What is left is expressed relative to the new anchor, l' = R^T (l - t).
template <class G>
void RangeBearingFilter<G>::rebase() {
  const typename G::PointCovariance Rt = pose_.rotation().transpose();
  clones_.clear();
  const Eigen::Index n = column(tracks_.size());
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(n, n);  // xi_l' = R^T (xi_l - xi_rho); the pose is exact now
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    A.template block<G::Dim, G::Dim>(column(i), column(i)) = Rt;
    A.template block<G::Dim, G::Dim>(column(i), 0) = -Rt;
    tracks_[i].position = pose_.inverse() * tracks_[i].position;
    tracks_[i].ray_a = Rt * tracks_[i].ray_a;
    tracks_[i].ray_b = Rt * tracks_[i].ray_b;
  }
  P_ = symmetrised(Eigen::MatrixXd(A * P_.topLeftCorner(n, n) * A.transpose()));
  pose_ = G();
}

template <class G>
std::optional<std::size_t> RangeBearingFilter<G>::find(std::uint64_t id) const {
  const auto it = std::find_if(tracks_.begin(), tracks_.end(), [&](const auto& t) { return t.id == id; });
  if (it == tracks_.end()) return std::nullopt;
  return static_cast<std::size_t>(it - tracks_.begin());
}

template <class G>
std::vector<PoseClone<G>> RangeBearingFilter<G>::clones() const {
  std::vector<PoseClone<G>> clones = clones_;
  for (std::size_t i = 0; i < clones.size(); ++i)
    clones[i].covariance = P_.template block<G::Dof, G::Dof>(clone_column(i), clone_column(i));
  return clones;
}

#define CONVOY_INSTANTIATE(G) template class RangeBearingFilter<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
