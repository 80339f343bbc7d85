#include "truth_listener.hpp"

#include <convoy/idl/sensorsPubSubTypes.h>
#include <convoy/config_error.hpp>
#include <convoy/dds/guarded_type.hpp>
#include <convoy/idl/sensors_qos.hpp>

#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>

#include <algorithm>
#include <cmath>
#include <deque>
#include <fstream>
#include <map>
#include <optional>
#include <sstream>

#include "evaluate/run_folder.hpp"
#include "evaluate/truth_depth.hpp"
#include "scenario/table_file.hpp"

namespace convoy::sensors::v1 {

static void scan_header(dds::WireScan& wire) {
  wire.skip(4);  // vehicle
  wire.skip(8);
  wire.skip(4);
  wire.skip(8);
}
void scan(dds::WireScan& wire, const Truth*) {
  scan_header(wire);
  wire.skip(8, 13);
}
void scan(dds::WireScan& wire, const TruthDepth*) {
  scan_header(wire);
  wire.skip(4, 3);
  wire.sequence(4, 1280 * 1024);
}

}  // namespace convoy::sensors::v1

namespace convoy::cli {

namespace edds = eprosima::fastdds::dds;
namespace wire = sensors::v1;
using eprosima::fastrtps::types::ReturnCode_t;

namespace {

template <class Entity>
Entity* need(Entity* entity) {
  if (entity == nullptr) throw ConfigError("truth: Fast DDS does not make what listens to it; its log says why");
  return entity;
}

/// Nothing if it is no pose.
std::optional<SE3> pose_of(const std::array<double, 7>& p) {
  const Eigen::Vector3d t(p[0], p[1], p[2]);
  const Eigen::Vector4d q(p[3], p[4], p[5], p[6]);
  if (!t.allFinite() || !(std::abs(q.norm() - 1.0) < 1e-6)) return std::nullopt;
  return SE3(q, t);
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

struct DepthFrame {
  double stamp_s = 0.0;
  std::uint32_t step = 0;
  int width = 0, height = 0;
  std::vector<float> depth_m;
};

/// Of one vehicle.
struct Heard {
  std::map<std::uint32_t, TruthPose<SE3>> poses;  // by step
  std::deque<DepthFrame> frames;                  // the last ones
  std::ifstream sightings;
  std::string unfinished;  // a line of it that is half there
  std::map<std::uint64_t, std::vector<Eigen::Vector3d>> tracks;
};

}  // namespace

struct TruthListener::Impl {
  Impl(std::uint32_t domain, std::uint64_t run_number, const std::filesystem::path& run_folder,
       const std::vector<VehicleId>& vehicles)
      : run(run_number), folder(run_folder) {
    for (const VehicleId id : vehicles) heard[id];
    edds::DomainParticipantQos qos;
    qos.name("convoy demo: truth");
    auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    udp->interfaceWhiteList = {"127.0.0.1"};
    udp->sendBufferSize = udp->receiveBufferSize = 4 << 20;
    udp->maxMessageSize = 65000;
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports = {udp};
    participant = need(factory->create_participant(domain, qos, nullptr, edds::StatusMask::none()));
    subscriber = need(participant->create_subscriber(edds::SubscriberQos()));
    poses = reader(new dds::GuardedType<wire::TruthPubSubType>, "Truth", 400);
    depths = reader(new dds::GuardedType<wire::TruthDepthPubSubType>, "TruthDepth", 8);
  }
  ~Impl() {
    participant->delete_contained_entities();
    factory->delete_participant(participant);
  }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  edds::DataReader* reader(edds::TopicDataType* made, const std::string& type, int depth) {
    edds::TypeSupport support(made);
    support.register_type(participant);
    auto* topic =
        need(participant->create_topic("convoy/sensors/v1/" + type, support.get_type_name(), edds::TopicQos()));
    return need(subscriber->create_datareader(topic, wire::endpoint_qos<edds::DataReaderQos>(depth)));
  }

  /// Calls use(of its vehicle, sample) for each sample of this run; false: it is none.
  template <class Sample, class Use>
  void take_from(edds::DataReader* from, const Use& use) {
    edds::SampleInfo info;
    dds::Guarded<Sample> received;
    for (; from->take_next_sample(&received, &info) == ReturnCode_t::RETCODE_OK;
         received.decoding = dds::Decoding::none) {
      if (!info.valid_data) continue;
      if (received.decoding != dds::Decoding::ok || !std::isfinite(received.sample.header().stamp_s())) {
        ++counters.unusable;
      } else if (received.sample.header().run() != run) {
        ++counters.foreign;
      } else if (const auto of = heard.find(received.sample.vehicle()); of != heard.end()) {
        if (!use(of->second, received.sample)) ++counters.unusable;
      }
    }
  }

