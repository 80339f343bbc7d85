// The sparse map against an independent dense solution of the same problem, and against the paper's filter.
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/map/ekf_map.hpp>
#include <convoy/map/problem.hpp>
#include <convoy/map/sparse_map.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <cstdio>

namespace convoy {
namespace {

Problem<SE2> problem_of(const test::SampleFleet& fleet) {
  const auto store = fleet.store();
  return build_problem(store, select(store, SelectionParams{}));
}

/// Poses and points moved by a vector of right perturbations, in the order of the problem.
struct Estimates {
  std::vector<SE2> poses;
  std::vector<SE2::Point> points;
  Eigen::Index size() const { return static_cast<Eigen::Index>(3 * poses.size() + 2 * points.size()); }
  Estimates moved(const Eigen::VectorXd& d) const {
    Estimates x = *this;
    for (std::size_t n = 0; n < poses.size(); ++n)
      x.poses[n] = poses[n] * SE2::Exp(d.segment<3>(3 * static_cast<Eigen::Index>(n)));
    const auto offset = static_cast<Eigen::Index>(3 * poses.size());
    for (std::size_t p = 0; p < points.size(); ++p)
      x.points[p] += d.segment<2>(offset + 2 * static_cast<Eigen::Index>(p));
    return x;
  }
};

/// All residuals, each whitened by its covariance: the cost is their squared norm.
Eigen::VectorXd residuals(const Problem<SE2>& problem, const Estimates& x) {
  std::vector<double> r;
  const auto add = [&](const auto& e, const auto& P) {
    const auto whitened = P.llt().matrixL().solve(e).eval();
    r.insert(r.end(), whitened.data(), whitened.data() + whitened.size());
  };
  const auto pose = [&](int n) { return x.poses[static_cast<std::size_t>(n)]; };
  for (const auto& f : problem.priors) add((f.mean.inverse() * pose(f.node)).Log(), f.covariance);
  for (const auto& f : problem.drifts) add((f.motion.inverse() * pose(f.a).inverse() * pose(f.b)).Log(), f.covariance);
  for (const auto& f : problem.landmarks)
    add(SE2::Point(pose(f.node).inverse() * x.points[static_cast<std::size_t>(f.point)] - f.position), f.covariance);
  return Eigen::Map<Eigen::VectorXd>(r.data(), static_cast<Eigen::Index>(r.size()));
}

Eigen::MatrixXd numeric_jacobian(const Problem<SE2>& problem, const Estimates& x) {
  constexpr double h = 1e-6;
  Eigen::MatrixXd J(residuals(problem, x).size(), x.size());
  for (Eigen::Index k = 0; k < x.size(); ++k) {
    const Eigen::VectorXd d = h * Eigen::VectorXd::Unit(x.size(), k);
    J.col(k) = (residuals(problem, x.moved(d)) - residuals(problem, x.moved(-d))) / (2.0 * h);
  }
  return J;
}

struct Dense {
  Estimates x;
  Eigen::MatrixXd covariance;
  double chi2 = 0.0;
};

Dense dense_gauss_newton(const Problem<SE2>& problem) {
  Dense dense;
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

Estimates estimates_of(Map<SE2>& map) {
  Estimates x{map.poses(), {}};
  for (std::size_t p = 0; p < map.problem().points.size(); ++p)
    x.points.push_back(map.class_point(static_cast<int>(p)).mean);
  return x;
}

/// Cov of nodes a and b: the state of a node is the node, up to the floor of a motion of nothing.
Eigen::Matrix<double, 6, 6> node_covariance(Map<SE2>& map, int a, int b) {
  const auto& na = map.problem().nodes[static_cast<std::size_t>(a)];
  const auto& nb = map.problem().nodes[static_cast<std::size_t>(b)];
  return *map.joint_covariance(na.anchor.chain, na.slam, nb.anchor.chain, nb.slam);
}

double relative(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B, const Eigen::VectorXd& sigma_row,
                const Eigen::VectorXd& sigma_col) {
  return ((A - B).array() / (sigma_row * sigma_col.transpose()).array()).abs().maxCoeff();
}

TEST(SparseMap, IsTheDenseSolutionInMeansAndCovariances) {
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    const auto fleet = test::street_fleet(seed);
    const Problem<SE2> problem = problem_of(fleet);
    ASSERT_GE(problem.points.size(), 20U);
    const Dense dense = dense_gauss_newton(problem);
    const auto map = SparseMap<SE2>().solve(problem);
    ASSERT_TRUE(map->report().converged);
    EXPECT_NEAR(map->report().chi2, dense.chi2, 1e-6 * (1.0 + dense.chi2));
    const Eigen::VectorXd sigma = dense.covariance.diagonal().cwiseSqrt();
    const int nodes = static_cast<int>(problem.nodes.size());
    for (int n = 0; n < nodes; ++n) {
      const Eigen::Vector3d d =
          (dense.x.poses[static_cast<std::size_t>(n)].inverse() * map->poses()[static_cast<std::size_t>(n)]).Log();
      EXPECT_LT(d.cwiseQuotient(sigma.segment<3>(3 * n)).cwiseAbs().maxCoeff(), 1e-5) << n;
    }
    for (int a = 0; a < nodes; a += 2)
      for (int b = 0; b < nodes; b += 3) {
        const auto P = node_covariance(*map, a, b);
        const Eigen::Vector3d sa = sigma.segment<3>(3 * a), sb = sigma.segment<3>(3 * b);
        EXPECT_LT(relative(P.topRightCorner<3, 3>(), dense.covariance.block<3, 3>(3 * a, 3 * b), sa, sb), 1e-4)
            << a << ", " << b;
        // (1e-5 m)^2 and (1e-6 rad)^2 are added to a pose's own block.
        EXPECT_LT(relative(P.topLeftCorner<3, 3>(), dense.covariance.block<3, 3>(3 * a, 3 * a), sa, sa), 1e-3) << a;
      }
    for (std::size_t p = 0; p < problem.points.size(); p += 5) {
      const auto estimate = map->class_point(static_cast<int>(p));
      const auto at = static_cast<Eigen::Index>(3 * problem.nodes.size() + 2 * p);
      const Eigen::Vector2d s = sigma.segment<2>(at);
      EXPECT_LT((estimate.mean - dense.x.points[p]).cwiseQuotient(s).cwiseAbs().maxCoeff(), 1e-5);
      EXPECT_LT(relative(estimate.covariance, dense.covariance.block<2, 2>(at, at), s, s), 1e-4);
    }
  }
}

// With a wrong Jacobian the solver would stop where the cost still falls.
TEST(SparseMap, StandsWhereTheCostNoLongerFalls) {
  const auto fleet = test::street_fleet(4);
  const Problem<SE2> problem = problem_of(fleet);
  const auto map = SparseMap<SE2>().solve(problem);
  const Estimates x = estimates_of(*map);
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

TEST(SparseMap, IsTheFilterOfThePaperWhereTheProblemIsLinear) {
  const auto fleet =
      test::street_fleet(5, {.scale = 1e-5, .bias = test::fair_start});  // errors of um: one linearisation serves
  const Problem<SE2> problem = problem_of(fleet);
  const auto sparse = SparseMap<SE2>().solve(problem), ekf = EkfMap<SE2>().solve(problem);
  ASSERT_TRUE(sparse->report().converged);
  double moved = 0.0;  // by the associations, at most
  for (std::size_t n = 0; n < problem.nodes.size(); ++n)
    moved = std::max(moved, (problem.nodes[n].initial.inverse() * sparse->poses()[n]).Log().norm());
  ASSERT_GT(moved, 1e-6);
  for (std::size_t n = 0; n < problem.nodes.size(); ++n)
    EXPECT_LT((ekf->poses()[n].inverse() * sparse->poses()[n]).Log().norm(), 1e-6 * moved) << n;
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

TEST(SparseMap, OfNothingIsEmpty) {
  const auto map = SparseMap<SE2>().solve({});
  EXPECT_TRUE(map->poses().empty());
  EXPECT_FALSE(map->pose(test::chain_of(1), {}));
  EXPECT_FALSE(map->aligned(test::chain_of(1)));
}

struct Nees {
  int runs = 0;
  double pose = 0.0, between = 0.0, chi2 = 0.0, dof = 0.0;
};

// Of the last pose of vehicle 2, and of that of vehicle 3 as seen from it.
Nees monte_carlo(int runs, const test::StreetOptions& options) {
  Nees nees;
  for (int run = 0; run < runs; ++run) {
    auto fleet = test::street_fleet(500 + static_cast<std::uint64_t>(run), options);
    const auto global = test::built(fleet.store());
    auto& map = *global.map;
    const Key a = test::key_of(2, 5), b = test::key_of(3, 5);
    const auto &state_a = fleet.anchor(a).state, &state_b = fleet.anchor(b).state;
    const auto pose_a = map.pose(a.chain, state_a), pose_b = map.pose(b.chain, state_b);
    ++nees.runs;
    nees.pose += squared_mahalanobis((pose_a->mean.inverse() * fleet.truth.at(a)).Log(), pose_a->covariance);
    const SE2 T_a_b = pose_a->mean.inverse() * pose_b->mean, truth = fleet.truth.at(a).inverse() * fleet.truth.at(b);
    Eigen::Matrix<double, 3, 6> A;  // T_a_b Exp(d) with d = d_b - Ad_{T_a_b}^-1 d_a
    A << -T_a_b.inverse().adjoint(), Eigen::Matrix3d::Identity();
    const SE2::Covariance P = A * *map.joint_covariance(a.chain, state_a, b.chain, state_b) * A.transpose();
    nees.between += squared_mahalanobis((T_a_b.inverse() * truth).Log(), P);
    nees.chi2 += map.report().chi2;
    nees.dof += map.report().dof;
  }
  return nees;
}

bool in_band(double sum, double dof) { return sum > chi2_quantile(0.001, dof) && sum < chi2_quantile(0.999, dof); }

TEST(SparseMap, IsConsistentWithTheModelItAssumes) {
  const Nees nees = monte_carlo(200, {.shared_m = 0.0});
  std::printf("NEES per dof: pose %.3f, relative pose %.3f, residuals %.3f\n", nees.pose / (3 * nees.runs),
              nees.between / (3 * nees.runs), nees.chi2 / nees.dof);
  EXPECT_TRUE(in_band(nees.pose, 3.0 * nees.runs)) << nees.pose / (3 * nees.runs);
  EXPECT_TRUE(in_band(nees.between, 3.0 * nees.runs)) << nees.between / (3 * nees.runs);
  EXPECT_NEAR(nees.chi2 / nees.dof, 1.0, 0.05);
  for (const double factor : {0.7, 1.5}) {  // covariances that are wrong would be noticed
    EXPECT_FALSE(in_band(nees.pose / factor, 3.0 * nees.runs));
    EXPECT_FALSE(in_band(nees.between / factor, 3.0 * nees.runs));
  }
}

}  // namespace
}  // namespace convoy
