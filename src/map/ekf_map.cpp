#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/ekf_map.hpp>

#include <Eigen/Cholesky>
#include <algorithm>

namespace convoy {
namespace {

// The filter: poses and points in the order in which they came, one joint covariance.
template <class G>
class Filter {
 public:
  explicit Filter(const Problem<G>& problem)
      : poses(problem.nodes.size()),
        points(problem.points.size()),
        node_at_(problem.nodes.size(), -1),
        point_at_(problem.points.size(), -1) {}

  std::vector<G> poses;
  std::vector<typename G::Point> points;

  bool has_point(int p) const { return point_at_[static_cast<std::size_t>(p)] >= 0; }

  void start_chain(int n, const G& mean, const typename G::Covariance& P0) {
    poses[static_cast<std::size_t>(n)] = mean;
    node_at_[static_cast<std::size_t>(n)] = grow(G::Dof);
    P_.template bottomRightCorner<G::Dof, G::Dof>() = P0;
  }

  // T_b = T_a U: d_b = Ad_U^-1 d_a + eta.
  void extend_chain(const DriftFactor<G>& f) {
    poses[static_cast<std::size_t>(f.b)] = poses[static_cast<std::size_t>(f.a)] * f.motion;
    const typename G::Adjoint F = f.motion.inverse().adjoint();
    const Eigen::Index a = node_at_[static_cast<std::size_t>(f.a)], b = grow(G::Dof);
    node_at_[static_cast<std::size_t>(f.b)] = b;
    P_.block(b, 0, G::Dof, b) = F * P_.block(a, 0, G::Dof, b);
    P_.block(0, b, b, G::Dof) = P_.block(b, 0, G::Dof, b).transpose();
    P_.template block<G::Dof, G::Dof>(b, b) =
        F * P_.template block<G::Dof, G::Dof>(a, a) * F.transpose() + f.covariance;
  }

  // First landmark of a class: m = T l.
  void add_point(const LandmarkFactor<G>& f) {
    const G& T = poses[static_cast<std::size_t>(f.node)];
    points[static_cast<std::size_t>(f.point)] = T * f.position;
    const typename G::PointJacobian H = T.act_jacobian(f.position);
    const auto R = T.rotation();
    const Eigen::Index a = node_at_[static_cast<std::size_t>(f.node)], m = grow(G::Dim);
    point_at_[static_cast<std::size_t>(f.point)] = m;
    P_.block(m, 0, G::Dim, m) = H * P_.block(a, 0, G::Dof, m);
    P_.block(0, m, m, G::Dim) = P_.block(m, 0, G::Dim, m).transpose();
    P_.template block<G::Dim, G::Dim>(m, m) =
        H * P_.template block<G::Dof, G::Dof>(a, a) * H.transpose() + R * f.covariance * R.transpose();
  }

  // A further one: l = T^-1 m + n. Returns the squared Mahalanobis distance of the innovation.
  double fuse(const LandmarkFactor<G>& f) {
    const G& T = poses[static_cast<std::size_t>(f.node)];
    const typename G::PointCovariance Rt = T.rotation().transpose();
    const typename G::Point q = Rt * (points[static_cast<std::size_t>(f.point)] - T.translation());
    const typename G::PointJacobian H_T = -G().act_jacobian(q);
    const Eigen::Index a = node_at_[static_cast<std::size_t>(f.node)], m = point_at_[static_cast<std::size_t>(f.point)];
    const Eigen::Matrix<double, Eigen::Dynamic, G::Dim> PHt =
        P_.middleCols(a, G::Dof) * H_T.transpose() + P_.middleCols(m, G::Dim) * Rt.transpose();
    const typename G::PointCovariance S = symmetrised(typename G::PointCovariance(
        H_T * PHt.template middleRows<G::Dof>(a) + Rt * PHt.template middleRows<G::Dim>(m) + f.covariance));
    const typename G::Point innovation = f.position - q;
    const Eigen::LLT<typename G::PointCovariance> llt(S);
    const Eigen::VectorXd d = PHt * llt.solve(innovation);
    const Eigen::Matrix<double, Eigen::Dynamic, G::Dim> W = llt.matrixL().solve(PHt.transpose()).transpose();
    P_.noalias() -= W * W.transpose();
    for (std::size_t n = 0; n < poses.size(); ++n)
      if (node_at_[n] >= 0) poses[n] = poses[n] * G::Exp(d.segment<G::Dof>(node_at_[n]));
    for (std::size_t p = 0; p < points.size(); ++p)
      if (point_at_[p] >= 0) points[p] += d.segment<G::Dim>(point_at_[p]);
    return innovation.dot(llt.solve(innovation));
  }

