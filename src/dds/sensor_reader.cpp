#include <convoy/idl/sensorsPubSubTypes.h>
#include <convoy/config_error.hpp>
#include <convoy/dds/guarded_type.hpp>
#include <convoy/dds/sensor_reader.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/idl/sensors_qos.hpp>

#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/dds/core/condition/WaitSet.hpp>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <mutex>
#include <set>
#include <tuple>
#include <utility>

namespace convoy::sensors::v1 {

using dds::WireScan;

// The bounds of sensors.idl.
constexpr std::uint32_t max_width = 1280, max_height = 1024;

static void scan_header(WireScan& wire) {
  wire.skip(4);  // vehicle
  wire.skip(8);
  wire.skip(4);
  wire.skip(8);
}
void scan(WireScan& wire, const CameraFrame*) {
  scan_header(wire);
  wire.skip(4, 3);
  wire.sequence(1, max_width * max_height);
}
void scan(WireScan& wire, const CameraCalibration*) {
  scan_header(wire);
  wire.skip(4, 2);
  wire.skip(8, 17);
}
void scan(WireScan& wire, const Odometry*) {
  scan_header(wire);
  wire.skip(4);
  wire.skip(8, 9);
}
void scan(WireScan& wire, const Gps*) {
  scan_header(wire);
  wire.skip(4, 2);
  wire.skip(1);
  wire.skip(8, 19);
}
void scan(WireScan& wire, const Step*) {
  scan_header(wire);
  wire.skip(4, 3);
  wire.skip(1);
}
void scan(WireScan& wire, const StepDone*) {
  wire.skip(4);
  wire.skip(8);
  wire.skip(4);
}

}  // namespace convoy::sensors::v1

namespace convoy::dds {

namespace edds = eprosima::fastdds::dds;
namespace wire = sensors::v1;
using eprosima::fastrtps::types::ReturnCode_t;
using Clock = std::chrono::steady_clock;

namespace {

void demand(bool holds, const std::string& what, const std::string& range) {
  if (!holds) throw ConfigError("sensors: " + what + " must " + range);
}

void validate(const SensorReaderParams& p) {
  demand(p.domain <= 232, "the domain", "lie in 0..232");
  demand(p.vehicle >= 1, "the vehicle", "be 1 or more");
  demand(!p.interfaces.empty(), "the interfaces",
         "name an address of this machine, such as 127.0.0.1: Fast DDS would speak on every one");
  demand(p.queued_frames >= 1 && p.queued_frames <= 64, "queued_frames", "lie in 1..64");
  demand(p.queued_readings >= 16 && p.queued_readings <= 65536, "queued_readings", "lie in 16..65536");
}

template <class Entity>
Entity* need(Entity* entity, const std::string& what) {
  if (entity == nullptr)
    throw ConfigError("sensors: Fast DDS does not make the " + what +
                      "; its log says why (are the interfaces addresses of this machine?)");
  return entity;
}

edds::DomainParticipantQos participant_qos(const SensorReaderParams& params) {
  edds::DomainParticipantQos qos;
  qos.name("convoy vehicle " + std::to_string(params.vehicle) + ": sensors");
  auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  udp->interfaceWhiteList = params.interfaces;
  udp->sendBufferSize = udp->receiveBufferSize = 4 << 20;
  udp->maxMessageSize = 65000;
  udp->TTL = 1;
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports = {udp};
  qos.transport().send_socket_buffer_size = qos.transport().listen_socket_buffer_size = 4 << 20;
  auto& discovery = qos.wire_protocol().builtin.discovery_config;
  discovery.leaseDuration = {20, 0};
  discovery.leaseDuration_announcementperiod = {1, 0};
  qos.wire_protocol().builtin.avoid_builtin_multicast = true;
  return qos;
}

template <class Array>
bool finite(const Array& numbers) {
  return std::all_of(std::begin(numbers), std::end(numbers), [](double x) { return std::isfinite(x); });
}

Eigen::Matrix3d unpacked(const std::array<double, 6>& p) {
  return (Eigen::Matrix3d() << p[0], p[1], p[2], p[1], p[3], p[4], p[2], p[4], p[5]).finished();
}

// Of a sample in the bounds of its type; nothing if it is not.
std::optional<CameraFrame> reading_of(wire::CameraFrame& sample) {
  const std::uint64_t width = sample.width(), height = sample.height();
  if (width < 1 || width > wire::max_width || height < 1 || height > wire::max_height) return std::nullopt;
  if (sample.grey().size() != width * height) return std::nullopt;
  return CameraFrame{sample.header().stamp_s(), sample.frame(), static_cast<int>(width), static_cast<int>(height),
                     std::move(sample.grey())};
}

std::optional<OdometryReading> reading_of(wire::Odometry& s) {
  const std::array numbers{s.distance_m(), s.speed_mps(), s.wheels_yaw_rate_radps(), s.gyro_yaw_rate_radps()};
  const std::array sigmas{s.sigma_distance_m(), s.sigma_wheels_yaw_rate_radps(), s.sigma_gyro_yaw_rate_radps()};
  if (!finite(numbers) || !finite(sigmas) || *std::min_element(sigmas.begin(), sigmas.end()) < 0.0) return std::nullopt;
  return OdometryReading{s.header().stamp_s(), s.reading(), numbers[0], numbers[1], numbers[2],
                         numbers[3],           sigmas[0],   sigmas[1],  sigmas[2]};
}

std::optional<GpsReading> reading_of(wire::Gps& s) {
  const Eigen::Matrix3d covariance = unpacked(s.covariance()), drift = unpacked(s.drift_covariance());
  if (!finite(s.antenna_body()) || !finite(s.position()) || !is_covariance(covariance) || !is_covariance(drift) ||
      !std::isfinite(s.correlation_s()) || s.correlation_s() <= 0.0)
    return std::nullopt;
  const auto vector = [](const std::array<double, 3>& v) { return Eigen::Vector3d(v[0], v[1], v[2]); };
  return GpsReading{s.header().stamp_s(),
                    s.reading(),
                    s.kind() == wire::GPS_RTK,
                    s.fix(),
                    vector(s.antenna_body()),
                    vector(s.position()),
                    covariance,
                    drift,
                    s.correlation_s()};
}

/// The writers that are there. The middleware's thread tells it.
class Writers final : public edds::DataReaderListener {
 public:
  void on_subscription_matched(edds::DataReader*, const edds::SubscriptionMatchedStatus& status) override {
    const std::lock_guard lock(mutex_);
    if (status.current_count_change > 0) there_.insert(status.last_publication_handle);
    else there_.erase(status.last_publication_handle);
  }
  bool there(const edds::InstanceHandle_t& writer) const {
    const std::lock_guard lock(mutex_);
    return there_.contains(writer);
  }

