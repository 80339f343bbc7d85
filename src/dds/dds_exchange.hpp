// SubmapExchange on Fast DDS: one topic per kind of message, quality of service from an XML profile file.
#pragma once

#include <convoy/config_error.hpp>
#include <convoy/exchange/submap_exchange.hpp>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace eprosima::fastdds {
namespace dds {
class DomainParticipant;
}
namespace rtps {
struct TransportDescriptorInterface;
}
}  // namespace eprosima::fastdds

namespace convoy::dds {

struct WireCounters;

struct DdsConfig {
  std::uint32_t domain = 0;                      ///< DDS domain, 0..232; unused with an injected participant
  std::string profile_file;                      ///< path of the XML profile file (see qos_profiles/README.md)
  std::string participant_profile = "convoy";    ///< name of the participant profile in it
  std::vector<std::string> interface_whitelist;  ///< IPv4 addresses to speak on; replaces that of the profile if given
  /// "ADDRESS" or "ADDRESS:PORT" (IPv4) of some other vehicles, for a profile without multicast (see discovery.hpp).
  std::vector<std::string> initial_peers;
  /// "ADDRESS:PORT" (IPv4), for a profile of Discovery Server clients; the first one runs under the id 0, and so on.
  std::vector<std::string> discovery_servers;
  std::string origin;         ///< "file:line" of these addresses, for errors; may be empty
  std::uint32_t vehicle = 0;  ///< names the participant in its GUID; with DDS Security on, must be its certificate's
  std::size_t max_queued_messages = 65536;  ///< received and not yet taken, >= 1; what comes beyond is dropped

  /// Folder that scripts/make-certs made for this vehicle: DDS Security is on, whatever the profile. Empty: off.
  std::string security_folder;

  /// Puts a transport of one's own between the byte counter and each transport of the profile, for trials; see
  /// impaired_transport.hpp. What it drops on purpose it adds to WireCounters::dropped.
  std::function<std::shared_ptr<eprosima::fastdds::rtps::TransportDescriptorInterface>(
      std::shared_ptr<eprosima::fastdds::rtps::TransportDescriptorInterface> below, std::shared_ptr<WireCounters>)>
      wrap_transport;

  /// The host's own participant, in place of one from the profile. It must outlive the exchange. Its transports are
  /// the host's affair: bytes_sent stays 0, and the addresses above have no effect.
  eprosima::fastdds::dds::DomainParticipant* participant = nullptr;
};

/// What was refused with DDS Security on. Each peer is counted once for as long as it announces itself.
struct SecurityCounters {
  std::uint64_t peers_unsecured = 0;       ///< they speak without DDS Security
  std::uint64_t peers_of_other_fleet = 0;  ///< another authority made their certificates
  std::uint64_t peers_unproven = 0;        ///< certificate or permissions expired, altered, or never shown
  std::uint64_t impersonations = 0;  ///< samples whose sender is not the vehicle whose certificate they came under
  std::uint64_t unprotected = 0;     ///< RTPS messages that lacked the protection which the fleet's rules ask for
};

/// What only this exchange can tell, besides ExchangeCounters.
struct DdsCounters {
  std::uint64_t datagrams_sent = 0;     ///< RTPS messages, one per destination
  std::uint64_t rtps_bytes_sent = 0;    ///< RTPS headers and everything in them
  std::uint64_t header_bytes_sent = 0;  ///< of what carries them: 28 per UDP datagram, 66 over TCP, 0 in shared memory
  std::uint64_t failed_sends = 0;       ///< the socket did not take a message; reliable topics repeat it
  std::uint64_t refused_to_wire =
      0;  ///< what the wire format cannot hold of one's own messages (convert.hpp): SendStatus::unfit
  std::uint64_t samples_lost = 0;  ///< samples the middleware knows it has lost
  SecurityCounters refused;        ///< all 0 with DDS Security off
};

/// Threads: send() and take() may be called from different threads, each from one at a time. Receiving threads of the
/// middleware only wake one of the exchange's own, which converts and enqueues.
///
/// Bytes: counters().bytes_sent counts every RTPS message of the participant (user data, discovery, heartbeats,
/// acknowledgements, repeats) with the headers that carry it (see counting_transport.hpp). Link-layer headers are not
/// included.
///
/// send() blocks for at most the max_blocking_time of the writer's profile, and only while a socket buffer is full.
/// Batches of landmarks are cut into samples of at most 1200 bytes, so one message may arrive as several.
template <class G>
class DdsExchange final : public SubmapExchange<G> {
 public:
  /// Opens all endpoints. Throws ConfigError. From any thread: creating and destroying exchanges of
  /// one process waits for one another.
  explicit DdsExchange(const DdsConfig& config);
  ~DdsExchange() override;
  DdsExchange(const DdsExchange&) = delete;
  DdsExchange& operator=(const DdsExchange&) = delete;

  [[nodiscard]] SendStatus send(const Message<G>& message) override;
  /// Facts that are said again share samples of at most 1200 bytes, where they are smaller.
  [[nodiscard]] SendStatus send_together(std::span<const Message<G>> messages) override;

  /// `now_s` is not used: a message is due once it has arrived.
  std::vector<Message<G>> take(double now_s) override;

  ExchangeCounters counters() const override;
  DdsCounters dds_counters() const;

  /// The profile keeps facts for late joiners, who get them from the middleware all at once, whatever a byte budget
  /// says.
  bool keeps_history() const;

  /// Remote participants of which every endpoint of convoy has found its counterpart here.
  std::size_t peers() const;
  std::optional<std::size_t> live_peers() const override { return peers(); }

  /// True once at least `count` peers are there, false if that is not so within `timeout_s`.
  [[nodiscard]] bool wait_for_peers(std::size_t count, double timeout_s) const;
  /// True once something can be taken, false if that is not so within `timeout_s`.
  [[nodiscard]] bool wait_for_messages(double timeout_s) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace convoy::dds
