// A vehicle as the simulator sees one, for the tests: takes what belongs to a step, says what it was, says StepDone. It
// knows of the simulator what idl/sensors.idl says.
#include <convoy/idl/sensorsPubSubTypes.h>

#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

namespace {

namespace edds = eprosima::fastdds::dds;
namespace v1 = convoy::sensors::v1;
using eprosima::fastrtps::types::ReturnCode_t;
using Clock = std::chrono::steady_clock;

struct Options {
  std::uint32_t domain = 0, vehicle = 1;
  std::uint32_t silent_from = 0;   // step from which it does not answer any more; 0: it does
  int delay_ms = 0;                // for each step
  bool garbage = false;            // answers first what nobody can read
  bool stale = false;              // says after each answer once more that it is there, and another step of another run
  std::uint32_t truth_domain = 0;  // where it hears the truth, as a judge would; 0: it does not
};

Options options_of(int argc, char** argv) {
  Options options;
  for (int i = 1; i + 1 < argc; i += 2) {
    const std::string name = argv[i];
    const auto value = static_cast<std::uint32_t>(std::strtoul(argv[i + 1], nullptr, 10));
    if (name == "--domain") options.domain = value;
    if (name == "--vehicle") options.vehicle = value;
    if (name == "--silent-from") options.silent_from = value;
    if (name == "--delay-ms") options.delay_ms = static_cast<int>(value);
    if (name == "--garbage") options.garbage = value != 0;
    if (name == "--stale") options.stale = value != 0;
    if (name == "--truth-domain") options.truth_domain = value;
  }
  return options;
}

std::uint64_t fnv1a(const std::vector<std::uint8_t>& bytes) {
  std::uint64_t hash = 0xcbf29ce484222325ULL;
  for (const std::uint8_t byte : bytes) hash = (hash ^ byte) * 0x100000001b3ULL;
  return hash;
}

/// StepDone, but for its encapsulation.
class Garbage final : public v1::StepDonePubSubType {
 public:
  bool serialize(void* data, eprosima::fastrtps::rtps::SerializedPayload_t* payload) override {
    if (!v1::StepDonePubSubType::serialize(data, payload)) return false;
    payload->data[0] = payload->data[1] = 0x7f;
    return true;
  }
};

/// Readers and writers in one domain, on the loopback device.
class Domain {
 public:
  explicit Domain(std::uint32_t domain) {
    edds::DomainParticipantQos qos;
    auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    udp->interfaceWhiteList = {"127.0.0.1"};
    udp->receiveBufferSize = 4 << 20;
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports = {udp};
    participant_ = edds::DomainParticipantFactory::get_instance()->create_participant(domain, qos);
    publisher_ = participant_->create_publisher(edds::PublisherQos());
    subscriber_ = participant_->create_subscriber(edds::SubscriberQos());
  }
  ~Domain() {
    participant_->delete_contained_entities();
    edds::DomainParticipantFactory::get_instance()->delete_participant(participant_);
  }
  Domain(const Domain&) = delete;
  Domain& operator=(const Domain&) = delete;

  edds::DataReader* reader(edds::TopicDataType* type, const std::string& name) {
    edds::DataReaderQos qos;
    qos.reliability().kind = edds::RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = edds::TRANSIENT_LOCAL_DURABILITY_QOS;
    qos.history().kind = edds::KEEP_ALL_HISTORY_QOS;
    qos.resource_limits().max_samples = 0;
    qos.resource_limits().max_instances = 0;
    qos.resource_limits().max_samples_per_instance = 0;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::DYNAMIC_REUSABLE_MEMORY_MODE;
    qos.data_sharing().off();
    return subscriber_->create_datareader(topic(edds::TypeSupport(type), name), qos);
  }
  edds::DataWriter* writer(edds::TopicDataType* type, const std::string& name) {
    edds::DataWriterQos qos;
    qos.reliability().kind = edds::RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = edds::TRANSIENT_LOCAL_DURABILITY_QOS;
    qos.data_sharing().off();
    return publisher_->create_datawriter(topic(edds::TypeSupport(type), name), qos);
  }

 private:
  edds::Topic* topic(edds::TypeSupport type, const std::string& name) {
    type->auto_fill_type_object(false);
    type->auto_fill_type_information(false);
    type.register_type(participant_);
    const std::string whole = "convoy/sensors/v1/" + name;
    return participant_->create_topic(whole, type.get_type_name(), edds::TopicQos());
  }

  edds::DomainParticipant* participant_ = nullptr;
  edds::Publisher* publisher_ = nullptr;
  edds::Subscriber* subscriber_ = nullptr;
};

class Vehicle {
 public:
  explicit Vehicle(const Options& options) : options_(options), sensors_(options.domain) {
    frames_ = sensors_.reader(new v1::CameraFramePubSubType, "CameraFrame");
    odometry_ = sensors_.reader(new v1::OdometryPubSubType, "Odometry");
    gps_ = sensors_.reader(new v1::GpsPubSubType, "Gps");
    steps_ = sensors_.reader(new v1::StepPubSubType, "Step");
    calibrations_ = sensors_.reader(new v1::CameraCalibrationPubSubType, "CameraCalibration");
    done_ = sensors_.writer(options.garbage ? new Garbage : new v1::StepDonePubSubType, "StepDone");
    if (options.truth_domain == 0) return;
    judge_ = std::make_unique<Domain>(options.truth_domain);
    truths_ = judge_->reader(new v1::TruthPubSubType, "Truth");
    depths_ = judge_->reader(new v1::TruthDepthPubSubType, "TruthDepth");
  }