 private:
  mutable std::mutex mutex_;
  std::set<edds::InstanceHandle_t> there_;
};

struct Pending {
  std::uint32_t step = 0;
  SensorReading reading;
};

}  // namespace

double stamp_of(const SensorReading& reading) {
  return std::visit([](const auto& r) { return r.stamp_s; }, reading);
}

struct SensorReader::Impl {
  explicit Impl(const SensorReaderParams& with) : params(with) {
    try {
      open();
    } catch (...) {
      close();
      throw;
    }
  }
  ~Impl() { close(); }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  void open() {
    participant =
        need(factory->create_participant(params.domain, participant_qos(params), nullptr, edds::StatusMask::none()),
             "participant in domain " + std::to_string(params.domain));
    publisher = need(participant->create_publisher(edds::PublisherQos()), "publisher");
    subscriber = need(participant->create_subscriber(edds::SubscriberQos()), "subscriber");
    frames = reader<wire::CameraFramePubSubType>("CameraFrame", params.queued_frames);
    odometry = reader<wire::OdometryPubSubType>("Odometry", params.queued_readings);
    gps = reader<wire::GpsPubSubType>("Gps", params.queued_readings);
    cameras = reader<wire::CameraCalibrationPubSubType>("CameraCalibration", 4);  // of a run that begins, too
    if (!params.lock_step) return;
    steps = reader<wire::StepPubSubType>("Step", params.queued_readings);
    done = need(publisher->create_datawriter(topic<wire::StepDonePubSubType>("StepDone"),
                                             wire::endpoint_qos<edds::DataWriterQos>(1)),
                "writer of StepDone");
  }
  void close() {
    if (participant == nullptr) return;
    participant->delete_contained_entities();
    factory->delete_participant(participant);
  }

