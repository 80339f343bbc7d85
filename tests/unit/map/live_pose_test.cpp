#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/map/live_pose.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <algorithm>

namespace convoy {
namespace {

using test::each;

// Vehicle 2 a while after its last anchor; its SLAM remembers landmarks around it, drawn from the model that is stated.
template <class G>
struct Drive {
  explicit Drive(std::uint64_t seed, double sigma_own_m = 0.05)
      : fleet(test::street_fleet<G>(seed)), global(test::built(fleet.store())) {
    const Key last = test::key_of(2, 5);
    typename G::Tangent along = G::Tangent::Zero();
    along[0] = 15.0;
    const G motion = G::Exp(along);
    const typename G::Covariance Q = (15.0 * each<G>(4e-4, 4e-6)).asDiagonal();
    truth = fleet.truth.at(last) * motion;
    live.chain = last.chain;
    live.state = fleet.anchor(last).state;
    live.state.stamp_s += 7.5;
    live.state.abscissa_m += 15.0;
    live.state.pose = live.state.pose * motion * G::Exp(fleet.random().template draw<G::Dof>(Q)).inverse();
    live.state.drift += live.state.pose.adjoint() * Q * live.state.pose.adjoint().transpose();
    live.shared = each<G>(4e-4, 1e-6).asDiagonal();
    const G seen_from = truth * G::Exp(fleet.random().template draw<G::Dof>(live.shared));
    for (const auto& [key, point] : nearest()) {
      const typename G::PointCovariance S = sigma_own_m * sigma_own_m * G::PointCovariance::Identity();
      live.remembered.push_back({key.index, seen_from.inverse() * point + fleet.random().template draw<G::Dim>(S), S});
    }
  }

  // Of vehicle 2, in classes, each class once.
  std::vector<std::pair<Key, typename G::Point>> nearest() const {
    std::vector<std::pair<Key, typename G::Point>> near;
    std::set<int> classes;
    for (const auto& [key, point] : fleet.point_of)
      if (key.chain.vehicle == 2 && global.class_of.count(key) > 0 && classes.insert(global.class_of.at(key)).second)
        near.emplace_back(key, point);
    std::stable_sort(near.begin(), near.end(),
                     [&](const auto& a, const auto& b) { return distance(a.second) < distance(b.second); });
    near.resize(std::min<std::size_t>(near.size(), LivePose<G>::max_remembered));
    return near;
  }
  double distance(const typename G::Point& point) const { return (point - truth.translation()).norm(); }

  typename G::Tangent error(const Estimate<G>& estimate) const { return (truth.inverse() * estimate.mean).Log(); }
  // Of the position relative to vehicle 1, which is near: what the map as a whole is off by cancels.
  typename G::Point beside_the_other(const Estimate<G>& estimate) const {
    const Key other = test::key_of(1, 5);
    const G T = global.map->pose(other.chain, fleet.anchor(other).state)->mean;
    return (T.inverse() * estimate.mean).translation() - (fleet.truth.at(other).inverse() * truth).translation();
  }
  Estimate<G> by_map() const { return *global.map->pose(live.chain, live.state); }

