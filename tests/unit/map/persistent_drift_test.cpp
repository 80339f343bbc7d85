// Drift that is no random walk: constants of an odometer (F5) and bounded components (F6). Whether the result is
// consistent is measured by the consistency suite; here stands what must hold exactly.
#include <convoy/config_error.hpp>
#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/map/factors.hpp>
#include <convoy/map/global_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <cstdio>
#include <numeric>
#include <variant>
#include <vector>

namespace convoy {
namespace {

using test::chain_of;
using test::key_of;

template <class G>
class PersistentDrifts : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(PersistentDrifts, Groups);

template <class G>
DriftParams<G> with_constants(double scale = 0.02, double heading = 5e-4) {
  DriftParams<G> params;
  params.persistent.scale = scale;
  params.persistent.heading_rad_per_m = heading;
  return params;
}

/// A winding way in steps of 1 m as a SLAM says it that is off by (kappa, g) and by nothing else; `truth` beside it.
template <class G>
struct WindingWay {
  explicit WindingWay(const DriftParams<G>& params, double kappa = 0.0, double g = 0.0, int metres = 300) {
    DriftAccumulator<G> drift(params);
    G X, T;
    states.push_back({});
    truth.push_back(T);
    for (int s = 1; s <= metres; ++s) {
      typename G::Tangent step = G::Tangent::Zero(), c = G::Tangent::Zero();
      step[0] = 1.0;
      step[G::Dof - 1] = 0.03 * std::sin(0.05 * s);
      if (G::Dim == 3) step[3] = 0.02 * std::cos(0.1 * s);
      const G U = G::Exp(step);
      c.template head<G::Dim>() = kappa * (U.rotation().transpose() * U.translation());
      c[G::Dof - 1] = g;
      X = X * U;
      T = T * U * G::Exp(c);
      states.push_back(drift.advance(s, s, X, G::Covariance::Zero()));
      truth.push_back(T);
    }
  }
  std::vector<ChainState<G>> states;
  std::vector<G> truth;
};

TYPED_TEST(PersistentDrifts, TheEffectOfConstantsIsKnownBetweenAnyTwoStates) {
  using G = TypeParam;
  constexpr double kappa = 1e-5, g = 1e-7;  // so small that the effect is linear
  const WindingWay<G> scaled(with_constants<G>(), kappa, 0.0), turned(with_constants<G>(), 0.0, g);
  for (const auto& [a, b] : {std::pair{0, 300}, std::pair{40, 41}, std::pair{100, 260}}) {
    const auto effect = [&](const WindingWay<G>& way) -> typename G::Tangent {
      const auto i = static_cast<std::size_t>(a), j = static_cast<std::size_t>(b);
      return (increment(way.states[i], way.states[j]).motion.inverse() * way.truth[i].inverse() * way.truth[j]).Log();
    };
    const auto A =
        increment(scaled.states[static_cast<std::size_t>(a)], scaled.states[static_cast<std::size_t>(b)]).constants;
    EXPECT_LT((effect(scaled) / kappa - A.col(0)).norm(), 1e-2 * (1.0 + A.col(0).norm())) << a << ".." << b;
    EXPECT_LT((effect(turned) / g - A.col(1)).norm(), 1e-2 * (1.0 + A.col(1).norm())) << a << ".." << b;
  }
}

/// The drift factor between two states does not depend on what lies in between: a lost anchor costs nothing.
TYPED_TEST(PersistentDrifts, ComposesOverAnyStateInBetween) {
  using G = TypeParam;
  const WindingWay<G> way(with_constants<G>());
  const auto ac = increment(way.states[20], way.states[280]);
  const auto ab = increment(way.states[20], way.states[130]), bc = increment(way.states[130], way.states[280]);
  const Eigen::MatrixXd composed = bc.motion.inverse().adjoint() * ab.constants + bc.constants;
  EXPECT_LT((composed.col(1) - ac.constants.col(1)).norm(), 1e-9);
  // The scale moves the point where the second piece begins, and with it the piece as a whole.
  EXPECT_LT((composed.col(0) - ac.constants.col(0)).norm(), 1e-9);
}

TYPED_TEST(PersistentDrifts, DriftJacobiansAreTheNumericOnes) {
  using G = TypeParam;
  test::Random random(31);
  constexpr double h = 1e-5;
  for (int k = 0; k < 100; ++k) {
    const G T_a = random.template pose_of<G>(30.0), T_b = random.template pose_of<G>(30.0);
    DriftFactor<G> f{0, 1, T_a.inverse() * T_b * random.template pose_of<G>(1.0), {}, 0};
    f.A.setRandom();
    const Constants<G> c = 0.3 * Constants<G>::Random();
    const DriftResidual<G> one(f, T_a, T_b, c);
    for (int i = 0; i < G::Dof; ++i) {
      const typename G::Tangent e = h * G::Tangent::Unit(i);
      const auto by_a =
          ((DriftResidual<G>(f, T_a * G::Exp(e), T_b, c).r - DriftResidual<G>(f, T_a * G::Exp(-e), T_b, c).r) /
           (2.0 * h))
              .eval();
      const auto by_b =
          ((DriftResidual<G>(f, T_a, T_b * G::Exp(e), c).r - DriftResidual<G>(f, T_a, T_b * G::Exp(-e), c).r) /
           (2.0 * h))
              .eval();
      EXPECT_LT((one.J_a.col(i) - by_a).cwiseAbs().maxCoeff(), 1e-6);
      EXPECT_LT((one.J_b.col(i) - by_b).cwiseAbs().maxCoeff(), 1e-6);
    }
    for (int i = 0; i < c.size(); ++i) {
      const Constants<G> e = h * Constants<G>::Unit(i);
      const auto by_c =
          ((DriftResidual<G>(f, T_a, T_b, c + e).r - DriftResidual<G>(f, T_a, T_b, c - e).r) / (2.0 * h)).eval();
      EXPECT_LT((one.J_c.col(i) - by_c).cwiseAbs().maxCoeff(), 1e-6);
    }
  }
}

TEST(BoundedDrift, JacobiansAreTheNumericOnes) {
  test::Random random(32);
  constexpr double h = 1e-5;
  for (int k = 0; k < 100; ++k) {
    const SE3 T_a = random.pose_of<SE3>(30.0), T_b = random.pose_of<SE3>(30.0);
    BoundedFactor f;
    f.phi = 0.7;
    f.up_a = random.unit_normal<3>().normalized();
    f.up_b = random.unit_normal<3>().normalized();
    f.height_a = 3.0;
    f.height_b = -2.0;
    for (const SE3* before : {&T_a, static_cast<const SE3*>(nullptr)}) {
      const BoundedResidual one(f, before, T_b, 1.5);
      for (int i = 0; i < 6; ++i) {
        const SE3::Tangent e = h * SE3::Tangent::Unit(i);
        const Eigen::Vector3d by_b = (BoundedResidual(f, before, T_b * SE3::Exp(e), 1.5).r -
                                      BoundedResidual(f, before, T_b * SE3::Exp(-e), 1.5).r) /
                                     (2.0 * h);
        EXPECT_LT((one.J_b.col(i) - by_b).cwiseAbs().maxCoeff(), 1e-6);
        if (before == nullptr) continue;
        const SE3 ahead = T_a * SE3::Exp(e), behind = T_a * SE3::Exp(-e);
        const Eigen::Vector3d by_a =
            (BoundedResidual(f, &ahead, T_b, 1.5).r - BoundedResidual(f, &behind, T_b, 1.5).r) / (2.0 * h);
        EXPECT_LT((one.J_a.col(i) - by_a).cwiseAbs().maxCoeff(), 1e-6);
      }
      const Eigen::Vector3d by_h =
          (BoundedResidual(f, before, T_b, 1.5 + h).r - BoundedResidual(f, before, T_b, 1.5 - h).r) / (2.0 * h);
      EXPECT_LT((one.J_c - by_h).cwiseAbs().maxCoeff(), 1e-6);
    }
  }
}

// AR(1) over a piece is AR(1) over its halves: what a lost anchor would have said in between does not matter.
TEST(BoundedDrift, ProcessComposesOverAnyStateInBetween) {
  ChainSpan span;
  span.persistent = {0.0, 0.0, 0.01, 0.5, 40.0, Eigen::Vector3d::UnitZ()};
  ChainState<SE3> a, b, c;
  b.abscissa_m = 30.0;
  c.abscissa_m = 75.0;
  const auto ab = bounded_between(&a, b, span), bc = bounded_between(&b, c, span), ac = bounded_between(&a, c, span);
  EXPECT_NEAR(ab.phi * bc.phi, ac.phi, 1e-12);
  for (int k = 0; k < 3; ++k)
    EXPECT_NEAR(bc.phi * bc.phi / ab.information[k] + 1.0 / bc.information[k], 1.0 / ac.information[k], 1e-12);
}

// A vehicle with a wrong scale that knows where it began and is told where it ended learns its scale.
TYPED_TEST(PersistentDrifts, ConstantsAreLearntAndTheWholeWayIsCorrected) {
  using G = TypeParam;
  constexpr double kappa = 0.015, g = 4e-4;
  const DriftParams<G> params = with_constants<G>();
  const WindingWay<G> way(params, kappa, g);
  FactStore<G> store;
  ASSERT_EQ(store.insert(AnchorFact<G>{key_of(1, 0), {}}), Insertion::inserted);
  PriorFact<G> prior{key_of(1, 0), true, G()};
  prior.covariance = 1e-8 * G::Covariance::Identity();
  prior.persistent = params.persistent;
  ASSERT_EQ(store.insert(prior), Insertion::inserted);
  for (std::uint32_t k = 1; k <= 12; ++k)
    ASSERT_EQ(store.insert(AnchorFact<G>{key_of(1, k), way.states[25 * k]}), Insertion::inserted);
  for (std::uint32_t k = 0; k < 4; ++k) {  // fixes along the way, as exact as a surveyor's
    AbsoluteFixFact<G> fix{key_of(1, k), 3 * k + 3, way.states[25 * (3 * k + 3)]};
    fix.position = way.truth[25 * (3 * k + 3)].translation();
    fix.covariance = 1e-4 * G::PointCovariance::Identity();
    ASSERT_EQ(store.insert(fix), Insertion::inserted);
  }
  SelectionParams selection;
  selection.common_frame_is_enu = true;
  selection.fix_correlation_s = 0.0;
  const auto global = test::built(store, selection);
  ASSERT_TRUE(global.map->report().converged);
  const auto learnt = global.map->constants(chain_of(1));
  ASSERT_TRUE(learnt.has_value());
  EXPECT_NEAR(learnt->mean[0], kappa, 4.0 * learnt->sigma[0]);
  EXPECT_NEAR(learnt->mean[1], g, 4.0 * learnt->sigma[1]);
  EXPECT_LT(learnt->sigma[0], 0.003);
  EXPECT_LT(learnt->sigma[1], 1.5e-4);
  // Between the fixes the corrected way is the true one, to their accuracy; without the constants it is metres off.
  const auto worst_of = [&](const GlobalMap<G>& map) {
    double worst = 0.0;
    for (std::size_t s = 0; s < way.states.size(); s += 10)
      worst = std::max(
          worst, (map.map->pose(chain_of(1), way.states[s])->mean.translation() - way.truth[s].translation()).norm());
    return worst;
  };
  EXPECT_LT(worst_of(global), 0.25);
  // One more anchor without anything to it, which is no node, and a lost one change nothing.
  FactStore<G> thinned;
  for (const auto& [k, a] : store.chains().at(chain_of(1)).anchors)
    if (k % 3 == 0) thinned.insert(a);
  thinned.insert(prior);
  for (const auto& [k, f] : store.chains().at(chain_of(1)).absolute_fixes) thinned.insert(f);
  EXPECT_EQ(test::built(thinned, selection).map->digest(), global.map->digest());
  FactStore<G> untold;
  for (const auto& [k, a] : store.chains().at(chain_of(1)).anchors) untold.insert(a);
  prior.persistent = {};
  untold.insert(prior);
  for (const auto& [k, f] : store.chains().at(chain_of(1)).absolute_fixes) untold.insert(f);
  const auto without = test::built(untold, selection);
  EXPECT_FALSE(without.map->constants(chain_of(1)).has_value());
  EXPECT_GT(worst_of(without), worst_of(global));
}

/// Vehicles on one street. The second measures the world by an odometer that is off by kappa: all lengths that it
/// states are too short by that, those of its landmarks, too. `stated`: what it says of that.
template <class G>
class ScaledStreet {
 public:
  static constexpr double kappa = 0.04;

