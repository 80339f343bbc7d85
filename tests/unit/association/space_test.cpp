// Association in space, where worlds are wide and low, three pairs make an alignment, and rows make none.
#include <convoy/association/associate.hpp>
#include <convoy/geometry/groups.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>

namespace convoy {
namespace {

using Prior = std::optional<RelativePrior<SE3>>;

const Key anchor_a{{1, 1}, 3}, anchor_b{{2, 1}, 5};

SE3 turned_anyhow(test::Random& random, const SE3::Point& t_m) {
  return SE3::from_rotation(random.pose_of<SE3>(1.0).rotation(), t_m);
}

/// Two vehicles in one world, turned anyhow. Each sees what lies within 22 m. `height`: of the world, as a share.
struct Meeting {
  explicit Meeting(std::uint64_t seed, double height = 1.0, double apart_m = 12.0, test::BatchNoise noise = {0.12, 0.1})
      : random(seed) {
    test::PointsOf<SE3> world = test::scattered<SE3>(random, 150, 55.0, 2.0);
    for (auto& p : world) p.z() *= height;
    const SE3 T_w_a = turned_anyhow(random, {0.0, 0.0, 1.0}), T_w_b = turned_anyhow(random, {apart_m, 0.0, -1.0});
    test::PointsOf<SE3> seen_a, seen_b;
    std::vector<std::size_t> id_a, id_b;
    for (std::size_t k = 0; k < world.size(); ++k) {
      if ((T_w_a.inverse() * world[k]).norm() < 22.0) seen_a.push_back(world[k]), id_a.push_back(k);
      if ((T_w_b.inverse() * world[k]).norm() < 22.0) seen_b.push_back(world[k]), id_b.push_back(k);
    }
    a = test::frozen_batch(random, anchor_a, T_w_a, seen_a, noise, 40);
    b = test::frozen_batch(random, anchor_b, T_w_b, seen_b, noise, 70);
    T_a_b = T_w_a.inverse() * T_w_b;
    for (std::size_t i = 0; i < id_a.size(); ++i)
      for (std::size_t j = 0; j < id_b.size(); ++j)
        if (id_a[i] == id_b[j]) same.emplace(a.landmarks[i].key, b.landmarks[j].key);
  }

  Prior prior(double sigma_m = 22.0, double sigma_rad = 0.3) {
    SE3::Tangent sigma;
    sigma << sigma_m, sigma_m, sigma_m, sigma_rad, sigma_rad, sigma_rad;
    const SE3::Covariance P = sigma.cwiseAbs2().asDiagonal();
    return RelativePrior<SE3>{T_a_b * SE3::Exp(random.draw<6>(P)), P};
  }

