// One vehicle's exchange in a process of its own: convoy_dds_peer PROFILES DOMAIN VEHICLE [ADDRESS] [OPTION...]
// Options: impair=IMPAIRMENT, security=FOLDER, and as often as needed peer=ADDRESS[:PORT] and server=ADDRESS:PORT.
// Driven by lines on standard input:
//   peers N           waits for N peers, prints "peers N" or "no peers"
//   now N             the same, without waiting
//   send FIRST COUNT  sends anchors of these indices, prints "sent COUNT"
//   relay AUTHOR FIRST COUNT  the same, of anchors that AUTHOR has written
//   claim AUTHOR FIRST COUNT  the same, pretending to be AUTHOR
//   refused           prints "refused UNSECURED OTHER_FLEET UNPROVEN IMPERSONATIONS UNPROTECTED", then the last peer
//   cpu               prints "cpu MS": what this process has used so far
//   pair N            sends one association of N pairings, prints "paired N" or "not paired"
//   expect N          takes until N different facts are held (or COUNT seconds), prints "held N"
//   take              takes what is there, prints "held N"
//   block V, unblock V  stops hearing vehicle V, or goes on; prints "blocked V", "unblocked V"
//   bytes             prints "bytes RTPS HEADERS DATAGRAMS"
//   dev               prints what the kernel has sent: per interface "NAME BYTES PACKETS", then "udp 0 DATAGRAMS",
//   "end"
#include <convoy/dds/dds_exchange.hpp>
#include <convoy/dds/impaired_transport.hpp>
#include <convoy/geometry/se2.hpp>

#include <fastdds/dds/log/Log.hpp>

#include <algorithm>
#include <chrono>
#include <ctime>
#include <fstream>
#include <iostream>
#include <set>
#include <sstream>
#include <string>
#include <vector>

using namespace convoy;

namespace {

constexpr double deadline_s = 60.0;
using Held = std::set<std::pair<FactKind, Key>>;

void take(dds::DdsExchange<SE2>& exchange, Held& held) {
  for (const auto& message : exchange.take(0.0)) {
    if (const auto* anchor = std::get_if<AnchorFact<SE2>>(&message.payload))
      held.insert({FactKind::anchor, anchor->key});
    if (const auto* association = std::get_if<AssociationFact>(&message.payload))
      held.insert({FactKind::association, association->key});
  }
}

void expect(dds::DdsExchange<SE2>& exchange, Held& held, std::size_t count, double timeout_s) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::duration<double>(timeout_s);
  while (held.size() < count && std::chrono::steady_clock::now() < deadline)
    if (exchange.wait_for_messages(0.1)) take(exchange, held);
}

std::uint32_t send(dds::DdsExchange<SE2>& exchange, VehicleId sender, VehicleId author, std::uint32_t first,
                   std::uint32_t count) {
  std::uint32_t sent = 0;
  for (std::uint32_t i = first; i < first + count; ++i) {
    AnchorFact<SE2> fact;
    fact.key = {{author, 1}, i};
    fact.state.abscissa_m = 25.0 * i;
    if (exchange.send({{sender, 1}, fact}) == SendStatus::sent) ++sent;
  }
  return sent;
}

bool send_association(dds::DdsExchange<SE2>& exchange, VehicleId vehicle, std::uint32_t pairings) {
  AssociationFact fact{{{vehicle, 1}, 0}, {}};
  for (std::uint32_t i = 0; i < pairings; ++i) fact.pairings.push_back({{{1, 1}, i}, {{2, 1}, i}});
  return exchange.send({fact.key.chain, fact}) == SendStatus::sent;
}

/// OutDatagrams of /proc/net/snmp: the second line that begins with "Udp:", fourth figure.
std::uint64_t udp_datagrams() {
  std::ifstream file("/proc/net/snmp");
  std::uint64_t figure[4] = {};
  for (std::string line; std::getline(file, line);)
    if (line.rfind("Udp: ", 0) == 0) {
      std::istringstream words(line.substr(5));
      for (auto& f : figure) words >> f;  // the line of names leaves zeros
    }
  return figure[3];
}

std::string text_of(const char* path) {
  std::ostringstream text;
  text << std::ifstream(path).rdbuf();
  return text.str();
}

