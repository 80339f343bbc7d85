#include <convoy/dds/discovery.hpp>

#include <arpa/inet.h>

#include <fastdds/rtps/attributes/ServerAttributes.h>
#include <fastdds/rtps/transport/TCPv4TransportDescriptor.h>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

#include <charconv>
#include <cstdint>

namespace convoy::dds {

namespace edds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
namespace transport = eprosima::fastdds::rtps;

namespace {

struct Entry {
  std::string address;
  std::uint16_t port = 0;  // 0: none is given
  std::string fault;
};

Entry faulty(const std::string& text, const std::string& fault, const std::string& form) {
  return {{}, 0, "'" + text + "' " + fault + "; write " + form};
}

Entry entry_of(const std::string& text, bool needs_port) {
  const std::string form = needs_port ? "ADDRESS:PORT, such as 192.0.2.1:11811"
                                      : "ADDRESS or ADDRESS:PORT, such as 192.0.2.1 or 192.0.2.1:7410";
  const auto colon = text.find(':');
  Entry entry{text.substr(0, colon), 0, {}};
  in_addr binary{};
  if (inet_pton(AF_INET, entry.address.c_str(), &binary) != 1)
    return faulty(text, "is no IPv4 address (a name would have to be looked up on the network)", form);
  const std::uint32_t address = ntohl(binary.s_addr);
  if (address >> 24 == 0 || address >> 28 >= 0xe) return faulty(text, "is the address of no single host", form);
  if (colon == std::string::npos) {
    if (needs_port) return faulty(text, "has no port", form);
    return entry;
  }
  const char* const end = text.data() + text.size();
  const auto [rest, error] = std::from_chars(text.data() + colon + 1, end, entry.port);
  if (error != std::errc() || rest != end || entry.port == 0)
    return faulty(text, "has a port that is not in 1..65535", form);
  return entry;
}

/// Connections have neither multicast nor ports that are known beforehand.
bool speaks_tcp_alone(const edds::DomainParticipantQos& qos) {
  bool tcp = false;
  for (const auto& descriptor : qos.transport().user_transports) {
    if (std::dynamic_pointer_cast<transport::UDPv4TransportDescriptor>(descriptor)) return false;
    if (std::dynamic_pointer_cast<transport::TCPv4TransportDescriptor>(descriptor)) tcp = true;
  }
  return tcp;
}

/// Port 0 stands for the first maxInitialPeersRange ports of the domain.
rtps::Locator_t locator_of(const Entry& entry, bool tcp) {
  rtps::Locator_t locator;
  rtps::IPLocator::createLocator(tcp ? LOCATOR_KIND_TCPv4 : LOCATOR_KIND_UDPv4, entry.address, 0, locator);
  if (tcp) rtps::IPLocator::setPhysicalPort(locator, entry.port);
  else locator.port = entry.port;
  return locator;
}

struct Errors {
  const DdsConfig& config;
  const std::string& where;

  std::string configuration() const { return config.origin.empty() ? "the configuration: " : config.origin + ": "; }
  std::string entry(const char* attribute) const {
    return config.origin.empty() ? std::string("the configuration")
                                 : config.origin + " (<dds " + attribute + "=\"...\">)";
  }
  void take(const std::vector<std::string>& list, const char* name, std::string (*fault_of)(const std::string&)) const {
    for (const std::string& text : list)
      if (const std::string fault = fault_of(text); !fault.empty())
        throw ConfigError(configuration() + name + ": " + fault);
  }
  void refuse(const std::vector<std::string>& given, const char* name, const std::string& instead) const {
    if (!given.empty())
      throw ConfigError(configuration() + name + " are of no use to this profile; " + instead + " (" +
                        where.substr(0, where.rfind(": ")) + ")");
  }
};

constexpr const char* peers = "initial peers";
constexpr const char* servers = "discovery servers";

void use_multicast(const DdsConfig& config, const Errors& errors) {
  const std::string found = "it finds vehicles by multicast: take them out, or take ";
  errors.refuse(config.initial_peers, peers, found + "unicast_peers.xml");
  errors.refuse(config.discovery_servers, servers, found + "large_fleet.xml");
}

void use_peers(rtps::BuiltinAttributes& builtin, const DdsConfig& config, const Errors& errors, bool tcp) {
  errors.refuse(config.discovery_servers, servers, "it needs initial peers: give these, or take large_fleet.xml");
  if (!config.initial_peers.empty()) builtin.initialPeersList.clear();
  for (const std::string& text : config.initial_peers) {
    const Entry entry = entry_of(text, tcp);
    if (!entry.fault.empty()) throw ConfigError(errors.configuration() + peers + " over TCP: " + entry.fault);
    builtin.initialPeersList.push_back(locator_of(entry, tcp));
  }
  if (builtin.initialPeersList.empty())
    throw ConfigError(errors.where + "no initial peers, and it does not use multicast; name the addresses of " +
                      "the other vehicles in " + errors.entry("peers"));
}

void use_servers(rtps::BuiltinAttributes& builtin, const DdsConfig& config, const Errors& errors, bool tcp) {
  errors.refuse(config.initial_peers, peers, "it needs discovery servers: give these, or take unicast_peers.xml");
  auto& list = builtin.discovery_config.m_DiscoveryServers;
  if (!config.discovery_servers.empty()) list.clear();
  for (std::size_t id = 0; id < config.discovery_servers.size(); ++id) {
    rtps::RemoteServerAttributes server;
    transport::get_server_client_default_guidPrefix(static_cast<int>(id), server.guidPrefix);
    server.metatrafficUnicastLocatorList.push_back(locator_of(entry_of(config.discovery_servers[id], true), tcp));
    list.push_back(server);
  }
  if (list.empty())
    throw ConfigError(errors.where + "no discovery servers, and it does not look for vehicles by itself; name " +
                      "address and port of at least one in " + errors.entry("discovery_servers"));
}

}  // namespace

std::string fault_of_peer(const std::string& entry) { return entry_of(entry, false).fault; }
std::string fault_of_server(const std::string& entry) { return entry_of(entry, true).fault; }

void apply_addresses(edds::DomainParticipantQos& qos, const DdsConfig& config, const std::string& where) {
  const Errors errors{config, where};
  errors.take(config.initial_peers, peers, fault_of_peer);
  errors.take(config.discovery_servers, servers, fault_of_server);
  auto& builtin = qos.wire_protocol().builtin;
  const bool tcp = speaks_tcp_alone(qos);
  switch (builtin.discovery_config.discoveryProtocol) {
    case rtps::DiscoveryProtocol_t::CLIENT:
    case rtps::DiscoveryProtocol_t::SUPER_CLIENT: return use_servers(builtin, config, errors, tcp);
    case rtps::DiscoveryProtocol_t::SIMPLE:
      if (!tcp && builtin.metatrafficUnicastLocatorList.empty()) return use_multicast(config, errors);
      return use_peers(builtin, config, errors, tcp);
    default:
      throw ConfigError(where + "<discoveryProtocol> must be SIMPLE, CLIENT or SUPER_CLIENT; a vehicle is no server");
  }
}

}  // namespace convoy::dds
