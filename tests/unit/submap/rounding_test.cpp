#include <convoy/frontend/front_end.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/submap/fact_store.hpp>
#include <convoy/submap/rounding.hpp>

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

namespace convoy {
namespace {

template <class G>
class Rounding : public ::testing::Test {
 protected:
  using Landmark = LandmarkFact<G>;
  using Block = typename G::PointCovariance;
  static constexpr int dim = G::Dim;

  double normal() { return std::normal_distribution<double>()(engine_); }
  Eigen::MatrixXd normal(Eigen::Index rows, Eigen::Index columns) {
    return Eigen::MatrixXd::NullaryExpr(rows, columns, [this] { return normal(); });
  }

  /// A batch as a front end states it: errors of `own_m` of each landmark's own, and of `shared_m` of all together.
  std::vector<Landmark> batch(std::uint32_t n, double own_m, double shared_m) {
    const Eigen::MatrixXd A = shared_m * normal(dim * n, 9);
    const Eigen::MatrixXd joint = A * A.transpose() + own_m * own_m * Eigen::MatrixXd::Identity(dim * n, dim * n);
    const auto loadings = shared_loadings<G>(joint);
    std::vector<Landmark> facts(n);
    for (std::uint32_t i = 0; i < n; ++i) {
      facts[i].key = {{1, 1}, i};
      facts[i].position = 40.0 * normal(dim, 1);
      facts[i].covariance = symmetrised(Block(joint.block(dim * i, dim * i, dim, dim)));
      facts[i].loading = loadings[i];
    }
    return facts;
  }

