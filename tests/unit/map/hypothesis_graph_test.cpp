// T4 and T5 (DESIGN B5): hypotheses against all the rest.
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/map/factors.hpp>
#include <convoy/map/hypothesis_graph.hpp>
#include <convoy/map/sparse_map.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>

namespace convoy {
namespace {

template <class G>
class HypothesisGraphs : public testing::Test {
 protected:
  explicit HypothesisGraphs()
      : fleet(test::street_fleet<G>(41)), store(fleet.store()), selection(select(store, SelectionParams{})) {
    map = SparseMap<G>().solve(build_problem<G>(store, selection));
  }
  std::size_t accepted() const {
    return static_cast<std::size_t>(std::count_if(selection.hypotheses.begin(), selection.hypotheses.end(),
                                                  [](const auto& h) { return h.state == HypothesisState::accepted; }));
  }
  /// Says of a hypothesis that its batches lie elsewhere.
  static void shift(Hypothesis<G>& h, double metres) {
    typename G::Tangent d = G::Tangent::Zero();
    d[1] = metres;
    h.alignment.T_a_b = h.alignment.T_a_b * G::Exp(d);
  }

  test::SampleFleetOf<G> fleet;
  FactStore<G> store;
  Selection<G> selection;
  std::unique_ptr<Map<G>> map;
};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(HypothesisGraphs, Groups);

// Against the long way: a map of the others, and how far it is from what the one says.
TYPED_TEST(HypothesisGraphs, LeavingOneOutIsAMapWithoutIt) {
  using G = TypeParam;
  const auto contradictions = HypothesisGraph<G>(*this->map, this->selection).leave_one_out();
  ASSERT_EQ(contradictions.size(), this->selection.hypotheses.size());
  int judged = 0;
  for (std::size_t k = 0; k < contradictions.size(); ++k) {
    Hypothesis<G>& h = this->selection.hypotheses[k];
    if (h.state != HypothesisState::accepted) continue;
    // The others, as factors between the nodes of the map.
    Problem<G> problem = this->map->problem();
    problem.points.clear();
    problem.landmarks.clear();
    for (std::size_t n = 0; n < problem.nodes.size(); ++n) problem.nodes[n].initial = this->map->poses()[n];
    const auto node_of = [&](const Key& anchor) {
      const auto it =
          std::find_if(problem.nodes.begin(), problem.nodes.end(), [&](const auto& n) { return n.anchor == anchor; });
      return static_cast<int>(it - problem.nodes.begin());
    };
    for (const Hypothesis<G>& other : this->selection.hypotheses)
      if (other.state == HypothesisState::accepted && other.id != h.id)
        problem.drifts.push_back(
            {node_of(other.batch_a), node_of(other.batch_b), other.alignment.T_a_b, other.alignment.covariance()});
    const auto without = SparseMap<G>().solve(problem);
    const auto& nodes = without->problem().nodes;
    const int a = node_of(h.batch_a), b = node_of(h.batch_b);
    const auto& node_a = nodes[static_cast<std::size_t>(a)];
    const auto& node_b = nodes[static_cast<std::size_t>(b)];
    const auto P = *without->joint_covariance(node_a.anchor.chain, node_a.slam, node_b.anchor.chain, node_b.slam);
    const DriftResidual<G> one({a, b, h.alignment.T_a_b, h.alignment.covariance()},
                               without->poses()[static_cast<std::size_t>(a)],
                               without->poses()[static_cast<std::size_t>(b)]);
    Eigen::Matrix<double, G::Dof, 2 * G::Dof> J;
    J << one.J_a, one.J_b;
    const double expected = squared_mahalanobis(
        one.r, symmetrised(typename G::Covariance(J * P * J.transpose() + h.alignment.covariance())));
    EXPECT_EQ(contradictions[k].second, G::Dof);
    EXPECT_NEAR(contradictions[k].first, expected, 0.02 * (1.0 + expected));  // of first order
    ++judged;
  }
  EXPECT_GT(judged, 8);
}

TYPED_TEST(HypothesisGraphs, TrueOnesContradictNothing) {
  using G = TypeParam;
  const HypothesisGraph<G> graph(*this->map, this->selection);
  for (const auto& [chi2, dof] : graph.leave_one_out()) {
    EXPECT_LT(chi2, chi2_quantile(0.9999, G::Dof));
  }
  EXPECT_TRUE(graph.outliers(0.9999).empty());
}

// Several that lie alike between the same two vehicles: no one of them stands out, all of them go together.
TYPED_TEST(HypothesisGraphs, ARobustEstimateDoesWithoutAllThatLie) {
  using G = TypeParam;
  std::set<Hash> lies;
  for (Hypothesis<G>& h : this->selection.hypotheses) {
    const bool between = h.batch_a.chain.vehicle == 1 && h.batch_b.chain.vehicle == 3;
    if (h.state != HypothesisState::accepted || !between || lies.size() == 3) continue;
    this->shift(h, 4.0);
    lies.insert(h.id);
  }
  ASSERT_GE(lies.size(), 2U);
  ASSERT_GT(this->accepted(), 3 * lies.size());
  const HypothesisGraph<G> graph(*this->map, this->selection);
  const auto contradictions = graph.leave_one_out();
  const auto worst = std::max_element(contradictions.begin(), contradictions.end());
  EXPECT_GT(worst->first, chi2_quantile(0.9999, G::Dof));
  EXPECT_EQ(graph.outliers(0.9999), lies);
}

TYPED_TEST(HypothesisGraphs, OfNothingIsEmpty) {
  using G = TypeParam;
  const auto empty = SparseMap<G>().solve(Problem<G>{});
  const HypothesisGraph<G> graph(*empty, Selection<G>{});
  EXPECT_TRUE(graph.leave_one_out().empty());
  EXPECT_TRUE(graph.outliers(0.99).empty());
}

// ---- graphs of next to nothing ----

/// Pairs of vehicles without error, each with a start that nobody knows, that meet twice in one place each time. Every
/// vehicle ends where it began.
template <class G>
class SmallGraphs : public testing::Test {
 protected:
  SmallGraphs() : fleet(5, 0.0) {
    for (const VehicleId v : {1U, 2U, 3U, 4U}) {
      fleet.start(v, test::on_the_street<G>(0.0, 3.0 * v, 0.3));
      for (const double x_m : {0.0, 15.0, 1.0}) fleet.stop(v, test::on_the_street<G>(x_m, 3.0 * v, 0.2 * x_m));
    }
  }
  Hash meet(VehicleId v, std::uint32_t k, VehicleId w, std::uint32_t m) {
    return fleet.associate(w, fleet.common(test::key_of(v, k), test::key_of(w, m), 8));
  }
  /// As the map of what was stated, but of those named says that their batches lie elsewhere, `metres` to the left.
  std::set<Hash> outliers(const std::map<Hash, double>& lies = {}) {
    const FactStore<G> store = fleet.store();
    Selection<G> selection = select(store, test::unconfirmed_too);
    map = SparseMap<G>().solve(build_problem<G>(store, selection));
    for (Hypothesis<G>& h : selection.hypotheses) {
      EXPECT_EQ(h.state, HypothesisState::accepted);
      h.alignment.P = test::each<G>(1e-2, 1e-4).asDiagonal();  // all alike
      if (const auto lie = lies.find(h.id); lie != lies.end())
        h.alignment.T_a_b = G::Exp(lie->second * test::each<G>(1.0, 0.0)) * h.alignment.T_a_b;
    }
    const HypothesisGraph<G> graph(*map, selection);
    left_out = graph.leave_one_out();
    return graph.outliers(0.9999);
  }

