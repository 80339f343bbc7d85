#include <convoy/dds/chained_transport.hpp>

#include <fastdds/rtps/network/SenderResource.h>
#include <fastrtps/utils/IPLocator.h>
#include <fastdds/rtps/common/LocatorList.hpp>

namespace convoy::dds {

namespace rtps = eprosima::fastrtps::rtps;

namespace {

class Sender final : public rtps::SenderResource {
 public:
  Sender(ChainedTransport& transport, rtps::SenderResource& below, const rtps::Locator_t& opened_for)
      : SenderResource(below.kind()), below_(below) {
    const bool one_peer = below.kind() == LOCATOR_KIND_TCPv4;  // a channel of TCP is a connection
    const rtps::Locator_t peer = one_peer ? rtps::IPLocator::toPhysicalLocator(opened_for) : rtps::Locator_t();
    send_lambda_ = [&transport, &below, one_peer, peer](const rtps::octet* buffer, std::uint32_t size,
                                                        rtps::LocatorsIterator* begin, rtps::LocatorsIterator* end,
                                                        const std::chrono::steady_clock::time_point& until) {
      rtps::LocatorList_t destinations;
      for (; *begin != *end; ++*begin) {
        const rtps::Locator_t& to = **begin;
        if (transport.IsLocatorSupported(to) && (!one_peer || rtps::IPLocator::toPhysicalLocator(to) == peer))
          destinations.push_back(to);
      }
      return destinations.empty() || transport.send(below, buffer, size, destinations, until);
    };
  }
  void add_locators_to_list(rtps::LocatorList_t& locators) const override { below_.add_locators_to_list(locators); }

 private:
  rtps::SenderResource& below_;
};

}  // namespace

bool ChainedTransport::OpenOutputChannel(eprosima::fastdds::rtps::SendResourceList& senders,
                                         const rtps::Locator_t& locator) {
  const std::size_t known = below_.size();
  const bool opened = low_level_transport_->OpenOutputChannel(below_, locator);
  for (std::size_t i = known; i < below_.size(); ++i)
    senders.push_back(std::make_unique<Sender>(*this, *below_[i], locator));
  return opened;
}

bool send_on(rtps::SenderResource& below, const rtps::octet* buffer, std::uint32_t size,
             const rtps::LocatorList_t& destinations, const std::chrono::steady_clock::time_point& until) {
  eprosima::fastdds::rtps::Locators begin(destinations.begin()), end(destinations.end());
  return below.send(buffer, size, &begin, &end, until);
}

}  // namespace convoy::dds
