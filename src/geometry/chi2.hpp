// Quantiles and tails of the distributions that the gates use.
#pragma once

namespace convoy {

/// P(X <= x) for X chi-square with dof > 0 degrees of freedom.
double chi2_cdf(double x, double dof);

/// x with P(X <= x) = p, 0 < p < 1 (eq. 5 uses d = 2, alpha = 0.95: 5.9915).
double chi2_quantile(double p, double dof);

/// P(Bin(n, q) >= k).
double binomial_tail(int n, double q, int k);

}  // namespace convoy
