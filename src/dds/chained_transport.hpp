// A layer above a transport of Fast DDS. Its ChainingTransport serves UDP only: above TCP it opens one channel more for
// every endpoint that is found, so that every message leaves many times, and above shared memory it is taken for
// something else. What is missing for these is here; and TCP speaks again to a peer that has come back, to which Fast
// DDS 2.9.1 alone goes on sending through the connection that is gone.
#pragma once

#include <fastdds/rtps/transport/ChainingTransport.h>
#include <fastdds/rtps/transport/ChainingTransportDescriptor.h>
#include <fastdds/rtps/transport/shared_mem/SharedMemTransportDescriptor.h>

#include <chrono>
#include <cstdint>
#include <memory>
#include <mutex>
#include <vector>

namespace convoy::dds {

class ChainedTransport : public eprosima::fastdds::rtps::ChainingTransport {
 public:
  explicit ChainedTransport(const eprosima::fastdds::rtps::ChainingTransportDescriptor& descriptor);
  ~ChainedTransport() override;

  bool OpenOutputChannel(eprosima::fastdds::rtps::SendResourceList& senders,
                         const eprosima::fastrtps::rtps::Locator_t& locator) override;
  void shutdown() override { low_level_transport_->shutdown(); }

  /// Sends a message through `below`. `destinations` are of this transport and of that channel alone, and not empty.
  virtual bool send(eprosima::fastrtps::rtps::SenderResource& below, const eprosima::fastrtps::rtps::octet* buffer,
                    std::uint32_t size, const eprosima::fastrtps::rtps::LocatorList_t& destinations,
                    const std::chrono::steady_clock::time_point& until) = 0;

 private:
  bool send(eprosima::fastrtps::rtps::SenderResource*, const eprosima::fastrtps::rtps::octet*, std::uint32_t,
            eprosima::fastrtps::rtps::LocatorsIterator*, eprosima::fastrtps::rtps::LocatorsIterator*,
            const std::chrono::steady_clock::time_point&) final {
    return false;  // for the sender resources of ChainingTransport, of which there are none
  }

  class Channel;

  std::mutex mutex_;  // of the two lists
  // TCP looks here for channels it has opened, and knows only resources of its own.
  eprosima::fastdds::rtps::SendResourceList below_;
  std::vector<std::unique_ptr<Channel>> channels_;  // one for each of below_, and as long as this
};

/// Hands the whole message to `below`.
bool send_on(eprosima::fastrtps::rtps::SenderResource& below, const eprosima::fastrtps::rtps::octet* buffer,
             std::uint32_t size, const eprosima::fastrtps::rtps::LocatorList_t& destinations,
             const std::chrono::steady_clock::time_point& until);

/// Layers above shared memory. A participant asks by the type of its descriptors whether it has shared memory, and does
/// not use that of its peers otherwise.
class ChainedSharedMemDescriptor final : public eprosima::fastdds::rtps::SharedMemTransportDescriptor {
 public:
  ChainedSharedMemDescriptor(const SharedMemTransportDescriptor& shared_mem,
                             std::shared_ptr<TransportDescriptorInterface> layers)
      : SharedMemTransportDescriptor(shared_mem), layers_(std::move(layers)) {}
  eprosima::fastdds::rtps::TransportInterface* create_transport() const override { return layers_->create_transport(); }

 private:
  std::shared_ptr<TransportDescriptorInterface> layers_;
};

}  // namespace convoy::dds