  /// Until the last step has been done. The exit status.
  int drive() {
    answer(0, 0);
    for (;;) {
      v1::Step step;
      const bool heard = eventually([&] { return take_own(steps_, step); });
      if (!heard || !eventually([&] { return take_all(step); })) return 1;
      say(step);
      say_senders();
      if (judge_ && !say_truth(step)) return 1;
      std::this_thread::sleep_for(std::chrono::milliseconds(options_.delay_ms));
      if (options_.silent_from == 0 || step.header().step() < options_.silent_from)
        answer(step.header().run(), step.header().step());
      if (options_.stale) answer(0, 0), answer(step.header().run(), 0), answer(step.header().run() + 1, 1);
      if (step.last()) break;
    }
    v1::CameraCalibration calibration;
    if (!take_own(calibrations_, calibration)) return 1;
    std::printf("camera %ux%u f %g\n", calibration.width(), calibration.height(), calibration.fx());
    done_->wait_for_acknowledgments({5, 0});
    return 0;
  }

 private:
  template <class Done>
  static bool eventually(const Done& done) {
    const auto deadline = Clock::now() + std::chrono::seconds(20);
    while (!done()) {
      if (Clock::now() > deadline) return false;
      std::this_thread::sleep_for(std::chrono::microseconds(500));
    }
    return true;
  }

  /// The next sample of this vehicle; those of others are passed over.
  template <class Sample>
  bool take_own(edds::DataReader* reader, Sample& sample) const {
    edds::SampleInfo info;
    while (reader->take_next_sample(&sample, &info) == ReturnCode_t::RETCODE_OK)
      if (info.valid_data && sample.vehicle() == options_.vehicle) return true;
    return false;
  }

  /// True when everything that belongs to the step is there.
  bool take_all(const v1::Step& step) {
    const std::uint32_t number = step.header().step();
    for (v1::CameraFrame frame; take_own(frames_, frame);) pictures_[frame.header().step()].push_back(frame);
    for (v1::Odometry reading; take_own(odometry_, reading);) readings_[reading.header().step()].push_back(reading);
    for (v1::Gps position; take_own(gps_, position);) positions_[position.header().step()].push_back(position);
    return pictures_[number].size() == step.frames() && readings_[number].size() == step.odometry() &&
           positions_[number].size() == step.gps();
  }

  /// How many have sent steps; nothing of the one whose they are.
  void say_senders() {
    edds::SubscriptionMatchedStatus matched;
    steps_->get_subscription_matched_status(matched);
    if (matched.total_count > 1) std::printf("senders %d\n", matched.total_count);
  }

  void say(const v1::Step& step) {
    const std::uint32_t number = step.header().step();
    std::printf("step %u", number);
    for (const v1::CameraFrame& frame : pictures_[number])
      std::printf(" frame %u %016llx", frame.frame(), static_cast<unsigned long long>(fnv1a(frame.grey())));
    for (const v1::Odometry& reading : readings_[number]) std::printf(" odometry %.17g", reading.distance_m());
    for (const v1::Gps& position : positions_[number]) std::printf(" gps %.17g", position.position()[0]);
    std::printf("\n");
    std::fflush(stdout);
    pictures_.erase(number);
    readings_.erase(number);
    positions_.erase(number);
  }

  /// As the simulator is run with --truth-depth and without dropped frames.
  bool say_truth(const v1::Step& step) {
    v1::Truth truth;
    v1::TruthDepth depth;
    if (!eventually([&] { return take_own(truths_, truth); }) || truth.header().step() != step.header().step() ||
        !eventually([&] { return take_own(depths_, depth); }) || depth.header().step() != step.header().step())
      return false;
    std::size_t solid = 0;
    for (const float d : depth.depth()) solid += d > 0.0F;
    std::printf("truth %.17g %.17g depth %zu of %zu\n", truth.T_world_body()[0], truth.T_world_body()[1], solid,
                depth.depth().size());
    return true;
  }

  void answer(std::uint64_t run, std::uint32_t step) {
    v1::StepDone sample;
    sample.vehicle(options_.vehicle);
    sample.run(run);
    sample.step(step);
    done_->write(&sample);
  }

  const Options options_;
  Domain sensors_;
  std::unique_ptr<Domain> judge_;
  edds::DataReader *frames_ = nullptr, *odometry_ = nullptr, *gps_ = nullptr, *steps_ = nullptr,
                   *calibrations_ = nullptr, *truths_ = nullptr, *depths_ = nullptr;
  edds::DataWriter* done_ = nullptr;
  std::map<std::uint32_t, std::vector<v1::CameraFrame>> pictures_;
  std::map<std::uint32_t, std::vector<v1::Odometry>> readings_;
  std::map<std::uint32_t, std::vector<v1::Gps>> positions_;
};

}  // namespace

int main(int argc, char** argv) { return Vehicle(options_of(argc, argv)).drive(); }
