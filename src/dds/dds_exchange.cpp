#include <arpa/inet.h>
#include <ifaddrs.h>
#include <netinet/in.h>
#include <unistd.h>

#include <algorithm>
#include <convoy/dds/admission.hpp>
#include <convoy/dds/convert.hpp>
#include <convoy/dds/counting_transport.hpp>
#include <convoy/dds/dds_exchange.hpp>
#include <convoy/dds/discovery.hpp>
#include <convoy/dds/guarded_type.hpp>
#include <convoy/dds/profile_file.hpp>
#include <convoy/dds/secure_gate.hpp>
#include <convoy/dds/security.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/submap/content_hash.hpp>

#include <fastdds/rtps/transport/TCPv4TransportDescriptor.h>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/DataWriterListener.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <fstream>
#include <map>
#include <mutex>
#include <random>

namespace convoy::dds {

namespace edds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
namespace transport = eprosima::fastdds::rtps;
using eprosima::fastrtps::types::ReturnCode_t;

namespace {

std::chrono::steady_clock::time_point deadline_after(double seconds) {
  return std::chrono::steady_clock::now() +
         std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<double>(seconds));
}

/// What the receiving threads leave for take().
template <class G>
class Inbox {
 public:
  explicit Inbox(std::size_t capacity) : capacity_(capacity) {}

  void push(Message<G> message) {
    {
      const std::lock_guard lock(mutex_);
      if (queue_.size() >= capacity_) {
        ++dropped;
        return;
      }
      queue_.push_back(std::move(message));
    }
    filled_.notify_all();
  }

  std::vector<Message<G>> take() {
    std::deque<Message<G>> queue;
    {
      const std::lock_guard lock(mutex_);
      queue.swap(queue_);
    }
    return {std::make_move_iterator(queue.begin()), std::make_move_iterator(queue.end())};
  }

  bool wait(double timeout_s) {
    std::unique_lock lock(mutex_);
    return filled_.wait_until(lock, deadline_after(timeout_s), [this] { return !queue_.empty(); });
  }

  std::atomic<std::uint64_t> dropped{0};
  std::atomic<std::uint64_t> undecodable{0};
  std::atomic<std::uint64_t> hostile{0};
  std::atomic<std::uint64_t> incompatible{0};
  std::atomic<std::uint64_t> lost{0};
  std::atomic<std::uint64_t> impersonations{0};

 private:
  const std::size_t capacity_;
  std::mutex mutex_;
  std::condition_variable filled_;
  std::deque<Message<G>> queue_;
};

/// Counts, per remote participant, the endpoints that are matched with ours.
class PeerTable {
 public:
  PeerTable(const rtps::GuidPrefix_t& self, int endpoints) : self_(self), endpoints_(endpoints) {}

  void change(const edds::InstanceHandle_t& remote_endpoint, int by) {
    const rtps::GuidPrefix_t peer = rtps::iHandle2GUID(remote_endpoint).guidPrefix;
    if (peer == self_) return;
    {
      const std::lock_guard lock(mutex_);
      if ((matched_[peer] += by) <= 0) matched_.erase(peer);
    }
    changed_.notify_all();
  }

  std::size_t complete() {
    const std::lock_guard lock(mutex_);
    return complete_locked();
  }

  bool wait(std::size_t count, double timeout_s) {
    std::unique_lock lock(mutex_);
    return changed_.wait_until(lock, deadline_after(timeout_s), [&] { return complete_locked() >= count; });
  }

 private:
  std::size_t complete_locked() const {
    std::size_t count = 0;
    for (const auto& [peer, matched] : matched_)
      if (matched >= endpoints_) ++count;
    return count;
  }

