#include <convoy/geometry/se2.hpp>

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace convoy {
namespace {

TEST(Se2, WrapsAnglesToOneTurn) {
  for (const double angle : {0.0, 1.0, -1.0, 3.0, -3.0, 3.2, -3.2, 7.0, 100.0, -12345.678}) {
    const double wrapped = wrap_angle(angle);
    EXPECT_LE(std::abs(wrapped), M_PI) << angle;
    EXPECT_NEAR(std::sin(wrapped), std::sin(angle), 1e-11) << angle;
    EXPECT_NEAR(std::cos(wrapped), std::cos(angle), 1e-11) << angle;
    EXPECT_EQ(SE2(1.0, 2.0, angle).theta(), wrapped);
  }
}

TEST(Se2, QuarterTurnTakesForwardToLeft) {
  const SE2 T(10.0, 20.0, M_PI / 2);
  EXPECT_LT((T * SE2::Point(1.0, 0.0) - SE2::Point(10.0, 21.0)).norm(), 1e-15);
}

TEST(Se2, ExpOfForwardMotionWithTurnIsAnArc) {
  // A quarter of a circle of radius 2 m.
  const SE2 T = SE2::Exp({M_PI, 0.0, M_PI / 2});
  EXPECT_LT((T.translation() - SE2::Point(2.0, 2.0)).norm(), 1e-14);
  EXPECT_DOUBLE_EQ(T.theta(), M_PI / 2);
}

TEST(Se2, NumbersThatAreNotFiniteStayVisible) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(std::isnan(SE2(0.0, 0.0, nan).theta()));
  EXPECT_TRUE(std::isnan(SE2(0.0, 0.0, std::numeric_limits<double>::infinity()).theta()));
  EXPECT_FALSE(SE2(nan, 0.0, 0.0).translation().allFinite());
}

}  // namespace
}  // namespace convoy
