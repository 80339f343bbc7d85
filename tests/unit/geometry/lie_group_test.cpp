// The axioms and the derivatives of a group, one battery for every group that convoy is built for.
#include <convoy/geometry/groups.hpp>

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <random>

namespace convoy {
namespace {

constexpr std::uint64_t seed = 20240611;
constexpr int cases = 500;

template <class G>
class LieGroup : public testing::Test {
 protected:
  using Tangent = typename G::Tangent;
  using Point = typename G::Point;
  using Adjoint = typename G::Adjoint;

  double uniform(double low, double high) { return std::uniform_real_distribution<double>(low, high)(random_); }

  /// Translational part up to `length`, rotational part up to `angle` in norm.
  Tangent tangent(double length, double angle) {
    Tangent d;
    for (int i = 0; i < G::Dof; ++i) d[i] = uniform(-1.0, 1.0);
    d.template head<G::Dim>() *= length;
    auto rotation = d.template tail<G::Dof - G::Dim>();
    rotation *= angle / std::sqrt(static_cast<double>(G::Dof - G::Dim));
    return d;
  }
  G element() { return G::Exp(tangent(100.0, 3.1)); }
  Point point() {
    Point p;
    for (int i = 0; i < G::Dim; ++i) p[i] = uniform(-50.0, 50.0);
    return p;
  }

  static double distance(const G& a, const G& b) { return (a.inverse() * b).Log().norm(); }