  const rtps::GuidPrefix_t self_;
  const int endpoints_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::map<rtps::GuidPrefix_t, int> matched_;
};

/// The three entities every channel is made of, and where the profiles come from.
struct Domain {
  edds::DomainParticipant* participant = nullptr;
  edds::Publisher* publisher = nullptr;
  edds::Subscriber* subscriber = nullptr;
  const ProfileFile* profiles = nullptr;
  Admission* admission = nullptr;  // null: DDS Security is off
};

template <class Entity>
Entity* need(Entity* entity, const Domain& domain, const std::string& what) {
  if (entity == nullptr)
    throw ConfigError(domain.profiles->path() + ": Fast DDS does not create the " + what +
                      "; its profile contradicts itself or the domain forbids it (see the log of Fast DDS)");
  return entity;
}

/// One topic with its writer and its reader.
template <class G, class PubSubType>
class Channel final : public edds::DataWriterListener, public edds::DataReaderListener {
 public:
  using Sample = typename PubSubType::type;

  Channel(const Domain& domain, const char* topic_name, Inbox<G>& inbox, PeerTable& peers)
      : domain_(domain), inbox_(inbox), peers_(peers) {
    try {
      open(topic_name);
    } catch (...) {
      close();
      throw;
    }
  }
  ~Channel() override { close(); }
  Channel(const Channel&) = delete;
  Channel& operator=(const Channel&) = delete;

  bool write(Sample& sample) { return writer_->write(&sample); }
  bool keeps_history() const { return writer_->get_qos().durability().kind != edds::VOLATILE_DURABILITY_QOS; }

  void on_data_available(edds::DataReader* reader) override {
    edds::SampleInfo info;
    Guarded<Sample> received;  // decoding == none if the host registered an unguarded type: then nothing is accepted
    for (; reader->take_next_sample(&received, &info) == ReturnCode_t::RETCODE_OK; received.decoding = Decoding::none)
      if (info.valid_data && info.sample_identity.writer_guid() != own_writer_) accept(received, info);
  }
  void on_publication_matched(edds::DataWriter*, const edds::PublicationMatchedStatus& status) override {
    peers_.change(status.last_subscription_handle, status.current_count_change);
  }
  void on_subscription_matched(edds::DataReader*, const edds::SubscriptionMatchedStatus& status) override {
    peers_.change(status.last_publication_handle, status.current_count_change);
  }
  void on_offered_incompatible_qos(edds::DataWriter*, const edds::OfferedIncompatibleQosStatus&) override {
    ++inbox_.incompatible;
  }
  void on_requested_incompatible_qos(edds::DataReader*, const edds::RequestedIncompatibleQosStatus&) override {
    ++inbox_.incompatible;
  }
  void on_sample_lost(edds::DataReader*, const edds::SampleLostStatus& status) override {
    inbox_.lost += static_cast<std::uint64_t>(status.total_count_change);
  }

 private:
  void open(const std::string& name) {
    edds::TypeSupport type(new GuardedType<PubSubType>);
    const ReturnCode_t registered = type.register_type(domain_.participant);
    // On a shared participant another exchange may have registered the type and created the topic before.
    if (registered != ReturnCode_t::RETCODE_OK && registered != ReturnCode_t::RETCODE_PRECONDITION_NOT_MET)
      throw ConfigError("the participant does not take the type " + type.get_type_name());
    edds::TopicDescription* topic = domain_.participant->lookup_topicdescription(name);
    if (topic == nullptr) {
      topic_ = need(domain_.participant->create_topic(name, type.get_type_name(), edds::TOPIC_QOS_DEFAULT), domain_,
                    "topic " + name);
      topic = topic_;
    }
    auto* whole_topic = need(dynamic_cast<edds::Topic*>(topic), domain_, "topic " + name);
    // The writer comes first, so that the reader's listener knows which samples are our own.
    writer_ = need(domain_.publisher->create_datawriter(whole_topic, domain_.profiles->writer(*domain_.publisher, name),
                                                        this, writer_events()),
                   domain_, "writer of " + name);
    own_writer_ = writer_->guid();
    reader_ = need(domain_.subscriber->create_datareader(topic, domain_.profiles->reader(*domain_.subscriber, name),
                                                         this, reader_events()),
                   domain_, "reader of " + name);
  }

  void close() {
    if (reader_ != nullptr) {
      reader_->set_listener(nullptr);
      domain_.subscriber->delete_datareader(reader_);
    }
    if (writer_ != nullptr) {
      writer_->set_listener(nullptr);
      domain_.publisher->delete_datawriter(writer_);
    }
    if (topic_ != nullptr) domain_.participant->delete_topic(topic_);
  }

