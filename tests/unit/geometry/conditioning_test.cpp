// Covariances that are hard to invert.
#include <convoy/geometry/conditioning.hpp>
#include <convoy/geometry/covariance.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>

#include <algorithm>

namespace convoy {
namespace {

template <int N>
using Square = Eigen::Matrix<double, N, N>;

// Of rank one, metres and radians mixed, over twenty orders of magnitude.
template <int N>
Square<N> of_rank_one(test::Random& random) {
  Eigen::Matrix<double, N, 1> v = random.unit_normal<N>();
  for (int k = 0; k < N; ++k) v[k] *= std::pow(10.0, random.uniform(-5.0, 5.0));
  return v * v.transpose();
}

template <int N>
void inverses_are_covariances() {
  test::Random random(4);
  for (int k = 0; k < 300; ++k) {
    const Square<N> P = invertible(of_rank_one<N>(random));
    const Square<N> W = inverse_covariance(P);
    ASSERT_TRUE(is_covariance(W)) << k;
    ASSERT_EQ(Square<N>(P.transpose()), P);
    // By what each component is: the product of correlations, which is the identity.
    const Eigen::Matrix<double, N, 1> sigma = P.diagonal().cwiseSqrt();
    const Square<N> C = sigma.cwiseInverse().asDiagonal() * P * sigma.cwiseInverse().asDiagonal();
    const Square<N> V = sigma.asDiagonal() * W * sigma.asDiagonal();
    ASSERT_LT((C * V - Square<N>::Identity()).norm(), 1e-3) << k;
  }
}

TEST(Conditioning, TheInverseOfWhatIsNearlySingularIsACovariance) {
  inverses_are_covariances<2>();
  inverses_are_covariances<3>();
  inverses_are_covariances<6>();
}

TEST(Conditioning, WhatIsWellConditionedStaysAsItIs) {
  test::Random random(5);
  for (int k = 0; k < 100; ++k) {
    Eigen::Matrix3d A;
    for (int c = 0; c < 3; ++c) A.col(c) = random.unit_normal<3>();
    const Eigen::Matrix3d P = symmetrised(Eigen::Matrix3d(A * A.transpose() + 0.1 * Eigen::Matrix3d::Identity()));
    EXPECT_TRUE(invertible(P).isApprox(P, 1e-9));
    EXPECT_TRUE((inverse_covariance(P) * P).isApprox(Eigen::Matrix3d::Identity(), 1e-9));
  }
}

TEST(Conditioning, ZeroAndWhatRoundingLeftBelowItCanBeInverted) {
  EXPECT_TRUE(is_covariance(invertible(Eigen::Matrix3d(Eigen::Matrix3d::Zero()))));
  Eigen::Matrix2d P;
  P << 4.0, 2.0 + 1e-9, 2.0 + 1e-9, 1.0;
  EXPECT_LT(P.determinant(), 0.0);
  EXPECT_TRUE(is_covariance(inverse_covariance(invertible(P))));
}

}  // namespace
}  // namespace convoy
