#include <convoy/geometry/polar.hpp>

#include <gtest/gtest.h>

#include "../random_world.hpp"

namespace convoy {
namespace {

template <class G>
class PolarTest : public ::testing::Test {
 protected:
  using Point = typename G::Point;
  static Point some_point(test::Random& random) {
    return 10.0 * Point::NullaryExpr([&] { return random.uniform(-1.0, 1.0); }) + 0.1 * Point::Ones();
  }
};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(PolarTest, Groups);

TYPED_TEST(PolarTest, APointIsItsRangeAlongItsRay) {
  test::Random random(1);
  for (int k = 0; k < 100; ++k) {
    const auto p = this->some_point(random);
    const auto polar = polar_of(p);
    EXPECT_LT((polar[0] * ray_of(polar) - p).norm(), 1e-12);
    EXPECT_NEAR(ray_of(polar).norm(), 1.0, 1e-15);
  }
}

TYPED_TEST(PolarTest, JacobiansAgreeWithNumericOnes) {
  constexpr double h = 1e-6;
  test::Random random(2);
  for (int k = 0; k < 100; ++k) {
    const auto p = this->some_point(random);
    const auto polar = polar_of(p);
    for (int c = 0; c < TypeParam::Dim; ++c) {
      const typename TypeParam::Point d = h * TypeParam::Point::Unit(c);
      const typename TypeParam::Point seen = polar_difference<TypeParam::Dim>(
          polar_of(typename TypeParam::Point(p + d)), polar_of(typename TypeParam::Point(p - d)));
      EXPECT_LT((polar_jacobian(p).col(c) - seen / (2.0 * h)).norm(), 1e-6 * std::max(1.0, seen.norm() / (2.0 * h)));
      const typename TypeParam::Point up = polar + d, down = polar - d;
      const typename TypeParam::Point moved = up[0] * ray_of(up) - down[0] * ray_of(down);
      EXPECT_LT((point_jacobian(polar).col(c) - moved / (2.0 * h)).norm(), 1e-6);
    }
  }
}

TEST(Polar, LeftAndUpArePositive) {
  EXPECT_NEAR(polar_of(Eigen::Vector2d(0.0, 2.0))[1], 0.5 * M_PI, 1e-15);
  const Eigen::Vector3d polar = polar_of(Eigen::Vector3d(0.0, 1.0, 1.0));
  EXPECT_NEAR(polar[0], std::sqrt(2.0), 1e-15);
  EXPECT_NEAR(polar[1], 0.5 * M_PI, 1e-15);
  EXPECT_NEAR(polar[2], 0.25 * M_PI, 1e-15);
}

TEST(Polar, AnglesAreWrappedAndRangesAreNot) {
  const Eigen::Vector3d d = polar_difference<3>({9.0, 3.1, 0.2}, {2.0, -3.1, 0.1});
  EXPECT_NEAR(d[0], 7.0, 1e-15);
  EXPECT_NEAR(d[1], 6.2 - 2.0 * M_PI, 1e-12);
  EXPECT_NEAR(d[2], 0.1, 1e-15);
}

TEST(Polar, TheAngleBetweenRaysNeedsNoAxis) {
  EXPECT_NEAR(angle_between(ray_of(Eigen::Vector2d(1.0, -0.3)), ray_of(Eigen::Vector2d(1.0, 0.4))), 0.7, 1e-12);
  EXPECT_NEAR(angle_between(ray_of(Eigen::Vector3d(1.0, 0.5, -0.3)), ray_of(Eigen::Vector3d(1.0, 0.5, 0.4))), 0.7,
              1e-12);
  EXPECT_NEAR(angle_between(Eigen::Vector2d(1.0, 0.0), Eigen::Vector2d(-1.0, 0.0)), M_PI, 1e-12);
}

}  // namespace
}  // namespace convoy
