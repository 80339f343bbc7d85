#include <arpa/inet.h>
#include <ifaddrs.h>
#include <netinet/in.h>
#include <unistd.h>

#include <convoy/dds/discovery.hpp>
#include <convoy/dds/entities.hpp>
#include <convoy/dds/secure_gate.hpp>
#include <convoy/submap/content_hash.hpp>

#include <fastdds/rtps/transport/TCPv4TransportDescriptor.h>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include <algorithm>
#include <fstream>
#include <random>

namespace convoy::dds {

namespace edds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
namespace transport = eprosima::fastdds::rtps;

namespace {

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

}  // namespace

Entities::Entities(const DdsConfig& config, const ProfileFile& profiles,
                   const std::shared_ptr<WireCounters>& counters) {
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

void Entities::create_participant(const DdsConfig& config, const ProfileFile& profiles,
                                  const std::shared_ptr<WireCounters>& counters) {
  edds::DomainParticipantQos qos = profiles.participant(config.participant_profile);
  add_layers(qos, config, profiles, counters, admission_.get());
  qos.wire_protocol().prefix = new_prefix(config.vehicle);
  if (security_) security_->apply(qos);
  // The first announcement goes out before answers to it can be taken. Those who heard it would answer once, in vain,
  // and be found by what they announce from time to time; so the second one is to be the first.
  counters->muted = qos.wire_protocol().builtin.discovery_config.discoveryProtocol == rtps::DiscoveryProtocol_t::SIMPLE;
  own_ = need(factory_->create_participant(config.domain, qos, admission_.get(), edds::StatusMask::none()), domain_,
              "participant '" + config.participant_profile + "' in domain " + std::to_string(config.domain));
  counters->muted = false;
  domain_.participant = own_;
}

void Entities::close() {
  if (domain_.subscriber != nullptr) domain_.participant->delete_subscriber(domain_.subscriber);
  if (domain_.publisher != nullptr) domain_.participant->delete_publisher(domain_.publisher);
  if (own_ == nullptr) return;
  own_->set_listener(nullptr);
  factory_->delete_participant(own_);
}

}  // namespace convoy::dds
