#include "bridged_lan.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <linux/filter.h>
#include <linux/if_ether.h>
#include <linux/if_packet.h>
#include <sched.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstring>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <thread>

namespace convoy::dds::testing {
namespace {

/// Holds a network namespace of its own for as long as its standard input is open.
std::unique_ptr<Child> hold_namespace() {
  auto holder = std::make_unique<Child>(std::vector<std::string>{"unshare", "-n", "sh", "-c", "echo held; exec cat"});
  if (holder->hear() != "held") throw std::runtime_error("no network namespace can be made here");
  return holder;
}

std::string namespace_of(const Child& holder) { return "/proc/" + std::to_string(holder.pid()) + "/ns/net"; }

std::vector<std::string> inside(const Child& holder, const std::vector<std::string>& command) {
  std::vector<std::string> words{"nsenter", "--net=" + namespace_of(holder)};
  words.insert(words.end(), command.begin(), command.end());
  return words;
}

void run(const Child& holder, const std::string& script) {
  if (Child(inside(holder, {"sh", "-ec", script})).finish() != 0) throw std::runtime_error("failed: " + script);
}

constexpr const char* no_ipv6 =
    "sysctl -qw net.ipv6.conf.all.disable_ipv6=1 net.ipv6.conf.default.disable_ipv6=1 "
    "2>/dev/null || true; ip link set lo up; ";

}  // namespace

std::string why_no_namespaces() {
  if (geteuid() != 0) return "needs root to make network namespaces";
  try {
    const BridgedLan trial(1);
  } catch (const std::runtime_error& error) {
    return std::string("this machine makes no network namespaces with a bridge: ") + error.what();
  }
  return {};
}

BridgedLan::BridgedLan(std::size_t hosts) : subnet_("10.97." + std::to_string(getpid() % 255) + ".") {
  for (std::size_t i = 0; i <= hosts; ++i) holders_.push_back(hold_namespace());
  const Child& bridge = *holders_.back();
  run(bridge, std::string(no_ipv6) + "ip link add lan type bridge mcast_snooping 0; ip link set lan up");
  for (std::size_t i = 0; i < hosts; ++i) {
    const std::string port = "port" + std::to_string(i);
    run(*holders_[i], no_ipv6);
    run(bridge, "ip link add " + port + " type veth peer name lan0 netns " + std::to_string(holders_[i]->pid()) +
                    "; ip link set " + port + " master lan up");
    run(*holders_[i],
        "ip addr add " + address(i) + "/24 dev lan0; ip link set lan0 up; " + "ip route add 224.0.0.0/4 dev lan0");
  }
}

std::vector<std::string> BridgedLan::on(std::size_t host, const std::vector<std::string>& command) const {
  return inside(*holders_[host], command);
}

void BridgedLan::plug(std::size_t host, bool in) const {
  run(*holders_.back(), "ip link set port" + std::to_string(host) + (in ? " up" : " down"));
}

std::string BridgedLan::host_namespace(std::size_t host) const { return namespace_of(*holders_[host]); }
std::string BridgedLan::bridge_namespace() const { return namespace_of(*holders_.back()); }

/// Of /proc/PID/net/netstat: a line of names that begins with "IpExt:", and below it one of figures.
std::uint64_t BridgedLan::ip_figure(std::size_t host, const std::string& name) const {
  std::ifstream file("/proc/" + std::to_string(holders_[host]->pid()) + "/net/netstat");
  std::string names, figures;
  while (std::getline(file, names) && std::getline(file, figures)) {
    std::istringstream n(names), f(figures);
    for (std::string key, value; n >> key && f >> value;)
      if (names.starts_with("IpExt:") && key == name) return std::stoull(value);
  }
  throw std::runtime_error("the kernel does not tell " + name);
}

int namespace_socket(const std::string& network_namespace, int domain, int type, int protocol) {
  int made = -1;
  // A thread has a namespace of its own, and its sockets stay there when it has ended.
  std::thread([&] {
    const int target = open(network_namespace.c_str(), O_RDONLY | O_CLOEXEC);
    if (target >= 0 && setns(target, CLONE_NEWNET) == 0) made = socket(domain, type | SOCK_CLOEXEC, protocol);
    if (target >= 0) close(target);
  }).join();
  if (made < 0) throw std::runtime_error("no socket in " + network_namespace);
  return made;
}

Sniffer::Sniffer(const std::string& network_namespace, const std::string& subnet)
    : socket_(namespace_socket(network_namespace, AF_PACKET, SOCK_DGRAM, htons(ETH_P_ALL))) {
  in_addr address{};
  inet_pton(AF_INET, (subnet + "0").c_str(), &address);
  subnet_ = address.s_addr;
  // The kernel passes on only what is of the subnet, so that the host's other traffic drowns nothing.
  sock_filter program[] = {BPF_STMT(BPF_LD | BPF_W | BPF_ABS, 12),  // the source address of an IPv4 header
                           BPF_STMT(BPF_ALU | BPF_AND | BPF_K, 0xffffff00),
                           BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, ntohl(subnet_), 0, 1), BPF_STMT(BPF_RET | BPF_K, 64),
                           BPF_STMT(BPF_RET | BPF_K, 0)};
  const sock_fprog filter{5, program};
  const int room = 16 << 20;
  setsockopt(socket_, SOL_SOCKET, SO_RCVBUFFORCE, &room, sizeof room);
  if (setsockopt(socket_, SOL_SOCKET, SO_ATTACH_FILTER, &filter, sizeof filter) != 0)
    throw std::runtime_error("the kernel takes no packet filter");
  for (char byte; recv(socket_, &byte, 1, MSG_DONTWAIT) >= 0;) continue;  // what came before the filter was there
}

Sniffer::~Sniffer() { close(socket_); }

std::uint64_t Sniffer::packets() {
  for (char byte; recv(socket_, &byte, 1, MSG_DONTWAIT) >= 0;) ++packets_;
  tpacket_stats stats{};
  socklen_t size = sizeof stats;
  if (getsockopt(socket_, SOL_PACKET, PACKET_STATISTICS, &stats, &size) != 0 || stats.tp_drops != 0)
    throw std::runtime_error("the sniffer has missed packets");
  return packets_;
}

}  // namespace convoy::dds::testing