  static edds::StatusMask writer_events() {
    return edds::StatusMask::publication_matched() << edds::StatusMask::offered_incompatible_qos();
  }
  static edds::StatusMask reader_events() {
    return edds::StatusMask::data_available()
           << edds::StatusMask::subscription_matched() << edds::StatusMask::requested_incompatible_qos()
           << edds::StatusMask::sample_lost();
  }

  void accept(const Guarded<Sample>& received, const edds::SampleInfo& info) {
    Message<G> message;
    if (received.decoding == Decoding::hostile) ++inbox_.hostile;
    else if (received.decoding != Decoding::ok) ++inbox_.undecodable;
    else if (from_wire(received.sample, message) != WireStatus::ok) ++inbox_.hostile;
    else if (!comes_from_its_sender(message, info)) ++inbox_.impersonations;
    else inbox_.push(std::move(message));
  }

  /// What a vehicle repeats for others it sends under its own name, so that this holds for relayed facts, too.
  bool comes_from_its_sender(const Message<G>& message, const edds::SampleInfo& info) const {
    return domain_.admission == nullptr ||
           domain_.admission->speaker(info.sample_identity.writer_guid()) == message.sender.vehicle;
  }

  Domain domain_;
  Inbox<G>& inbox_;
  PeerTable& peers_;
  edds::Topic* topic_ = nullptr;
  edds::DataWriter* writer_ = nullptr;
  edds::DataReader* reader_ = nullptr;
  rtps::GUID_t own_writer_;
};

/// The same in all processes of this machine, whatever their namespaces; two bytes of it.
std::uint16_t this_machine() {
  std::string name;
  if (!std::getline(std::ifstream("/proc/sys/kernel/random/boot_id"), name)) {
    char host[256] = {};
    gethostname(host, sizeof host - 1);
    name = host;
  }
  ContentHash hash;
  for (const char c : name) hash.add(static_cast<unsigned char>(c), 1);
  return static_cast<std::uint16_t>(hash.value());
}

/// Bytes 0-1: vendor, 2-3: machine, 4-7: random, 8-11: vehicle id. Fast DDS takes equal bytes 0-3 for one machine, and
/// equal bytes 0-7 for one process, within which it speaks in memory. No other participant has our random bytes, not
/// even one of this process: our own samples come back in memory, where they cost no bytes, while vehicles that share a
/// process still meet on sockets as they would apart. The id tells who is who in a trace; it proves nothing.
rtps::GuidPrefix_t new_prefix(VehicleId vehicle) {
  rtps::GuidPrefix_t prefix;
  std::random_device random;
  const auto put = [&](int at, std::uint64_t value, int bytes) {
    for (int i = bytes; i-- > 0; value >>= 8) prefix.value[at + i] = static_cast<rtps::octet>(value);
  };
  put(0, 0x010f, 2);  // eProsima, as every participant of Fast DDS
  put(2, this_machine(), 2);
  put(4, random(), 4);
  put(8, vehicle, 4);
  return prefix;
}

/// The IPv4 addresses of this host.
std::vector<std::string> host_addresses() {
  std::vector<std::string> addresses;
  ifaddrs* list = nullptr;
  if (getifaddrs(&list) != 0) return addresses;
  for (const ifaddrs* i = list; i != nullptr; i = i->ifa_next) {
    if (i->ifa_addr == nullptr || i->ifa_addr->sa_family != AF_INET) continue;
    char text[INET_ADDRSTRLEN] = {};
    inet_ntop(AF_INET, &reinterpret_cast<const sockaddr_in*>(i->ifa_addr)->sin_addr, text, sizeof text);
    addresses.emplace_back(text);
  }
  freeifaddrs(list);
  return addresses;
}

/// Fast DDS leaves out what is no interface of this host, and is then silent: a vehicle that nobody hears.
void check_interfaces(const std::string& where, const std::vector<std::string>& whitelist) {
  const std::vector<std::string> host = host_addresses();
  for (const std::string& address : whitelist) {
    if (std::find(host.begin(), host.end(), address) != host.end()) continue;
    std::string known;
    for (const std::string& h : host) known += (known.empty() ? "" : ", ") + h;
    throw ConfigError(where + "interface '" + address + "' is no IPv4 address of this host; it has " + known);
  }
}

/// A transport of sockets that speaks on the given interfaces only.
template <class Sockets>
std::shared_ptr<Sockets> restricted(const Sockets& profile, const DdsConfig& config, const std::string& where) {
  auto sockets = std::make_shared<Sockets>(profile);
  if (!config.interface_whitelist.empty()) sockets->interfaceWhiteList = config.interface_whitelist;
  if (sockets->interfaceWhiteList.empty())
    throw ConfigError(
        where +
        "no <interfaceWhiteList>; name the addresses to speak on, in the profile's transport descriptor or in " +
        (config.origin.empty() ? "the configuration" : config.origin + " (<dds interfaces=\"...\">)"));
  // Fast DDS cannot send its handshake in pieces: where it is larger than a message, nobody is ever let in.
  if (!config.security_folder.empty())
    sockets->maxMessageSize = std::max(sockets->maxMessageSize, SecurityFolder::largest_handshake_bytes);
  const bool from_config = !config.interface_whitelist.empty() && !config.origin.empty();
  check_interfaces(from_config ? config.origin + ": " : where, sockets->interfaceWhiteList);
  return sockets;
}

/// The transport of a profile with a counter above it, and with DDS Security on, a gate.
std::shared_ptr<transport::TransportDescriptorInterface> layered(
    const std::shared_ptr<transport::TransportDescriptorInterface>& profile, const DdsConfig& config,
    const std::string& where, const std::shared_ptr<WireCounters>& counters, const Admission* admission) {
  const auto above = [&](std::shared_ptr<transport::TransportDescriptorInterface> layers) {
    if (config.wrap_transport) layers = config.wrap_transport(std::move(layers), counters);
    layers = std::make_shared<CountingTransportDescriptor>(std::move(layers), counters);
    if (admission != nullptr)
      layers = std::make_shared<SecureGateDescriptor>(std::move(layers), admission->unprotected);
    return layers;
  };
  if (const auto udp = std::dynamic_pointer_cast<transport::UDPv4TransportDescriptor>(profile))
    return above(restricted(*udp, config, where));
  if (const auto tcp = std::dynamic_pointer_cast<transport::TCPv4TransportDescriptor>(profile))
    return above(restricted(*tcp, config, where));
  if (const auto memory = std::dynamic_pointer_cast<transport::SharedMemTransportDescriptor>(profile))
    return std::make_shared<ChainedSharedMemDescriptor>(*memory, above(memory));
  throw ConfigError(where + "a transport is none of UDPv4, TCPv4 and SHM; its bytes cannot be counted");
}

/// Secured vehicles would start by these, say nothing, and never meet (Fast DDS 2.9.1).
void refuse_to_secure(const edds::DomainParticipantQos& qos, const std::string& where) {
  std::string what;
  if (qos.wire_protocol().builtin.discovery_config.discoveryProtocol != rtps::DiscoveryProtocol_t::SIMPLE)
    what = "through a Discovery Server";
  for (const auto& descriptor : qos.transport().user_transports)
    if (std::dynamic_pointer_cast<transport::TCPv4TransportDescriptor>(descriptor)) what = "over TCP";
  if (!what.empty())
    throw ConfigError(where + "vehicles with DDS Security do not meet " + what +
                      "; take a profile over UDP whose vehicles find each other (lan.xml, lossy_radio.xml, "
                      "unicast_peers.xml), or take out <dds security=\"...\">");
}

/// Puts a counter between the participant and each transport of its profile, and with DDS Security on, a gate.
void add_layers(edds::DomainParticipantQos& qos, const DdsConfig& config, const ProfileFile& profiles,
                const std::shared_ptr<WireCounters>& counters, const Admission* admission) {
  const std::string where = profiles.where("participant", config.participant_profile) + ": participant profile '" +
                            config.participant_profile + "': ";
  if (qos.transport().use_builtin_transports)
    throw ConfigError(where +
                      "write <useBuiltinTransports>false</useBuiltinTransports>; the built-in transports speak "
                      "on every interface and cannot be counted");
  if (qos.transport().user_transports.empty())
    throw ConfigError(where + "no transport; name a transport descriptor in <userTransports>");
  if (admission != nullptr) refuse_to_secure(qos, where);
  apply_addresses(qos, config, where);
  for (auto& descriptor : qos.transport().user_transports)
    descriptor = layered(descriptor, config, where, counters, admission);
}

void check(const DdsConfig& config) {
  if (config.participant != nullptr && !config.security_folder.empty())
    throw ConfigError(config.security_folder +
                      ": the security of an injected participant is its host's affair; leave security_folder empty");
  if (config.max_queued_messages == 0) throw ConfigError("max_queued_messages is 0; give room for at least 1 message");
  if (config.domain > 232) throw ConfigError("domain " + std::to_string(config.domain) + " is not in 0..232");
}

/// A participant with its publisher and subscriber, deleted in the right order. An injected one is left alone.
class Entities {
 public:
  Entities(const DdsConfig& config, const ProfileFile& profiles, const std::shared_ptr<WireCounters>& counters) {
    domain_.profiles = &profiles;
    domain_.participant = config.participant;
    if (!config.security_folder.empty()) {
      security_ = std::make_unique<SecurityFolder>(config.security_folder, config.vehicle);
      admission_ = std::make_unique<Admission>(security_->authority());
      domain_.admission = admission_.get();
    }
    try {
      if (domain_.participant == nullptr) create_participant(config, profiles, counters);
      edds::PublisherQos publisher;
      edds::SubscriberQos subscriber;
      if (security_) {
        publisher.partition().push_back(partition_of(security_->vehicle()).c_str());
        subscriber.partition().push_back(partitions_of_all);
      }
      domain_.publisher = need(domain_.participant->create_publisher(publisher), domain_, "publisher");
      domain_.subscriber = need(domain_.participant->create_subscriber(subscriber), domain_, "subscriber");
    } catch (...) {
      close();
      throw;
    }
  }
  ~Entities() { close(); }
  Entities(const Entities&) = delete;
  Entities& operator=(const Entities&) = delete;
  const Domain& domain() const { return domain_; }