  template <class PubSubType>
  edds::Topic* topic(const std::string& type) {
    const std::string name = "convoy/sensors/v1/" + type;
    edds::TypeSupport support(new GuardedType<PubSubType>);
    support.register_type(participant);
    return need(participant->create_topic(name, support.get_type_name(), edds::TopicQos()), "topic " + name);
  }
  template <class PubSubType>
  edds::DataReader* reader(const std::string& type, int depth) {
    auto* made =
        need(subscriber->create_datareader(topic<PubSubType>(type), wire::endpoint_qos<edds::DataReaderQos>(depth),
                                           &writers, edds::StatusMask::subscription_matched()),
             "reader of " + type);
    made->get_statuscondition().set_enabled_statuses(edds::StatusMask::data_available());
    something.attach_condition(made->get_statuscondition());
    return made;
  }

  void answer(std::uint64_t of_run, std::uint32_t of_step) {
    wire::StepDone sample;
    sample.vehicle(params.vehicle);
    sample.run(of_run);
    sample.step(of_step);
    done->write(&sample);
  }

  /// Calls use(sample, writer) for each sample of this vehicle that could be decoded.
  template <class Sample, class Use>
  void take(edds::DataReader* from, const Use& use) {
    edds::SampleInfo info;
    Guarded<Sample> received;
    for (; from->take_next_sample(&received, &info) == ReturnCode_t::RETCODE_OK; received.decoding = Decoding::none) {
      if (!info.valid_data) continue;
      if (received.decoding == Decoding::undecodable) ++counters.undecodable;
      else if (received.decoding == Decoding::hostile) ++counters.hostile;
      else if (received.decoding == Decoding::ok && received.sample.vehicle() == params.vehicle)
        use(received.sample, info.publication_handle);
    }
  }

  /// False if it is of an earlier run. Of a later one: what was pending belongs to the one before.
  bool is_of_this_run(const wire::Header& header) {
    if (header.run() == run) return true;
    if (std::find(past_runs.begin(), past_runs.end(), header.run()) != past_runs.end()) return false;
    if (run) past_runs.push_back(*run);
    if (past_runs.size() > 16) past_runs.erase(past_runs.begin());
    run = header.run();
    counters.stale += pending.size();
    pending.clear();
    step.reset();
    camera.reset();
    sender_of.clear();
    last_step = 0;
    last_number = {};
    return true;
  }

  /// Counts what is not to be used. Of two who send the same topic of one run, the one that was heard first is heard
  /// for as long as it is there.
  bool is_heard(const edds::DataReader* topic, const wire::Header& header, const edds::InstanceHandle_t& writer) {
    if (!is_of_this_run(header)) {
      ++counters.stale;
      return false;
    }
    edds::InstanceHandle_t& sender = sender_of.try_emplace(topic, writer).first->second;
    if (sender != writer && writers.there(sender)) {
      ++counters.foreign;
      return false;
    }
    sender = writer;
    return true;
  }

  template <class Sample>
  void take_readings(edds::DataReader* from, std::size_t kind) {
    take<Sample>(from, [&](Sample& sample, const edds::InstanceHandle_t& writer) {
      const std::uint32_t of_step = sample.header().step();
      auto reading = std::isfinite(sample.header().stamp_s()) ? reading_of(sample) : std::nullopt;
      if (!reading) {
        ++counters.hostile;
        return;
      }
      if (!is_heard(from, sample.header(), writer)) return;
      if (params.lock_step && of_step <= last_step) {
        ++counters.stale;
        return;
      }
      auto& last = last_number[kind];
      if (last && reading->number <= *last) {
        ++counters.stale;
        return;
      }
      if (std::is_same_v<Sample, wire::Odometry> && last) counters.lost += reading->number - *last - 1;
      last = reading->number;
      pending.push_back({of_step, std::move(*reading)});
    });
  }

  void take_all() {
    take_readings<wire::Odometry>(odometry, 0);
    take_readings<wire::Gps>(gps, 1);
    take_readings<wire::CameraFrame>(frames, 2);
    take<wire::CameraCalibration>(cameras, [&](const auto& sample, const auto& writer) {
      if (is_heard(cameras, sample.header(), writer)) camera = sample;
    });
    if (!params.lock_step) return;
    take<wire::Step>(steps, [&](const auto& sample, const auto& writer) {
      if (!is_heard(steps, sample.header(), writer)) return;
      if (sample.header().step() > last_step) step = sample;
      else ++counters.stale;
    });
  }

  /// Everything that belongs to the step has come.
  bool step_is_whole() const {
    if (!step) return false;
    std::array<std::uint32_t, 3> count{};
    for (const Pending& p : pending)
      if (p.step == step->header().step()) ++count[p.reading.index()];
    return count[0] >= step->odometry() && count[1] >= step->gps() && count[2] >= step->frames();
  }