  test::SampleFleetOf<G> fleet;
  GlobalMap<G> global;
  G truth;
  LivePose<G> live;
};

template <class G>
void expect_same(const Estimate<G>& a, const Estimate<G>& b) {
  EXPECT_TRUE((a.mean.inverse() * b.mean).Log().isZero(1e-12));
  EXPECT_EQ(a.covariance, b.covariance);
}

template <class G>
class LivePoseTest : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(LivePoseTest, Groups);

TYPED_TEST(LivePoseTest, IsConsistentAndBetterThanDeadReckoningFromTheLastAnchor) {
  using G = TypeParam;
  double nees = 0.0, squares = 0.0, squares_by_map = 0.0, smaller = 0.0;
  constexpr int runs = 60;
  for (int run = 0; run < runs; ++run) {
    Drive<G> drive(100 + static_cast<std::uint64_t>(run));
    ASSERT_EQ(drive.live.remembered.size(), LivePose<G>::max_remembered);
    const auto live = live_pose(drive.global, drive.live);
    ASSERT_TRUE(live);
    ASSERT_TRUE(is_covariance(live->covariance));
    nees += squared_mahalanobis(drive.error(*live), live->covariance) / (runs * G::Dof);
    squares += drive.beside_the_other(*live).squaredNorm() / runs;
    squares_by_map += drive.beside_the_other(drive.by_map()).squaredNorm() / runs;
    smaller += live->covariance.determinant() < drive.by_map().covariance.determinant();
  }
  std::printf("seeds 100..%d: ANEES %.2f, position RMSE beside vehicle 1 %.3f m, by the last anchor alone %.3f m\n",
              100 + runs - 1, nees, std::sqrt(squares), std::sqrt(squares_by_map));
  EXPECT_GT(nees, 0.6);
  EXPECT_LT(nees, chi2_quantile(0.999, runs * G::Dof) / (runs * G::Dof));
  EXPECT_LT(std::sqrt(squares), 0.8 * std::sqrt(squares_by_map));
  EXPECT_EQ(smaller, runs);
}

TYPED_TEST(LivePoseTest, LeavesOutALandmarkThatWasTakenForAnother) {
  using G = TypeParam;
  Drive<G> drive(1);
  auto without = drive.live, wrong = drive.live;
  without.remembered.erase(without.remembered.begin() + 3);
  wrong.remembered[3].position[0] += 5.0;
  expect_same(*live_pose(drive.global, wrong), *live_pose(drive.global, without));
}

TYPED_TEST(LivePoseTest, FallsBackToTheLastAnchor) {
  using G = TypeParam;
  Drive<G> drive(2);
  auto few = drive.live, scattered = drive.live, strange = drive.live, turned = drive.live;
  few.remembered.resize(G::Dim);
  expect_same(*live_pose(drive.global, few), drive.by_map());
  for (std::size_t i = 0; i < scattered.remembered.size(); ++i)
    scattered.remembered[i].position[static_cast<int>(i) % G::Dim] += 3.0 * (static_cast<double>(i) - 4.0);
  expect_same(*live_pose(drive.global, scattered), drive.by_map());
  for (auto& l : strange.remembered) l.index += 1'000'000;  // never heard of
  expect_same(*live_pose(drive.global, strange), drive.by_map());
  // All of them fit, and put the vehicle where neither the map's uncertainty nor the drift allows it to be.
  typename G::Tangent off = G::Tangent::Zero();
  off[0] = 20.0;
  for (auto& l : turned.remembered) l.position = G::Exp(off) * l.position;
  expect_same(*live_pose(drive.global, turned), drive.by_map());
}

TYPED_TEST(LivePoseTest, KnowsNothingOfAnUnknownChain) {
  Drive<TypeParam> drive(3);
  drive.live.chain = {99, 1};
  EXPECT_FALSE(live_pose(drive.global, drive.live));
}

TYPED_TEST(LivePoseTest, TheMapKnowsAPoseAndPointsTogether) {
  using G = TypeParam;
  Drive<G> drive(4);
  std::vector<int> classes;
  for (const auto& l : drive.live.remembered) classes.push_back(drive.global.class_of.at({drive.live.chain, l.index}));
  Map<G>& map = *drive.global.map;
  ChainState<G> between = drive.fleet.anchor(test::key_of(2, 2)).state;  // smoothed, then extrapolated
  const auto& next = drive.fleet.anchor(test::key_of(2, 3)).state;
  between.stamp_s = 0.5 * (between.stamp_s + next.stamp_s);
  between.pose = between.pose * G::Exp(0.5 * (between.pose.inverse() * next.pose).Log());
  between.drift = 0.5 * (between.drift + next.drift);
  for (const ChainState<G>& state : {between, drive.live.state}) {
    const auto around = map.surroundings(drive.live.chain, state, classes);
    ASSERT_TRUE(around);
    const Eigen::MatrixXd& P = around->covariance;
    ASSERT_EQ(P.rows(), G::Dof + G::Dim * static_cast<int>(classes.size()));
    EXPECT_TRUE(is_covariance(P));
    const auto pose = map.pose(drive.live.chain, state);
    EXPECT_LT((P.topLeftCorner(G::Dof, G::Dof) + around->motion - pose->covariance).norm(),
              1e-9 * pose->covariance.norm());
    for (std::size_t i = 0; i < classes.size(); ++i) {
      const auto point = map.class_point(classes[i]);
      const auto at = G::Dof + G::Dim * static_cast<Eigen::Index>(i);
      EXPECT_EQ(around->points[i], point.mean);
      EXPECT_LT((P.block(at, at, G::Dim, G::Dim) - point.covariance).norm(), 1e-9 * point.covariance.norm());
    }
  }
}

}  // namespace
}  // namespace convoy
