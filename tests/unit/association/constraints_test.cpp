#include <convoy/association/constraints.hpp>
#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include "../random_world.hpp"
#include "../sample_facts.hpp"

#include <gtest/gtest.h>
#include <Eigen/Cholesky>

namespace convoy {
namespace {

test::Store two_chains(bool second_known = true) {
  test::Store store;
  for (const VehicleId v : {1U, 2U}) {
    auto prior = test::prior(v);
    if (v == 2 && !second_known) prior = {prior.key, false, SE2()};
    EXPECT_EQ(store.insert(prior), Insertion::inserted);
    for (std::uint32_t k = 0; k < 4; ++k) EXPECT_EQ(store.insert(test::anchor(v, k)), Insertion::inserted);
  }
  return store;
}

TEST(RelativePrior, BothDirectionsAreEachOthersInverse) {
  const auto store = two_chains();
  const auto inverse_of_each_other = [&](const Key& a, const Key& b) {
    const auto ab = relative_prior(store, a, b), ba = relative_prior(store, b, a);
    ASSERT_TRUE(ab && ba);
    EXPECT_LT((ab->mean * ba->mean).Log().norm(), 1e-12);
    // (T Exp(d))^-1 = T^-1 Exp(-Ad_T d)
    const SE2::Covariance turned = ab->mean.adjoint() * ab->covariance * ab->mean.adjoint().transpose();
    EXPECT_LT((turned - ba->covariance).norm(), 1e-9 * turned.norm());
  };
  inverse_of_each_other(test::key_of(1, 1), test::key_of(2, 3));
  inverse_of_each_other(test::key_of(1, 0), test::key_of(2, 0));
  inverse_of_each_other(test::key_of(1, 1), test::key_of(1, 3));
}

TEST(RelativePrior, WithinAChainIsTheDriftAloneAndBetweenChainsTheStaticBiasesToo) {
  const auto store = two_chains();
  const auto within = relative_prior(store, test::key_of(1, 1), test::key_of(1, 3));
  const auto drift = increment(test::anchor(1, 1).state, test::anchor(1, 3).state);
  EXPECT_EQ(within->covariance, drift.covariance);
  const auto starts = relative_prior(store, test::key_of(1, 0), test::key_of(2, 0));
  const SE2 expected = test::prior(1).mean.inverse() * test::prior(2).mean;
  EXPECT_LT((starts->mean.inverse() * expected).Log().norm(), 1e-12);
  const SE2::Adjoint Ad = expected.inverse().adjoint();
  const SE2::Covariance P = Ad * test::prior(1).covariance * Ad.transpose() + test::prior(2).covariance;
  EXPECT_LT((starts->covariance - P).norm(), 1e-9 * P.norm());
}

TEST(RelativePrior, IsTheSpreadOfTheErrors) {
  const auto store = two_chains();
  const Key a = test::key_of(1, 2), b = test::key_of(2, 3);
  const auto stated = relative_prior(store, a, b);
  const auto drift = [](const test::Anchor& x) { return increment({}, x.state); };
  const auto da = drift(test::anchor(1, 2)), db = drift(test::anchor(2, 3));
  test::Random random(1);
  double sum = 0.0;
  constexpr int runs = 2000;
  constexpr double small = 1e-3;  // first order
  for (int run = 0; run < runs; ++run) {
    const auto moved = [&](const SE2& T, const SE2::Covariance& P) { return T * SE2::Exp(small * random.draw<3>(P)); };
    const SE2 T_a = moved(moved(test::prior(1).mean, test::prior(1).covariance) * da.motion, da.covariance);
    const SE2 T_b = moved(moved(test::prior(2).mean, test::prior(2).covariance) * db.motion, db.covariance);
    sum +=
        squared_mahalanobis((stated->mean.inverse() * T_a.inverse() * T_b).Log(), stated->covariance) / (small * small);
  }
  EXPECT_GT(sum, chi2_quantile(0.001, 3.0 * runs));
  EXPECT_LT(sum, chi2_quantile(0.999, 3.0 * runs));
}

TEST(RelativePrior, OfAnUnknownStartIsNothingButWithinItsChain) {
  const auto store = two_chains(false);
  EXPECT_FALSE(relative_prior(store, test::key_of(1, 1), test::key_of(2, 1)));
  EXPECT_FALSE(relative_prior(store, test::key_of(2, 1), test::key_of(1, 1)));
  EXPECT_TRUE(relative_prior(store, test::key_of(2, 0), test::key_of(2, 3)));
}

TEST(Complete, WhenAnchorPriorAndEveryLandmarkAreThere) {
  auto anchor = test::anchor(1, 1);
  anchor.first_landmark = 4;
  anchor.landmark_count = 4;
  std::vector<test::Fact> facts{anchor, test::prior(1)};
  for (std::uint32_t i = 4; i < 8; ++i) facts.emplace_back(test::landmark(1, i));
  const Key key = anchor.key;
  for (std::size_t left_out = 0; left_out <= facts.size(); ++left_out) {
    test::Store store;
    for (std::size_t k = 0; k < facts.size(); ++k)
      if (k != left_out) {
        ASSERT_EQ(test::insert(store, facts[k]), Insertion::inserted);
      }
    EXPECT_EQ(complete(store, key), left_out == facts.size()) << "without fact " << left_out;
  }
  EXPECT_FALSE(complete(test::Store(), key));
}

TEST(Complete, ABatchOfNothingNeedsNoLandmarks) {
  test::Store store;
  store.insert(test::anchor(1, 1));
  store.insert(test::prior(1));
  EXPECT_TRUE(complete(store, test::key_of(1, 1)));
}

TEST(BatchOf, IsInIndexOrderWhateverCameFirst) {
  test::Store store;
  for (const std::uint32_t i : {6U, 4U, 7U, 5U, 9U}) store.insert(test::landmark(1, i));
  const auto batch = batch_of(store, test::key_of(1, 1));
  ASSERT_EQ(batch.landmarks.size(), 4U);
  for (std::uint32_t i = 0; i < 4; ++i) EXPECT_EQ(batch.landmarks[i].key.index, 4 + i);
}

TEST(IndividualCompatibility, DrawsTheLineOfEquation5) {
  RelativePrior<SE2> prior{SE2(10.0, -3.0, 0.7), SE2::Covariance::Zero()};
  prior.covariance.diagonal() << 4.0, 1.0, 0.0;
  prior.covariance(0, 1) = prior.covariance(1, 0) = 0.5;
  const IndividualCompatibility<SE2> compatible(prior, 0.95);
  LandmarkFact<SE2> i, j;
  j.position = {5.0, 2.0};
  i.covariance << 0.3, 0.1, 0.1, 0.2;
  j.covariance << 0.2, -0.05, -0.05, 0.4;
  const Eigen::Matrix2d R = prior.mean.rotation();
  const Eigen::Matrix2d C = i.covariance + R * (j.covariance + prior.covariance.topLeftCorner<2, 2>()) * R.transpose();
  const Eigen::Matrix2d L = C.llt().matrixL();
  for (int k = 0; k < 12; ++k) {
    const Eigen::Vector2d direction(std::cos(k), std::sin(k));
    const double threshold = std::sqrt(5.991464547);  // chi2(2, 0.95)
    i.position = prior.mean * j.position + L * (0.999 * threshold) * direction;
    EXPECT_TRUE(compatible(i, j)) << k;
    i.position = prior.mean * j.position + L * (1.001 * threshold) * direction;
    EXPECT_FALSE(compatible(i, j)) << k;
  }
}

TEST(IndividualCompatibility, AnUncertainHeadingMovesWhatIsFarAway) {
  RelativePrior<SE2> prior{SE2(), SE2::Covariance::Zero()};
  prior.covariance(2, 2) = 0.01;  // 0.1 rad
  const IndividualCompatibility<SE2> compatible(prior, 0.99);
  LandmarkFact<SE2> i, j;
  i.covariance = j.covariance = 0.01 * Eigen::Matrix2d::Identity();
  j.position = {50.0, 0.0};
  i.position = {50.0, 5.0};
  EXPECT_TRUE(compatible(i, j));
  i.position = {55.0, 0.0};
  EXPECT_FALSE(compatible(i, j));
  j.position = {2.0, 0.0};
  i.position = {2.0, 5.0};
  EXPECT_FALSE(compatible(i, j));
}

TEST(IndividualCompatibility, WithoutAPriorEverythingIs) {
  const IndividualCompatibility<SE2> compatible(std::nullopt, 0.99);
  LandmarkFact<SE2> i, j;
  i.position = {1e5, 1e5};
  EXPECT_TRUE(compatible(i, j));
}

TEST(DistanceTable, HoldsDistancesAndWhatTheJointCovarianceMakesOfThem) {
  test::Random random(2);
  const auto batch = test::frozen_batch(random, {}, SE2(), test::scattered(random, 6, 20.0), {0.1, 0.4});
  const DistanceTable table(batch);
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) {
      if (i == j) continue;
      const auto &p = batch.landmarks[static_cast<std::size_t>(i)], &q = batch.landmarks[static_cast<std::size_t>(j)];
      const Eigen::Matrix2d shared = p.loading * q.loading.transpose();  // Cov(p, q)
      const Eigen::Matrix2d difference = p.covariance + q.covariance - shared - shared.transpose();
      const Eigen::Vector2d n = (p.position - q.position).normalized();
      EXPECT_NEAR(table.distance(i, j), (p.position - q.position).norm(), 1e-12);
      EXPECT_NEAR(table.variance(i, j), n.dot(difference * n), 1e-12);
    }
}

TEST(DistanceCompatibility, AcceptsAsOftenAsItIsToldTo) {
  // Of true pairs, 99 % pass, with a shared error in the batch or without.
  for (const double shared_m : {0.0, 0.5}) {
    int passed = 0, asked = 0;
    for (std::uint64_t seed = 1; seed <= 1500; ++seed) {
      test::Random random(seed);
      const test::Points points{{random.uniform(-20, 20), random.uniform(-20, 20)}, {25.0, 25.0}};
      const auto a = test::frozen_batch(random, {}, SE2(), points, {0.1, shared_m});
      const auto b = test::frozen_batch(random, {}, random.pose(10.0), points, {0.2, shared_m});
      const DistanceTable table_a(a), table_b(b);
      ++asked;
      passed += DistanceCompatibility(table_a, table_b, {})(0, 0, 1, 1);
    }
    EXPECT_NEAR(static_cast<double>(passed) / asked, 0.99, 0.009) << shared_m;
  }
}

TEST(DistanceCompatibility, RefusesTheSameLandmarkTwiceOtherDistancesAndWhatIsTooClose) {
  test::Random random(1);
  const test::Points points{{0.0, 0.0}, {10.0, 0.0}, {10.2, 0.0}, {0.0, 20.0}};
  const auto a = test::frozen_batch(random, {}, SE2(), points, {0.05, 0.0, 0.0});
  const auto b = test::frozen_batch(random, {}, SE2(3.0, 1.0, 2.0), points, {0.05, 0.0, 0.0});
  const DistanceTable table_a(a), table_b(b);
  const DistanceCompatibility compatible(table_a, table_b, {});
  EXPECT_TRUE(compatible(0, 0, 1, 1));
  EXPECT_TRUE(compatible(0, 1, 1, 0));  // a distance has no direction
  EXPECT_FALSE(compatible(0, 0, 0, 1));
  EXPECT_FALSE(compatible(0, 0, 1, 0));
  EXPECT_FALSE(compatible(0, 0, 1, 3));
  EXPECT_FALSE(compatible(1, 1, 2, 2));  // 0.2 m apart
  EXPECT_NEAR(table_b.distance(0, 3), 20.0, 1e-9);
}

template <class G>
class HeadingIn : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(HeadingIn, Groups);

// Two views of the same points, the second turned by an error that the prior knows of.
TYPED_TEST(HeadingIn, KeepsWhatIsTurnedAsThePriorSaysAndRefusesAMirrorImage) {
  using G = TypeParam;
  constexpr int Rot = G::Dof - G::Dim;
  int kept = 0, mirrored_kept = 0, all = 0;
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    test::Random random(seed);
    const auto points = test::scattered<G>(random, 12, 15.0);
    typename G::Tangent sigma = G::Tangent::Constant(3.0);
    sigma.template tail<Rot>().setConstant(0.15);
    const G T_a_b = random.pose_of<G>(5.0);
    RelativePrior<G> prior{T_a_b * G::Exp(sigma.cwiseProduct(random.unit_normal<G::Dof>())),
                           sigma.cwiseAbs2().asDiagonal()};
    const Batch<G> a = test::frozen_batch(random, {{1, 1}, 1}, G(), points, {0.2, 0.1});
    const Batch<G> b = test::frozen_batch(random, {{2, 1}, 1}, T_a_b, points, {0.2, 0.1});
    Batch<G> mirrored = b;  // about where the prior looks
    for (auto& l : mirrored.landmarks) {
      typename G::Point p = prior.mean.rotation() * l.position;
      p.y() = -p.y();
      l.position = prior.mean.rotation().transpose() * p;
    }
    const DistanceTable table_a(a), table_b(b), table_mirrored(mirrored);
    const HeadingCompatibility<G> fits(a, b, table_a, table_b, prior, 0.9999);
    const HeadingCompatibility<G> mirror_fits(a, mirrored, table_a, table_mirrored, prior, 0.9999);
    for (int i = 0; i < 12; ++i)
      for (int j = i + 1; j < 12; ++j, ++all) {
        kept += fits(i, i, j, j) ? 1 : 0;
        mirrored_kept += mirror_fits(i, i, j, j) ? 1 : 0;
      }
  }
  EXPECT_GE(kept, all * 995 / 1000);
  EXPECT_LE(mirrored_kept, all / 2);
}