  void take() {
    take_from<wire::Truth>(poses, [](Heard& h, wire::Truth& sample) {
      const auto pose = pose_of(sample.T_world_body());
      if (pose) h.poses[sample.header().step()] = {sample.header().stamp_s(), *pose};
      return pose.has_value();
    });
    take_from<wire::TruthDepth>(depths, [](Heard& h, wire::TruthDepth& sample) {
      if (sample.width() > 1280 || sample.height() > 1024 || sample.depth().size() != sample.width() * sample.height())
        return false;
      h.frames.push_back({sample.header().stamp_s(), sample.header().step(), static_cast<int>(sample.width()),
                          static_cast<int>(sample.height()), std::move(sample.depth())});
      if (h.frames.size() > kept_frames) h.frames.pop_front();
      return true;
    });
    for (auto& [id, h] : heard) read_sightings(id, h);
  }

  void read_sightings(VehicleId id, Heard& h) {
    if (!h.sightings.is_open()) h.sightings.open(vehicle_folder(folder, id) / "sightings.csv");
    if (!h.sightings.is_open()) return;
    h.sightings.clear();  // it may have grown
    for (std::string part; std::getline(h.sightings, part);) {
      h.unfinished += part;
      if (h.sightings.eof()) break;
      use_sighting(std::exchange(h.unfinished, {}), h);
    }
  }

  // track,stamp_s,u_px,v_px, where its ray begins in the body frame, where it goes per metre of depth
  static void use_sighting(const std::string& line, Heard& h) {
    std::istringstream in(line);
    std::vector<double> row;
    for (std::string field; std::getline(in, field, ',');) row.push_back(std::atof(field.c_str()));
    if (row.size() != 10) return;
    const auto frame = std::find_if(h.frames.begin(), h.frames.end(),
                                    [&](const DepthFrame& f) { return std::abs(f.stamp_s - row[1]) < 1e-6; });
    if (frame == h.frames.end()) return;
    const auto pose = h.poses.find(frame->step);
    const double depth_m = depth_of_corner(frame->depth_m, frame->width, frame->height, row[2], row[3]);
    if (pose == h.poses.end() || !(std::isfinite(depth_m) && depth_m > 0.0)) return;
    const Eigen::Vector3d origin(row[4], row[5], row[6]), per_m(row[7], row[8], row[9]);
    h.tracks[static_cast<std::uint64_t>(row[0])].push_back(pose->second.T_world_body * (origin + depth_m * per_m));
  }

  static constexpr std::size_t kept_frames = 12;
  const std::uint64_t run;
  const std::filesystem::path folder;
  std::map<VehicleId, Heard> heard;
  TruthCounters counters;
  std::shared_ptr<edds::DomainParticipantFactory> factory = edds::DomainParticipantFactory::get_shared_instance();
  edds::DomainParticipant* participant = nullptr;
  edds::Subscriber* subscriber = nullptr;
  edds::DataReader *poses = nullptr, *depths = nullptr;
};

TruthListener::TruthListener(std::uint32_t domain, std::uint64_t run, const std::filesystem::path& run_folder,
                             const std::vector<VehicleId>& vehicles)
    : impl_(std::make_unique<Impl>(domain, run, run_folder, vehicles)) {}

TruthListener::~TruthListener() = default;

void TruthListener::take() { impl_->take(); }

std::vector<TruthPose<SE3>> TruthListener::path(VehicleId vehicle) const {
  std::vector<TruthPose<SE3>> path;
  for (const auto& [step, pose] : impl_->heard.at(vehicle).poses) {
    if (path.empty()) path.push_back({0.0, pose.T_world_body});  // a vehicle starts at rest
    path.push_back(pose);
  }
  return path;
}

const TruthCounters& TruthListener::counters() const { return impl_->counters; }

double TruthListener::time_s() const {
  double latest_s = 0.0;
  for (const auto& [id, h] : impl_->heard)
    if (!h.poses.empty()) latest_s = std::max(latest_s, h.poses.rbegin()->second.t_s);
  return latest_s;
}

void TruthListener::write_tracks() const {
  for (const auto& [id, h] : impl_->heard) {
    std::string text(tracks_header);
    text += '\n';
    for (const auto& [track, points] : h.tracks) {
      Eigen::Vector3d middle;
      for (int axis = 0; axis < 3; ++axis) {
        std::vector<double> values;
        for (const Eigen::Vector3d& p : points) values.push_back(p[axis]);
        middle[axis] = median(values);
      }
      append_csv_row(text, track, middle[0], middle[1], middle[2], std::uint64_t{points.size()});
    }
    write_text_file(tracks_file(impl_->folder, id), text);
  }
}

}  // namespace convoy::cli
