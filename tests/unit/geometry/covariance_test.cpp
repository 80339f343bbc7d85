#include <convoy/geometry/covariance.hpp>

#include <gtest/gtest.h>
#include <Eigen/LU>

#include <cmath>
#include <limits>

namespace convoy {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double infinity = std::numeric_limits<double>::infinity();

Eigen::Matrix3d positive_definite() {
  return (Eigen::Matrix3d() << 4.0, 1.0, -0.5, 1.0, 2.0, 0.3, -0.5, 0.3, 0.04 + 0.2).finished();
}

TEST(IsCovariance, TakesPositiveDefiniteAndSemidefinite) {
  EXPECT_TRUE(is_covariance(positive_definite()));
  EXPECT_TRUE(is_covariance(Eigen::Matrix3d::Zero()));
  EXPECT_TRUE(is_covariance(Eigen::Matrix2d(Eigen::Vector2d(1.0, 0.0).asDiagonal())));
  const Eigen::Vector3d v(1.0, -2.0, 3.0);
  EXPECT_TRUE(is_covariance(Eigen::Matrix3d(v * v.transpose())));  // rank one
}

TEST(IsCovariance, TakesDynamicMatricesAndBlocks) {
  EXPECT_TRUE(is_covariance(Eigen::MatrixXd::Identity(7, 7)));
  EXPECT_TRUE(is_covariance(positive_definite().topLeftCorner<2, 2>()));
}

TEST(IsCovariance, IsIndependentOfScale) {
  for (const double scale : {1e-18, 1e-6, 1.0, 1e6, 1e12}) {
    EXPECT_TRUE(is_covariance(Eigen::Matrix3d(scale * positive_definite()))) << scale;
    Eigen::Matrix3d indefinite = positive_definite();
    indefinite(0, 0) = -0.1;
    EXPECT_FALSE(is_covariance(Eigen::Matrix3d(scale * indefinite))) << scale;
  }
}

TEST(IsCovariance, RefusesWhatIsNotFinite) {
  for (const double bad : {nan, infinity, -infinity})
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        Eigen::Matrix3d P = positive_definite();
        P(i, j) = P(j, i) = bad;
        EXPECT_FALSE(is_covariance(P)) << bad << " at " << i << ", " << j;
      }
}

TEST(IsCovariance, RefusesAsymmetry) {
  Eigen::Matrix3d P = positive_definite();
  P(0, 1) += 1e-6;
  EXPECT_FALSE(is_covariance(P));
  P = positive_definite();
  P(0, 1) += 1e-12;  // rounding
  EXPECT_TRUE(is_covariance(P));
}

TEST(IsCovariance, RefusesIndefiniteWithPositiveDiagonal) {
  EXPECT_FALSE(is_covariance((Eigen::Matrix2d() << 1.0, 2.0, 2.0, 1.0).finished()));
  EXPECT_FALSE(is_covariance(Eigen::Matrix2d(-1e-6 * Eigen::Matrix2d::Identity())));
}

TEST(Symmetrised, IsTheMeanWithTheTranspose) {
  const Eigen::Matrix2d P = (Eigen::Matrix2d() << 1.0, 2.0, 4.0, 3.0).finished();
  EXPECT_EQ(symmetrised(P), (Eigen::Matrix2d() << 1.0, 3.0, 3.0, 3.0).finished());
}

TEST(SquaredMahalanobis, MatchesTheInverse) {
  const Eigen::Vector3d r(0.3, -2.0, 0.7);
  const Eigen::Matrix3d P = positive_definite();
  EXPECT_NEAR(squared_mahalanobis(r, P), r.dot(P.inverse() * r), 1e-12);
}

TEST(SquaredMahalanobis, IsInvariantUnderALinearMap) {
  const Eigen::Vector3d r(0.3, -2.0, 0.7);
  const Eigen::Matrix3d A = (Eigen::Matrix3d() << 2, 1, 0, -1, 3, 0.5, 0.2, 0, 5).finished();
  const Eigen::Matrix3d P = positive_definite();
  EXPECT_NEAR(squared_mahalanobis(Eigen::Vector3d(A * r), Eigen::Matrix3d(A * P * A.transpose())),
              squared_mahalanobis(r, P), 1e-10);
}

TEST(SquaredMahalanobis, IsInfiniteWithoutAPositiveDefiniteCovariance) {
  const Eigen::Vector2d r(1.0, 1.0);
  EXPECT_EQ(squared_mahalanobis(r, Eigen::Matrix2d::Zero()), infinity);
  EXPECT_EQ(squared_mahalanobis(r, Eigen::Matrix2d(-Eigen::Matrix2d::Identity())), infinity);
}

}  // namespace
}  // namespace convoy
