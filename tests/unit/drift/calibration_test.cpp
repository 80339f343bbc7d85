#include <convoy/config_error.hpp>
#include <convoy/drift/calibration.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>

namespace convoy {
namespace {

constexpr double rate_xy = 2e-4, rate_theta = 4e-6;
constexpr double no_truth_noise = 1e-4;

/// What is true of one simulated vehicle.
struct Noise {
  double xy = rate_xy, theta = rate_theta;  // per metre
  double gamma = 0.0;  // of the covariance that the SLAM states (the same shape, a rate of its own)
  double kappa = 0.0, g = 0.0;
};
constexpr double stated_xy = 1e-4, stated_theta = 2e-6;  // what the SLAM states per metre

struct Drive {
  DrivenPath<SE2> path;
  std::vector<SE2> truth;
};

/// Laps of about 340 m (straights of 120 m, half circles), driven as the model says: T_{k+1} = T_k U Exp(A c + eta).
Drive drive(test::Random& random, const Noise& noise, double length_m, bool stated) {
  constexpr double step_m = 1.0, straight_m = 120.0, curve_m = 50.0;
  Drive d;
  d.path.states.push_back({});
  d.truth.push_back(SE2(random.pose(100.0)));
  SE2::Covariance C = SE2::Covariance::Zero();
  for (double s = step_m; s <= length_m; s += step_m) {
    const double on_lap = std::fmod(s, 2.0 * (straight_m + curve_m));
    const bool turning = std::fmod(on_lap, straight_m + curve_m) > straight_m;
    const SE2 U = SE2::Exp({step_m, 0.0, turning ? M_PI * step_m / curve_m : 0.0});
    const ChainState<SE2>& before = d.path.states.back();
    ChainState<SE2> now = before;
    now.abscissa_m = s;
    now.stamp_s = s / 10.0;
    now.pose = before.pose * U;
    SE2::Tangent variance(noise.xy, noise.xy, noise.theta);
    const SE2::Tangent stated_rate(stated_xy, stated_xy, stated_theta);
    if (stated) {
      variance += noise.gamma * stated_rate;
      const SE2::Adjoint Ad = now.pose.adjoint();
      C += step_m * Ad * stated_rate.asDiagonal() * Ad.transpose();
      now.drift = C;
    }
    SE2::Tangent eta = (step_m * variance).cwiseSqrt().cwiseProduct(random.unit_normal<3>());
    eta.head<2>() += noise.kappa * (U.rotation().transpose() * U.translation());
    eta[2] += noise.g * step_m;
    d.truth.push_back(d.truth.back() * U * SE2::Exp(eta));
    d.path.states.push_back(now);
  }
  return d;
}

ResidualGroup spans_of(const Drive& d, double span_m = 80.0) {
  return span_residuals(d.path, d.truth, span_m, SE2::Tangent(no_truth_noise, no_truth_noise, 1e-5));
}

/// The second lap against the first: 11 closures with 0.1 m and 0.005 rad.
ResidualGroup double_lap(test::Random& random, const Noise& noise) {
  const Drive d = drive(random, noise, 670.0, false);
  std::vector<Closure<SE2>> closures;
  const SE2::Covariance Z = Eigen::Vector3d(0.01, 0.01, 2.5e-5).asDiagonal();
  for (int k = 0; k < 11; ++k) {
    const int a = 5 + 30 * k, b = a + 330;
    const SE2 T = d.truth[static_cast<std::size_t>(a)].inverse() * d.truth[static_cast<std::size_t>(b)];
    closures.push_back({0, a, 0, b, T * SE2::Exp(random.draw<3>(Z)), Z});
  }
  return closure_residuals<SE2>({d.path}, closures);
}

struct Spread {
  double low, median, high;  // 10, 50, 90 %
};
Spread spread(std::vector<double> x) {
  std::sort(x.begin(), x.end());
  const auto q = [&](double p) { return x[static_cast<std::size_t>(p * static_cast<double>(x.size() - 1))]; };
  return {q(0.1), q(0.5), q(0.9)};
}
void print(const char* what, const Spread& s) {
  std::printf("  %-28s %.2f (%.2f-%.2f)\n", what, s.median, s.low, s.high);
}

TEST(VarianceFit, AgreesWithTheDerivativeOfTheLikelihoodAtItsMaximum) {
  test::Random random(3);
  std::vector<ResidualGroup> groups;
  for (int run = 0; run < 6; ++run)
    groups.push_back(spans_of(drive(random, {rate_xy, rate_theta, 0.7, 0.01, 1e-4}, 680.0, true)));
  const VarianceFit fit = fit_variances(groups, {.constants = true, .intervals = false});
  ASSERT_TRUE(fit.converged);
  for (std::size_t p = 0; p < variance_part_count; ++p) {
    auto more = fit.theta(), less = fit.theta();
    more[p] *= 1.02;
    less[p] /= 1.02;
    EXPECT_LE(log_likelihood(groups, more), fit.log_likelihood + 1e-6) << to_string(static_cast<VariancePart>(p));
    EXPECT_LE(log_likelihood(groups, less), fit.log_likelihood + 1e-6) << to_string(static_cast<VariancePart>(p));
  }
}

TEST(VarianceFit, SaysWhatItCannotKnow) {
  test::Random random(4);
  const VarianceFit fit = fit_variances({spans_of(drive(random, {}, 680.0, false))}, {.intervals = false});
  EXPECT_FALSE(fit[VariancePart::gamma].known);  // the SLAM stated no covariance
  EXPECT_EQ(fit[VariancePart::gamma].value, 1.0);
  EXPECT_TRUE(fit[VariancePart::rotation].known);
  EXPECT_THROW(fit_variances({}), ConfigError);
  EXPECT_THROW(fit_variances({spans_of(drive(random, {}, 40.0, false))}), ConfigError);  // shorter than a span
}

// DESIGN B6: 60 repetitions each, seeds 1000 and on. Bounds leave room around what was measured.
TEST(CalibrateByTruth, FindsTheRatesAndItsIntervalsCoverThem) {
  std::vector<double> xy, theta;
  int covered = 0, asked = 0;
  for (int repetition = 0; repetition < 60; ++repetition) {
    test::Random random(1000 + static_cast<std::uint64_t>(repetition));
    std::vector<ResidualGroup> groups;
    for (int run = 0; run < 3; ++run) groups.push_back(spans_of(drive(random, {}, 680.0, false)));
    const VarianceFit fit = fit_variances(groups);
    xy.push_back(fit[VariancePart::translation].value / rate_xy);
    theta.push_back(fit[VariancePart::rotation].value / rate_theta);
    for (const auto& [part, truth] :
         {std::pair(VariancePart::translation, rate_xy), std::pair(VariancePart::rotation, rate_theta)}) {
      covered += fit[part].low <= truth && truth <= fit[part].high;
      ++asked;
    }
  }
  print("truth, 3 runs, q_xy/true", spread(xy));
  print("truth, 3 runs, q_theta/true", spread(theta));
  std::printf("  95 %% intervals cover %d of %d\n", covered, asked);
  EXPECT_NEAR(spread(xy).median, 1.0, 0.2);
  EXPECT_NEAR(spread(theta).median, 1.0, 0.15);
  EXPECT_GT(spread(theta).low, 0.6);
  EXPECT_LT(spread(theta).high, 1.5);
  EXPECT_GE(covered, asked * 88 / 100);
}

class CalibrateByClosures : public testing::TestWithParam<std::pair<int, std::pair<double, double>>> {};

TEST_P(CalibrateByClosures, FindsTheRates) {
  const auto [runs, band] = GetParam();
  std::vector<double> xy, theta;
  for (int repetition = 0; repetition < 60; ++repetition) {
    test::Random random(2000 + static_cast<std::uint64_t>(repetition));
    std::vector<ResidualGroup> groups;
    for (int run = 0; run < runs; ++run) groups.push_back(double_lap(random, {}));
    const VarianceFit fit = fit_variances(groups, {.intervals = false});
    xy.push_back(fit[VariancePart::translation].value / rate_xy);
    theta.push_back(fit[VariancePart::rotation].value / rate_theta);
  }
  std::printf("closures of %d run%s\n", runs, runs == 1 ? "" : "s");
  print("q_xy/true", spread(xy));
  print("q_theta/true", spread(theta));
  EXPECT_NEAR(spread(theta).median, 1.0, 0.25);
  EXPECT_GT(spread(theta).low, band.first);
  EXPECT_LT(spread(theta).high, band.second);
}
INSTANTIATE_TEST_SUITE_P(Runs, CalibrateByClosures,
                         testing::Values(std::pair(1, std::pair(0.2, 2.2)), std::pair(3, std::pair(0.45, 1.7)),
                                         std::pair(10, std::pair(0.7, 1.4))));

// Two vehicles, of which nobody knows where they start: the closures between them speak of drift all the same.
TEST(CalibrateByClosures, BetweenTwoVehiclesWithUnknownStarts) {
  std::vector<double> theta;
  for (int repetition = 0; repetition < 40; ++repetition) {
    test::Random random(3000 + static_cast<std::uint64_t>(repetition));
    std::vector<ResidualGroup> groups;
    for (int run = 0; run < 10; ++run) {
      const Drive one = drive(random, {}, 340.0, false), other = drive(random, {}, 340.0, false);
      std::vector<Closure<SE2>> closures;
      const SE2::Covariance Z = Eigen::Vector3d(0.01, 0.01, 2.5e-5).asDiagonal();
      for (int k = 5; k < 340; k += 30) {
        const SE2 T = one.truth[static_cast<std::size_t>(k)].inverse() * other.truth[static_cast<std::size_t>(k)];
        closures.push_back({0, k, 1, k, T * SE2::Exp(random.draw<3>(Z)), Z});
      }
      groups.push_back(closure_residuals<SE2>({one.path, other.path}, closures));
    }
    const VarianceFit fit = fit_variances(groups, {.intervals = false});
    theta.push_back(fit[VariancePart::rotation].value / rate_theta);
  }
  print("two vehicles, q_theta/true", spread(theta));
  EXPECT_NEAR(spread(theta).median, 1.0, 0.2);
}

TEST(Constants, OfAnOdometerThatIsOffAreFound) {
  constexpr double kappa = 0.01, g = 2e-4;
  test::Random random(7);
  std::vector<ResidualGroup> groups;
  for (int run = 0; run < 6; ++run)
    groups.push_back(spans_of(drive(random, {rate_xy, rate_theta, 0.0, kappa, g}, 680.0, false)));
  const VarianceFit without = fit_variances(groups, {.intervals = false});
  const VarianceFit with = fit_variances(groups, {.constants = true, .intervals = false});
  EXPECT_GT(with.log_likelihood, without.log_likelihood + 10.0);
  for (const auto& group : with.constants) {
    ASSERT_EQ(group.size(), 1U);
    EXPECT_NEAR(group[0].mean[0], kappa, 4.0 * group[0].sigma[0]);
    EXPECT_NEAR(group[0].mean[1], g, 4.0 * group[0].sigma[1]);
    EXPECT_LT(group[0].sigma[0], 0.3 * kappa);
  }
  EXPECT_LT(with[VariancePart::translation].value, without[VariancePart::translation].value);
}

TEST(Lag1Correlation, RaisesTheAlarmForAPersistentErrorAndForNothingElse) {
  int false_alarms = 0, alarms = 0;
  for (int repetition = 0; repetition < 60; ++repetition) {
    test::Random random(4000 + static_cast<std::uint64_t>(repetition));
    const auto alarm = [&](const Noise& noise) {
      std::vector<ResidualGroup> groups;
      for (int run = 0; run < 2; ++run) groups.push_back(spans_of(drive(random, noise, 680.0, false), 30.0));
      return lag1_correlation(groups, fit_variances(groups, {.intervals = false}).theta()).alarm();
    };
    false_alarms += alarm({});
    alarms += alarm({rate_xy, rate_theta, 0.0, 0.01, 5e-4});
  }
  std::printf("  lag-1: %d of 60 alarms for a persistent error, %d of 60 for white drift\n", alarms, false_alarms);
  EXPECT_GE(alarms, 48);
  EXPECT_LE(false_alarms, 6);
}

TEST(Lag1Correlation, OfTooFewPairsSaysNothing) {
  Lag1 lag;
  lag.rho = Eigen::Vector3d::Constant(0.9);
  lag.pairs = 3;
  EXPECT_FALSE(lag.alarm());
  lag.pairs = 100;
  EXPECT_TRUE(lag.alarm());
}

// The same road driven by the model in space: nothing in the code knows the dimension.
TEST(CalibrateByTruth, InSpace) {
  test::Random random(11);
  std::vector<ResidualGroup> groups;
  for (int run = 0; run < 12; ++run) {
    DrivenPath<SE3> path;
    path.states.push_back({});
    std::vector<SE3> truth{random.pose_of<SE3>(10.0)};
    for (int k = 1; k <= 500; ++k) {
      SE3::Tangent step = SE3::Tangent::Zero();
      step[0] = 1.0;
      step[5] = 0.02;
      step[4] = 0.003;
      const SE3 U = SE3::Exp(step);
      ChainState<SE3> now = path.states.back();
      now.abscissa_m = k;
      now.pose = now.pose * U;
      path.states.push_back(now);
      SE3::Tangent eta = random.unit_normal<6>();
      eta.head<3>() *= std::sqrt(rate_xy);
      eta.tail<3>() *= std::sqrt(rate_theta);
      truth.push_back(truth.back() * U * SE3::Exp(eta));
    }
    groups.push_back(span_residuals(path, truth, 80.0, SE3::Tangent(SE3::Tangent::Constant(1e-6))));
  }
  const VarianceFit fit = fit_variances(groups, {.intervals = false});
  EXPECT_NEAR(fit[VariancePart::translation].value / rate_xy, 1.0, 0.35);
  EXPECT_NEAR(fit[VariancePart::rotation].value / rate_theta, 1.0, 0.3);
}

TEST(Inflation, IsChiSquarePerDegreeOfFreedom) {
  const PartEstimate f = inflation_estimate(300.0, 200);
  EXPECT_DOUBLE_EQ(f.value, 1.5);
  EXPECT_NEAR(f.low, 300.0 / 241.06, 1e-3);
  EXPECT_NEAR(f.high, 300.0 / 162.73, 1e-3);
  EXPECT_FALSE(inflation_estimate(0.0, 0).known);
}

}  // namespace
}  // namespace convoy
