// What the tests of the DDS layer share: a domain of one's own, the loopback profile, waiting with a deadline,
// children.
#pragma once

#include <convoy/dds/dds_exchange.hpp>
#include <convoy/geometry/groups.hpp>

#include <gtest/gtest.h>

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace convoy::dds::testing {

inline constexpr double deadline_s = 20.0;

/// A domain for the running test, of those of its executable; no other process takes it meanwhile.
std::uint32_t domain_of_this_test();

std::string profile_named(const std::string& name);

/// The one of sockets, so that bytes can be held against the kernel's, and processes killed without remains.
std::string loopback_profile();

DdsConfig config_of_this_test();

/// The loopback profile with one text replaced by another, in a file of its own.
struct ChangedProfile {
  ChangedProfile(const std::string& from, const std::string& to);
  ~ChangedProfile();
  std::string path;
};

/// Calls `done` whenever something may have changed, until it says true or the deadline has passed.
bool eventually(const std::function<bool()>& done, double timeout_s = deadline_s);

/// Waits until each of `exchanges` has all others as peers.
template <class G>
bool all_connected(const std::vector<DdsExchange<G>*>& exchanges) {
  for (const auto* exchange : exchanges)
    if (!exchange->wait_for_peers(exchanges.size() - 1, deadline_s)) return false;
  return true;
}
inline bool all_connected(const std::vector<DdsExchange<SE2>*>& exchanges) { return all_connected<SE2>(exchanges); }

/// Takes until `count` messages are there or the deadline has passed.
std::vector<Message<SE2>> collect(DdsExchange<SE2>& exchange, std::size_t count, double timeout_s = deadline_s);

/// A child process that is spoken to line by line. It is killed when this goes out of scope.
class Child {
 public:
  explicit Child(const std::vector<std::string>& command);
  ~Child();
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;
  void tell(const std::string& line);
  /// The next line the child prints; empty if there is none within the deadline.
  std::string hear(double timeout_s = deadline_s);
  void kill_hard();
  /// Of the process; -1 once it is known to have ended.
  int pid() const { return pid_; }
  /// Closes its input and waits for it. The exit status, or -signal.
  int finish();

 private:
  int pid_ = -1;
  int to_child_ = -1;
  int from_child_ = -1;
  std::string heard_;
};

/// A child that runs one vehicle (see peer.cpp) in the domain of this test.
std::vector<std::string> peer_command(VehicleId vehicle, const std::string& profile = loopback_profile());

/// A Discovery Server: fast-discovery-server with qos_profiles/discovery_server.xml, at an address and a port of its
/// own. It is killed when this goes out of scope.
class DiscoveryServer {
 public:
  /// `place` is that among the discovery_servers; `wrapped` makes the command run somewhere
  /// else.
  DiscoveryServer(const std::string& address, std::uint16_t port, int place = 0,
                  const std::function<std::vector<std::string>(const std::vector<std::string>&)>& wrapped = {});
  ~DiscoveryServer();
  DiscoveryServer(const DiscoveryServer&) = delete;
  DiscoveryServer& operator=(const DiscoveryServer&) = delete;
  void start();
  void kill_hard() { server_.reset(); }
  std::string option() const { return "server=" + address_; }
  static bool installed();

 private:
  std::string file_, address_;
  std::vector<std::string> command_;
  std::unique_ptr<Child> server_;
};

/// What a peer says it has put on the wire.
struct Sent {
  std::uint64_t rtps = 0, headers = 0, datagrams = 0;
};
Sent sent_by(Child& peer);

/// What opening an exchange is refused with; "accepted" if it is not.
std::string refusal(const DdsConfig& config);

}  // namespace convoy::dds::testing
