// A transport that counts what it hands to the transport below it: user data, discovery, heartbeats, acknowledgements
// and repeats alike.
#pragma once

#include <convoy/dds/chained_transport.hpp>

#include <atomic>
#include <cstdint>
#include <memory>

namespace convoy::dds {

/// Figures since the transport was opened. Safe to read from any thread.
struct WireCounters {
  std::atomic<std::uint64_t> datagrams{0};     ///< RTPS messages, one per destination
  std::atomic<std::uint64_t> rtps_bytes{0};    ///< RTPS header and everything in it
  std::atomic<std::uint64_t> header_bytes{0};  ///< of what carries them; see header_bytes_of()
  std::atomic<std::uint64_t> failed_sends{0};  ///< the transport below took less than all of a message's datagrams
  std::atomic<std::uint64_t> dropped{0};       ///< by an impairment, of what was sent or received
  std::atomic<bool> muted{false};              ///< what is sent meanwhile is not, and nobody is told

  std::uint64_t wire_bytes() const { return rtps_bytes.load() + header_bytes.load(); }
};

/// What is added to each RTPS message on the wire, without the link layer's headers and those of IP fragments.
/// UDPv4: 28 (IPv4 20, UDP 8). TCPv4: 66 (IPv4 20, TCP with time stamps 32, framing of RTPS over TCP 14), as if every
/// message were a segment; connecting, keeping alive, acknowledgements and repeats of TCP itself are not seen from
/// here. Shared memory: 0.
std::uint32_t header_bytes_of(std::int32_t transport_kind);

/// Counts above any transport. One of sockets needs an interfaceWhiteList for an exact count: without it the transport
/// below chooses by itself on which sockets a datagram leaves.
class CountingTransportDescriptor final : public eprosima::fastdds::rtps::ChainingTransportDescriptor {
 public:
  CountingTransportDescriptor(std::shared_ptr<TransportDescriptorInterface> below,
                              std::shared_ptr<WireCounters> wire_counters)
      : ChainingTransportDescriptor(std::move(below)), counters(std::move(wire_counters)) {}
  eprosima::fastdds::rtps::TransportInterface* create_transport() const override;

  std::shared_ptr<WireCounters> counters;
};

class CountingTransport final : public ChainedTransport {
 public:
  explicit CountingTransport(const CountingTransportDescriptor& descriptor)
      : ChainedTransport(descriptor), descriptor_(descriptor) {}

  bool send(eprosima::fastrtps::rtps::SenderResource& below, const eprosima::fastrtps::rtps::octet* buffer,
            std::uint32_t size, const eprosima::fastrtps::rtps::LocatorList_t& destinations,
            const std::chrono::steady_clock::time_point& until) override;

  void receive(eprosima::fastdds::rtps::TransportReceiverInterface* next_receiver,
               const eprosima::fastrtps::rtps::octet* buffer, std::uint32_t size,
               const eprosima::fastrtps::rtps::Locator_t& local_locator,
               const eprosima::fastrtps::rtps::Locator_t& remote_locator) override;

  eprosima::fastdds::rtps::TransportDescriptorInterface* get_configuration() override { return &descriptor_; }

 private:
  CountingTransportDescriptor descriptor_;
};

}  // namespace convoy::dds