 private:
  void create_participant(const DdsConfig& config, const ProfileFile& profiles,
                          const std::shared_ptr<WireCounters>& counters) {
    edds::DomainParticipantQos qos = profiles.participant(config.participant_profile);
    add_layers(qos, config, profiles, counters, admission_.get());
    qos.wire_protocol().prefix = new_prefix(config.vehicle);
    if (security_) security_->apply(qos);
    // The first announcement goes out before answers to it can be taken. Those who heard it would answer once, in vain,
    // and be found by what they announce from time to time; so the second one is to be the first.
    counters->muted =
        qos.wire_protocol().builtin.discovery_config.discoveryProtocol == rtps::DiscoveryProtocol_t::SIMPLE;
    own_ = need(factory_->create_participant(config.domain, qos, admission_.get(), edds::StatusMask::none()), domain_,
                "participant '" + config.participant_profile + "' in domain " + std::to_string(config.domain));
    counters->muted = false;
    domain_.participant = own_;
  }
  void close() {
    if (domain_.subscriber != nullptr) domain_.participant->delete_subscriber(domain_.subscriber);
    if (domain_.publisher != nullptr) domain_.participant->delete_publisher(domain_.publisher);
    if (own_ == nullptr) return;
    own_->set_listener(nullptr);
    factory_->delete_participant(own_);
  }

