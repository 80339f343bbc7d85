// Whom a participant looks for. Its profile says how vehicles find each other, and the vehicle's configuration whom to
// ask: addresses are a matter of the fleet and not of quality of service.
#pragma once

#include <convoy/dds/dds_exchange.hpp>

#include <fastdds/dds/domain/qos/DomainParticipantQos.hpp>

#include <string>

namespace convoy::dds {

/// What is wrong with an entry of DdsConfig::initial_peers, or of discovery_servers, and how to mend it; empty if it is
/// in order. Only figures are: Fast DDS would look a name up on the network.
std::string fault_of_peer(const std::string& entry);
std::string fault_of_server(const std::string& entry);

/// Puts initial_peers or discovery_servers into `qos`, whose transports are still those of the profile. What the
/// profile is made for follows from what it says:
///   discoveryProtocol SIMPLE, no metatrafficUnicastLocatorList, not over TCP alone: multicast; takes neither
///   SIMPLE otherwise: needs initial_peers, which replace an initialPeersList of its own (over TCP each with its port)
///   CLIENT or SUPER_CLIENT: needs discovery_servers, which replace a discoveryServersList of its own
/// The n-th server of the list, from 0, is the one that runs under the id n (`fast-discovery-server -i n`).
/// Throws ConfigError if the profile has no use for what is given, or lacks what it needs. `where` begins errors about
/// the profile ("file:line: participant profile 'convoy': ").
void apply_addresses(eprosima::fastdds::dds::DomainParticipantQos& qos, const DdsConfig& config,
                     const std::string& where);

}  // namespace convoy::dds