  ScaledStreet(std::uint64_t seed, const PersistentDrift& stated) : fleet_(test::street_fleet<G>(seed)) {
    for (AnyFact<G> fact : fleet_.facts) {
      if (auto* anchor = std::get_if<AnchorFact<G>>(&fact); anchor != nullptr && anchor->key.chain == chain_of(2)) {
        G& X = anchor->state.pose;
        X = G::from_rotation(X.rotation(), X.translation() / (1.0 + kappa));
        anchor->state.abscissa_m /= 1.0 + kappa;
      }
      if (auto* landmark = std::get_if<LandmarkFact<G>>(&fact);
          landmark != nullptr && landmark->key.chain == chain_of(2))
        landmark->position /= 1.0 + kappa;
      if (auto* prior = std::get_if<PriorFact<G>>(&fact); prior != nullptr && prior->key.chain == chain_of(2))
        prior->persistent = stated;
      test::insert(store, fact);
    }
  }

  /// Squared Mahalanobis distances of the landmarks of vehicle 2 from where they are, by its map.
  std::vector<double> squared_errors(const GlobalMap<G>& map) const {
    std::vector<double> all;
    for (const auto& [index, landmark] : store.chains().at(chain_of(2)).landmarks) {
      const auto estimate = map.map->landmark(store, landmark);
      all.push_back(squared_mahalanobis(estimate->mean - fleet_.point_of.at(landmark.key), estimate->covariance));
    }
    return all;
  }