  // Held, so that the factory outlives the participant whatever the order in which a process winds down.
  std::shared_ptr<edds::DomainParticipantFactory> factory_ = edds::DomainParticipantFactory::get_shared_instance();
  std::unique_ptr<SecurityFolder> security_;
  std::unique_ptr<Admission> admission_;
  Domain domain_;
  edds::DomainParticipant* own_ = nullptr;
};

constexpr int endpoints_per_exchange = 24;  // a writer and a reader for each of twelve topics

}  // namespace

template <class G>
struct DdsExchange<G>::Impl {
  explicit Impl(const DdsConfig& config)
      : profiles((check(config), config.profile_file)),
        entities(config, profiles, wire),
        inbox(config.max_queued_messages),
        peers(entities.domain().participant->guid().guidPrefix, endpoints_per_exchange) {}

  SendStatus write(const Message<G>& of, const AnchorFact<G>& fact) { return write_fact(bias, of, fact); }
  SendStatus write(const Message<G>& of, const PriorFact<G>& fact) { return write_fact(prior, of, fact); }
  SendStatus write(const Message<G>& of, const AssociationFact& fact) { return write_fact(association, of, fact); }
  SendStatus write(const Message<G>& of, const VerdictFact& fact) { return write_fact(verdict, of, fact); }
  SendStatus write(const Message<G>& of, const AbsoluteFixFact<G>& fact) { return write_fact(absolute_fix, of, fact); }
  SendStatus write(const Message<G>& of, const EncounterFact<G>& fact) { return write_fact(encounter, of, fact); }
  SendStatus write(const Message<G>& of, const WaypointFact<G>& fact) { return write_fact(waypoint, of, fact); }
  SendStatus write(const Message<G>& of, const LivePose<G>& live) { return convert_and_write(pose, of, live); }
  SendStatus write(const Message<G>& of, const Request& asked) { return convert_and_write(request, of, asked); }
  SendStatus write(const Message<G>& of, const Digest& known) { return convert_and_write(digest, of, known); }
  SendStatus write(const Message<G>& of, const LandmarkBatch<G>& batch) {
    SendStatus status = SendStatus::sent;  // of all parts; what was refused for now goes before what is unfit
    for (const auto part : split(std::span<const LandmarkFact<G>>(batch.landmarks)))
      if (const SendStatus of_part = write_fact(landmark, of, part);
          of_part == SendStatus::rejected || status == SendStatus::sent)
        status = of_part;
    return status;
  }