  test::SampleFleetOf<G> fleet;
  std::unique_ptr<Map<G>> map;
  std::vector<std::pair<double, int>> left_out;
};
TYPED_TEST_SUITE(SmallGraphs, Groups);

TYPED_TEST(SmallGraphs, WithoutHypothesesThereIsNothingToLeaveOut) {
  EXPECT_TRUE(this->outliers().empty());
  EXPECT_TRUE(this->left_out.empty());
  ASSERT_FALSE(this->map->poses().empty());
}

// Whatever it says: there is nothing else that ties its chains.
TYPED_TEST(SmallGraphs, TheOnlyOneContradictsNothing) {
  const Hash only = this->meet(1, 1, 2, 1);
  EXPECT_TRUE(this->outliers({{only, 50.0}}).empty());
  ASSERT_EQ(this->left_out.size(), 1U);
  EXPECT_EQ(this->left_out[0].second, 0);
}

// One of them is wrong, and nothing says which.
TYPED_TEST(SmallGraphs, OfTwoThatContradictEachOtherEquallyNeitherStays) {
  const Hash one = this->meet(1, 1, 2, 1), other = this->meet(1, 3, 2, 3);
  ASSERT_TRUE(this->outliers().empty());
  EXPECT_EQ(this->left_out[0].second, TypeParam::Dof);
  for (const Hash liar : {one, other}) EXPECT_EQ(this->outliers({{liar, 20.0}}), (std::set{one, other}));
}

TYPED_TEST(SmallGraphs, AThirdTellsWhichOfTwoIsWrong) {
  const Hash liar = this->meet(1, 1, 2, 1);
  this->meet(1, 3, 2, 3);
  this->meet(1, 1, 2, 3);
  EXPECT_EQ(this->outliers({{liar, 20.0}}), std::set{liar});
}

// Those that nothing connects have no say in each other.
TYPED_TEST(SmallGraphs, ChainsThatNothingConnectsAreJudgedByThemselves) {
  const Hash liar = this->meet(1, 1, 2, 1), victim = this->meet(1, 3, 2, 3);
  this->meet(3, 1, 4, 1);
  this->meet(3, 3, 4, 3);
  EXPECT_EQ(this->outliers({{liar, 20.0}}), (std::set{liar, victim}));
}

// The first two go at once, and vehicle 2 hangs on nothing while the others are weighed. Where it starts then, the one
// that does not lie fits: it may come back.
TYPED_TEST(SmallGraphs, AChainThatHangsOnNothingOnTheWaySpoilsNoOther) {
  const Hash liar = this->meet(1, 1, 2, 1), victim = this->meet(1, 3, 2, 3);
  const Hash slight = this->meet(3, 1, 4, 3);
  this->meet(3, 1, 4, 1);
  this->meet(3, 3, 4, 3);
  auto outliers = this->outliers({{liar, 200.0}, {slight, 3.0}});
  outliers.erase(victim);
  EXPECT_EQ(outliers, (std::set{liar, slight}));
}

// A place that a vehicle comes back to: its own drift tells.
TYPED_TEST(SmallGraphs, WithinOneChainTheDriftIsTheJudge) {
  const Hash loop = this->meet(1, 1, 1, 3);
  EXPECT_TRUE(this->outliers().empty());
  EXPECT_EQ(this->left_out[0].second, TypeParam::Dof);
  EXPECT_EQ(this->outliers({{loop, 20.0}}), std::set{loop});
}

}  // namespace
}  // namespace convoy