  FactStore<G> store;

 private:
  test::SampleFleetOf<G> fleet_;
};

double mean_of(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

TYPED_TEST(PersistentDrifts, TheScaleOfLandmarksIsLearntAndTheyAreCorrected) {
  using G = TypeParam;
  PersistentDrift told;
  told.scale = 0.05;
  told.scales_landmarks = true;
  PersistentDrift of_the_way_alone = told;
  of_the_way_alone.scales_landmarks = false;
  double told_nees = 0.0, half_told_nees = 0.0;
  constexpr int runs = 5;
  for (int seed = 1; seed <= runs; ++seed) {
    const ScaledStreet<G> street(static_cast<std::uint64_t>(seed), told);
    const auto map = test::built(street.store);
    ASSERT_TRUE(map.map->report().converged);
    ASSERT_TRUE(map.map->aligned(chain_of(2))) << seed;
    const auto learnt = map.map->constants(chain_of(2));
    ASSERT_TRUE(learnt.has_value());
    EXPECT_NEAR(learnt->mean[0], street.kappa, 4.0 * learnt->sigma[0]) << seed;
    EXPECT_LT(learnt->sigma[0], 0.005) << seed;
    EXPECT_EQ(map.map->landmark_scale(chain_of(2)), 1.0 + learnt->mean[0]);
    EXPECT_EQ(map.map->landmark_scale(chain_of(1)), 1.0) << "it says nothing of a scale";
    told_nees += mean_of(street.squared_errors(map)) / G::Dim / runs;
    const ScaledStreet<G> silent(static_cast<std::uint64_t>(seed), of_the_way_alone);
    half_told_nees += mean_of(silent.squared_errors(test::built(silent.store))) / G::Dim / runs;
  }
  std::printf("NEES of landmarks: %.2f; if they are not said to be scaled %.2f\n", told_nees, half_told_nees);
  EXPECT_LT(told_nees, 1.3);
  EXPECT_GT(half_told_nees, 1.5 * told_nees);
}

// Nobody knows how large the world is: a smaller one must not seem to fit better.
TYPED_TEST(PersistentDrifts, AWorldMeasuredByOdometersAloneDoesNotShrink) {
  using G = TypeParam;
  constexpr int runs = 10;
  double mean = 0.0;
  for (int seed = 1; seed <= runs; ++seed) {
    FactStore<G> store;
    for (AnyFact<G> fact : test::street_fleet<G>(static_cast<std::uint64_t>(seed)).facts) {
      if (auto* prior = std::get_if<PriorFact<G>>(&fact)) {
        prior->persistent.scale = 0.05;
        prior->persistent.scales_landmarks = true;
      }
      test::insert(store, fact);
    }
    const auto map = test::built(store);
    for (const VehicleId v : {1U, 2U, 3U}) {
      ASSERT_TRUE(map.map->aligned(chain_of(v)));
      mean += map.map->landmark_scale(chain_of(v)) / (3.0 * runs);
    }
  }
  std::printf("mean scale: %.4f\n", mean);
  EXPECT_NEAR(mean, 1.0, 0.015);  // F1 has its noise in true lengths, and shrinks by .5 %
}

TYPED_TEST(PersistentDrifts, UnfitOnesAreRefused) {
  using G = TypeParam;
  const auto with = [](const auto& change) {
    PriorFact<G> prior{key_of(1, 0), false, G()};
    change(prior.persistent);
    return FactStore<G>().check(prior);
  };
  EXPECT_EQ(with([](PersistentDrift& p) { p.scale = 0.01; }), Insertion::inserted);
  EXPECT_EQ(with([](PersistentDrift& p) { p.scales_landmarks = true; }), Insertion::malformed) << "by no scale";
  EXPECT_EQ(with([](PersistentDrift& p) { p.scale = NAN; }), Insertion::not_finite);
  EXPECT_EQ(with([](PersistentDrift& p) { p.scale = -0.01; }), Insertion::out_of_range);
  EXPECT_EQ(with([](PersistentDrift& p) { p.heading_rad_per_m = 2.0; }), Insertion::out_of_range);
  EXPECT_EQ(with([](PersistentDrift& p) { p.tilt_rad = 0.01; }), Insertion::malformed) << "no direction, no length";
  EXPECT_EQ(with([](PersistentDrift& p) { p.correlation_m = 10.0; }), Insertion::malformed) << "of nothing";
  EXPECT_EQ(with([](PersistentDrift& p) { p = {0.0, 0.0, 0.01, 0.0, 10.0, {0.0, 0.0, 2.0}}; }), Insertion::malformed);
  EXPECT_EQ(with([](PersistentDrift& p) {
              p = {0.0, 0.0, 0.01, 0.0, 10.0, {0.0, 0.0, 1.0}};
            }),
            G::Dim == 3 ? Insertion::inserted : Insertion::malformed);
  EXPECT_THROW(validate(with_constants<G>(-1.0)), ConfigError);
  DriftParams<G> literal = with_constants<G>();
  literal.model = DriftModel::literal;
  EXPECT_THROW(validate(literal), ConfigError);
}

}  // namespace
}  // namespace convoy
