#include <convoy/dds/chained_transport.hpp>

#include <fastdds/rtps/network/SenderResource.h>
#include <fastrtps/utils/IPLocator.h>
#include <fastdds/rtps/common/LocatorList.hpp>

namespace convoy::dds {

namespace rtps = eprosima::fastrtps::rtps;

namespace {

constexpr std::chrono::seconds reopening_pause{1};

/// What the participant holds.
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

/// Stands for a resource of the transport below, and opens a failed connection anew.
class ChainedTransport::Channel final : public rtps::SenderResource {
 public:
  Channel(ChainedTransport& transport, rtps::SenderResource* below, const rtps::Locator_t& opened_for)
      : SenderResource(below->kind()), transport_(transport), below_(below), opened_for_(opened_for) {
    send_lambda_ = [this](const rtps::octet* buffer, std::uint32_t size, rtps::LocatorsIterator* begin,
                          rtps::LocatorsIterator* end, const std::chrono::steady_clock::time_point& until) {
      const std::lock_guard lock(mutex_);
      const bool sent = below_ != nullptr && below_->send(buffer, size, begin, end, until);
      if (!sent && kind() == LOCATOR_KIND_TCPv4) reopen();
      return sent;
    };
  }
  void add_locators_to_list(rtps::LocatorList_t& locators) const override {
    const std::lock_guard lock(mutex_);
    if (below_ != nullptr) below_->add_locators_to_list(locators);
  }

 private:
  /// The peer may have connected again: then there is a new connection to it, and ours is the old one.
  void reopen() {
    const auto now = std::chrono::steady_clock::now();
    if (now - reopened_ < reopening_pause) return;
    reopened_ = now;
    const std::lock_guard lock(transport_.mutex_);
    auto& all = transport_.below_;
    std::erase_if(all, [this](const auto& resource) { return resource.get() == below_; });
    const std::size_t known = all.size();
    transport_.low_level_transport_->OpenOutputChannel(all, opened_for_);
    below_ = all.size() > known ? all.back().get() : nullptr;
  }

  ChainedTransport& transport_;
  mutable std::mutex mutex_;
  rtps::SenderResource* below_;
  const rtps::Locator_t opened_for_;
  std::chrono::steady_clock::time_point reopened_ = std::chrono::steady_clock::now();
};

ChainedTransport::ChainedTransport(const eprosima::fastdds::rtps::ChainingTransportDescriptor& descriptor)
    : ChainingTransport(descriptor) {}
ChainedTransport::~ChainedTransport() = default;

bool ChainedTransport::OpenOutputChannel(eprosima::fastdds::rtps::SendResourceList& senders,
                                         const rtps::Locator_t& locator) {
  const std::lock_guard lock(mutex_);
  const std::size_t known = below_.size();
  const bool opened = low_level_transport_->OpenOutputChannel(below_, locator);
  for (std::size_t i = known; i < below_.size(); ++i) {
    channels_.push_back(std::make_unique<Channel>(*this, below_[i].get(), locator));
    senders.push_back(std::make_unique<Sender>(*this, *channels_.back(), locator));
  }
  return opened;
}

bool send_on(rtps::SenderResource& below, const rtps::octet* buffer, std::uint32_t size,
             const rtps::LocatorList_t& destinations, const std::chrono::steady_clock::time_point& until) {
  eprosima::fastdds::rtps::Locators begin(destinations.begin()), end(destinations.end());
  return below.send(buffer, size, &begin, &end, until);
}

}  // namespace convoy::dds
