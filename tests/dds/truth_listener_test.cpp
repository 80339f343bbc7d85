// Simulators that tell the truth over sockets, and the one who judges by it.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <limits>

#include <unistd.h>

#include "evaluate/run_folder.hpp"
#include "sensor_topics_testing.hpp"
#include "truth_listener.hpp"

namespace convoy::dds::testing {
namespace {

namespace edds = eprosima::fastdds::dds;
namespace fs = std::filesystem;
namespace wire = sensors::v1;
using cli::TruthListener;

constexpr VehicleId vehicle = 7;
constexpr std::uint64_t run = 5;

class Simulator {
 public:
  explicit Simulator(bool lying = false)
      : poses(participant_.writer(new wire::TruthPubSubType, "Truth")),
        depths(participant_.writer(depth_type(lying), "TruthDepth")) {}

 private:
  static edds::TopicDataType* depth_type(bool lying) {
    if (lying) return new Liar<wire::TruthDepthPubSubType>;
    return new wire::TruthDepthPubSubType;
  }
  SensorParticipant participant_;

 public:
  edds::DataWriter* const poses;
  edds::DataWriter* const depths;
};

wire::Truth pose(std::uint32_t step, double x_m) {
  auto sample = sample_of<wire::Truth>(vehicle, run, 0.1 * step, step);
  sample.T_world_body({x_m, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0});
  return sample;
}

wire::TruthDepth depth(std::uint32_t step, float each_m) {
  auto sample = sample_of<wire::TruthDepth>(vehicle, run, 0.1 * step, step);
  sample.width(4);
  sample.height(2);
  sample.depth(std::vector<float>(8, each_m));
  return sample;
}

template <class Sample>
void say(edds::DataWriter* writer, Sample sample) {
  ASSERT_TRUE(writer->write(&sample));
}

class Truth : public ::testing::Test {
 protected:
  Truth() { fs::create_directories(cli::vehicle_folder(folder, vehicle)); }
  ~Truth() override { fs::remove_all(folder); }

  bool hears(const std::function<bool()>& done) {
    return eventually([&] {
      listener.take();
      return done();
    });
  }
  bool refuses(std::uint64_t foreign, std::uint64_t unusable) {
    return hears([&] { return listener.counters().foreign == foreign && listener.counters().unusable == unusable; });
  }
  bool has_poses(std::size_t count) {  // and the one at t = 0
    return hears([&] { return listener.path(vehicle).size() == count + 1; });
  }
  /// The vehicle sees a landmark in the middle of the picture of that step, straight ahead of its body.
  void see(std::uint32_t step) {
    std::ofstream(cli::vehicle_folder(folder, vehicle) / "sightings.csv", std::ios::app)
        << "3," << 0.1 * step << ",1,1,0,0,0,1,0,0\n";
    listener.take();
  }
  /// The track of that landmark, as soon as the depth of the step has come in.
  std::string track_seen_in(std::uint32_t step) {
    EXPECT_TRUE(eventually([&] {
      see(step);
      return !track().empty();
    }));
    return track();
  }
  std::string track() {
    listener.write_tracks();
    std::ifstream in(cli::tracks_file(folder, vehicle));
    std::string header, row;
    std::getline(in, header);
    std::getline(in, row);
    return row;
  }

  const fs::path folder = fs::temp_directory_path() / ("convoy_truth_" + std::to_string(getpid()));
  TruthListener listener{domain_of_this_test(), run, folder, {vehicle}};
};

TEST_F(Truth, OfAnotherRunIsNotMixedWithThatOfThisOne) {
  Simulator own, other;
  const auto foreign = [](auto sample) {
    sample.header().run(run + 1);
    return sample;
  };
  say(other.poses, foreign(pose(1, 100.0)));
  ASSERT_TRUE(refuses(1, 0)) << "though it is heard first";
  say(own.poses, pose(1, 10.0));
  say(own.depths, depth(1, 2.0F));
  ASSERT_TRUE(has_poses(1));
  say(other.poses, foreign(pose(1, 200.0)));
  say(other.poses, foreign(pose(2, 200.0)));
  say(other.depths, foreign(depth(1, 50.0F)));
  ASSERT_TRUE(refuses(4, 0)) << listener.counters().foreign;
  const auto path = listener.path(vehicle);
  ASSERT_EQ(path.size(), 2U);
  EXPECT_EQ(path[1].T_world_body.translation().x(), 10.0);
  EXPECT_EQ(listener.time_s(), 0.1);
  EXPECT_EQ(track_seen_in(1), "3,12,0,0,1");
}

TEST_F(Truth, ThatIsNoneIsCountedAndTheRestIsHeard) {
  Simulator own;
  say(own.poses, pose(1, 10.0));
  ASSERT_TRUE(has_poses(1));
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  say(own.poses, pose(2, nan));
  auto no_turn = pose(2, 0.0);
  no_turn.T_world_body({0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0});
  say(own.poses, no_turn);
  auto no_time = pose(2, 0.0);
  no_time.header().stamp_s(nan);
  say(own.poses, no_time);
  ASSERT_TRUE(refuses(0, 3)) << listener.counters().unusable;
  say(own.poses, pose(3, 30.0));
  ASSERT_TRUE(has_poses(2));
  EXPECT_EQ(listener.path(vehicle)[2].T_world_body.translation().x(), 30.0);
}

TEST_F(Truth, ADepthThatIsNotOfEachPixelIsCountedAndNotUsed) {
  Simulator own;
  say(own.poses, pose(1, 10.0));
  auto short_of_pixels = depth(1, 5.0F);
  short_of_pixels.depth().pop_back();
  say(own.depths, short_of_pixels);
  auto too_many = depth(1, 5.0F);
  too_many.depth().push_back(5.0F);
  say(own.depths, too_many);
  auto huge = depth(1, 5.0F);  // 2^32 pixels: none, as 32 bits have it
  huge.width(1U << 31);
  huge.height(2);
  huge.depth().clear();
  say(own.depths, huge);
  ASSERT_TRUE(refuses(0, 3)) << listener.counters().unusable;
  ASSERT_TRUE(has_poses(1));
  see(1);
  EXPECT_EQ(track(), "");
  say(own.poses, pose(2, 20.0));
  say(own.depths, depth(2, 2.0F));
  ASSERT_TRUE(has_poses(2));
  EXPECT_EQ(track_seen_in(2), "3,22,0,0,1");
}

TEST_F(Truth, ALengthThatIsALieAllocatesNothing) {
  Simulator lying(true);
  say(lying.depths, depth(1, 5.0F));
  EXPECT_TRUE(refuses(0, 1));
}

}  // namespace
}  // namespace convoy::dds::testing
