#include <convoy/dds/counting_transport.hpp>

#include <fastdds/rtps/network/SenderResource.h>

namespace convoy::dds {

namespace rtps = eprosima::fastrtps::rtps;
namespace transport = eprosima::fastdds::rtps;

std::uint32_t header_bytes_of(std::int32_t transport_kind) {
  if (transport_kind == LOCATOR_KIND_UDPv4) return 20 + 8;
  if (transport_kind == LOCATOR_KIND_TCPv4) return 20 + 32 + 14;
  return 0;
}

transport::TransportInterface* CountingTransportDescriptor::create_transport() const {
  return new CountingTransport(*this);
}

bool CountingTransport::send(rtps::SenderResource& below, const rtps::octet* buffer, std::uint32_t size,
                             const rtps::LocatorList_t& destinations,
                             const std::chrono::steady_clock::time_point& until) {
  if (descriptor_.counters->muted) return true;
  const bool sent = send_on(below, buffer, size, destinations, until);
  WireCounters& counters = *descriptor_.counters;
  if (!sent) ++counters.failed_sends;
  // A connection that is not open yet takes nothing. A failed send of datagrams may still have served some of its
  // destinations: it is counted in full, so as never to say too little.
  if (!sent && kind() == LOCATOR_KIND_TCPv4) return false;
  counters.datagrams += destinations.size();
  counters.rtps_bytes += std::uint64_t{size} * destinations.size();
  counters.header_bytes += header_bytes_of(kind()) * std::uint64_t{destinations.size()};
  return sent;
}

void CountingTransport::receive(transport::TransportReceiverInterface* next_receiver, const rtps::octet* buffer,
                                std::uint32_t size, const rtps::Locator_t& local_locator,
                                const rtps::Locator_t& remote_locator) {
  next_receiver->OnDataReceived(buffer, size, local_locator, remote_locator);
}

}  // namespace convoy::dds