  std::mt19937_64 random_{seed};
};

using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(LieGroup, Groups);

TYPED_TEST(LieGroup, DefaultIsTheIdentity) {
  const TypeParam identity;
  EXPECT_EQ(identity.Log().norm(), 0.0);
  EXPECT_EQ(identity.adjoint(), TypeParam::Adjoint::Identity());
  for (int i = 0; i < cases; ++i) {
    const auto X = this->element();
    EXPECT_EQ(this->distance(X * identity, X), this->distance(X, identity * X)) << "seed " << seed << ", case " << i;
  }
}

TYPED_TEST(LieGroup, LogInvertsExp) {
  for (const double angle : {3.14, 1.0, 0.11, 0.09, 1e-2, 1e-4, 1.1e-5, 0.9e-5, 1e-8, 0.0})
    for (int i = 0; i < cases; ++i) {
      const auto d = this->tangent(100.0, angle);
      EXPECT_NEAR((TypeParam::Exp(d).Log() - d).norm(), 0.0, 1e-11 * (1.0 + d.norm()))
          << "seed " << seed << ", angle " << angle << ", case " << i;
    }
}

// Up to 1e-12 short of half a turn, and back again: the same rotation, to the same digits.
TYPED_TEST(LieGroup, LogInvertsExpNearHalfATurn) {
  constexpr int rotations = TypeParam::Dof - TypeParam::Dim;
  for (const double short_of_pi : {1e-2, 1e-5, 1e-8, 1e-12})
    for (int i = 0; i < cases; ++i) {
      auto d = this->tangent(100.0, 3.0);
      d.template tail<rotations>() *= (M_PI - short_of_pi) / d.template tail<rotations>().norm();
      EXPECT_LT((TypeParam::Exp(d).Log() - d).norm(), 1e-10) << "seed " << seed << ", case " << i;
      d.template tail<rotations>() *= (M_PI + short_of_pi) / (M_PI - short_of_pi);  // beyond: the other way round
      const auto log = TypeParam::Exp(d).Log();
      EXPECT_LE(log.template tail<rotations>().norm(), M_PI + 1e-15) << "seed " << seed << ", case " << i;
      EXPECT_LT(this->distance(TypeParam::Exp(log), TypeParam::Exp(d)), 1e-10) << "seed " << seed << ", case " << i;
    }
}

TYPED_TEST(LieGroup, SmallAdIsTheDerivativeOfAd) {
  constexpr double h = 1e-5;
  for (int i = 0; i < cases; ++i) {
    const auto d = this->tangent(10.0, 2.0);
    const auto numeric = ((TypeParam::Exp(h * d).adjoint() - TypeParam::Exp(-h * d).adjoint()) / (2.0 * h)).eval();
    EXPECT_LT((TypeParam::ad(d) - numeric).norm(), 1e-6) << "seed " << seed << ", case " << i;
    EXPECT_LT((TypeParam::ad(d) * d).norm(), 1e-12);
  }
}

TYPED_TEST(LieGroup, ExpInvertsLog) {
  for (int i = 0; i < cases; ++i) {
    const auto X = this->element();
    EXPECT_LT(this->distance(TypeParam::Exp(X.Log()), X), 1e-11) << "seed " << seed << ", case " << i;
  }
}

TYPED_TEST(LieGroup, ExpOfATenthTenTimesIsExp) {
  for (int i = 0; i < cases; ++i) {
    const auto d = this->tangent(10.0, 3.0);
    TypeParam X;
    for (int step = 0; step < 10; ++step) X = X * TypeParam::Exp(0.1 * d);
    EXPECT_LT(this->distance(X, TypeParam::Exp(d)), 1e-11) << "seed " << seed << ", case " << i;
  }
}

TYPED_TEST(LieGroup, ExpHasNoStepWhereItsSeriesTakesOver) {
  for (const double angle : {1e-5, 2e-4, 1e-3, 0.1})
    for (int i = 0; i < cases; ++i) {
      auto below = this->tangent(100.0, 1.0), above = below;
      below.template tail<TypeParam::Dof - TypeParam::Dim>().normalize();
      above.template tail<TypeParam::Dof - TypeParam::Dim>().normalize();
      below.template tail<TypeParam::Dof - TypeParam::Dim>() *= angle * (1.0 - 1e-12);
      above.template tail<TypeParam::Dof - TypeParam::Dim>() *= angle * (1.0 + 1e-12);
      EXPECT_LT(this->distance(TypeParam::Exp(below), TypeParam::Exp(above)), 1e-9)
          << "seed " << seed << ", angle " << angle << ", case " << i;
      const auto difference =
          (TypeParam::right_jacobian_inverse(below) - TypeParam::right_jacobian_inverse(above)).eval();
      EXPECT_LT(difference.norm(), 1e-6 * above.norm()) << "seed " << seed << ", case " << i;
    }
}

TYPED_TEST(LieGroup, CompositionIsAssociativeAndInverseUndoesIt) {
  for (int i = 0; i < cases; ++i) {
    const auto A = this->element(), B = this->element(), C = this->element();
    EXPECT_LT(this->distance((A * B) * C, A * (B * C)), 1e-11) << "seed " << seed << ", case " << i;
    EXPECT_LT((A * A.inverse()).Log().norm(), 1e-11) << "seed " << seed << ", case " << i;
    EXPECT_LT((A.inverse() * A).Log().norm(), 1e-11) << "seed " << seed << ", case " << i;
  }
}

TYPED_TEST(LieGroup, ActsOnPoints) {
  for (int i = 0; i < cases; ++i) {
    const auto A = this->element(), B = this->element();
    const auto p = this->point();
    EXPECT_LT(((A * B) * p - A * (B * p)).norm(), 1e-11) << "seed " << seed << ", case " << i;
    EXPECT_LT((A * p - (A.rotation() * p + A.translation())).norm(), 1e-12) << "seed " << seed << ", case " << i;
  }
}

TYPED_TEST(LieGroup, RotationIsOrthogonal) {
  for (int i = 0; i < cases; ++i) {
    const auto R = this->element().rotation();
    EXPECT_LT((R * R.transpose() - decltype(R)::Identity()).norm(), 1e-14) << "seed " << seed << ", case " << i;
    EXPECT_NEAR(R.determinant(), 1.0, 1e-14) << "seed " << seed << ", case " << i;
  }
}

// X Exp(d) = Exp(Ad_X d) X.
TYPED_TEST(LieGroup, AdjointMovesAPerturbationToTheOtherSide) {
  for (int i = 0; i < cases; ++i) {
    const auto X = this->element();
    const auto d = this->tangent(1.0, 0.5);
    EXPECT_LT(this->distance(X * TypeParam::Exp(d), TypeParam::Exp(X.adjoint() * d) * X), 1e-10)
        << "seed " << seed << ", case " << i;
  }
}

TYPED_TEST(LieGroup, AdjointIsAHomomorphism) {
  for (int i = 0; i < cases; ++i) {
    const auto A = this->element(), B = this->element();
    EXPECT_LT(((A * B).adjoint() - A.adjoint() * B.adjoint()).norm(), 1e-10) << "seed " << seed << ", case " << i;
    EXPECT_LT((A.inverse().adjoint() * A.adjoint() - TypeParam::Adjoint::Identity()).norm(), 1e-10)
        << "seed " << seed << ", case " << i;
  }
}

TYPED_TEST(LieGroup, ActJacobianMatchesNumericDifferentiation) {
  const double h = 1e-6;
  for (int i = 0; i < cases; ++i) {
    const auto X = this->element();
    const auto p = this->point();
    typename TypeParam::PointJacobian numeric;
    for (int k = 0; k < TypeParam::Dof; ++k) {
      typename TypeParam::Tangent e = TypeParam::Tangent::Zero();
      e[k] = h;
      numeric.col(k) = (X * TypeParam::Exp(e) * p - X * TypeParam::Exp(-e) * p) / (2.0 * h);
    }
    EXPECT_LT((X.act_jacobian(p) - numeric).cwiseAbs().maxCoeff(), 1e-6) << "seed " << seed << ", case " << i;
  }
}

TYPED_TEST(LieGroup, RightJacobianInverseMatchesNumericDifferentiation) {
  const double h = 1e-4;  // a smaller step would differentiate the rounding of 1 - cos(theta)
  for (const double angle : {3.0, 1.0, 1e-3, 1e-6, 0.0})
    for (int i = 0; i < cases; ++i) {
      const auto d = this->tangent(5.0, angle);
      typename TypeParam::Adjoint numeric;
      for (int k = 0; k < TypeParam::Dof; ++k) {
        typename TypeParam::Tangent e = TypeParam::Tangent::Zero();
        e[k] = h;
        numeric.col(k) =
            ((TypeParam::Exp(d) * TypeParam::Exp(e)).Log() - (TypeParam::Exp(d) * TypeParam::Exp(-e)).Log()) /
            (2.0 * h);
      }
      EXPECT_LT((TypeParam::right_jacobian_inverse(d) - numeric).cwiseAbs().maxCoeff(), 1e-6)
          << "seed " << seed << ", angle " << angle << ", case " << i;
    }
}

TYPED_TEST(LieGroup, FromItsOwnRotationAndTranslationItIsTheSame) {
  for (int i = 0; i < cases; ++i) {
    const auto X = this->element();
    EXPECT_LT(this->distance(TypeParam::from_rotation(X.rotation(), X.translation()), X), 1e-12)
        << "seed " << seed << ", case " << i;
  }
}

// (X Exp(d))^-1 = X^-1 Exp(-Ad_X d): how the covariance of T_b_a follows from that of T_a_b.
TYPED_TEST(LieGroup, PerturbationOfAnInverseIsThatOfTheAdjoint) {
  for (int i = 0; i < cases; ++i) {
    const auto X = this->element();
    const auto d = this->tangent(1.0, 0.5);
    const auto moved = X.inverse() * TypeParam::Exp(-(X.adjoint() * d));
    EXPECT_LT(this->distance((X * TypeParam::Exp(d)).inverse(), moved), 1e-10) << "seed " << seed << ", case " << i;
  }
}

}  // namespace
}  // namespace convoy
