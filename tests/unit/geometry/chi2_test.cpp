#include <convoy/geometry/chi2.hpp>

#include <gtest/gtest.h>

#include <cmath>

namespace convoy {
namespace {

struct Quantile {
  double p, dof, x;
};

// Values of the usual tables, to more digits than they print (scipy.stats.chi2.ppf).
class Chi2Table : public testing::TestWithParam<Quantile> {};

TEST_P(Chi2Table, QuantileAndCdfMatchTheTable) {
  const auto [p, dof, x] = GetParam();
  EXPECT_NEAR(chi2_quantile(p, dof), x, 1e-9 * x);
  EXPECT_NEAR(chi2_cdf(x, dof), p, 1e-12);
}

INSTANTIATE_TEST_SUITE_P(Values, Chi2Table,
                         testing::Values(Quantile{0.95, 1, 3.841458820694124}, Quantile{0.95, 2, 5.991464547107979},
                                         Quantile{0.95, 3, 7.814727903251179}, Quantile{0.99, 3, 11.344866730144373},
                                         Quantile{0.9999, 3, 21.107513466160214}, Quantile{0.99, 6, 16.811893829770927},
                                         Quantile{0.5, 10, 9.34181776559197}, Quantile{0.025, 100, 74.22192747492373},
                                         Quantile{0.975, 100, 129.56119718583659},
                                         Quantile{0.025, 600, 534.0185504659327},
                                         Quantile{0.975, 600, 669.7691522164112}));

TEST(Chi2, TwoDegreesAreAnExponential) {
  for (const double x : {1e-6, 0.1, 1.0, 5.0, 20.0, 60.0}) EXPECT_NEAR(chi2_cdf(x, 2), -std::expm1(-0.5 * x), 1e-14);
}

TEST(Chi2, OneDegreeIsASquaredNormal) {
  for (const double x : {1e-6, 0.1, 1.0, 4.0, 20.0}) EXPECT_NEAR(chi2_cdf(x, 1), std::erf(std::sqrt(0.5 * x)), 1e-14);
}

TEST(Chi2, CdfRisesAndQuantileInvertsIt) {
  for (const double dof : {1.0, 2.0, 3.0, 7.0, 64.0, 1000.0}) {
    double last = 0.0;
    for (const double p : {1e-6, 0.01, 0.3, 0.5, 0.9, 0.99, 0.9999}) {
      const double x = chi2_quantile(p, dof);
      EXPECT_GT(x, last) << "dof " << dof << ", p " << p;
      EXPECT_NEAR(chi2_cdf(x, dof), p, 1e-11) << "dof " << dof;
      last = x;
    }
  }
}

TEST(Chi2, CdfOfNothingIsZero) {
  EXPECT_EQ(chi2_cdf(0.0, 3), 0.0);
  EXPECT_EQ(chi2_cdf(-1.0, 3), 0.0);
}

TEST(BinomialTail, MatchesCountingByHand) {
  EXPECT_NEAR(binomial_tail(2, 0.5, 1), 0.75, 1e-14);
  EXPECT_NEAR(binomial_tail(4, 0.25, 4), 1.0 / 256, 1e-15);
  EXPECT_NEAR(binomial_tail(10, 0.1, 3), 0.0701908264, 1e-13);  // 1 - .3486784401 - .387420489 - .1937102445
}

TEST(BinomialTail, BoundsAreExact) {
  EXPECT_EQ(binomial_tail(5, 0.3, 0), 1.0);
  EXPECT_EQ(binomial_tail(5, 0.3, -1), 1.0);
  EXPECT_EQ(binomial_tail(5, 0.3, 6), 0.0);
  EXPECT_EQ(binomial_tail(5, 0.0, 1), 0.0);
  EXPECT_EQ(binomial_tail(5, 1.0, 5), 1.0);
}

TEST(BinomialTail, TailsOfAllSuccessesAndFailuresAddToOne) {
  for (const int n : {1, 7, 50, 400})
    for (const double q : {1e-6, 0.03, 0.5, 0.97})
      for (const int k : {1, n / 2, n})
        EXPECT_NEAR(binomial_tail(n, q, k) + binomial_tail(n, 1.0 - q, n - k + 1), 1.0, 1e-11)
            << "n " << n << ", q " << q << ", k " << k;
}

TEST(BinomialTail, KeepsItsDigitsFarOut) {
  // One term carries the sum: C(100, 20) q^20 with q = 1e-3, and the next one is 80/21*q/(1-q) of it.
  const double leading =
      std::exp(std::lgamma(101) - std::lgamma(21) - std::lgamma(81) + 20 * std::log(1e-3) + 80 * std::log1p(-1e-3));
  EXPECT_GT(binomial_tail(100, 1e-3, 20), leading);
  EXPECT_LT(binomial_tail(100, 1e-3, 20), leading * 1.005);
}

}  // namespace
}  // namespace convoy
