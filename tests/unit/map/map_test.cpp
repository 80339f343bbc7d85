#include <convoy/geometry/covariance.hpp>
#include <convoy/map/map.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>
#include <Eigen/Eigenvalues>

namespace convoy {
namespace {

/// a <= b as covariances.
bool not_larger(const SE2::Covariance& a, const SE2::Covariance& b) {
  const Eigen::SelfAdjointEigenSolver<SE2::Covariance> eigen(SE2::Covariance(b - a));
  return eigen.eigenvalues().minCoeff() >= -1e-9 * b.norm();
}

/// The state of vehicle 1 at this share of the way from one anchor to the next.
ChainState<SE2> between(const test::SampleFleet& fleet, const Key& first, double share) {
  const auto &a = fleet.anchor(first).state, &b = fleet.anchor({first.chain, first.index + 1}).state;
  ChainState<SE2> state;
  state.stamp_s = a.stamp_s + share * (b.stamp_s - a.stamp_s);
  state.abscissa_m = a.abscissa_m + share * (b.abscissa_m - a.abscissa_m);
  state.pose = a.pose * SE2::Exp(share * (a.pose.inverse() * b.pose).Log());
  state.drift = a.drift + share * (b.drift - a.drift);
  return state;
}

struct Solved {
  explicit Solved(std::uint64_t seed) : fleet(test::street_fleet(seed)), global(test::built(fleet.store())) {}
  Map<SE2>& map() { return *global.map; }
  test::SampleFleet fleet;
  GlobalMap<SE2> global;
};

TEST(Map, AtANodeIsTheNode) {
  Solved s(1);
  const auto& nodes = s.map().problem().nodes;
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    const auto estimate = s.map().pose(nodes[n].anchor.chain, nodes[n].slam);
    ASSERT_TRUE(estimate);
    EXPECT_LT((estimate->mean.inverse() * s.map().poses()[n]).Log().norm(), 1e-6) << n;
    EXPECT_TRUE(is_covariance(estimate->covariance));
  }
}

TEST(Map, ExtrapolatesTheLastNodeByTheMotionOfTheSlamAndItsDrift) {
  Solved s(2);
  const Key last = test::key_of(2, 5);
  const auto at = s.map().pose(last.chain, s.fleet.anchor(last).state);
  ChainState<SE2> now = s.fleet.anchor(last).state;
  now.stamp_s += 5.0;
  now.abscissa_m += 10.0;
  now.pose = now.pose * SE2(10.0, 1.0, 0.3);
  const SE2::Covariance Q = Eigen::Vector3d(4e-3, 4e-3, 4e-5).asDiagonal();
  now.drift += now.pose.adjoint() * Q * now.pose.adjoint().transpose();
  const auto live = s.map().pose(last.chain, now);
  ASSERT_TRUE(live);
  EXPECT_LT((live->mean.inverse() * (at->mean * SE2(10.0, 1.0, 0.3))).Log().norm(), 1e-9);
  const SE2::Adjoint Ad = SE2(10.0, 1.0, 0.3).inverse().adjoint();
  const SE2::Covariance expected = Ad * at->covariance * Ad.transpose() + Q;
  EXPECT_LT((live->covariance - expected).norm(), 1e-6 * expected.norm());
  EXPECT_GT(live->covariance.determinant(), at->covariance.determinant());
}

TEST(Map, BetweenTwoNodesIsSmoothedAndNeverWorseThanFromEitherSide) {
  Solved s(3);
  const Key first = test::key_of(2, 2);
  const auto a = s.fleet.anchor(first).state, b = s.fleet.anchor({first.chain, 3}).state;
  const auto pa = s.map().pose(first.chain, a), pb = s.map().pose(first.chain, b);
  for (const double share : {0.001, 0.1, 0.3, 0.5, 0.7, 0.9, 0.999}) {
    const auto state = between(s.fleet, first, share);
    const auto estimate = s.map().pose(first.chain, state);
    ASSERT_TRUE(estimate);
    EXPECT_TRUE(is_covariance(estimate->covariance));
    const auto forward = increment(a, state);
    const SE2::Adjoint F = forward.motion.inverse().adjoint();
    EXPECT_TRUE(not_larger(estimate->covariance, F * pa->covariance * F.transpose() + forward.covariance)) << share;
    const auto backward = increment(state, b);  // T = T_b (U Exp(e))^-1
    const SE2::Adjoint B = backward.motion.adjoint();
    const SE2::Covariance from_b = B * (pb->covariance + backward.covariance) * B.transpose();
    EXPECT_TRUE(not_larger(estimate->covariance, from_b)) << share;
  }
  // Continuous at both ends.
  const auto near_a = s.map().pose(first.chain, between(s.fleet, first, 1e-7)),
             near_b = s.map().pose(first.chain, between(s.fleet, first, 1 - 1e-7));
  EXPECT_LT((near_a->mean.inverse() * pa->mean).Log().norm(), 1e-3);
  EXPECT_LT((near_b->mean.inverse() * pb->mean).Log().norm(), 1e-3);
}

TEST(Map, BetweenTwoNodesIsWhatANodeThereWouldBe) {
  // The state as an anchor with a factor of no weight gives the same posterior.
  Solved s(4);
  const Key first = test::key_of(3, 2);
  const auto state = between(s.fleet, first, 0.4);
  const auto smoothed = s.map().pose(first.chain, state);
  Problem<SE2> problem = s.map().problem();
  std::size_t at = 0;
  while (problem.nodes[at].anchor != first) ++at;
  const int n = static_cast<int>(at) + 1;  // the index of the new node
  ASSERT_EQ(problem.nodes[at + 1].anchor.index, first.index + 1);
  problem.nodes.insert(
      problem.nodes.begin() + n,
      {Key{first.chain, 999}, state, problem.nodes[at].initial * (problem.nodes[at].slam.pose.inverse() * state.pose)});
  const auto shift = [&](int& node) { node += node >= n; };
  for (auto& f : problem.priors) shift(f.node);
  for (auto& f : problem.landmarks) shift(f.node);
  for (auto& span : problem.chains) {
    shift(span.first);
    if (span.end >= n) ++span.end;
  }
  for (std::size_t k = 0; k < problem.drifts.size(); ++k) {
    auto& f = problem.drifts[k];
    shift(f.a), shift(f.b);
    if (f.a != n - 1 || f.b != n + 1) continue;
    const auto one = increment(problem.nodes[at].slam, state), two = increment(state, problem.nodes[at + 2].slam);
    f = {n - 1, n, one.motion, one.covariance};
    problem.drifts.insert(problem.drifts.begin() + static_cast<std::ptrdiff_t>(k) + 1,
                          {n, n + 1, two.motion, two.covariance});
    ++k;
  }
  const auto map = SparseMap<SE2>().solve(problem);
  ASSERT_TRUE(map->report().converged);
  const auto as_node = map->pose(first.chain, state);
  const SE2::Tangent d = (as_node->mean.inverse() * smoothed->mean).Log();
  EXPECT_LT(d.norm(), 1e-2 * std::sqrt(as_node->covariance.trace()));  // interpolation is of first order
  EXPECT_LT((as_node->covariance - smoothed->covariance).norm(), 1e-3 * as_node->covariance.norm());
}

TEST(Map, JointCovarianceAgreesWithPose) {
  Solved s(5);
  const Key k2 = test::key_of(2, 2), k3 = test::key_of(3, 4);
  const std::vector<std::pair<ChainId, ChainState<SE2>>> places{{k2.chain, s.fleet.anchor(k2).state},
                                                                {k2.chain, between(s.fleet, k2, 0.5)},
                                                                {k3.chain, between(s.fleet, k3, 0.3)},
                                                                {k3.chain, s.fleet.anchor(test::key_of(3, 5)).state}};
  for (const auto& [chain_a, a] : places)
    for (const auto& [chain_b, b] : places) {
      const auto P = s.map().joint_covariance(chain_a, a, chain_b, b);
      ASSERT_TRUE(P);
      EXPECT_LT((P->topLeftCorner<3, 3>() - s.map().pose(chain_a, a)->covariance).norm(), 1e-9);
      EXPECT_LT((P->bottomRightCorner<3, 3>() - s.map().pose(chain_b, b)->covariance).norm(), 1e-9);
      EXPECT_LT((*P - P->transpose()).norm(), 1e-9 * P->norm());
      const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 6, 6>> eigen(*P);
      EXPECT_GT(eigen.eigenvalues().minCoeff(), -1e-9 * P->norm());
    }
  EXPECT_FALSE(s.map().joint_covariance({99, 1}, {}, k2.chain, {}));
  EXPECT_FALSE(s.map().joint_covariance(k2.chain, {}, {99, 1}, {}));
}

TEST(Map, KnowsNothingOfAnUnknownChain) {
  Solved s(1);
  EXPECT_FALSE(s.map().pose({99, 1}, {}));
  EXPECT_FALSE(s.map().aligned({99, 1}));
  EXPECT_FALSE(s.map().pose({1, test::epoch + 1}, {}));  // another epoch is another chain
}

TEST(Map, PlacesALandmarkByItsAnchor) {
  Solved s(6);
  const auto store = s.fleet.store();
  double squared = 0.0;
  int count = 0;
  for (const auto& [id, chain] : store.chains())
    for (const auto& [index, l] : chain.landmarks) {
      const auto estimate = s.map().landmark(store, l);
      ASSERT_TRUE(estimate);
      EXPECT_TRUE(is_covariance(estimate->covariance));
      squared += squared_mahalanobis(SE2::Point(estimate->mean - s.fleet.point_of.at(l.key)), estimate->covariance);
      ++count;
    }
  ASSERT_GT(count, 100);
  EXPECT_LT(squared / count, 6.0);  // 2, had they no errors in common
  LandmarkFact<SE2> stranger;
  stranger.key = {{99, 1}, 0};
  EXPECT_FALSE(s.map().landmark(store, stranger));
}

TEST(Map, DigestIsOfEveryPoseToTheBit) {
  Solved s(1), again(1);
  EXPECT_EQ(s.map().digest(), again.map().digest());
  const auto remade = [&](auto change) {
    auto poses = s.map().poses();
    std::vector<SE2::Point> points;
    for (std::size_t p = 0; p < s.map().problem().points.size(); ++p)
      points.push_back(s.map().class_point(static_cast<int>(p)).mean);
    change(poses, points);
    return Map<SE2>(std::make_shared<const Problem<SE2>>(s.map().problem()), {poses, points, {}}, {}, nullptr).digest();
  };
  EXPECT_EQ(remade([](auto&, auto&) {}), s.map().digest());
  const double next = std::nextafter(s.map().poses().back().translation().x(), 1e9);
  EXPECT_NE(remade([&](auto& poses, auto&) {
              poses.back() = SE2(next, poses.back().translation().y(), poses.back().theta());
            }),
            s.map().digest());
  EXPECT_NE(remade([&](auto&, auto& points) { points[0].y() = std::nextafter(points[0].y(), 1e9); }), s.map().digest());
}

}  // namespace
}  // namespace convoy
