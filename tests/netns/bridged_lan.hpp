// Vehicles on a LAN of their own: a network namespace for each, with a cable to a bridge in one more. No interface of
// the host takes part. A namespace is held by a child process and by nothing else, so that it is gone with the test
// even if that is killed.
#pragma once

#include "../dds/dds_testing.hpp"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace convoy::dds::testing {

/// Why this process cannot make network namespaces; empty if it can.
std::string why_no_namespaces();

class BridgedLan {
 public:
  /// Hosts 0 .. hosts-1 with their addresses, up and running. Throws std::runtime_error.
  explicit BridgedLan(std::size_t hosts);

  std::string address(std::size_t host) const { return subnet_ + std::to_string(host + 1); }
  /// The first three bytes of all addresses, and a dot: no other test's that runs at the same time.
  const std::string& subnet() const { return subnet_; }
  /// `command`, to be run on a host.
  std::vector<std::string> on(std::size_t host, const std::vector<std::string>& command) const;
  /// Pulls the cable of a host out of the bridge, or puts it back.
  void plug(std::size_t host, bool in) const;
  /// IP multicast packets a host has sent, and those that it has received.
  std::uint64_t multicast_sent(std::size_t host) const { return ip_figure(host, "OutMcastPkts"); }
  std::uint64_t multicast_received(std::size_t host) const { return ip_figure(host, "InMcastPkts"); }

  /// For namespace_socket().
  std::string host_namespace(std::size_t host) const;
  std::string bridge_namespace() const;

 private:
  std::uint64_t ip_figure(std::size_t host, const std::string& name) const;

  std::string subnet_;
  std::vector<std::unique_ptr<Child>> holders_;  // the last one holds the bridge
};

/// The network namespace of this process.
inline const std::string this_namespace = "/proc/self/ns/net";

/// A socket in another network namespace. Throws std::runtime_error.
int namespace_socket(const std::string& network_namespace, int domain, int type, int protocol);

/// Counts IPv4 packets that come from a subnet, on all interfaces of a namespace.
class Sniffer {
 public:
  Sniffer(const std::string& network_namespace, const std::string& subnet);
  ~Sniffer();
  Sniffer(const Sniffer&) = delete;
  Sniffer& operator=(const Sniffer&) = delete;
  /// Up to now. Throws std::runtime_error if the kernel has dropped packets that were not looked at.
  std::uint64_t packets();

 private:
  int socket_;
  std::uint32_t subnet_;  // network order, last byte 0
  std::uint64_t packets_ = 0;
};

}  // namespace convoy::dds::testing
