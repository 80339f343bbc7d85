// Absolute fixes from a sensor log: one vehicle, a receiver, and where it all is on the globe.
#include <gtest/gtest.h>

#include <unistd.h>

#include <cmath>
#include <fstream>

#include "command.hpp"

namespace convoy::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr double speed_m_s = 5.0, turn_rad_s = 0.05, lever_x_m = 1.0, lever_y_m = -0.5;
constexpr double datum_x_m = 400.0, datum_y_m = -250.0, datum_rad = 0.7;  // T_enu_start

struct Pose {
  double x, y, theta;
};

Pose after(double t_s) {
  const double a = turn_rad_s * t_s, r = speed_m_s / turn_rad_s;
  return {r * std::sin(a), r * (1.0 - std::cos(a)), a};
}

Pose compose(const Pose& a, const Pose& b) {
  return {a.x + std::cos(a.theta) * b.x - std::sin(a.theta) * b.y,
          a.y + std::sin(a.theta) * b.x + std::cos(a.theta) * b.y, a.theta + b.theta};
}

// Half a minute; a fix every second, one of them gross, the times between those of the odometry.
fs::path vehicle_with_receiver(const fs::path& folder, const std::string& elements) {
  fs::create_directories(folder);
  std::ofstream sensors(folder / "sensors.csv");
  sensors << "t_s,kind,a,b,c\n";
  sensors.precision(12);
  for (int i = 0; i <= 150; ++i) {
    sensors << 0.2 * i << ",odometry," << speed_m_s << ',' << turn_rad_s << ",\n";
    if (i % 5 != 0 || i == 150) continue;
    const double t_s = 0.2 * i + 0.13;
    const Pose antenna = compose(compose({datum_x_m, datum_y_m, datum_rad}, after(t_s)), {lever_x_m, lever_y_m, 0.0});
    const double gross_m = i == 75 ? 80.0 : 0.0;
    sensors << t_s << ",fix," << antenna.x + 0.2 * std::sin(3.0 * i) << ','
            << antenna.y + 0.2 * std::cos(5.0 * i) + gross_m << ",0.2\n";
  }
  std::ofstream(folder / "c.xml")
      << "<convoy version=\"1\">\n  <vehicle id=\"1\" state_folder=\"state\"/>\n  <dds domain=\"" << 5 + getpid() % 14
      << "\" profile=\"" CONVOY_SOURCE_FOLDER "/qos_profiles/loopback_udp.xml\"/>\n"
      << elements << "  <sensors file=\"sensors.csv\" rate=\"8\" fix_lever_x_m=\"" << lever_x_m << "\" fix_lever_y_m=\""
      << lever_y_m << "\"/>\n</convoy>\n";
  return folder / "c.xml";
}

int used(const json& fixes) {
  int count = 0;
  for (const json& fix : fixes) count += fix["used"] == true;
  return count;
}

TEST(AbsoluteFixes, OfASensorLogSayWhereTheCommonFrameIs) {
  const ScratchFolder scratch;
  const fs::path config = vehicle_with_receiver(scratch / "v",
                                                "  <static_bias sigma_x_m=\"0.01\" sigma_y_m=\"0.01\" "
                                                "sigma_theta_rad=\"0.001\"/>\n  <map fix_correlation_s=\"0.5\"/>\n");
  const Outcome outcome = run_convoy("vehicle --until-end " + config.string());
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  const json absolute = read_json(scratch / "v/map.json")["absolute"];
  ASSERT_FALSE(absolute["datum"].is_null());
  EXPECT_NEAR(absolute["datum"]["pose"][0].get<double>(), datum_x_m, 2.0);
  EXPECT_NEAR(absolute["datum"]["pose"][1].get<double>(), datum_y_m, 2.0);
  EXPECT_NEAR(absolute["datum"]["pose"][2].get<double>(), datum_rad, 0.03);
  EXPECT_EQ(absolute["fixes"].size(), 30U);
  EXPECT_GE(used(absolute["fixes"]), 27);
  EXPECT_EQ(absolute["fixes"][15]["used"], false) << "the gross one";
  EXPECT_EQ(read_json(scratch / "v/summary.json")["integrity"], "OK");
}

TEST(AbsoluteFixes, AlignAVehicleThatDoesNotKnowItsStartWhereTheCommonFrameIsEastNorth) {
  const ScratchFolder scratch;
  const fs::path config =
      vehicle_with_receiver(scratch / "v", "  <map common_frame_is_enu=\"true\" fix_correlation_s=\"1.5\"/>\n");
  const Outcome outcome = run_convoy("vehicle --until-end " + config.string());
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  const json map = read_json(scratch / "v/map.json"), summary = read_json(scratch / "v/summary.json");
  EXPECT_EQ(summary["integrity"], "OK");
  EXPECT_TRUE(map["absolute"]["datum"].is_null());
  EXPECT_EQ(map["absolute"]["fixes"].size(), 15U);
  EXPECT_EQ(summary["counters"]["fixes_thinned"], 15);
  const json last = map["anchors"].back();
  const Pose truth = compose({datum_x_m, datum_y_m, datum_rad}, after(last["stamp_s"]));
  EXPECT_NEAR(last["pose"][0].get<double>(), truth.x, 2.0);
  EXPECT_NEAR(last["pose"][1].get<double>(), truth.y, 2.0);
  EXPECT_NEAR(std::remainder(last["pose"][2].get<double>() - truth.theta, 2.0 * M_PI), 0.0, 0.05);
}

}  // namespace
}  // namespace convoy::testing
