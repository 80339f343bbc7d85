// Sensors that say something over sockets, and the reader that a vehicle hears them by.
#include <convoy/config_error.hpp>
#include <convoy/dds/sensor_reader.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>

#include <algorithm>
#include <array>
#include <limits>

#include "sensor_topics_testing.hpp"

namespace convoy::dds::testing {
namespace {

namespace edds = eprosima::fastdds::dds;
namespace wire = sensors::v1;
using eprosima::fastrtps::types::ReturnCode_t;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr VehicleId vehicle = 7;
constexpr std::uint64_t run = 5;
constexpr double nan = std::numeric_limits<double>::quiet_NaN();

/// Drivers of two vehicles' sensors, or a simulator.
class Sensors {
 public:
  explicit Sensors(bool lying = false) {
    if (lying) frames = participant_.writer(new Liar<wire::CameraFramePubSubType>, "CameraFrame");
    else frames = participant_.writer(new wire::CameraFramePubSubType, "CameraFrame");
    odometry = participant_.writer(new wire::OdometryPubSubType, "Odometry");
    gps = participant_.writer(new wire::GpsPubSubType, "Gps");
    cameras = participant_.writer(new wire::CameraCalibrationPubSubType, "CameraCalibration");
    steps = participant_.writer(new wire::StepPubSubType, "Step");
    auto* subscriber = participant_->create_subscriber(edds::SubscriberQos());
    edds::DataReaderQos reader_qos;
    reader_qos.reliability().kind = edds::RELIABLE_RELIABILITY_QOS;
    reader_qos.durability().kind = edds::TRANSIENT_LOCAL_DURABILITY_QOS;
    reader_qos.history().kind = edds::KEEP_ALL_HISTORY_QOS;
    reader_qos.data_sharing().off();
    done_ = subscriber->create_datareader(participant_.topic(new wire::StepDonePubSubType, "StepDone"), reader_qos);
  }

  edds::DataWriter *frames, *odometry, *gps, *cameras, *steps;

  /// run and step of what the vehicle has said next.
  std::pair<std::uint64_t, std::uint32_t> answer() {
    wire::StepDone done;
    edds::SampleInfo info;
    EXPECT_TRUE(eventually([&] { return done_->take_next_sample(&done, &info) == ReturnCode_t::RETCODE_OK; }));
    EXPECT_EQ(done.vehicle(), vehicle);
    return {done.run(), done.step()};
  }