  test::Random random;
  Batch<SE3> a, b;
  SE3 T_a_b;
  std::set<Pairing> same;
};

TEST(AssociateInSpace, AcceptsAnOverlapAndPairsOnlyWhatIsTheSame) {
  for (const double height : {1.0, 0.05})
    for (const bool known : {true, false}) {
      int accepted = 0, offered = 0;
      for (std::uint64_t seed = 1; seed <= 40; ++seed) {
        Meeting m(seed, height);
        if (m.same.size() < 8) continue;
        ++offered;
        const auto result = associate(m.a, m.b, known ? m.prior() : Prior{}, {});
        if (result.decision != Decision::accepted) continue;
        ++accepted;
        EXPECT_TRUE(std::all_of(result.pairings.begin(), result.pairings.end(), [&](const Pairing& p) {
          return m.same.count(p) != 0;
        })) << seed;
        EXPECT_LT((result.alignment.T_a_b.inverse() * m.T_a_b).Log().norm(), 1.0) << seed;
      }
      ASSERT_GE(offered, 25);
      EXPECT_GE(accepted, offered * 7 / 10) << accepted << " of " << offered << ", height " << height;
    }
}

TEST(AssociateInSpace, RefusesWhereThereIsNoOverlap) {
  int searched = 0;
  for (const double height : {1.0, 0.0})
    for (std::uint64_t seed = 1; seed <= 150; ++seed) {
      Meeting m(seed, height), other(10'000 + seed, height);  // b is of another world
      for (const Prior& prior : {Prior{}, m.prior()}) {
        const auto result = associate(m.a, other.b, prior, {});
        EXPECT_NE(result.decision, Decision::accepted) << seed << ", height " << height;
        searched += result.nodes > 0;
      }
    }
  EXPECT_GE(searched, 450);  // they had to be searched to be refused
}

TEST(AssociateInSpace, RefusesAMirroredWorld) {
  int compared = 0;
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    Meeting m(seed, 1.0, 0.0);
    const Eigen::Matrix3d mirror = Eigen::Vector3d(1.0, -1.0, 1.0).asDiagonal();
    for (auto& l : m.b.landmarks) {
      l.position = mirror * l.position;
      l.covariance = mirror * l.covariance * mirror;
      l.loading = mirror * l.loading;
    }
    const auto result = associate(m.a, m.b, Prior{}, {});
    EXPECT_NE(result.decision, Decision::accepted) << seed;
    compared += result.rejection == Rejection::geometry;
  }
  EXPECT_GE(compared, 20) << "distances alone fit a mirror image";
}

// The same places in a layer of 0.6 m instead of 12 m: a random landmark meets one of them far more often, which a ball
// that is mostly sky would not show.
TEST(AssociateInSpace, AFlatWorldIsADenseOne) {
  double log_ratio = 0.0;
  int compared = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    Meeting tall(seed, 1.0), flat(seed, 0.05);
    const auto in_tall = associate(tall.a, tall.b, Prior{}, {}), in_flat = associate(flat.a, flat.b, Prior{}, {});
    if (in_tall.decision != Decision::accepted || in_flat.decision != Decision::accepted) continue;
    if (in_tall.support != in_flat.support || tall.a.landmarks.size() != flat.a.landmarks.size()) continue;
    ++compared;
    log_ratio += std::log10(in_flat.expected_false_alarms / in_tall.expected_false_alarms);
  }
  ASSERT_GE(compared, 3);
  EXPECT_GT(log_ratio / compared, 4.0);
}

// Lamps at equal distances along a straight road: every shift fits, and so does every turn about the road.
TEST(AssociateInSpace, RefusesARow) {
  test::Random random(1);
  test::PointsOf<SE3> row;
  for (int k = 0; k < 12; ++k) row.emplace_back(4.0 * k + 0.7 * (k % 3), 5.0, 3.0);
  const auto a = test::frozen_batch(random, anchor_a, SE3(), row, {0.1, 0.05});
  const auto b = test::frozen_batch(random, anchor_b, turned_anyhow(random, {2.0, 1.0, 0.0}), row, {0.1, 0.05});
  const auto result = associate(a, b, Prior{}, {});
  EXPECT_NE(result.decision, Decision::accepted);
  EXPECT_EQ(result.rejection, Rejection::geometry);
}

TEST(CompatibilityGraph, CountsThreesThatGoTogether) {
  test::Random random(1);
  std::vector<IndexPairing> candidates;
  for (int k = 0; k < 90; ++k) candidates.emplace_back(k / 9, k % 9);
  std::set<std::pair<IndexPairing, IndexPairing>> edges;
  const CompatibilityGraph graph(candidates, [&](const IndexPairing& p, const IndexPairing& q) {
    const bool joined = random.uniform(0.0, 1.0) < 0.2;
    if (joined) edges.insert(std::minmax(p, q));
    return joined;
  });
  std::uint64_t threes = 0;
  for (std::size_t i = 0; i < 90; ++i)
    for (std::size_t j = i + 1; j < 90; ++j)
      for (std::size_t k = j + 1; k < 90; ++k)
        threes += graph.adjacent(i, j) && graph.adjacent(j, k) && graph.adjacent(i, k);
  EXPECT_GT(threes, 100U);
  EXPECT_EQ(graph.triangles(), threes);
  EXPECT_EQ(graph.edges(), edges.size());
}

}  // namespace
}  // namespace convoy
