#include "gps.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>

#include <cmath>
#include <stdexcept>
#include <vector>

namespace convoy::simulator {
namespace {

VehicleState at_step(std::uint64_t step) {
  VehicleState state;
  state.step = step;
  state.time_s = static_cast<double>(step) / 240.0;
  state.T_world_body.translation() = Eigen::Vector3d(10.0, -20.0, 0.5);
  return state;
}

std::uint64_t steps_per_frame(const GpsParams& params) {
  return static_cast<std::uint64_t>(std::lround(240.0 / params.rate_hz));
}

std::optional<GpsReading> frame(Gps& gps, const GpsParams& params, std::uint64_t number) {
  return gps.step(at_step(number * steps_per_frame(params)));
}

Eigen::Vector3d error_of(const GpsReading& reading, const GpsParams& params) {
  return reading.antenna_world_m - at_step(0).T_world_body * params.antenna_body_m;
}

GpsParams without_errors() {
  GpsParams params;
  params.error = {0.0, 0.0, 0.0, 0.0};
  return params;
}

TEST(Gps, IsWhereTheAntennaIs) {
  GpsParams params = without_errors();
  params.antenna_body_m = {0.5, -0.2, 1.5};
  Gps gps(params, 1, 1);
  VehicleState state = at_step(48);
  state.T_world_body.linear() =
      (Eigen::AngleAxisd(1.0, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitX()))
          .toRotationMatrix();
  const auto reading = gps.step(state);
  ASSERT_TRUE(reading);
  EXPECT_LT((reading->antenna_world_m - state.T_world_body * params.antenna_body_m).norm(), 1e-12);
  EXPECT_EQ(reading->stamp_s, 0.2);
  EXPECT_EQ(reading->frame, 1U);
}

// Average of e' P^-1 e / 3 over runs, chi-square of three degrees each: 1 within 4 sigma; of each axis, too.
TEST(Gps, CovarianceIsHonest) {
  for (const GpsParams& params : {standard_gps(), rtk_gps()})
    for (std::uint64_t number : {0U, 1U, 300U}) {
      Eigen::Array3d squares = Eigen::Array3d::Zero();
      int runs = 0;
      for (std::uint32_t seed = 0; seed < 2000; ++seed) {
        Gps gps(params, seed, 4);
        const auto reading = frame(gps, params, number);
        if (!reading) continue;
        const Eigen::Vector3d e = error_of(*reading, params);
        squares += e.array().square() / reading->covariance_m2.diagonal().array();
        ++runs;
      }
      EXPECT_GT(runs, 1900);
      EXPECT_NEAR(squares.sum() / (3.0 * runs), 1.0, 4.0 * std::sqrt(2.0 / (3.0 * runs)));
      for (double axis : squares) EXPECT_NEAR(axis / runs, 1.0, 4.0 * std::sqrt(2.0 / runs));
    }
}

// <e(0) e(t)> = drift^2 exp(-t / correlation time), over runs.
TEST(Gps, ErrorsStayForTheCorrelationTime) {
  const GpsParams params = standard_gps();
  constexpr int runs = 3000;
  for (double part : {0.0, 0.5, 1.0, 2.0}) {
    const auto later = static_cast<std::uint64_t>(params.rate_hz * params.correlation_s * part) + (part == 0.0 ? 1 : 0);
    double product = 0.0, variance = 0.0;
    for (std::uint32_t seed = 0; seed < runs; ++seed) {
      Gps gps(params, seed, 1);
      const auto first = frame(gps, params, 0), second = frame(gps, params, later);
      const Eigen::Vector3d a = error_of(*first, params), b = error_of(*second, params);
      product += a.x() * b.x() + a.y() * b.y();
      variance += first->covariance_m2(0, 0) + first->covariance_m2(1, 1);
    }
    const double share = 1.2 * 1.2 / (1.2 * 1.2 + 0.4 * 0.4);  // of drift in the variance
    EXPECT_NEAR(product / variance, share * std::exp(-part), 4.0 * std::sqrt(2.0 / (2.0 * runs))) << part;
  }
}

TEST(Gps, RtkIsOfCentimetresUntilItsFixIsLost) {
  GpsParams params = rtk_gps();
  params.lost_per_hour = 60.0;
  int lost = 0, all = 0;
  double fixed_squares = 0.0, lost_squares = 0.0;
  for (std::uint32_t seed = 0; seed < 40; ++seed) {
    Gps gps(params, seed, 1);
    for (std::uint64_t number = 0; number < 18000; ++number) {  // half an hour
      const auto reading = frame(gps, params, number);
      ASSERT_TRUE(reading);
      const double squares = error_of(*reading, params).head<2>().squaredNorm();
      (reading->fix ? fixed_squares : lost_squares) += squares;
      lost += !reading->fix;
      ++all;
      EXPECT_NEAR(reading->covariance_m2(0, 0), reading->fix ? 1.28e-4 : 0.0925, 1e-9);
      EXPECT_NEAR(reading->covariance_m2(2, 2), reading->fix ? 4.5e-4 : 0.37, 1e-9);
      EXPECT_NEAR(reading->drift_covariance_m2(0, 0), reading->fix ? 6.4e-5 : 0.09, 1e-9);
    }
  }
  // Once a minute of fix, for 15 s: of a renewal process.
  EXPECT_NEAR(static_cast<double>(lost) / all, 15.0 / 75.0, 0.02);
  EXPECT_NEAR(std::sqrt(fixed_squares / (all - lost) / 2), 0.0113, 0.0012);
  EXPECT_NEAR(std::sqrt(lost_squares / lost / 2), 0.304, 0.04);
}

TEST(Gps, OutagesAreGapsAndCanBeSwitchedOff) {
  GpsParams params = standard_gps();
  Gps whole(params, 3, 1);
  params.outages_per_hour = 60.0;
  params.outage_s = 20.0;
  Gps broken(params, 3, 1);
  int gone = 0, gaps = 0;
  bool before = false;
  constexpr int frames = 5 * 3600 * 10;
  for (int number = 0; number < frames; ++number) {
    const auto all = frame(whole, params, static_cast<std::uint64_t>(number));
    const auto some = frame(broken, params, static_cast<std::uint64_t>(number));
    ASSERT_TRUE(all);
    if (some) {
      EXPECT_EQ(some->antenna_world_m, all->antenna_world_m) << "an outage changes nothing but what is missing";
      EXPECT_EQ(some->frame, static_cast<std::uint32_t>(number));
    }
    gone += !some;
    gaps += !some && !before;
    before = !some;
  }
  EXPECT_NEAR(static_cast<double>(gone) / frames, 20.0 / 80.0, 0.03);
  EXPECT_NEAR(gaps, 10 * 3600 / 80.0, 4.0 * std::sqrt(450.0));
}

TEST(Gps, ReadingsDependOnTimeNotOnTheCallsBefore) {
  const GpsParams params = rtk_gps();
  Gps every(params, 9, 2), late(params, 9, 2), other(params, 9, 3);
  std::optional<GpsReading> last;
  for (std::uint64_t step = 0; step <= 24 * 50; ++step) {
    const auto reading = every.step(at_step(step));
    EXPECT_EQ(reading.has_value(), step % 24 == 0);
    if (reading) last = reading;
  }
  ASSERT_TRUE(last);
  EXPECT_EQ(frame(late, params, 50)->antenna_world_m, last->antenna_world_m);
  EXPECT_NE(frame(other, params, 50)->antenna_world_m, last->antenna_world_m);
}

TEST(Gps, RefusesWhatIsOutOfRange) {
  GpsParams params;
  params.rate_hz = 7.0;
  EXPECT_THROW(Gps(params, 1, 1), std::invalid_argument);
  params = {};
  params.error.drift_m = -1.0;
  try {
    params.validate("gps of vehicle 2");
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find("gps of vehicle 2.error.drift_m is -1"), std::string::npos);
  }
  params = {};
  params.antenna_body_m.x() = std::nan("");
  EXPECT_THROW(params.validate(), std::invalid_argument);
  Gps gps({}, 1, 1);
  gps.step(at_step(48));
  EXPECT_THROW(gps.step(at_step(0)), std::invalid_argument);
}

}  // namespace
}  // namespace convoy::simulator