  std::mt19937_64 engine_{20240718};
};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(Rounding, Groups);

template <class G>
typename G::PointCovariance of_difference(const LandmarkFact<G>& i, const LandmarkFact<G>& j) {
  const typename G::Loading apart = i.loading - j.loading;
  return i.own_covariance() + j.own_covariance() + apart * apart.transpose();
}

/// The largest and the least by which a covariance has become larger in any direction.
template <class Matrix>
std::pair<double, double> growth(const Matrix& from, const Matrix& to) {
  const Eigen::GeneralizedSelfAdjointEigenSolver<Matrix> eigen(to, from);
  return {eigen.eigenvalues().minCoeff(), eigen.eigenvalues().maxCoeff()};
}

TYPED_TEST(Rounding, IsDoneOnce) {
  for (const double shared_m : {1e-6, 0.01, 0.3, 20.0}) {
    for (const auto& fact : this->batch(20, 0.05, shared_m)) {
      EXPECT_FALSE(is_rounded(fact));
      const auto once = rounded(fact);
      EXPECT_TRUE(is_rounded(once));
      EXPECT_EQ(hash_of(rounded(once)), hash_of(once));
      EXPECT_EQ(once.covariance, once.covariance.transpose());
    }
  }
}

TYPED_TEST(Rounding, LoadingsAreOffByOnePartIn127OfTheirColumnAtMost) {
  for (const double shared_m : {1e-9, 0.3, 1e6}) {
    for (const auto& fact : this->batch(20, 0.05, shared_m)) {
      const auto once = rounded(fact);
      for (Eigen::Index k = 0; k < fact.loading.cols(); ++k) {
        const double largest = fact.loading.col(k).cwiseAbs().maxCoeff();
        EXPECT_LE((once.loading.col(k) - fact.loading.col(k)).cwiseAbs().maxCoeff(),
                  std::max(largest / 127.0, fact.loading.cwiseAbs().maxCoeff() / 4e6));
      }
      EXPECT_LE((once.position - fact.position).cwiseAbs().maxCoeff(), 1e-7 * fact.position.cwiseAbs().maxCoeff());
    }
  }
}

TYPED_TEST(Rounding, ABlockLoadingComesBackInTheSameForm) {
  for (int round = 0; round < 1000; ++round) {
    BlockLoading<TypeParam> block;
    block.exponent = static_cast<std::uint8_t>(this->engine_() % 128);
    for (std::size_t k = 0; k < block.columns; ++k) {
      if (k > 0) block.shift[k] = static_cast<std::uint8_t>(this->engine_() % (std::min(15, int{block.exponent}) + 1));
      for (std::size_t r = 0; r < block.rows; ++r)
        block.mantissa[block.rows * k + r] = static_cast<std::int8_t>(static_cast<int>(this->engine_() % 255) - 127);
      block.mantissa[block.rows * k] = static_cast<std::int8_t>(64 + this->engine_() % 64);
    }
    const auto again = block_loading<TypeParam>(loading_of(block));
    ASSERT_TRUE(again);
    EXPECT_EQ(*again, block);
  }
  EXPECT_EQ(block_loading<TypeParam>(TypeParam::Loading::Zero()), BlockLoading<TypeParam>());
}

TYPED_TEST(Rounding, TheOwnPartDoesNotShrinkHoweverSmallItIs) {
  using Covariance = typename TypeParam::PointCovariance;
  FactStore<TypeParam> store;
  for (const double shared_m : {0.0, 1e-3, 0.3, 20.0}) {
    for (const double own_m : {0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1}) {
      for (auto fact : this->batch(12, own_m, shared_m)) {
        const Covariance own = fact.own_covariance();
        const auto once = rounded(fact);
        EXPECT_EQ(store.check(once), Insertion::inserted) << shared_m << ' ' << own_m;
        const double slack = 1e-14 * fact.covariance.cwiseAbs().maxCoeff();  // of the sums in double precision
        EXPECT_GE(eigenvalues(Covariance(once.own_covariance() - own)).minCoeff(), -slack) << shared_m << ' ' << own_m;
        EXPECT_GE(eigenvalues(once.own_covariance()).minCoeff(), -slack);
        EXPECT_LE((once.covariance - fact.covariance).cwiseAbs().maxCoeff(),
                  0.05 * fact.covariance.cwiseAbs().maxCoeff() + 1e-30);
      }
    }
  }
}

// Known exactly but for what is shared, or in one direction alone.
TYPED_TEST(Rounding, ASingularOwnPartStaysACovariance) {
  using Covariance = typename TypeParam::PointCovariance;
  FactStore<TypeParam> store;
  for (int round = 0; round < 2000; ++round) {
    LandmarkFact<TypeParam> fact;
    fact.key = {{1, 1}, 0};
    const double scale = std::pow(10.0, static_cast<double>(round % 30) - 25.0);
    fact.loading = scale * this->normal(TypeParam::Dim, TypeParam::Shared);
    const Eigen::Matrix<double, TypeParam::Dim, 1> direction = scale * this->normal(TypeParam::Dim, 1);
    Covariance own = Covariance::Zero();
    if (round % 2 == 0) own = direction * direction.transpose();
    fact.covariance = symmetrised(Covariance(own + fact.loading * fact.loading.transpose()));
    ASSERT_EQ(store.check(fact), Insertion::inserted);
    const auto once = rounded(fact);
    EXPECT_TRUE(is_rounded(once));
    EXPECT_EQ(store.check(once), Insertion::inserted) << scale;
  }
}

TYPED_TEST(Rounding, DifferencesWithinABatchStayHonest) {
  double least = 1e300, most = 0.0, sum = 0.0;
  int count = 0;
  for (int round = 0; round < 30; ++round) {
    const auto facts = this->batch(20, 0.02, 0.1 * (1 + round % 3));
    for (std::size_t i = 0; i < facts.size(); ++i)
      for (std::size_t j = 0; j < i; ++j) {
        const auto [from, to] =
            growth(of_difference(facts[i], facts[j]), of_difference(rounded(facts[i]), rounded(facts[j])));
        least = std::min(least, from);
        most = std::max(most, to);
        sum += std::sqrt(from * to);
        ++count;
      }
  }
  EXPECT_GT(least, 0.8);
  EXPECT_LT(most, 1.25);
  EXPECT_NEAR(sum / count, 1.0, 0.01);
}

// The bound that holds whatever the numbers are: of (L_i + D_i - L_j - D_j) and the 8 D D^T of both, 1 / (1 + 2 / 8).
TYPED_TEST(Rounding, ADifferenceIsNeverStatedSmallerThanFourFifths) {
  for (int round = 0; round < 2000; ++round) {
    LandmarkFact<TypeParam> l[2];
    const typename TypeParam::Loading common = this->normal(TypeParam::Dim, TypeParam::Shared);
    const double apart = std::pow(10.0, -static_cast<double>(round % 8));
    for (auto& fact : l) {
      fact.loading = common + apart * this->normal(TypeParam::Dim, TypeParam::Shared);
      fact.covariance = symmetrised(typename TypeParam::PointCovariance(fact.loading * fact.loading.transpose()));
      fact.covariance.diagonal().array() += 1e-10;
    }
    EXPECT_GT(growth(of_difference(l[0], l[1]), of_difference(rounded(l[0]), rounded(l[1]))).first, 0.8);
  }
}

TYPED_TEST(Rounding, ZeroStaysZero) {
  LandmarkFact<TypeParam> exact;
  exact.key = {{1, 1}, 0};
  EXPECT_TRUE(is_rounded(exact));
  exact.position.setConstant(0.1);
  const auto once = rounded(exact);
  EXPECT_TRUE(is_rounded(once));
  EXPECT_EQ(once.covariance, exact.covariance);
  EXPECT_EQ(once.loading, exact.loading);
}

TYPED_TEST(Rounding, ADescriptorOfNoKindHasNoBytes) {
  LandmarkFact<TypeParam> fact;
  fact.descriptor.bytes[7] = 1;
  EXPECT_FALSE(is_rounded(fact));
  EXPECT_EQ(rounded(fact).descriptor, Descriptor{});
  fact.descriptor.kind = Descriptor::Kind::patch_8x8_4bit;
  EXPECT_TRUE(is_rounded(fact));
}

TYPED_TEST(Rounding, WhatCannotBeRoundedIsLeftAlone) {
  for (const double value : {1e300, -1e300, 1e39, std::numeric_limits<double>::infinity(),
                             -std::numeric_limits<double>::infinity(), std::numeric_limits<double>::quiet_NaN()}) {
    const auto expect_left_alone = [](const LandmarkFact<TypeParam>& fact) {
      EXPECT_FALSE(is_rounded(fact));
      EXPECT_EQ(hash_of(rounded(fact)), hash_of(fact));
    };
    LandmarkFact<TypeParam> fact;
    fact.covariance.setIdentity();
    auto spoilt = fact;
    spoilt.position[0] = value;
    expect_left_alone(spoilt);
    spoilt = fact;
    spoilt.covariance(1, 1) = value;
    expect_left_alone(spoilt);
    spoilt = fact;
    spoilt.loading(1, 2) = value;
    expect_left_alone(spoilt);
  }
}

TYPED_TEST(Rounding, CountsTheColumnsThatAreUsed) {
  typename TypeParam::Loading loading = TypeParam::Loading::Zero();
  EXPECT_EQ(columns_of<TypeParam>(loading), 0U);
  loading(1, 4) = 1e-300;
  EXPECT_EQ(columns_of<TypeParam>(loading), 5U);
  loading(0, TypeParam::Shared - 1) = 1.0;
  EXPECT_EQ(columns_of<TypeParam>(loading), static_cast<std::size_t>(TypeParam::Shared));
}

}  // namespace
}  // namespace convoy
