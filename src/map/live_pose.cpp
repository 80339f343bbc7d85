#include <convoy/frontend/front_end.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/live_pose.hpp>

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
  for (const RememberedLandmark<G>& l : live.remembered) {
    const auto found = map.class_of.find({live.chain, l.index});
    if (found == map.class_of.end() || std::find(known.at.begin(), known.at.end(), found->second) != known.at.end())
      continue;
    known.landmarks.push_back(l);
    known.at.push_back(found->second);
  }
  return known;
}

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
    if (step.norm() > 1e-9) continue;
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

// Of the mixtures T_1 Exp((1 - w) e) of two poses, e = Log(T_1^-1 T_2), the one whose covariance is smallest. What the
// map contributes to both is known; what the SLAM contributes is not independent, and w Q + (1 - w) S is no smaller
// than the covariance of w q + (1 - w) s, whatever q and s have in common. Empty if the two contradict each other: one
// of them is not what it says.
template <class G>
std::optional<Estimate<G>> mixed(const Surroundings<G>& around, const Laid<G>& laid, const typename G::Covariance& S) {
  const Eigen::Index n = laid.gain.cols();
  const typename G::Tangent e = (around.pose.inverse() * laid.pose).Log();
  Eigen::MatrixXd F(G::Dof, G::Dof + n);
  F << -G::Covariance::Identity(), laid.gain;
  const typename G::Covariance apart = F * around.covariance * F.transpose() + 2.0 * (around.motion + S);  // at most
  if (!(squared_mahalanobis(e, symmetrised(apart)) < chi2_quantile(0.9999, G::Dof))) return std::nullopt;
  const auto of = [&](double w) {
    F << w * G::Covariance::Identity(), (1.0 - w) * laid.gain;
    return Estimate<G>{
        around.pose * G::Exp((1.0 - w) * e),
        symmetrised(typename G::Covariance(F * around.covariance * F.transpose() + w * around.motion + (1.0 - w) * S))};
  };
  Estimate<G> best = of(1.0);
  constexpr int steps = 10;
  for (int k = 0; k < steps; ++k) {
    const Estimate<G> mixture = of(static_cast<double>(k) / steps);
    if (mixture.covariance.determinant() < best.covariance.determinant()) best = mixture;
  }
  return best;
}

}  // namespace

template <class G>
std::optional<Estimate<G>> live_pose(const GlobalMap<G>& map, const LivePose<G>& live) {
  const double gate = chi2_quantile(0.999, G::Dim);
  Remembered<G> known = known_to(map, live);
  const std::size_t enough = std::max<std::size_t>(G::Dim + 1, (2 * known.at.size() + 2) / 3);
  while (known.at.size() >= enough) {
    const auto around = map.map->surroundings(live.chain, live.state, known.at);
    if (!around) return std::nullopt;
    const auto own = own_of(*around);
    const auto laid = own ? lay(known.landmarks, around->points, *own, around->pose) : std::nullopt;
    if (!laid) break;
    const auto worst = std::max_element(laid->chi2.begin(), laid->chi2.end()) - laid->chi2.begin();
    if (laid->chi2[static_cast<std::size_t>(worst)] < gate) {
      if (auto both = mixed(*around, *laid, typename G::Covariance(live.shared + laid->own))) return both;
      break;
    }
    known.landmarks.erase(known.landmarks.begin() + worst);  // it was taken for another one, or has moved
    known.at.erase(known.at.begin() + worst);
  }
  return map.map->pose(live.chain, live.state);
}

#define CONVOY_INSTANTIATE(G) template std::optional<Estimate<G>> live_pose(const GlobalMap<G>&, const LivePose<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