  SensorBatch hand_out() {
    SensorBatch batch{run.value_or(0), 0, false, {}};
    if (step) {
      batch.step = last_step = step->header().step();
      batch.last = step->last();
    }
    for (Pending& p : pending)
      if (!step || p.step == batch.step) batch.readings.push_back(std::move(p.reading));
    std::erase_if(pending, [&](const Pending& p) { return !step || p.step <= batch.step; });
    step.reset();
    const auto order = [](const SensorReading& r) { return std::pair(stamp_of(r), r.index()); };
    std::stable_sort(batch.readings.begin(), batch.readings.end(),
                     [&](const auto& a, const auto& b) { return order(a) < order(b); });
    counters.readings += batch.readings.size();
    return batch;
  }

  const SensorReaderParams params;
  SensorCounters counters;
  Writers writers;  // before the participant, so that it outlives the readers
  // Held, so that the factory outlives the participant whatever the order in which a process winds down.
  std::shared_ptr<edds::DomainParticipantFactory> factory = edds::DomainParticipantFactory::get_shared_instance();
  edds::DomainParticipant* participant = nullptr;
  edds::Publisher* publisher = nullptr;
  edds::Subscriber* subscriber = nullptr;
  edds::DataReader *frames = nullptr, *odometry = nullptr, *gps = nullptr, *cameras = nullptr, *steps = nullptr;
  edds::DataWriter* done = nullptr;
  edds::WaitSet something;

  std::optional<std::uint64_t> run;
  std::vector<std::uint64_t> past_runs;
  std::map<const edds::DataReader*, edds::InstanceHandle_t> sender_of;  // this run
  std::uint32_t last_step = 0;                                          // handed out
  std::array<std::optional<std::uint32_t>, 3> last_number = {};         // of each kind, in the order of SensorReading
  std::vector<Pending> pending;
  std::optional<wire::Step> step;
  std::optional<wire::CameraCalibration> camera;
};

SensorReader::SensorReader(const SensorReaderParams& params) {
  validate(params);
  impl_ = std::make_unique<Impl>(params);
  if (params.lock_step) impl_->answer(0, 0);
}

SensorReader::~SensorReader() = default;

std::optional<SensorBatch> SensorReader::next(double timeout_s) {
  const auto until = Clock::now() + std::chrono::duration<double>(std::clamp(timeout_s, 0.0, 1e6));
  for (;;) {
    impl_->take_all();
    if (impl_->params.lock_step ? impl_->step_is_whole() : !impl_->pending.empty()) return impl_->hand_out();
    const std::chrono::duration<double> left = until - Clock::now();
    if (left.count() <= 0.0) return std::nullopt;
    const double wait_s = std::min(left.count(), 1.0);
    edds::ConditionSeq changed;
    (void)impl_->something.wait(
        changed, {static_cast<std::int32_t>(wait_s), static_cast<std::uint32_t>(std::fmod(wait_s, 1.0) * 1e9)});
  }
}

void SensorReader::done(const SensorBatch& batch) {
  if (impl_->params.lock_step) impl_->answer(batch.run, batch.step);
}

std::optional<MountedCamera> SensorReader::camera() const {
  if (!impl_->camera) return std::nullopt;
  const wire::CameraCalibration& c = *impl_->camera;
  MountedCamera mounted;
  mounted.run = c.header().run();
  const auto whole = [](std::uint32_t pixels) { return static_cast<int>(std::min(pixels, 100'000U)); };
  mounted.calibration.width = whole(c.width());
  mounted.calibration.height = whole(c.height());
  mounted.calibration.fx = c.fx();
  mounted.calibration.fy = c.fy();
  mounted.calibration.cx = c.cx();
  mounted.calibration.cy = c.cy();
  mounted.calibration.coefficients = Eigen::Map<const Eigen::Matrix<double, 5, 1>>(c.distortion().data());
  convoy::validate(mounted.calibration);
  mounted.rate_hz = c.rate_hz();
  const auto& p = c.T_body_camera();
  const Eigen::Vector4d q(p[3], p[4], p[5], p[6]);
  demand(finite(p) && std::abs(q.norm() - 1.0) < 1e-6, "T_body_camera", "hold a position and a unit quaternion");
  mounted.T_body_camera = SE3(q, {p[0], p[1], p[2]});
  return mounted;
}

const SensorCounters& SensorReader::counters() const { return impl_->counters; }

}  // namespace convoy::dds