/// The two files are read one after the other: a reading counts only if no datagram was sent in between.
void print_devices() {
  std::uint64_t datagrams = udp_datagrams();
  std::string devices = text_of("/proc/net/dev");
  for (std::uint64_t after = udp_datagrams(); after != datagrams; after = udp_datagrams()) {
    datagrams = after;
    devices = text_of("/proc/net/dev");
  }
  std::istringstream lines(devices);
  std::string line;
  for (int i = 0; std::getline(lines, line); ++i) {
    if (i < 2) continue;
    std::replace(line.begin(), line.end(), ':', ' ');
    std::istringstream words(line);
    std::string name;
    std::uint64_t figure[10] = {};
    words >> name;
    for (auto& f : figure) words >> f;
    std::cout << name << ' ' << figure[8] << ' ' << figure[9] << '\n';
  }
  std::cout << "udp 0 " << datagrams << "\nend" << std::endl;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 4) return 2;
  eprosima::fastdds::dds::Log::ClearConsumers();  // they write to standard output, where our answers go
  dds::DdsConfig config;
  config.profile_file = argv[1];
  config.domain = static_cast<std::uint32_t>(std::stoul(argv[2]));
  const auto vehicle = static_cast<VehicleId>(std::stoul(argv[3]));
  config.vehicle = vehicle;
  std::shared_ptr<dds::ImpairedNetwork> network;
  for (int i = 4; i < argc; ++i) {
    const std::string option = argv[i];
    if (option.starts_with("impair=")) network = dds::impair(config, Impairments::parse(option.substr(7)));
    else if (option.starts_with("security=")) config.security_folder = option.substr(9);
    else if (option.starts_with("peer=")) config.initial_peers.push_back(option.substr(5));
    else if (option.starts_with("server=")) config.discovery_servers.push_back(option.substr(7));
    else config.interface_whitelist = {option};
  }
  dds::DdsExchange<SE2> exchange(config);
  Held held;
  std::cout << "ready" << std::endl;
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream words(line);
    std::string verb;
    VehicleId author = vehicle;
    std::uint32_t first = 0, count = 0;
    words >> verb;
    if (verb == "relay" || verb == "claim") words >> author;
    words >> first >> count;
    if (verb == "peers" || verb == "now") {
      std::cout << (exchange.wait_for_peers(first, verb == "now" ? 0.0 : deadline_s) ? "peers " + std::to_string(first)
                                                                                     : "no peers")
                << std::endl;
    } else if (verb == "send") {
      std::cout << "sent " << send(exchange, vehicle, vehicle, first, count) << std::endl;
    } else if (verb == "relay" || verb == "claim") {
      const VehicleId sender = verb == "claim" ? author : vehicle;
      std::cout << "sent " << send(exchange, sender, author, first, count) << std::endl;
    } else if (verb == "refused") {
      const auto refused = exchange.dds_counters().refused;
      std::cout << "refused " << refused.peers_unsecured << ' ' << refused.peers_of_other_fleet << ' '
                << refused.peers_unproven << ' ' << refused.impersonations << ' ' << refused.unprotected << '\n'
                << exchange.counters().last_unauthorised << std::endl;
    } else if (verb == "cpu") {
      std::cout << "cpu " << 1000 * std::clock() / CLOCKS_PER_SEC << std::endl;
    } else if (verb == "pair") {
      std::cout << (send_association(exchange, vehicle, first) ? "paired " + std::to_string(first) : "not paired")
                << std::endl;
    } else if (verb == "expect") {
      expect(exchange, held, first, count == 0 ? deadline_s : count);
      std::cout << "held " << held.size() << std::endl;
    } else if (verb == "take") {
      take(exchange, held);
      std::cout << "held " << held.size() << std::endl;
    } else if (verb == "block" && network) {
      network->block(first);
      std::cout << "blocked " << first << std::endl;
    } else if (verb == "unblock" && network) {
      network->unblock(first);
      std::cout << "unblocked " << first << std::endl;
    } else if (verb == "bytes") {
      const auto counters = exchange.dds_counters();
      std::cout << "bytes " << counters.rtps_bytes_sent << ' ' << counters.header_bytes_sent << ' '
                << counters.datagrams_sent << std::endl;
    } else if (verb == "dev") {
      print_devices();
    }
  }
}
