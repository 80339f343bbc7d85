#include <convoy/geometry/se2.hpp>
#include <convoy/geometry/se3.hpp>

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>

namespace convoy {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

/// The same pose with the plane z = 0 for its world.
SE3 raised(const SE2& T) {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  R.topLeftCorner<2, 2>() = T.rotation();
  return SE3::from_rotation(R, {T.translation().x(), T.translation().y(), 0.0});
}
SE3::Tangent raised(const SE2::Tangent& d) { return (SE3::Tangent() << d[0], d[1], 0.0, 0.0, 0.0, d[2]).finished(); }

std::array<std::uint64_t, 4> bits(const SE3::Quaternion& q) {
  std::array<std::uint64_t, 4> out;
  std::memcpy(out.data(), q.data(), sizeof out);
  return out;
}

TEST(Se3, OfThePlaneIsSe2) {
  std::mt19937_64 engine(1);
  std::uniform_real_distribution<double> metres(-100.0, 100.0), radians(-3.1, 3.1);
  for (int k = 0; k < 500; ++k) {
    const SE2 A(metres(engine), metres(engine), radians(engine)), B(metres(engine), metres(engine), radians(engine));
    EXPECT_LT((raised(A * B).inverse() * (raised(A) * raised(B))).Log().norm(), 1e-11) << k;
    EXPECT_LT((raised(A).Log() - raised(A.Log())).norm(), 1e-9) << k;
    const SE2::Tangent d(metres(engine), metres(engine), radians(engine));
    EXPECT_LT((SE3::Exp(raised(d)).inverse() * raised(SE2::Exp(d))).Log().norm(), 1e-11) << k;
    EXPECT_LT((raised(A).adjoint() * raised(d) - raised(SE2::Tangent(A.adjoint() * d))).norm(), 1e-9) << k;
    const SE2::Tangent e(1.0, -0.5, 0.3);
    EXPECT_LT(
        (SE3::right_jacobian_inverse(raised(d)) * raised(e) - raised(SE2::Tangent(SE2::right_jacobian_inverse(d) * e)))
            .norm(),
        1e-9)
        << k;
  }
}

TEST(Se3, QuarterTurnAboutZTakesForwardToLeftAndKeepsUpUp) {
  const SE3 T({1.0, 0.0, 0.0, 1.0}, {10.0, 20.0, 30.0});
  EXPECT_LT((T * SE3::Point(1.0, 0.0, 0.0) - SE3::Point(10.0, 21.0, 30.0)).norm(), 1e-14);
  EXPECT_LT((T * SE3::Point(0.0, 0.0, 2.0) - SE3::Point(10.0, 20.0, 32.0)).norm(), 1e-14);
}

TEST(Se3, ExpOfForwardMotionWithAClimbingTurnIsAHelix) {
  // Half a turn about z of radius 2 m, rising by 3 m.
  const SE3 T = SE3::Exp((SE3::Tangent() << 2.0 * M_PI, 0.0, 3.0, 0.0, 0.0, M_PI).finished());
  EXPECT_LT((T.translation() - SE3::Point(0.0, 4.0, 3.0)).norm(), 1e-14);
}

TEST(Se3, RotationMatricesOfEveryKindGiveTheirQuaternion) {
  // Turns by almost pi about every axis: each of the four ways to the quaternion is taken.
  for (const auto& axis : {Eigen::Vector3d(1, 0.1, -0.1), Eigen::Vector3d(0.1, 1, 0.1), Eigen::Vector3d(-0.1, 0.1, 1),
                           Eigen::Vector3d(1, 1, 1), Eigen::Vector3d(-1, 1, -1)})
    for (const double angle : {0.0, 1e-9, 0.5, 2.0, 3.0, 3.14159}) {
      SE3::Tangent d = SE3::Tangent::Zero();
      d.tail<3>() = angle * axis.normalized();
      const SE3 T = SE3::Exp(d);
      EXPECT_LT((SE3::from_rotation(T.rotation(), SE3::Point::Zero()).quaternion() - T.quaternion()).norm(), 1e-14);
    }
}

TEST(Se3, OneRotationHasOneQuaternionToTheBit) {
  std::mt19937_64 engine(2);
  std::normal_distribution<double> normal;
  for (int k = 0; k < 2000; ++k) {
    const SE3::Quaternion q(normal(engine), normal(engine), normal(engine), normal(engine));
    const SE3 T(q, SE3::Point::Zero());
    EXPECT_NEAR(T.quaternion().norm(), 1.0, 1e-15);
    EXPECT_GT(T.quaternion()[0], 0.0);
    EXPECT_EQ(bits(SE3(-q, SE3::Point::Zero()).quaternion()), bits(T.quaternion())) << "-q is q";
    EXPECT_EQ(bits(SE3(T.quaternion(), SE3::Point::Zero()).quaternion()), bits(T.quaternion())) << "once is enough";
    const SE3::Quaternion product = (T * T.inverse() * T).quaternion();
    EXPECT_EQ(bits(SE3(product, SE3::Point::Zero()).quaternion()), bits(product));
  }
  // Half a turn has no w to go by.
  EXPECT_EQ(SE3({0.0, -1.0, 0.0, 0.0}, SE3::Point::Zero()).quaternion(), SE3::Quaternion(0.0, 1.0, 0.0, 0.0));
  EXPECT_EQ(SE3({0.0, 0.0, -2.0, 0.0}, SE3::Point::Zero()).quaternion(), SE3::Quaternion(0.0, 0.0, 1.0, 0.0));
  EXPECT_NEAR(SE3({0.0, 0.0, -2.0, 0.0}, SE3::Point::Zero()).Log()[4], M_PI, 1e-15);
}

TEST(Se3, ALongChainStaysARotation) {
  SE3 T;
  const SE3 step = SE3::Exp((SE3::Tangent() << 1.0, 0.1, 0.0, 0.01, -0.02, 0.03).finished());
  for (int k = 0; k < 100'000; ++k) T = T * step;
  EXPECT_LT((T.rotation() * T.rotation().transpose() - Eigen::Matrix3d::Identity()).norm(), 1e-13);
}

TEST(Se3, NumbersThatAreNotFiniteStayVisible) {
  EXPECT_FALSE(SE3({nan, 0.0, 0.0, 0.0}, SE3::Point::Zero()).quaternion().allFinite());
  EXPECT_FALSE(SE3({0.0, 0.0, 0.0, 0.0}, SE3::Point::Zero()).quaternion().allFinite());
  const double infinite = std::numeric_limits<double>::infinity();
  EXPECT_FALSE(SE3({1.0, infinite, 0.0, 0.0}, SE3::Point::Zero()).quaternion().allFinite());
  EXPECT_FALSE(SE3({1.0, 0.0, 0.0, 0.0}, {nan, 0.0, 0.0}).translation().allFinite());
  EXPECT_FALSE(SE3({1.0, 0.0, 0.0, 0.0}, {nan, 0.0, 0.0}).Log().allFinite());
}

}  // namespace
}  // namespace convoy
