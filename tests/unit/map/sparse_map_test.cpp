// The sparse map against an independent dense solution of the same problem, and against the paper's filter.
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/map/ekf_map.hpp>
#include <convoy/map/problem.hpp>
#include <convoy/map/sparse_map.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>
#include <Eigen/Cholesky>
#include <Eigen/QR>

#include <cstdio>

namespace convoy {
namespace {

template <class G>
class SparseMapOf : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(SparseMapOf, Groups);

template <class G>
Problem<G> problem_of(const test::SampleFleetOf<G>& fleet) {
  const auto store = fleet.store();
  return build_problem(store, select(store, SelectionParams{}));
}

/// Poses and points moved by a vector of right perturbations, in the order of the problem.
template <class G>
struct Estimates {
  std::vector<G> poses;
  std::vector<typename G::Point> points;
  Eigen::Index size() const { return static_cast<Eigen::Index>(G::Dof * poses.size() + G::Dim * points.size()); }
  Estimates moved(const Eigen::VectorXd& d) const {
    Estimates x = *this;
    for (std::size_t n = 0; n < poses.size(); ++n)
      x.poses[n] = poses[n] * G::Exp(d.segment<G::Dof>(G::Dof * static_cast<Eigen::Index>(n)));
    const auto offset = static_cast<Eigen::Index>(G::Dof * poses.size());
    for (std::size_t p = 0; p < points.size(); ++p)
      x.points[p] += d.segment<G::Dim>(offset + G::Dim * static_cast<Eigen::Index>(p));
    return x;
  }
};

/// All residuals, each whitened by its covariance: the cost is their squared norm.
template <class G>
Eigen::VectorXd residuals(const Problem<G>& problem, const Estimates<G>& x) {
  std::vector<double> r;
  const auto add = [&](const auto& e, const auto& P) {
    const auto whitened = P.llt().matrixL().solve(e).eval();
    r.insert(r.end(), whitened.data(), whitened.data() + whitened.size());
  };
  const auto pose = [&](int n) { return x.poses[static_cast<std::size_t>(n)]; };
  for (const auto& f : problem.priors) add((f.mean.inverse() * pose(f.node)).Log(), f.covariance);
  for (const auto& f : problem.drifts) add((f.motion.inverse() * pose(f.a).inverse() * pose(f.b)).Log(), f.covariance);
  const auto loading = [&](const LandmarkFactor<G>& f) -> typename G::Loading {
    return f.loading < 0 ? G::Loading::Zero() : problem.loadings[static_cast<std::size_t>(f.loading)];
  };
  for (int node = 0; node < static_cast<int>(problem.nodes.size()); ++node) {  // landmarks of a node share errors
    std::vector<LandmarkFactor<G>> batch;
    for (const auto& f : problem.landmarks)
      if (f.node == node) batch.push_back(f);
    const auto n = static_cast<Eigen::Index>(batch.size());
    Eigen::VectorXd e(G::Dim * n);
    Eigen::MatrixXd P(G::Dim * n, G::Dim * n);
    for (Eigen::Index i = 0; i < n; ++i) {
      const auto& f = batch[static_cast<std::size_t>(i)];
      e.segment<G::Dim>(G::Dim * i) = pose(f.node).inverse() * x.points[static_cast<std::size_t>(f.point)] - f.position;
      for (Eigen::Index j = 0; j < n; ++j)
        P.block<G::Dim, G::Dim>(G::Dim * i, G::Dim * j) =
            i == j ? Eigen::MatrixXd(f.covariance)
                   : Eigen::MatrixXd(loading(f) * loading(batch[static_cast<std::size_t>(j)]).transpose());
    }
    add(e, P);
  }
  return Eigen::Map<Eigen::VectorXd>(r.data(), static_cast<Eigen::Index>(r.size()));
}

/// With landmarks that share nothing, as the filter of the paper takes them.
template <class G>
Problem<G> unshared(Problem<G> problem) {
  for (auto& f : problem.landmarks) f.loading = -1;
  return problem;
}

template <class G>
Eigen::MatrixXd numeric_jacobian(const Problem<G>& problem, const Estimates<G>& x) {
  constexpr double h = 1e-6;
  Eigen::MatrixXd J(residuals(problem, x).size(), x.size());
  for (Eigen::Index k = 0; k < x.size(); ++k) {
    const Eigen::VectorXd d = h * Eigen::VectorXd::Unit(x.size(), k);
    J.col(k) = (residuals(problem, x.moved(d)) - residuals(problem, x.moved(-d))) / (2.0 * h);
  }
  return J;
}

template <class G>
struct Dense {
  Estimates<G> x;
  Eigen::MatrixXd covariance;
  double chi2 = 0.0;
};

template <class G>
Dense<G> dense_gauss_newton(const Problem<G>& problem) {
  Dense<G> dense;
  for (const auto& node : problem.nodes) dense.x.poses.push_back(node.initial);
  dense.x.points = problem.points;
  for (int iteration = 0; iteration < 15; ++iteration) {
    const Eigen::MatrixXd J = numeric_jacobian(problem, dense.x);
    dense.x = dense.x.moved(-J.colPivHouseholderQr().solve(residuals(problem, dense.x)));
  }
  const Eigen::MatrixXd J = numeric_jacobian(problem, dense.x);
  dense.covariance = (J.transpose() * J).ldlt().solve(Eigen::MatrixXd::Identity(J.cols(), J.cols()));
  dense.chi2 = residuals(problem, dense.x).squaredNorm();
  return dense;
}

template <class G>
Estimates<G> estimates_of(Map<G>& map) {
  Estimates<G> x{map.poses(), {}};
  for (std::size_t p = 0; p < map.problem().points.size(); ++p)
    x.points.push_back(map.class_point(static_cast<int>(p)).mean);
  return x;
}

/// Cov of nodes a and b: the state of a node is the node, up to the floor of a motion of nothing.
template <class G>
Eigen::Matrix<double, 2 * G::Dof, 2 * G::Dof> node_covariance(Map<G>& map, int a, int b) {
  const auto& na = map.problem().nodes[static_cast<std::size_t>(a)];
  const auto& nb = map.problem().nodes[static_cast<std::size_t>(b)];
  return *map.joint_covariance(na.anchor.chain, na.slam, nb.anchor.chain, nb.slam);
}

double relative(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B, const Eigen::VectorXd& sigma_row,
                const Eigen::VectorXd& sigma_col) {
  return ((A - B).array() / (sigma_row * sigma_col.transpose()).array()).abs().maxCoeff();
}

TYPED_TEST(SparseMapOf, IsTheDenseSolutionInMeansAndCovariances) {
  using G = TypeParam;
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    const auto fleet = test::street_fleet<G>(seed);
    const Problem<G> problem = problem_of(fleet);
    ASSERT_GE(problem.points.size(), 20U);
    const Dense<G> dense = dense_gauss_newton(problem);
    const auto map = SparseMap<G>().solve(problem);
    ASSERT_TRUE(map->report().converged);
    EXPECT_NEAR(map->report().chi2, dense.chi2, 1e-6 * (1.0 + dense.chi2));
    const Eigen::VectorXd sigma = dense.covariance.diagonal().cwiseSqrt();
    const int nodes = static_cast<int>(problem.nodes.size());
    for (int n = 0; n < nodes; ++n) {
      const typename G::Tangent d =
          (dense.x.poses[static_cast<std::size_t>(n)].inverse() * map->poses()[static_cast<std::size_t>(n)]).Log();
      EXPECT_LT(d.cwiseQuotient(sigma.segment<G::Dof>(G::Dof * n)).cwiseAbs().maxCoeff(), 1e-5) << n;
    }
    for (int a = 0; a < nodes; a += 2)
      for (int b = 0; b < nodes; b += 3) {
        const auto P = node_covariance(*map, a, b);
        const typename G::Tangent sa = sigma.segment<G::Dof>(G::Dof * a), sb = sigma.segment<G::Dof>(G::Dof * b);
        const auto block = [&](int i, int j) {
          return typename G::Covariance(dense.covariance.template block<G::Dof, G::Dof>(G::Dof * i, G::Dof * j));
        };
        EXPECT_LT(relative(P.template topRightCorner<G::Dof, G::Dof>(), block(a, b), sa, sb), 1e-4) << a << ", " << b;
        // (1e-5 m)^2 and (1e-6 rad)^2 are added to a pose's own block.
        EXPECT_LT(relative(P.template topLeftCorner<G::Dof, G::Dof>(), block(a, a), sa, sa), 1e-3) << a;
      }
    for (std::size_t p = 0; p < problem.points.size(); p += 5) {
      const auto estimate = map->class_point(static_cast<int>(p));
      const auto at = static_cast<Eigen::Index>(G::Dof * problem.nodes.size() + G::Dim * p);
      const typename G::Point s = sigma.segment<G::Dim>(at);
      EXPECT_LT((estimate.mean - dense.x.points[p]).cwiseQuotient(s).cwiseAbs().maxCoeff(), 1e-5);
      EXPECT_LT(relative(estimate.covariance, dense.covariance.template block<G::Dim, G::Dim>(at, at), s, s), 1e-4);
    }
  }
}

// With a wrong Jacobian the solver would stop where the cost still falls.
TYPED_TEST(SparseMapOf, StandsWhereTheCostNoLongerFalls) {
  using G = TypeParam;
  const auto fleet = test::street_fleet<G>(4);
  const Problem<G> problem = problem_of(fleet);
  const auto map = SparseMap<G>().solve(problem);
  const Estimates<G> x = estimates_of(*map);
  const Eigen::VectorXd r = residuals(problem, x);
  EXPECT_NEAR(map->report().chi2, r.squaredNorm(), 1e-9 * (1.0 + r.squaredNorm()));
  const Eigen::MatrixXd J = numeric_jacobian(problem, x);
  const Eigen::VectorXd gradient = 2.0 * J.transpose() * r;
  const Eigen::VectorXd sharpness = J.colwise().norm();  // 1 / conditional sigma
  EXPECT_LT(gradient.cwiseQuotient(sharpness).cwiseAbs().maxCoeff(), 1e-4);
  test::Random random(1);
  for (int round = 0; round < 200; ++round) {
    Eigen::VectorXd d(x.size());
    for (Eigen::Index k = 0; k < d.size(); ++k) d[k] = 0.05 * random.normal() / sharpness[k];
    ASSERT_GT(residuals(problem, x.moved(d)).squaredNorm(), r.squaredNorm());
  }
  for (Eigen::Index k = 0; k < x.size(); ++k)
    for (const double step : {-0.05, 0.05})
      ASSERT_GT(residuals(problem, x.moved(step / sharpness[k] * Eigen::VectorXd::Unit(x.size(), k))).squaredNorm(),
                r.squaredNorm());
}

TYPED_TEST(SparseMapOf, IsTheFilterOfThePaperWhereTheProblemIsLinear) {
  using G = TypeParam;
  const auto fleet = test::street_fleet<G>(
      5, {.scale = 1e-5, .bias = test::fair_start_of<G>});  // errors of um: one linearisation serves
  const Problem<G> problem = unshared(problem_of(fleet));
  const auto sparse = SparseMap<G>().solve(problem), ekf = EkfMap<G>().solve(problem);
  ASSERT_TRUE(sparse->report().converged);
  double moved = 0.0;  // by the associations, at most
  for (std::size_t n = 0; n < problem.nodes.size(); ++n)
    moved = std::max(moved, (problem.nodes[n].initial.inverse() * sparse->poses()[n]).Log().norm());
  ASSERT_GT(moved, 1e-6);
  for (std::size_t n = 0; n < problem.nodes.size(); ++n)
    EXPECT_LT((ekf->poses()[n].inverse() * sparse->poses()[n]).Log().norm(), 1e-5 * moved) << n;
  for (int a = 0; a < static_cast<int>(problem.nodes.size()); ++a)
    for (int b = 0; b < static_cast<int>(problem.nodes.size()); ++b) {
      const auto P = node_covariance(*sparse, a, b), Q = node_covariance(*ekf, a, b);
      const Eigen::VectorXd sigma = P.diagonal().cwiseSqrt();
      ASSERT_LT(relative(P, Q, sigma, sigma), 1e-6) << a << ", " << b;
    }
  for (int p = 0; p < static_cast<int>(problem.points.size()); ++p)
    EXPECT_LT((sparse->class_point(p).covariance - ekf->class_point(p).covariance).norm(),
              1e-6 * sparse->class_point(p).covariance.norm());
}

// At one linearisation the two are the same estimator, to 1e-9 of a standard deviation.
TYPED_TEST(SparseMapOf, AndTheFilterAgreeToRoundingAtOneLinearisation) {
  using G = TypeParam;
  const auto fleet = test::street_fleet<G>(6, {.scale = 1e-9, .bias = test::fair_start_of<G>});
  const Problem<G> problem = unshared(problem_of(fleet));
  const auto sparse = SparseMap<G>().solve(problem), ekf = EkfMap<G>().solve(problem);
  ASSERT_TRUE(sparse->report().converged);
  for (int a = 0; a < static_cast<int>(problem.nodes.size()); ++a)
    for (int b = 0; b < static_cast<int>(problem.nodes.size()); ++b) {
      const auto P = node_covariance(*sparse, a, b), Q = node_covariance(*ekf, a, b);
      const Eigen::VectorXd sigma = P.diagonal().cwiseSqrt();
      ASSERT_LT(relative(P, Q, sigma, sigma), 1e-9) << a << ", " << b;
    }
  // Errors of a hundred-thousandth, which move the map by thousands of times 1e-9 sigma and bend it by less.
  const auto larger = test::street_fleet<G>(6, {.scale = 1e-5, .bias = test::fair_start_of<G>});
  const Problem<G> bent = unshared(problem_of(larger));
  const auto moved = SparseMap<G>().solve(bent), filtered = EkfMap<G>().solve(bent);
  double furthest = 0.0;
  for (int n = 0; n < static_cast<int>(bent.nodes.size()); ++n) {
    const auto at = static_cast<std::size_t>(n);
    const typename G::Tangent sigma = node_covariance(*moved, n, n).diagonal().template head<G::Dof>().cwiseSqrt();
    const auto in_sigmas = [&](const G& T) {
      return (T.inverse() * moved->poses()[at]).Log().cwiseQuotient(sigma).cwiseAbs().maxCoeff();
    };
    furthest = std::max(furthest, in_sigmas(bent.nodes[at].initial));
    EXPECT_LT(in_sigmas(filtered->poses()[at]), 1e-9) << n;
  }
  EXPECT_GT(furthest, 1e-6);
}

TYPED_TEST(SparseMapOf, OfNothingIsEmpty) {
  using G = TypeParam;
  const auto map = SparseMap<G>().solve({});
  EXPECT_TRUE(map->poses().empty());
  EXPECT_FALSE(map->pose(test::chain_of(1), {}));
  EXPECT_FALSE(map->aligned(test::chain_of(1)));
}

struct Nees {
  int runs = 0;
  double pose = 0.0, between = 0.0, chi2 = 0.0, dof = 0.0;
};

// Of the last pose of vehicle 2, and of that of vehicle 3 as seen from it.
template <class G>
Nees monte_carlo(int runs, const test::StreetOptionsOf<G>& options) {
  Nees nees;
  for (int run = 0; run < runs; ++run) {
    auto fleet = test::street_fleet<G>(500 + static_cast<std::uint64_t>(run), options);
    const auto global = test::built(fleet.store());
    auto& map = *global.map;
    const Key a = test::key_of(2, 5), b = test::key_of(3, 5);
    const auto &state_a = fleet.anchor(a).state, &state_b = fleet.anchor(b).state;
    const auto pose_a = map.pose(a.chain, state_a), pose_b = map.pose(b.chain, state_b);
    ++nees.runs;
    nees.pose += squared_mahalanobis((pose_a->mean.inverse() * fleet.truth.at(a)).Log(), pose_a->covariance);
    const G T_a_b = pose_a->mean.inverse() * pose_b->mean, truth = fleet.truth.at(a).inverse() * fleet.truth.at(b);
    Eigen::Matrix<double, G::Dof, 2 * G::Dof> A;  // T_a_b Exp(d) with d = d_b - Ad_{T_a_b}^-1 d_a
    A << -T_a_b.inverse().adjoint(), G::Covariance::Identity();
    const typename G::Covariance P = A * *map.joint_covariance(a.chain, state_a, b.chain, state_b) * A.transpose();
    nees.between += squared_mahalanobis((T_a_b.inverse() * truth).Log(), P);
    nees.chi2 += map.report().chi2;
    nees.dof += map.report().dof;
  }
  return nees;
}

bool in_band(double sum, double dof) { return sum > chi2_quantile(0.001, dof) && sum < chi2_quantile(0.999, dof); }

TYPED_TEST(SparseMapOf, IsConsistentWithTheModelItAssumes) {
  using G = TypeParam;
  const double dof = G::Dof * 200;
  const Nees nees = monte_carlo<G>(200, {.shared_m = 0.0});
  std::printf("NEES per dof: pose %.3f, relative pose %.3f, residuals %.3f\n", nees.pose / dof, nees.between / dof,
              nees.chi2 / nees.dof);
  EXPECT_TRUE(in_band(nees.pose, dof)) << nees.pose / dof;
  EXPECT_TRUE(in_band(nees.between, dof)) << nees.between / dof;
  EXPECT_NEAR(nees.chi2 / nees.dof, 1.0, 0.05);
  for (const double factor : {0.7, 1.5}) {  // covariances that are wrong would be noticed
    EXPECT_FALSE(in_band(nees.pose / factor, dof));
    EXPECT_FALSE(in_band(nees.between / factor, dof));
  }
}

}  // namespace
}  // namespace convoy
