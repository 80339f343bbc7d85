#include <convoy/frontend/front_end.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/live_pose.hpp>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <vector>

namespace convoy {
namespace {

// The landmarks that a vehicle remembers, of those that the map has joined to others; the rest say nothing that their
// anchors do not say. `at`: their classes.
template <class G>
struct Remembered {
  std::vector<RememberedLandmark<G>> landmarks;
  std::vector<int> at;
};

template <class G>
Remembered<G> known_to(const GlobalMap<G>& map, const LivePose<G>& live) {
  Remembered<G> known;
  const double scale = map.map->landmark_scale(live.chain);
  const double sigma = map.map->scales_landmarks(live.chain) ? map.map->constants(live.chain)->sigma[0] : 0.0;
  const double variance = sigma * sigma;
  for (const RememberedLandmark<G>& l : live.remembered) {
    const std::optional<int> at = map.class_of.find({live.chain, l.index});
    if (!at || std::find(known.at.begin(), known.at.end(), *at) != known.at.end()) continue;
    known.landmarks.push_back(l);
    RememberedLandmark<G>& last = known.landmarks.back();
    last.position *= scale;
    last.covariance =
        positive_part(typename G::PointCovariance(l.covariance + variance * l.position * l.position.transpose()));
    known.at.push_back(*at);
  }
  return known;
}

constexpr double widest_turn_rad2 = 0.09;  // (0.3 rad)^2, as for alignments
constexpr double small_step = 1e-6;        // m and rad: far from the origin rounding is not much less

// The pose that lays landmarks onto points, T l_i = m_i, by their own covariances.
template <class G>
struct Laid {
  G pose;
  Eigen::MatrixXd gain;                                // Dof x Dim n: d_pose = gain d_points
  typename G::Covariance own = G::Covariance::Zero();  // of the landmarks' own errors
  std::vector<double> chi2;                            // of each landmark
};

template <class G>
std::optional<Laid<G>> lay(const std::vector<RememberedLandmark<G>>& landmarks,
                           const std::vector<typename G::Point>& points,
                           const std::vector<typename G::PointCovariance>& of_points, const G& start) {
  const auto n = static_cast<Eigen::Index>(landmarks.size());
  Laid<G> laid{start, Eigen::MatrixXd(G::Dof, G::Dim * n), {}, {}};
  for (int iteration = 0; iteration < 20; ++iteration) {
    typename G::Covariance N = G::Covariance::Zero();
    typename G::Tangent g = G::Tangent::Zero();
    laid.chi2.clear();
    const typename G::PointCovariance Rt = laid.pose.rotation().transpose();
    for (Eigen::Index i = 0; i < n; ++i) {
      const RememberedLandmark<G>& l = landmarks[static_cast<std::size_t>(i)];
      const typename G::PointJacobian A = Rt * laid.pose.act_jacobian(l.position);
      const typename G::PointCovariance V = l.covariance + Rt * of_points[static_cast<std::size_t>(i)] * Rt.transpose();
      const typename G::Point r = laid.pose.inverse() * points[static_cast<std::size_t>(i)] - l.position;
      const Eigen::Matrix<double, G::Dof, G::Dim> AtW = A.transpose() * V.inverse();
      N += AtW * A;
      g += AtW * r;
      laid.gain.template middleCols<G::Dim>(G::Dim * i) = AtW;
      laid.chi2.push_back(squared_mahalanobis(r, V));
    }
    const Eigen::LDLT<typename G::Covariance> ldlt(N);
    const typename G::Tangent step = ldlt.solve(g);
    if (!step.allFinite()) return std::nullopt;
    laid.pose = laid.pose * G::Exp(step);
    if (step.norm() > small_step) continue;
    const typename G::Covariance inverse = N.inverse();  // in space: points in a row leave the turn about it open
    if (!(inverse.template bottomRightCorner<G::Dof - G::Dim, G::Dof - G::Dim>().diagonal().maxCoeff() <
          widest_turn_rad2))
      return std::nullopt;
    laid.gain = ldlt.solve(laid.gain).eval();
    laid.own.setZero();
    for (Eigen::Index i = 0; i < n; ++i) {
      const Eigen::Matrix<double, G::Dof, G::Dim> K = laid.gain.template middleCols<G::Dim>(G::Dim * i);
      laid.own += K * landmarks[static_cast<std::size_t>(i)].covariance * K.transpose();
      laid.gain.template middleCols<G::Dim>(G::Dim * i) = K * Rt;  // the points err in the common frame
    }
    return laid;
  }
  return std::nullopt;
}

// What is each point's own, when the rest of their joint covariance moves them like one body.
template <class G>
std::optional<std::vector<typename G::PointCovariance>> own_of(const Surroundings<G>& around) {
  RelativeLandmarks<G> seen;  // from the pose, so that numbers stay small
  const auto n = static_cast<Eigen::Index>(around.points.size());
  Eigen::MatrixXd turn = Eigen::MatrixXd::Zero(G::Dim * n, G::Dim * n);
  const typename G::PointCovariance Rt = around.pose.rotation().transpose();
  for (Eigen::Index i = 0; i < n; ++i) {
    seen.positions.push_back(around.pose.inverse() * around.points[static_cast<std::size_t>(i)]);
    turn.template block<G::Dim, G::Dim>(G::Dim * i, G::Dim * i) = Rt;
  }
  seen.covariance = turn * around.covariance.bottomRightCorner(G::Dim * n, G::Dim * n) * turn.transpose();
  auto part = rigid_part(seen);
  if (!part) return std::nullopt;
  for (auto& P : part->own) P = symmetrised(typename G::PointCovariance(Rt.transpose() * P * Rt));
  return std::move(part->own);
}

// Without its point `i`.
template <class G>
void leave_out(Surroundings<G>& around, Eigen::Index i) {
  std::vector<Eigen::Index> rows;
  for (Eigen::Index row = 0; row < around.covariance.rows(); ++row)
    if (row < G::Dof + G::Dim * i || row >= G::Dof + G::Dim * (i + 1)) rows.push_back(row);
  around.covariance = Eigen::MatrixXd(around.covariance(rows, rows));
  around.points.erase(around.points.begin() + i);
}

template <class G>
Estimate<G> continued(const Surroundings<G>& around) {
  const typename G::Covariance of_map = around.covariance.template topLeftCorner<G::Dof, G::Dof>();
  return {around.pose, symmetrised(typename G::Covariance(of_map + around.motion))};
}

// Of the two ways to know the pose the one that is known better, unless they contradict each other: then one of them is
// not what it says. Both come from the same measurements in ways that nobody knows any more, so that no mixture of them
// can be shown to be known better than the better one.
template <class G>
Estimate<G> better(const Surroundings<G>& around, const Laid<G>& laid, const typename G::Covariance& of_slam) {
  const Estimate<G> one = continued(around);
  const Eigen::MatrixXd of_points = around.covariance.bottomRightCorner(laid.gain.cols(), laid.gain.cols());
  const Estimate<G> other{laid.pose,
                          symmetrised(typename G::Covariance(laid.gain * of_points * laid.gain.transpose() + of_slam))};
  Eigen::MatrixXd F(G::Dof, G::Dof + laid.gain.cols());
  F << -G::Covariance::Identity(), laid.gain;
  const typename G::Covariance apart =
      F * around.covariance * F.transpose() + 2.0 * (around.motion + of_slam);  // at most
  const typename G::Tangent e = (one.mean.inverse() * other.mean).Log();
  const bool agree = squared_mahalanobis(e, symmetrised(apart)) < chi2_quantile(0.9999, G::Dof);
  const bool definite = Eigen::LLT<typename G::Covariance>(other.covariance).info() == Eigen::Success;
  return agree && definite && other.covariance.determinant() < one.covariance.determinant() ? other : one;
}

}  // namespace

template <class G>
std::optional<Estimate<G>> live_pose(const GlobalMap<G>& map, const LivePose<G>& live) {
  Remembered<G> known = known_to(map, live);
  const std::size_t enough = std::max<std::size_t>(G::Dim + 1, (2 * known.at.size() + 2) / 3);
  if (known.at.size() < enough) return map.map->pose(live.chain, live.state);
  auto around = map.map->surroundings(live.chain, live.state, known.at);
  if (!around) return std::nullopt;
  const double gate = chi2_quantile(0.999, G::Dim);
  while (known.landmarks.size() >= enough) {
    const auto own = own_of(*around);
    const auto laid = own ? lay(known.landmarks, around->points, *own, around->pose) : std::nullopt;
    if (!laid) break;
    const auto worst = std::max_element(laid->chi2.begin(), laid->chi2.end()) - laid->chi2.begin();
    if (laid->chi2[static_cast<std::size_t>(worst)] < gate)
      return better(*around, *laid, typename G::Covariance(positive_part(live.shared) + laid->own));
    known.landmarks.erase(known.landmarks.begin() + worst);  // it was taken for another one, or has moved
    leave_out(*around, worst);
  }
  return continued(*around);
}

#define CONVOY_INSTANTIATE(G) template std::optional<Estimate<G>> live_pose(const GlobalMap<G>&, const LivePose<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
