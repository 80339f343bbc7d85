// The filter's Jacobians, in both groups, against numeric differences of the motion and the sighting themselves.
#include <convoy/frontend/range_bearing_filter.hpp>
#include <convoy/geometry/polar.hpp>

#include <gtest/gtest.h>
#include <Eigen/LU>

#include <functional>

#include "../random_world.hpp"

namespace convoy {
namespace {

constexpr double gate = 1e9;
constexpr int nis_window = 10;

template <class G>
class FilterJacobians : public ::testing::Test {
 protected:
  using Point = typename G::Point;
  using Tangent = typename G::Tangent;
  static constexpr int Unknowns = G::Dim + 2 * G::Dof;  // errors of the first sighting and of two steps
  using Unknown = Eigen::Matrix<double, Unknowns, 1>;

  // A course of two steps with one landmark: seen at the start and after the first step, as predicted.
  FilterJacobians() {
    test::Random random(4);
    const auto tangent = [&](double size) {
      return Tangent(size * Tangent::NullaryExpr([&] { return random.uniform(-1.0, 1.0); }));
    };
    first_step_ = G::Exp(tangent(1.0));
    second_step_ = G::Exp(tangent(1.0));
    variance_ = (0.05 * Tangent::Ones() + tangent(0.02)).cwiseAbs2();
    polar_ = polar_of(Point(5.0 * Point::Ones() + Point::Unit(1)));
    noise_ = (0.03 * Point::Ones() + 0.01 * Point::Unit(0)).cwiseAbs2().asDiagonal();
  }

  RangeBearingFilter<G> drive() const {
    RangeBearingFilter<G> filter;
    filter.add(0.0, 7, polar_, noise_);
    filter.move(first_step_, variance_);
    const Point seen = polar_of(Point(filter.pose().inverse() * filter.tracks()[0].position));
    EXPECT_LT(filter.update(0, 1.0, seen, noise_, gate, nis_window), 1e-20);
    filter.move(second_step_, variance_);
    return filter;
  }

  // The same course with errors x, by the functions alone.
  Point first_seen(const Unknown& x) const { return polar_ + x.template head<G::Dim>(); }
  G after_first(const Unknown& x) const { return first_step_ * G::Exp(x.template segment<G::Dof>(G::Dim)); }
  G after_second(const Unknown& x) const { return after_first(x) * second_step_ * G::Exp(x.template tail<G::Dof>()); }
  Point landmark(const Unknown& x) const { return first_seen(x)[0] * ray_of(first_seen(x)); }

  template <int Rows>
  static Eigen::Matrix<double, Rows, Unknowns> numeric(
      const std::function<Eigen::Matrix<double, Rows, 1>(const Unknown&)>& f) {
    constexpr double h = 1e-5;
    Eigen::Matrix<double, Rows, Unknowns> J;
    for (int c = 0; c < Unknowns; ++c) J.col(c) = (f(h * Unknown::Unit(c)) - f(-h * Unknown::Unit(c))) / (2.0 * h);
    return J;
  }

  // Covariance of x once the second sighting is in.
  Eigen::MatrixXd posterior() const {
    Eigen::MatrixXd P = Eigen::MatrixXd::Zero(Unknowns, Unknowns);
    P.diagonal() << noise_.diagonal(), variance_, variance_;
    const Point there = polar_of(Point(after_first(Unknown::Zero()).inverse() * landmark(Unknown::Zero())));
    const auto H = numeric<G::Dim>([&](const Unknown& x) {
      return polar_difference<G::Dim>(polar_of(Point(after_first(x).inverse() * landmark(x))), there);
    });
    const Eigen::MatrixXd S = H * P * H.transpose() + Eigen::MatrixXd(noise_);
    return P - P * H.transpose() * S.inverse() * H * P;
  }

  G first_step_, second_step_;
  Tangent variance_;
  Point polar_;
  typename G::PointCovariance noise_;
};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(FilterJacobians, Groups);

TYPED_TEST(FilterJacobians, OfLandmarksFromHereAgreeWithNumericOnes) {
  using G = TypeParam;
  using X = typename TestFixture::Unknown;
  const auto J = this->template numeric<G::Dim>(
      [&](const X& x) { return typename G::Point(this->after_second(x).inverse() * this->landmark(x)); });
  const Eigen::MatrixXd expected = J * this->posterior() * J.transpose();
  const RangeBearingFilter<G> filter = this->drive();
  EXPECT_LT((filter.relative_covariance({0}) - expected).norm(), 1e-6 * expected.norm());
}

TYPED_TEST(FilterJacobians, OfThePoseAgreeWithNumericOnes) {
  using G = TypeParam;
  using X = typename TestFixture::Unknown;
  const G pose = this->after_second(X::Zero());
  const auto J = this->template numeric<G::Dof>(
      [&](const X& x) { return (this->after_second(x) * pose.inverse()).Log(); });  // a left perturbation
  const Eigen::MatrixXd expected = J * this->posterior() * J.transpose();
  const RangeBearingFilter<G> filter = this->drive();
  EXPECT_LT((filter.pose().inverse() * pose).Log().norm(), 1e-12);
  EXPECT_LT((filter.pose_covariance() - expected).norm(), 1e-6 * expected.norm());
}

// Relative to a new anchor nothing is known worse or better.
TYPED_TEST(FilterJacobians, ANewAnchorKeepsWhatIsKnownFromIt) {
  RangeBearingFilter<TypeParam> filter = this->drive();
  const Eigen::MatrixXd before = filter.relative_covariance({0});
  const auto place = filter.pose().inverse() * filter.tracks()[0].position;
  filter.rebase();
  EXPECT_LT((filter.relative_covariance({0}) - before).norm(), 1e-12 * before.norm());
  EXPECT_LT((filter.tracks()[0].position - place).norm(), 1e-12);
  EXPECT_TRUE(filter.pose_covariance().isZero(0.0));
}

TYPED_TEST(FilterJacobians, TheParallaxIsThatOfTheTwoRaysFurthestApart) {
  using P = typename TypeParam::Point;
  RangeBearingFilter<TypeParam> filter;
  const P start = P::Unit(0) * 5.0;
  filter.add(0.0, 1, start, this->noise_);
  typename TypeParam::Tangent ahead = TypeParam::Tangent::Zero();
  for (const double step_m : {1.0, 1.0, -4.0}) {  // to and fro beside it
    ahead[1] = step_m;
    filter.move(TypeParam::Exp(ahead), this->variance_);
    filter.update(0, 1.0, polar_of(P(filter.pose().inverse() * start)), this->noise_, gate, nis_window);
  }
  EXPECT_NEAR(filter.tracks()[0].parallax_rad, 2.0 * std::atan(2.0 / 5.0), 0.05);
  const double parallax = filter.tracks()[0].parallax_rad;
  filter.rebase();
  EXPECT_EQ(filter.tracks()[0].parallax_rad, parallax);
}

}  // namespace
}  // namespace convoy
