// A transport that counts what it hands to the sockets of the transport below it: user data, discovery, heartbeats,
// acknowledgements and repeats alike.
#pragma once

#include <fastdds/rtps/transport/ChainingTransport.h>
#include <fastdds/rtps/transport/ChainingTransportDescriptor.h>
#include <fastdds/rtps/transport/UDPTransportDescriptor.h>

#include <atomic>
#include <cstdint>
#include <memory>

namespace convoy::dds {

/// Figures since the transport was opened. Safe to read from any thread.
struct WireCounters {
  std::atomic<std::uint64_t> datagrams{0};
  std::atomic<std::uint64_t> rtps_bytes{0};    ///< UDP payload: RTPS header and everything in it
  std::atomic<std::uint64_t> failed_sends{0};  ///< the socket took less than all of a message's datagrams

  /// IPv4 (20) and UDP (8) headers. Ethernet's are not included, nor those of IP fragments.
  std::uint64_t header_bytes() const { return 28 * datagrams.load(); }
  std::uint64_t wire_bytes() const { return rtps_bytes.load() + header_bytes(); }
};

/// Wraps a UDP transport with an interfaceWhiteList. The list is needed for an exact count: without one the transport
/// below chooses by itself on which sockets a datagram leaves.
class CountingTransportDescriptor : public eprosima::fastdds::rtps::ChainingTransportDescriptor {
 public:
  CountingTransportDescriptor(std::shared_ptr<eprosima::fastdds::rtps::UDPTransportDescriptor> udp,
                              std::shared_ptr<WireCounters> counters);
  eprosima::fastdds::rtps::TransportInterface* create_transport() const override;

  std::shared_ptr<eprosima::fastdds::rtps::UDPTransportDescriptor> udp;
  std::shared_ptr<WireCounters> counters;
};

class CountingTransport final : public eprosima::fastdds::rtps::ChainingTransport {
 public:
  explicit CountingTransport(const CountingTransportDescriptor& descriptor);

  bool send(eprosima::fastrtps::rtps::SenderResource* low_sender_resource,
            const eprosima::fastrtps::rtps::octet* buffer, std::uint32_t size,
            eprosima::fastrtps::rtps::LocatorsIterator* destinations_begin,
            eprosima::fastrtps::rtps::LocatorsIterator* destinations_end,
            const std::chrono::steady_clock::time_point& timeout) override;

  void receive(eprosima::fastdds::rtps::TransportReceiverInterface* next_receiver,
               const eprosima::fastrtps::rtps::octet* buffer, std::uint32_t size,
               const eprosima::fastrtps::rtps::Locator_t& local_locator,
               const eprosima::fastrtps::rtps::Locator_t& remote_locator) override;

  eprosima::fastdds::rtps::TransportDescriptorInterface* get_configuration() override { return &descriptor_; }

 private:
  CountingTransportDescriptor descriptor_;
};

}  // namespace convoy::dds
