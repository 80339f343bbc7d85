#include <convoy/dds/counting_transport.hpp>

#include <fastdds/rtps/network/SenderResource.h>
#include <fastdds/rtps/common/LocatorList.hpp>

namespace convoy::dds {

namespace rtps = eprosima::fastrtps::rtps;
namespace transport = eprosima::fastdds::rtps;

CountingTransportDescriptor::CountingTransportDescriptor(
    std::shared_ptr<transport::UDPTransportDescriptor> udp_transport, std::shared_ptr<WireCounters> wire_counters)
    : ChainingTransportDescriptor(udp_transport), udp(std::move(udp_transport)), counters(std::move(wire_counters)) {}

transport::TransportInterface* CountingTransportDescriptor::create_transport() const {
  return new CountingTransport(*this);
}

CountingTransport::CountingTransport(const CountingTransportDescriptor& descriptor)
    : ChainingTransport(descriptor), descriptor_(descriptor) {}

bool CountingTransport::send(rtps::SenderResource* low_sender_resource, const rtps::octet* buffer, std::uint32_t size,
                             rtps::LocatorsIterator* destinations_begin, rtps::LocatorsIterator* destinations_end,
                             const std::chrono::steady_clock::time_point& timeout) {
  // The iterator below us is used up by sending, and it cannot be copied; a list of our own can be walked twice. One
  // datagram leaves per destination of our kind.
  rtps::LocatorList_t destinations;
  for (; *destinations_begin != *destinations_end; ++*destinations_begin)
    if (IsLocatorSupported(**destinations_begin)) destinations.push_back(**destinations_begin);
  transport::Locators begin(destinations.begin());
  transport::Locators end(destinations.end());
  const bool sent = low_sender_resource->send(buffer, size, &begin, &end, timeout);
  if (!sent) ++descriptor_.counters->failed_sends;
  // A failed send may still have served some of its destinations: it is counted in full, so as never to say too little.
  descriptor_.counters->datagrams += destinations.size();
  descriptor_.counters->rtps_bytes += std::uint64_t{size} * destinations.size();
  return sent;
}

void CountingTransport::receive(transport::TransportReceiverInterface* next_receiver, const rtps::octet* buffer,
                                std::uint32_t size, const rtps::Locator_t& local_locator,
                                const rtps::Locator_t& remote_locator) {
  next_receiver->OnDataReceived(buffer, size, local_locator, remote_locator);
}

}  // namespace convoy::dds