  Eigen::MatrixXd covariance(const std::vector<int>& a, const std::vector<int>& b) const {
    return P_(rows(a), rows(b));
  }

 private:
  std::vector<Eigen::Index> rows(const std::vector<int>& unknowns) const {
    const int nodes = static_cast<int>(poses.size());
    std::vector<Eigen::Index> rows;
    for (const int u : unknowns) {
      const Eigen::Index first =
          u < nodes ? node_at_[static_cast<std::size_t>(u)] : point_at_[static_cast<std::size_t>(u - nodes)];
      for (Eigen::Index c = 0; c < (u < nodes ? G::Dof : G::Dim); ++c) rows.push_back(first + c);
    }
    return rows;
  }

  Eigen::Index grow(Eigen::Index by) {
    const Eigen::Index n = P_.rows();
    P_.conservativeResizeLike(Eigen::MatrixXd::Zero(n + by, n + by));
    return n;
  }

  std::vector<Eigen::Index> node_at_, point_at_;
  Eigen::MatrixXd P_;
};

template <class G>
class FilterCovariance final : public CovarianceSource<G> {
 public:
  explicit FilterCovariance(Filter<G> filter) : filter_(std::move(filter)) {}
  Eigen::MatrixXd between(int a, int b) override { return filter_.covariance({a}, {b}); }
  Eigen::MatrixXd joint(const std::vector<int>& unknowns) override { return filter_.covariance(unknowns, unknowns); }

 private:
  Filter<G> filter_;
};

// An unknown start, diffuse but finite, around the alignment that its associations gave.
template <class G>
typename G::Covariance diffuse() {
  typename G::Tangent variance;
  variance.template head<G::Dim>().setConstant(1e4);
  variance.template tail<G::Dof - G::Dim>().setConstant(10.0);
  return variance.asDiagonal();
}

}  // namespace

template <class G>
std::unique_ptr<Map<G>> EkfMap<G>::solve(Problem<G> problem) const {
  Filter<G> filter(problem);
  SolveReport report;
  report.iterations = 1;
  report.converged = true;
  std::vector<std::vector<const LandmarkFactor<G>*>> landmarks_of(problem.nodes.size());
  for (const auto& f : problem.landmarks) landmarks_of[static_cast<std::size_t>(f.node)].push_back(&f);
  std::size_t drift = 0;
  for (const ChainSpan& span : problem.chains) {
    for (int n = span.first; n < span.end; ++n) {
      if (n > span.first) {
        filter.extend_chain(problem.drifts[drift++]);
      } else {
        const auto prior = std::find_if(problem.priors.begin(), problem.priors.end(),
                                        [&](const PriorFactor<G>& f) { return f.node == n; });
        if (prior != problem.priors.end()) filter.start_chain(n, prior->mean, prior->covariance);
        else filter.start_chain(n, problem.nodes[static_cast<std::size_t>(n)].initial, diffuse<G>());
      }
      for (const LandmarkFactor<G>* f : landmarks_of[static_cast<std::size_t>(n)]) {
        if (!filter.has_point(f->point)) {
          filter.add_point(*f);
        } else {
          report.chi2 += filter.fuse(*f);
          report.dof += G::Dim;
        }
      }
    }
  }
  State<G> at{filter.poses, filter.points, {}};
  return std::make_unique<Map<G>>(std::make_shared<const Problem<G>>(std::move(problem)), std::move(at), report,
                                  std::make_unique<FilterCovariance<G>>(std::move(filter)));
}

#define CONVOY_INSTANTIATE(G) template class EkfMap<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
