#include <convoy/geometry/chi2.hpp>

#include <algorithm>
#include <cmath>

namespace convoy {
namespace {

// std::lgamma writes a global sign; this one may be called from any thread.
double log_gamma(double x) {
  int sign = 0;
  return ::lgamma_r(x, &sign);
}

// Regularised lower incomplete gamma P(a, x): series below x = a + 1, continued fraction (Lentz) above.
double gamma_p(double a, double x) {
  if (x <= 0.0) return 0.0;
  const double log_prefix = a * std::log(x) - x - log_gamma(a);
  if (x < a + 1.0) {
    double term = 1.0 / a, sum = term;
    for (int n = 1; n < 10000 && std::abs(term) > 1e-17 * std::abs(sum); ++n) {
      term *= x / (a + n);
      sum += term;
    }
    return sum * std::exp(log_prefix);
  }
  double b = x + 1.0 - a, c = 1e300, d = 1.0 / b, h = d;
  for (int n = 1; n < 10000; ++n) {
    const double an = -n * (n - a);
    b += 2.0;
    d = 1.0 / (an * d + b);
    c = b + an / c;
    const double delta = d * c;
    h *= delta;
    if (std::abs(delta - 1.0) < 1e-16) break;
  }
  return 1.0 - std::exp(log_prefix) * h;
}

}  // namespace

double chi2_cdf(double x, double dof) { return gamma_p(0.5 * dof, 0.5 * x); }

double chi2_quantile(double p, double dof) {
  double low = 0.0, high = std::max(1.0, dof);
  while (chi2_cdf(high, dof) < p) high *= 2.0;
  for (int i = 0; i < 200 && high - low > 1e-13 * high; ++i) {
    const double mid = 0.5 * (low + high);
    (chi2_cdf(mid, dof) < p ? low : high) = mid;
  }
  return 0.5 * (low + high);
}

double binomial_tail(int n, double q, int k) {
  if (k <= 0) return 1.0;
  if (k > n || q <= 0.0) return 0.0;
  if (q >= 1.0) return 1.0;
  double sum = 0.0;
  for (int i = k; i <= n; ++i) {
    sum += std::exp(log_gamma(n + 1.0) - log_gamma(i + 1.0) - log_gamma(n - i + 1.0) + i * std::log(q) +
                    (n - i) * std::log1p(-q));
  }
  return std::min(1.0, sum);
}

}  // namespace convoy