 private:
  SensorParticipant participant_;
  edds::DataReader* done_;
};

template <class Sample>
Sample sample_of(double stamp_s, std::uint32_t step = 0) {
  return dds::testing::sample_of<Sample>(vehicle, run, stamp_s, step);
}
wire::CameraFrame picture(double stamp_s, std::uint32_t number, std::uint32_t step = 0) {
  auto sample = sample_of<wire::CameraFrame>(stamp_s, step);
  sample.frame(number);
  sample.width(4);
  sample.height(2);
  sample.grey({0, 1, 2, 3, 4, 5, 6, 255});
  return sample;
}
wire::Odometry odometry(double stamp_s, std::uint32_t number, std::uint32_t step = 0) {
  auto sample = sample_of<wire::Odometry>(stamp_s, step);
  sample.reading(number);
  sample.distance_m(0.25);
  sample.speed_mps(5.0);
  sample.gyro_yaw_rate_radps(0.5);
  sample.sigma_distance_m(0.01);
  return sample;
}
wire::Gps position(double stamp_s, std::uint32_t number, std::uint32_t step = 0) {
  auto sample = sample_of<wire::Gps>(stamp_s, step);
  sample.reading(number);
  sample.kind(wire::GPS_RTK);
  sample.fix(true);
  sample.antenna_body({1.0, 0.0, 2.0});
  sample.position({10.0, 20.0, 30.0});
  sample.covariance({4.0, 1.0, 0.0, 4.0, 0.0, 9.0});
  sample.correlation_s(60.0);
  return sample;
}
wire::CameraCalibration calibration() {
  auto sample = sample_of<wire::CameraCalibration>(0.0);
  sample.width(640);
  sample.height(480);
  sample.rate_hz(10.0);
  sample.fx(400.0);
  sample.fy(401.0);
  sample.cx(320.0);
  sample.cy(240.0);
  sample.distortion({-0.1, 0.01, 0.0, 0.0, 0.0});
  sample.T_body_camera({1.5, 0.0, 1.4, 0.5, -0.5, 0.5, -0.5});
  return sample;
}

template <class Sample>
void say(edds::DataWriter* writer, Sample sample) {
  ASSERT_TRUE(writer->write(&sample));
}

SensorReaderParams params(bool lock_step = false) {
  SensorReaderParams params;
  params.domain = domain_of_this_test();
  params.vehicle = vehicle;
  params.lock_step = lock_step;
  return params;
}

/// Batches until there are as many readings, or the deadline has passed.
std::vector<SensorReading> readings(SensorReader& reader, std::size_t count) {
  std::vector<SensorReading> all;
  while (all.size() < count) {
    auto batch = reader.next(deadline_s);
    if (!batch) break;
    EXPECT_EQ(batch->run, run);
    EXPECT_EQ(batch->step, 0U);
    for (SensorReading& reading : batch->readings) all.push_back(std::move(reading));
  }
  EXPECT_EQ(all.size(), count);
  return all;
}

TEST(SensorReader, OnTheClockHandsOutWhatItsOwnVehicleSenses) {
  Sensors sensors;
  SensorReader reader(params());
  auto of_another = odometry(0.5, 1);
  of_another.vehicle(vehicle + 1);
  say(sensors.odometry, of_another);
  say(sensors.odometry, odometry(1.0, 1));
  say(sensors.gps, position(1.1, 0));
  say(sensors.frames, picture(1.2, 0));
  auto all = readings(reader, 3);
  std::sort(all.begin(), all.end(), [](const auto& a, const auto& b) { return stamp_of(a) < stamp_of(b); });
  ASSERT_EQ(all.size(), 3U);
  const auto& o = std::get<OdometryReading>(all[0]);
  EXPECT_EQ(o.stamp_s, 1.0);
  EXPECT_EQ(o.number, 1U);
  EXPECT_EQ(o.distance_m, 0.25);
  EXPECT_EQ(o.speed_m_s, 5.0);
  EXPECT_EQ(o.gyro_yaw_rate_rad_s, 0.5);
  EXPECT_EQ(o.sigma_distance_m, 0.01);
  const auto& g = std::get<GpsReading>(all[1]);
  EXPECT_TRUE(g.rtk && g.fix);
  EXPECT_EQ(g.antenna, Eigen::Vector3d(1, 0, 2));
  EXPECT_EQ(g.position, Eigen::Vector3d(10, 20, 30));
  EXPECT_EQ(g.covariance, (Eigen::Matrix3d() << 4, 1, 0, 1, 4, 0, 0, 0, 9).finished());
  EXPECT_EQ(g.correlation_s, 60.0);
  const auto& f = std::get<CameraFrame>(all[2]);
  EXPECT_EQ(f.width, 4);
  EXPECT_EQ(f.height, 2);
  EXPECT_THAT(f.grey, ElementsAre(0, 1, 2, 3, 4, 5, 6, 255));
  EXPECT_FALSE(reader.next(0.2));
  EXPECT_EQ(reader.counters().readings, 3U);
}

TEST(SensorReader, InLockStepHandsOutWholeStepsAndAnswersThem) {
  Sensors sensors;
  SensorReader reader(params(true));
  EXPECT_EQ(sensors.answer(), std::pair(std::uint64_t{0}, 0U)) << "it is there";
  auto step = sample_of<wire::Step>(0.1, 1);
  step.frames(1);
  step.odometry(2);
  say(sensors.steps, step);
  say(sensors.odometry, odometry(0.1, 2, 1));
  say(sensors.frames, picture(0.05, 0, 1));
  EXPECT_FALSE(reader.next(0.5)) << "a reading is missing";
  say(sensors.odometry, odometry(0.2, 3, 1));
  const auto batch = reader.next(deadline_s);
  ASSERT_TRUE(batch);
  EXPECT_EQ(batch->step, 1U);
  EXPECT_FALSE(batch->last);
  ASSERT_EQ(batch->readings.size(), 3U);
  EXPECT_TRUE(std::holds_alternative<CameraFrame>(batch->readings[0])) << "by stamp";
  EXPECT_EQ(stamp_of(batch->readings[2]), 0.2);
  reader.done(*batch);
  EXPECT_EQ(sensors.answer(), std::pair(run, 1U));
  auto empty = sample_of<wire::Step>(0.2, 2);
  empty.last(true);
  say(sensors.steps, empty);
  const auto last = reader.next(deadline_s);
  ASSERT_TRUE(last);
  EXPECT_TRUE(last->last);
  EXPECT_TRUE(last->readings.empty());
  say(sensors.steps, step);  // again
  EXPECT_FALSE(reader.next(0.3));
  EXPECT_EQ(reader.counters().stale, 1U);
}

TEST(SensorReader, WhatIsNoReadingIsCountedAndTheRestIsHeard) {
  Sensors sensors;
  SensorReader reader(params());
  auto short_of_pixels = picture(1.0, 0);
  short_of_pixels.grey({1, 2, 3});
  say(sensors.frames, short_of_pixels);
  auto huge = picture(1.0, 1);
  huge.width(100'000);
  say(sensors.frames, huge);
  auto empty = picture(1.0, 2);
  empty.width(0);
  empty.grey({});
  say(sensors.frames, empty);
  say(sensors.frames, picture(nan, 3));
  for (const auto spoil : {+[](wire::Odometry& o) { o.distance_m(nan); },
                           +[](wire::Odometry& o) { o.gyro_yaw_rate_radps(std::numeric_limits<double>::infinity()); },
                           +[](wire::Odometry& o) { o.sigma_distance_m(-1.0); }}) {
    auto spoilt = odometry(1.0, 1);
    spoil(spoilt);
    say(sensors.odometry, spoilt);
  }
  for (const auto spoil : {+[](wire::Gps& g) {
                             g.covariance({1.0, 2.0, 0.0, 1.0, 0.0, 1.0});
                           },
                           +[](wire::Gps& g) { g.correlation_s(0.0); },
                           +[](wire::Gps& g) {
                             g.position({nan, 0.0, 0.0});
                           }}) {
    auto spoilt = position(1.0, 0);
    spoil(spoilt);
    say(sensors.gps, spoilt);
  }
  EXPECT_FALSE(reader.next(1.0));
  EXPECT_TRUE(eventually([&] {
    EXPECT_FALSE(reader.next(0.1));
    return reader.counters().hostile == 10;
  })) << reader.counters().hostile;
  say(sensors.odometry, odometry(2.0, 1));
  say(sensors.odometry, odometry(2.0, 1));  // twice
  say(sensors.odometry, odometry(3.0, 4));
  EXPECT_EQ(readings(reader, 2).size(), 2U);
  EXPECT_EQ(reader.counters().stale, 1U);
  EXPECT_EQ(reader.counters().lost, 2U);
}

TEST(SensorReader, ALengthThatIsALieAllocatesNothing) {
  Sensors sensors(true);
  SensorReader reader(params());
  say(sensors.frames, picture(1.0, 0));
  EXPECT_TRUE(eventually([&] {
    EXPECT_FALSE(reader.next(0.1));
    return reader.counters().hostile == 1;
  }));
}

TEST(SensorReader, WhoBeginsAnewIsHeardAndItsEarlierRunIsNot) {
  Sensors sensors;
  SensorReader reader(params());
  say(sensors.odometry, odometry(100.0, 500));
  (void)readings(reader, 1);
  auto anew = odometry(0.1, 1);
  anew.header().run(run + 1);
  say(sensors.odometry, anew);
  const auto batch = reader.next(deadline_s);
  ASSERT_TRUE(batch);
  EXPECT_EQ(batch->run, run + 1);
  ASSERT_EQ(batch->readings.size(), 1U);
  say(sensors.odometry, odometry(100.1, 501));
  EXPECT_FALSE(reader.next(0.5));
  EXPECT_EQ(reader.counters().stale, 1U);
}

TEST(SensorReader, OfTwoWhoSendTheSameTheFirstIsHeardForAsLongAsItIsThere) {
  auto first = std::make_unique<Sensors>();
  SensorReader reader(params());
  say(first->odometry, odometry(1.0, 1));
  say(first->frames, picture(1.0, 1));
  say(first->cameras, calibration());
  (void)readings(reader, 2);
  EXPECT_TRUE(eventually([&] {
    EXPECT_FALSE(reader.next(0.1));
    return reader.camera().has_value();
  }));

  Sensors second;
  auto other_camera = calibration();
  other_camera.fx(999.0);
  say(second.odometry, odometry(2.0, 2));
  say(second.frames, picture(2.0, 2));
  say(second.cameras, other_camera);
  EXPECT_TRUE(eventually([&] {
    EXPECT_FALSE(reader.next(0.1));
    return reader.counters().foreign == 3;
  })) << reader.counters().foreign;
  EXPECT_EQ(reader.camera()->calibration.fx, 400.0);
  say(first->odometry, odometry(2.5, 2));
  EXPECT_EQ(stamp_of(readings(reader, 1).at(0)), 2.5);

  first.reset();
  std::uint32_t number = 3;
  EXPECT_TRUE(eventually([&] {
    say(second.odometry, odometry(number, number));
    ++number;
    return reader.next(0.1).has_value();
  }));
}

TEST(SensorReader, TheCameraIsThatOfTheRunThatIsHeard) {
  Sensors first, second;
  SensorReader reader(params());
  say(first.cameras, calibration());
  say(first.odometry, odometry(1.0, 1));
  (void)readings(reader, 1);
  EXPECT_TRUE(eventually([&] {
    EXPECT_FALSE(reader.next(0.1));
    return reader.camera().has_value();
  }));
  EXPECT_EQ(reader.camera()->run, run);
  auto other_camera = calibration();
  other_camera.header().run(run + 1);
  other_camera.fx(999.0);
  say(second.cameras, other_camera);
  EXPECT_TRUE(eventually([&] {
    EXPECT_FALSE(reader.next(0.1));
    return reader.camera()->run == run + 1;
  }));
  say(first.odometry, odometry(2.0, 2));
  EXPECT_FALSE(reader.next(0.5)) << "readings of one run with the camera of another";
  EXPECT_EQ(reader.counters().stale, 1U);
}

TEST(SensorReader, OfARunThatHasBegunThereIsNoCameraUntilItIsSaid) {
  Sensors first, second;
  SensorReader reader(params());
  const auto has_camera = [&] {
    (void)reader.next(0.1);
    return reader.camera().has_value();
  };
  say(first.cameras, calibration());
  EXPECT_TRUE(eventually(has_camera));
  auto anew = odometry(0.1, 1);
  anew.header().run(run + 1);
  say(second.odometry, anew);
  const auto batch = reader.next(deadline_s);
  ASSERT_TRUE(batch);
  EXPECT_EQ(batch->run, run + 1);
  EXPECT_FALSE(reader.camera()) << "that of the run before";

  auto other_camera = calibration();
  other_camera.header().run(run + 1);
  say(second.cameras, other_camera);
  ASSERT_EQ(second.cameras->wait_for_acknowledgments({20, 0}), ReturnCode_t::RETCODE_OK);
  say(first.cameras, calibration());  // takes nothing from the one that is not yet taken
  ASSERT_EQ(first.cameras->wait_for_acknowledgments({20, 0}), ReturnCode_t::RETCODE_OK);
  EXPECT_TRUE(eventually(has_camera));
  EXPECT_EQ(reader.camera()->run, run + 1);
}

TEST(SensorReader, SaysWhatTheCameraIsAlsoToWhoComesLate) {
  Sensors sensors;
  say(sensors.cameras, calibration());
  SensorReader reader(params());
  EXPECT_FALSE(reader.camera());
  EXPECT_TRUE(eventually([&] {
    (void)reader.next(0.1);
    return reader.camera().has_value();
  }));
  const MountedCamera camera = *reader.camera();
  EXPECT_EQ(camera.calibration.width, 640);
  EXPECT_EQ(camera.calibration.fy, 401.0);
  EXPECT_EQ(camera.calibration.coefficients[0], -0.1);
  EXPECT_EQ(camera.rate_hz, 10.0);
  const Eigen::Vector3d ahead = camera.T_body_camera * Eigen::Vector3d(0.0, 0.0, 1.0);
  EXPECT_TRUE(ahead.isApprox(Eigen::Vector3d(2.5, 0.0, 1.4), 1e-12)) << ahead.transpose();
}

TEST(SensorReader, ACameraThatIsNoneIsAClearError) {
  Sensors sensors;
  auto broken = calibration();
  broken.fx(0.0);
  say(sensors.cameras, broken);
  SensorReader reader(params());
  EXPECT_TRUE(eventually([&] {
    (void)reader.next(0.1);
    try {
      return reader.camera().has_value();
    } catch (const ConfigError&) {
      return true;
    }
  }));
  EXPECT_THROW((void)reader.camera(), ConfigError);
}

TEST(SensorReader, ParametersOutOfRangeAreNamed) {
  const auto fault = [](const auto& spoil) {
    SensorReaderParams spoilt = params();
    spoil(spoilt);
    try {
      SensorReader reader(spoilt);
    } catch (const ConfigError& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_THAT(fault([](auto& p) { p.domain = 233; }), HasSubstr("domain must lie in 0..232"));
  EXPECT_THAT(fault([](auto& p) { p.vehicle = 0; }), HasSubstr("vehicle must be 1 or more"));
  EXPECT_THAT(fault([](auto& p) { p.interfaces = {}; }), HasSubstr("127.0.0.1"));
  EXPECT_THAT(fault([](auto& p) { p.queued_frames = 0; }), HasSubstr("queued_frames"));
  EXPECT_THAT(fault([](auto& p) { p.queued_readings = 1; }), HasSubstr("queued_readings"));
}

TEST(SensorReader, DrivesThroughTheSimulatorStepByStep) {
  const std::string simulator = CONVOY_SIM;
  if (simulator.empty()) GTEST_SKIP() << "the simulator is not built (CONVOY_BUILD_SIMULATOR)";
  const std::uint32_t domain = domain_of_this_test();
  Child sim({simulator, "--lock-step", "--vehicles", "1", "--duration", "2", "--gps", "rtk", "--drop", "0", "--camera",
             "64x48", "--world", CONVOY_SIM_TEST_MAP, "--domain-sensors", std::to_string(domain), "--domain-truth",
             std::to_string(domain - 1), "--run=77"});
  SensorReaderParams of_one = params(true);
  of_one.vehicle = 1;
  SensorReader reader(of_one);
  std::array<std::size_t, 3> count{};
  double distance_m = 0.0, stamp_s = 0.0;
  for (bool last = false; !last;) {
    const auto batch = reader.next(deadline_s);
    ASSERT_TRUE(batch);
    EXPECT_EQ(batch->run, 77U);
    for (const SensorReading& reading : batch->readings) {
      ++count[reading.index()];
      stamp_s = std::max(stamp_s, stamp_of(reading));
      if (const auto* o = std::get_if<OdometryReading>(&reading)) distance_m += o->distance_m;
      if (const auto* f = std::get_if<CameraFrame>(&reading)) {
        EXPECT_EQ(f->grey.size(), 64U * 48U);
      }
    }
    last = batch->last;
    reader.done(*batch);
  }
  EXPECT_EQ(sim.finish(), 0);
  EXPECT_EQ(count[2], 20U) << "two seconds at 10 Hz";
  EXPECT_GT(count[0], 20U);
  EXPECT_GT(count[1], 0U);
  EXPECT_GT(distance_m, 0.5);
  EXPECT_NEAR(stamp_s, 2.0, 0.1);
  ASSERT_TRUE(reader.camera());
  EXPECT_EQ(reader.camera()->calibration.width, 64);
  EXPECT_EQ(reader.counters().hostile + reader.counters().undecodable + reader.counters().lost, 0U);
}

}  // namespace
}  // namespace convoy::dds::testing