  template <class PubSubType, class Part>
  SendStatus write_fact(Channel<G, PubSubType>& channel, const Message<G>& of, const Part& part) {
    if (!of.repeated) return convert_and_write(channel, of, part);
    typename PubSubType::type sample;
    v1::Answer said_again;
    const bool fits = to_wire<G>(of.sender, part, sample) == WireStatus::ok &&
                      to_answer(of.sender, sample, said_again) == WireStatus::ok;
    return write_sample(answer, said_again, fits);
  }

  template <class PubSubType, class Part>
  SendStatus convert_and_write(Channel<G, PubSubType>& channel, const Message<G>& of, const Part& part) {
    typename PubSubType::type sample;
    const bool fits = to_wire<G>(of.sender, part, sample) == WireStatus::ok;
    return write_sample(channel, sample, fits);
  }

  template <class PubSubType>
  SendStatus write_sample(Channel<G, PubSubType>& channel, typename PubSubType::type& sample, bool fits) {
    if (fits) return channel.write(sample) ? SendStatus::sent : SendStatus::rejected;
    ++refused_to_wire;
    return SendStatus::unfit;
  }

  std::shared_ptr<WireCounters> wire = std::make_shared<WireCounters>();
  ProfileFile profiles;
  Entities entities;
  Inbox<G> inbox;
  PeerTable peers;
  std::atomic<std::uint64_t> sent{0};
  std::atomic<std::uint64_t> taken{0};
  std::atomic<std::uint64_t> rejected{0};
  std::atomic<std::uint64_t> refused_to_wire{0};

