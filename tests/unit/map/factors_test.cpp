// The analytic Jacobians of the factors against numeric ones, in both groups.
#include <convoy/geometry/groups.hpp>
#include <convoy/map/factors.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

namespace convoy {
namespace {

template <class G>
class Factors : public testing::Test {
 protected:
  /// An error of some metres and tenths of a radian: residuals are far from zero, where every Jacobian is the identity.
  typename G::Tangent error() {
    typename G::Tangent d = 2.0 * random_.unit_normal<G::Dof>();
    d.template tail<G::Dof - G::Dim>() *= 0.2;
    return d;
  }
  typename G::Point point() { return 20.0 * random_.unit_normal<G::Dim>(); }

  /// d(residual(d)) / dd at d = 0, central differences.
  template <int Columns, class Residual>
  static auto numeric(const Residual& residual) {
    constexpr double h = 1e-5;
    Eigen::Matrix<double, decltype(residual(Eigen::Matrix<double, Columns, 1>()))::RowsAtCompileTime, Columns> J;
    for (int k = 0; k < Columns; ++k) {
      const Eigen::Matrix<double, Columns, 1> e = h * Eigen::Matrix<double, Columns, 1>::Unit(k);
      J.col(k) = (residual(e) - residual(-e)) / (2.0 * h);
    }
    return J;
  }

  static double worst(const Eigen::MatrixXd& analytic, const Eigen::MatrixXd& differences) {
    return (analytic - differences).cwiseAbs().maxCoeff();
  }

  test::Random random_{20240611};
};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(Factors, Groups);

constexpr int cases = 200;

TYPED_TEST(Factors, PriorJacobianIsTheNumericOne) {
  using G = TypeParam;
  for (int k = 0; k < cases; ++k) {
    const G T = this->random_.template pose_of<G>(30.0);
    const PriorFactor<G> f{0, T * G::Exp(this->error()), {}};
    const PriorResidual<G> at(f, T);
    EXPECT_GT(at.r.norm(), 0.01);
    const auto J = this->template numeric<G::Dof>(
        [&](const typename G::Tangent& d) { return PriorResidual<G>(f, T * G::Exp(d)).r; });
    EXPECT_LT(this->worst(at.J, J), 1e-6) << k;
  }
}

TYPED_TEST(Factors, DriftJacobiansAreTheNumericOnes) {
  using G = TypeParam;
  for (int k = 0; k < cases; ++k) {
    const G T_a = this->random_.template pose_of<G>(30.0), T_b = this->random_.template pose_of<G>(30.0);
    const DriftFactor<G> f{0, 1, T_a.inverse() * T_b * G::Exp(this->error()), {}};
    const DriftResidual<G> at(f, T_a, T_b);
    const auto J_a = this->template numeric<G::Dof>(
        [&](const typename G::Tangent& d) { return DriftResidual<G>(f, T_a * G::Exp(d), T_b).r; });
    const auto J_b = this->template numeric<G::Dof>(
        [&](const typename G::Tangent& d) { return DriftResidual<G>(f, T_a, T_b * G::Exp(d)).r; });
    EXPECT_LT(this->worst(at.J_a, J_a), 1e-6) << k;
    EXPECT_LT(this->worst(at.J_b, J_b), 1e-6) << k;
  }
}

TYPED_TEST(Factors, LandmarkJacobiansAreTheNumericOnes) {
  using G = TypeParam;
  for (int k = 0; k < cases; ++k) {
    const G T = this->random_.template pose_of<G>(30.0);
    const typename G::Point m = this->point();
    const LandmarkFactor<G> f{0, 0, {}, this->point(), {}};
    const LandmarkResidual<G> at(f, T, m);
    EXPECT_LT((at.r - (T.inverse() * m - f.position)).norm(), 1e-12) << k;
    const auto J_T = this->template numeric<G::Dof>(
        [&](const typename G::Tangent& d) { return LandmarkResidual<G>(f, T * G::Exp(d), m).r; });
    const auto J_m =
        this->template numeric<G::Dim>([&](const typename G::Point& d) { return LandmarkResidual<G>(f, T, m + d).r; });
    EXPECT_LT(this->worst(at.J_T, J_T), 1e-6) << k;
    EXPECT_LT(this->worst(at.J_m, J_m), 1e-6) << k;
  }
}

TYPED_TEST(Factors, ALandmarkIsAsFarAsItsChainsScaleSays) {
  using G = TypeParam;
  constexpr int C = Constants<G>::RowsAtCompileTime;
  const G T = this->random_.template pose_of<G>(30.0);
  const typename G::Point m = this->point();
  const LandmarkFactor<G> f{0, 0, {}, this->point(), {}};
  const Constants<G> c = 0.1 * Constants<G>::Random();
  const LandmarkResidual<G> at(f, T, m, c);
  EXPECT_LT((at.r - ((T.inverse() * m) / (1.0 + c[0]) - f.position)).norm(), 1e-12);
  const auto J_c =
      this->template numeric<C>([&](const Constants<G>& d) { return LandmarkResidual<G>(f, T, m, c + d).r; });
  EXPECT_LT(this->worst(at.J_c, J_c), 1e-6);
  const auto J_T = this->template numeric<G::Dof>(
      [&](const typename G::Tangent& d) { return LandmarkResidual<G>(f, T * G::Exp(d), m, c).r; });
  EXPECT_LT(this->worst(at.J_T, J_T), 1e-6);
  const auto J_m =
      this->template numeric<G::Dim>([&](const typename G::Point& d) { return LandmarkResidual<G>(f, T, m + d, c).r; });
  EXPECT_LT(this->worst(at.J_m, J_m), 1e-6);
}

}  // namespace
}  // namespace convoy