TEST(Heading, WithoutAPriorMayBeAny) {
  test::Random random(1);
  const auto points = test::scattered(random, 5, 15.0);
  const Batch<SE2> a = test::frozen_batch(random, {{1, 1}, 1}, SE2(), points, {0.2, 0.1});
  const Batch<SE2> b = test::frozen_batch(random, {{2, 1}, 1}, SE2(0.0, 0.0, 3.0), points, {0.2, 0.1});
  const DistanceTable table_a(a), table_b(b);
  const HeadingCompatibility<SE2> fits(a, b, table_a, table_b, {}, 0.9999);
  EXPECT_TRUE(fits(0, 0, 1, 1));
  EXPECT_TRUE(fits(0, 1, 1, 0));
}

template <class G>
class ScaleErrors : public testing::Test {};
TYPED_TEST_SUITE(ScaleErrors, Groups);

// Where everything is shared already, the sum has one component more than a loading holds.
TYPED_TEST(ScaleErrors, AreSharedAndNoLandmarkIsKnownBetterForThem) {
  using G = TypeParam;
  constexpr double sigma = 0.01;
  test::Random random(7);
  for (const double shared_m : {0.0, 0.05}) {
    std::vector<LandmarkFact<G>> landmarks(12);
    for (LandmarkFact<G>& l : landmarks) {
      l.position = 10.0 * random.template unit_normal<G::Dim>();
      for (Eigen::Index c = 0; c < l.loading.size(); ++c)
        l.loading.data()[c] = shared_m * random.template unit_normal<1>()[0];
      l.covariance = 0.01 * G::PointCovariance::Identity() + l.loading * l.loading.transpose();
    }
    std::vector<LandmarkFact<G>> scaled = landmarks;
    add_scale_error(scaled, sigma);
    double missing = 0.0, whole = 0.0;
    for (std::size_t i = 0; i < landmarks.size(); ++i) {
      const typename G::PointCovariance expected =
          landmarks[i].covariance + sigma * sigma * landmarks[i].position * landmarks[i].position.transpose();
      EXPECT_LT((scaled[i].covariance - expected).norm(), 1e-12);
      EXPECT_TRUE(is_covariance(scaled[i].own_covariance()));
      EXPECT_GT(eigenvalues(scaled[i].own_covariance()).minCoeff(), 0.0099) << "its own error has not gone";
      for (std::size_t j = 0; j < i; ++j) {
        const typename G::PointCovariance joint =
            landmarks[i].loading * landmarks[j].loading.transpose() +
            sigma * sigma * landmarks[i].position * landmarks[j].position.transpose();
        missing += (scaled[i].loading * scaled[j].loading.transpose() - joint).squaredNorm();
        whole += joint.squaredNorm();
      }
    }
    EXPECT_LT(missing, (shared_m == 0.0 ? 1e-9 : 0.05) * whole) << shared_m;
  }
}

TYPED_TEST(ScaleErrors, NoneIsNone) {
  using G = TypeParam;
  std::vector<LandmarkFact<G>> landmarks(3);
  for (LandmarkFact<G>& l : landmarks) l.position.setConstant(5.0);
  add_scale_error(landmarks, 0.0);
  for (const LandmarkFact<G>& l : landmarks) {
    EXPECT_TRUE(l.covariance.isZero(0.0));
    EXPECT_TRUE(l.loading.isZero(0.0));
  }
}

}  // namespace
}  // namespace convoy