  // Last, so that they are gone before anything they use.
  Channel<G, v1::BiasPubSubType> bias{entities.domain(), "convoy/v1/Bias", inbox, peers};
  Channel<G, v1::LandmarkPubSubType> landmark{entities.domain(), "convoy/v1/Landmark", inbox, peers};
  Channel<G, v1::PriorPubSubType> prior{entities.domain(), "convoy/v1/Prior", inbox, peers};
  Channel<G, v1::AssociationPubSubType> association{entities.domain(), "convoy/v1/Association", inbox, peers};
  Channel<G, v1::VerdictPubSubType> verdict{entities.domain(), "convoy/v1/Verdict", inbox, peers};
  Channel<G, v1::AbsoluteFixPubSubType> absolute_fix{entities.domain(), "convoy/v1/AbsoluteFix", inbox, peers};
  Channel<G, v1::EncounterPubSubType> encounter{entities.domain(), "convoy/v1/Encounter", inbox, peers};
  Channel<G, v1::WaypointPubSubType> waypoint{entities.domain(), "convoy/v1/Waypoint", inbox, peers};
  Channel<G, v1::PosePubSubType> pose{entities.domain(), "convoy/v1/Pose", inbox, peers};
  Channel<G, v1::RequestPubSubType> request{entities.domain(), "convoy/v1/Request", inbox, peers};
  Channel<G, v1::AnswerPubSubType> answer{entities.domain(), "convoy/v1/Answer", inbox, peers};
  Channel<G, v1::DigestPubSubType> digest{entities.domain(), "convoy/v1/Digest", inbox, peers};
};

namespace {

/// Fast DDS's table of profiles and its factory serve one thread at a time, and a watchdog may open an exchange while
/// another vehicle of the process does.
std::mutex& opening() {
  static std::mutex mutex;
  return mutex;
}

}  // namespace

template <class G>
DdsExchange<G>::DdsExchange(const DdsConfig& config) {
  const std::lock_guard lock(opening());
  impl_ = std::make_unique<Impl>(config);
}
template <class G>
DdsExchange<G>::~DdsExchange() {
  const std::lock_guard lock(opening());
  impl_.reset();
}

template <class G>
bool DdsExchange<G>::keeps_history() const {
  return impl_->landmark.keeps_history();
}

template <class G>
SendStatus DdsExchange<G>::send(const Message<G>& message) {
  const SendStatus status =
      std::visit([&](const auto& payload) { return impl_->write(message, payload); }, message.payload);
  impl_->sent += status == SendStatus::sent;
  impl_->rejected += status == SendStatus::rejected;
  return status;
}

template <class G>
std::vector<Message<G>> DdsExchange<G>::take(double) {
  auto messages = impl_->inbox.take();
  impl_->taken += messages.size();
  return messages;
}

template <class G>
ExchangeCounters DdsExchange<G>::counters() const {
  ExchangeCounters counters;
  counters.messages_sent = impl_->sent;
  counters.messages_taken = impl_->taken;
  counters.bytes_sent = impl_->wire->wire_bytes();
  counters.send_rejected = impl_->rejected;
  counters.undecodable = impl_->inbox.undecodable;
  counters.hostile = impl_->inbox.hostile;
  counters.dropped = impl_->inbox.dropped + impl_->wire->dropped;
  counters.incompatible_peers = impl_->inbox.incompatible;
  const SecurityCounters refused = dds_counters().refused;
  counters.unauthorised = refused.peers_unsecured + refused.peers_of_other_fleet + refused.peers_unproven +
                          refused.impersonations + refused.unprotected;
  if (Admission* admission = impl_->entities.domain().admission) counters.last_unauthorised = admission->last_refused();
  return counters;
}

template <class G>
DdsCounters DdsExchange<G>::dds_counters() const {
  const WireCounters& wire = *impl_->wire;
  SecurityCounters refused;
  if (Admission* admission = impl_->entities.domain().admission) refused = admission->counters();
  refused.impersonations = impl_->inbox.impersonations;
  return {wire.datagrams,    wire.rtps_bytes, wire.header_bytes, wire.failed_sends, impl_->refused_to_wire,
          impl_->inbox.lost, refused};
}

template <class G>
std::size_t DdsExchange<G>::peers() const {
  return impl_->peers.complete();
}
template <class G>
bool DdsExchange<G>::wait_for_peers(std::size_t count, double timeout_s) const {
  return impl_->peers.wait(count, timeout_s);
}
template <class G>
bool DdsExchange<G>::wait_for_messages(double timeout_s) const {
  return impl_->inbox.wait(timeout_s);
}

#define CONVOY_INSTANTIATE(G) template class DdsExchange<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::dds
