#include "scenario/street.hpp"

#include <gtest/gtest.h>
#include <convoy/config_error.hpp>

#include <set>

#include "evaluate/truth.hpp"
#include "fake_run.hpp"

namespace convoy::cli {
namespace {

constexpr std::uint64_t seed = 11;

std::vector<SensorEvent> of_kind(const VehicleLog<SE2>& log, SensorEvent::Kind kind) {
  std::vector<SensorEvent> events;
  for (const SensorEvent& event : log.sensors)
    if (event.kind == kind) events.push_back(event);
  return events;
}

std::string bytes_of(const Scenario<SE2>& scenario) {
  const test::TemporaryFolder folder;
  scenario.write(folder.path());
  std::string all;
  for (const char* file : {"scenario.json", "truth/landmarks.csv", "truth/vehicle_1.csv", "truth/vehicle_2.csv",
                           "vehicle_1/sensors.csv", "vehicle_2/sensors.csv"})
    all += test::read(folder / file);
  return all;
}

TEST(Street, IsTheSameForTheSameSeedAndNoOther) {
  EXPECT_EQ(bytes_of(make_street<SE2>({}, seed)), bytes_of(make_street<SE2>({}, seed)));
  EXPECT_NE(bytes_of(make_street<SE2>({}, seed)), bytes_of(make_street<SE2>({}, seed + 1)));
}

TEST(Street, OneNoiseLeavesAllOtherReadingsAlone) {
  StreetParams noisy_range;
  noisy_range.range_sigma_share = 0.05;
  const Scenario<SE2> a = make_street<SE2>({}, seed), b = make_street<SE2>(noisy_range, seed);
  for (std::size_t v = 0; v < 2; ++v) {
    EXPECT_EQ(of_kind(a.vehicles[v], SensorEvent::Kind::odometry), of_kind(b.vehicles[v], SensorEvent::Kind::odometry));
    auto seen_a = of_kind(a.vehicles[v], SensorEvent::Kind::sighting);
    auto seen_b = of_kind(b.vehicles[v], SensorEvent::Kind::sighting);
    ASSERT_EQ(seen_a.size(), seen_b.size());
    EXPECT_NE(seen_a, seen_b);
    for (auto* seen : {&seen_a, &seen_b})
      for (SensorEvent& event : *seen) event.range_m = 1.0;
    EXPECT_EQ(seen_a, seen_b);
  }
}

TEST(Street, IsThePapersExperiment) {
  const Scenario<SE2> scenario = make_street<SE2>({}, seed);
  ASSERT_EQ(scenario.vehicles.size(), 2U);
  const VehicleLog<SE2>&front = scenario.vehicles[0], &back = scenario.vehicles[1];
  EXPECT_EQ(scenario.common_frame_vehicle, front.id);
  EXPECT_EQ(front.truth.front().T_world_body.translation(), Eigen::Vector2d::Zero());
  EXPECT_EQ(back.truth.front().T_world_body.translation(), Eigen::Vector2d(-20.0, 0.0));
  EXPECT_EQ(back.truth.front().T_world_body.theta(), 0.0);
  double distance = 0.0, top_speed = 0.0;
  for (std::size_t i = 1; i < front.truth.size(); ++i) {
    const double step =
        (front.truth[i].T_world_body.translation() - front.truth[i - 1].T_world_body.translation()).norm();
    distance += step;
    top_speed = std::max(top_speed, step / (front.truth[i].t_s - front.truth[i - 1].t_s));
  }
  EXPECT_NEAR(distance, StreetParams{}.distance_m, 0.5);
  EXPECT_NEAR(top_speed, 2.0, 0.15);
  ASSERT_TRUE(front.prior && back.prior);
  EXPECT_EQ(front.prior->sigma[0] + front.prior->sigma[1] + front.prior->sigma[2], 0.0);
  EXPECT_NEAR(back.prior->sigma[0] * std::sqrt(-2.0 * std::log(0.05)), 22.0, 1e-9);
}

TEST(Street, LandmarksStandApartAndBesideTheStreet) {
  const StreetParams params;
  const Scenario<SE2> scenario = make_street<SE2>(params, seed);
  const double street_m = params.distance_m + params.gap_m;
  EXPECT_GT(static_cast<double>(scenario.landmarks.size()), 0.8 * street_m);
  EXPECT_LT(static_cast<double>(scenario.landmarks.size()), 1.3 * street_m);
  std::set<std::uint32_t> ids;
  for (std::size_t i = 0; i < scenario.landmarks.size(); ++i) {
    const TruthLandmark<SE2>& landmark = scenario.landmarks[i];
    ids.insert(landmark.id);
    for (std::size_t k = 0; k < i; ++k)
      ASSERT_GE((landmark.p_world_m - scenario.landmarks[k].p_world_m).norm(), params.landmark_spacing_m - 1e-5);
    for (const VehicleLog<SE2>& vehicle : scenario.vehicles)
      for (std::size_t k = 0; k < vehicle.truth.size(); k += 10)
        ASSERT_GE((landmark.p_world_m - vehicle.truth[k].T_world_body.translation()).norm(),
                  params.landmark_near_m - 0.1);
  }
  EXPECT_EQ(ids.size(), scenario.landmarks.size());
}

TEST(Street, SensorsErrAsDocumented) {
  const StreetParams params;
  const Scenario<SE2> scenario = make_street<SE2>(params, seed);
  for (const VehicleLog<SE2>& log : scenario.vehicles) {
    double range = 0, bearing = 0, product = 0, speed = 0, yaw = 0;
    int sightings = 0, readings = 0;
    std::map<std::uint32_t, Eigen::Vector2d> place;
    for (const TruthLandmark<SE2>& l : scenario.landmarks) place[l.id] = l.p_world_m;
    for (const SensorEvent& e : log.sensors) {
      const auto T = truth_at(log.truth, e.t_s);
      ASSERT_TRUE(T);
      if (e.kind == SensorEvent::Kind::sighting) {
        const Eigen::Vector2d q = T->inverse() * place.at(e.track);
        EXPECT_LE(q.norm(), params.range_max_m);
        EXPECT_LE(std::abs(std::atan2(q.y(), q.x())), 0.5 * params.field_of_view_rad);
        const double range_error =
            (e.range_m - q.norm()) / (params.range_sigma_m + params.range_sigma_share * q.norm());
        const double bearing_error = (e.bearing_rad - std::atan2(q.y(), q.x())) / params.bearing_sigma_rad;
        range += range_error * range_error;
        bearing += bearing_error * bearing_error;
        product += range_error * bearing_error;
        ++sightings;
      } else if (const auto next = truth_at(log.truth, e.t_s + 0.05)) {
        const auto moved = (T->inverse() * *next).Log();
        speed += std::pow((e.v_m_s - moved[0] / 0.05) / params.speed_sigma_m_s, 2);
        yaw += std::pow((e.omega_rad_s - moved[2] / 0.05) / (params.yaw_rate_density_rad_sqrt_s * std::sqrt(20.0)), 2);
        ++readings;
      }
    }
    EXPECT_GT(sightings, 8000);
    EXPECT_NEAR(range / sightings, 1.0, 0.06);
    EXPECT_NEAR(bearing / sightings, 1.0, 0.06);
    EXPECT_NEAR(product / sightings, 0.0, 0.05);  // streams of their own
    EXPECT_NEAR(speed / readings, 1.0, 0.25);     // the scale error adds to it
    EXPECT_NEAR(yaw / readings, 1.0, 0.1);
  }
}

TEST(Street, EachVehicleSeesItsOwnShareOfTheLandmarks) {
  const Scenario<SE2> scenario = make_street<SE2>({}, seed);
  std::set<std::uint32_t> seen[2], common;
  for (int v = 0; v < 2; ++v)
    for (const SensorEvent& event :
         of_kind(scenario.vehicles[static_cast<std::size_t>(v)], SensorEvent::Kind::sighting))
      seen[v].insert(event.track);
  std::set_intersection(seen[0].begin(), seen[0].end(), seen[1].begin(), seen[1].end(),
                        std::inserter(common, common.end()));
  const auto all = static_cast<double>(scenario.landmarks.size());
  for (const auto& s : seen) EXPECT_NEAR(static_cast<double>(s.size()) / all, 0.65, 0.1);
  EXPECT_NEAR(static_cast<double>(common.size()) / all, 0.43, 0.1);
}

TEST(Street, RefusesParametersOutOfRange) {
  const auto refused = [](auto change) {
    StreetParams params;
    change(params);
    return !test::config_error_of([&] { make_street<SE2>(params, 1); }).empty();
  };
  EXPECT_TRUE(refused([](StreetParams& p) { p.turns.push_back(1); }));
  EXPECT_TRUE(refused([](StreetParams& p) { p.distance_m = 1e4; }));
  EXPECT_TRUE(refused([](StreetParams& p) { p.speed_m_s = 0.0; }));
  EXPECT_TRUE(refused([](StreetParams& p) { p.camera_rate_hz = 7.0; }));
  EXPECT_TRUE(refused([](StreetParams& p) { p.detectability = 1.5; }));
  EXPECT_TRUE(refused([](StreetParams& p) { p.bearing_sigma_rad = -1.0; }));
  EXPECT_FALSE(refused([](StreetParams&) {}));
}

}  // namespace
}  // namespace convoy::cli
