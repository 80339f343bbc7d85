// What may come in from the network while DDS Security is on. Fast DDS 2.9.1 checks what comes protected, and takes
// what comes without protection for good all the same: whoever can reach its port may write samples and heartbeats
// under any name, and a vehicle that holds the keys to read another's samples may write in its name by leaving out the
// part that only the author can make. So both are stopped here.
#pragma once

#include <convoy/dds/chained_transport.hpp>

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>

namespace convoy::dds {

/// True if everything in this RTPS message is either protected, with the author's proof for its receivers, or needed to
/// get so far: announcements of participants and the handshake, which proves itself.
bool may_enter(std::span<const unsigned char> message);

/// Lets through what may_enter() and counts the rest.
class SecureGateDescriptor final : public eprosima::fastdds::rtps::ChainingTransportDescriptor {
 public:
  SecureGateDescriptor(std::shared_ptr<TransportDescriptorInterface> below,
                       std::shared_ptr<std::atomic<std::uint64_t>> stopped_messages)
      : ChainingTransportDescriptor(std::move(below)), stopped(std::move(stopped_messages)) {}
  eprosima::fastdds::rtps::TransportInterface* create_transport() const override;

  std::shared_ptr<std::atomic<std::uint64_t>> stopped;
};

class SecureGate final : public ChainedTransport {
 public:
  explicit SecureGate(const SecureGateDescriptor& descriptor) : ChainedTransport(descriptor), descriptor_(descriptor) {}

  bool send(eprosima::fastrtps::rtps::SenderResource& below, const eprosima::fastrtps::rtps::octet* buffer,
            std::uint32_t size, const eprosima::fastrtps::rtps::LocatorList_t& destinations,
            const std::chrono::steady_clock::time_point& until) override {
    return send_on(below, buffer, size, destinations, until);
  }

  void receive(eprosima::fastdds::rtps::TransportReceiverInterface* next_receiver,
               const eprosima::fastrtps::rtps::octet* buffer, std::uint32_t size,
               const eprosima::fastrtps::rtps::Locator_t& local_locator,
               const eprosima::fastrtps::rtps::Locator_t& remote_locator) override;

  eprosima::fastdds::rtps::TransportDescriptorInterface* get_configuration() override { return &descriptor_; }

 private:
  SecureGateDescriptor descriptor_;
};

}  // namespace convoy::dds
