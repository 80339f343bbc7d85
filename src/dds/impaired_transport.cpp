#include <convoy/dds/counting_transport.hpp>
#include <convoy/dds/impaired_transport.hpp>

#include <fastdds/rtps/network/SenderResource.h>
#include <fastrtps/utils/IPLocator.h>

#include <atomic>
#include <condition_variable>
#include <map>
#include <optional>
#include <set>
#include <thread>
#include <vector>

namespace convoy::dds {

namespace rtps = eprosima::fastrtps::rtps;
namespace transport = eprosima::fastdds::rtps;

namespace {

using Clock = std::chrono::steady_clock;

Clock::duration duration_of(double seconds) {
  return std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(seconds));
}

constexpr std::size_t max_held_bytes = 64U << 20;

/// The GUID prefix in the header of an RTPS message; nothing if it is none.
std::optional<rtps::GuidPrefix_t> sender_of(const rtps::octet* message, std::uint32_t size) {
  if (size < 20) return std::nullopt;
  rtps::GuidPrefix_t prefix;
  std::copy(message + 8, message + 20, prefix.value);
  return prefix;
}

VehicleId vehicle_of(const rtps::GuidPrefix_t& prefix) {
  VehicleId id = 0;
  for (int i = 8; i < 12; ++i) id = id << 8 | prefix.value[i];
  return id;
}

/// A datagram on its way, and the next stop: a receiver, or else a sender.
struct Held {
  std::vector<rtps::octet> bytes;
  transport::TransportReceiverInterface* receiver = nullptr;
  rtps::Locator_t local, remote;
  rtps::SenderResource* sender = nullptr;
  rtps::LocatorList_t destination;
};

/// Hands datagrams on when they are due, one after the other, on a thread of its own.
class Timetable {
 public:
  explicit Timetable(std::function<void(const Held&)> hand_on)
      : hand_on_(std::move(hand_on)), thread_([this] { run(); }) {}
  ~Timetable() { stop(); }
  Timetable(const Timetable&) = delete;
  Timetable& operator=(const Timetable&) = delete;

  /// False if there is no room, or no time any more.
  bool add(Clock::time_point due, Held held) {
    {
      const std::lock_guard lock(mutex_);
      if (stopped_ || bytes_ + held.bytes.size() > max_held_bytes) return false;
      bytes_ += held.bytes.size();
      held_.emplace(due, std::move(held));
    }
    changed_.notify_all();
    return true;
  }

  /// After this nothing is handed to `receiver` any more.
  void forget(const transport::TransportReceiverInterface* receiver) {
    std::unique_lock lock(mutex_);
    for (auto it = held_.begin(); it != held_.end();) {
      if (it->second.receiver != receiver) {
        ++it;
        continue;
      }
      bytes_ -= it->second.bytes.size();
      it = held_.erase(it);
    }
    changed_.wait(lock, [&] { return serving_ != receiver; });
  }

  /// What is held is lost. May be called again.
  void stop() {
    {
      const std::lock_guard lock(mutex_);
      stopped_ = true;
    }
    changed_.notify_all();
    if (thread_.joinable()) thread_.join();
  }

 private:
  void run() {
    std::unique_lock lock(mutex_);
    while (!stopped_) {
      if (held_.empty()) {
        changed_.wait(lock);
        continue;
      }
      const Clock::time_point due = held_.begin()->first;
      if (Clock::now() < due) {
        changed_.wait_until(lock, due);
        continue;
      }
      const Held next = std::move(held_.extract(held_.begin()).mapped());
      bytes_ -= next.bytes.size();
      serving_ = next.receiver;
      lock.unlock();
      hand_on_(next);
      lock.lock();
      serving_ = nullptr;
      changed_.notify_all();
    }
  }

  const std::function<void(const Held&)> hand_on_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::multimap<Clock::time_point, Held> held_;
  std::size_t bytes_ = 0;
  const transport::TransportReceiverInterface* serving_ = nullptr;
  bool stopped_ = false;
  std::thread thread_;  // last: it uses the rest
};

class ImpairedTransportDescriptor final : public transport::ChainingTransportDescriptor {
 public:
  ImpairedTransportDescriptor(std::shared_ptr<TransportDescriptorInterface> below,
                              std::shared_ptr<ImpairedNetwork> impaired_network,
                              std::shared_ptr<WireCounters> wire_counters)
      : ChainingTransportDescriptor(std::move(below)),
        network(std::move(impaired_network)),
        counters(std::move(wire_counters)) {}
  transport::TransportInterface* create_transport() const override;

  std::shared_ptr<ImpairedNetwork> network;
  std::shared_ptr<WireCounters> counters;
};

class ImpairedTransport final : public ChainedTransport {
 public:
  explicit ImpairedTransport(const ImpairedTransportDescriptor& descriptor)
      : ChainedTransport(descriptor),
        descriptor_(descriptor),
        slow_reception_(descriptor.network->impairments().received.takes_time()),
        slow_sending_(descriptor.network->impairments().sent.takes_time()),
        timetable_([this](const Held& held) { hand_on(held); }) {}

  bool OpenInputChannel(const rtps::Locator_t& locator, transport::TransportReceiverInterface* receiver,
                        std::uint32_t max_message_size) override {
    {
      const std::lock_guard lock(mutex_);
      receivers_.emplace(locator, receiver);
      if (!rtps::IPLocator::isMulticast(locator)) own_ports_.insert(locator.port);
    }
    return ChainedTransport::OpenInputChannel(locator, receiver, max_message_size);
  }

  bool CloseInputChannel(const rtps::Locator_t& locator) override {
    const bool closed = ChainedTransport::CloseInputChannel(locator);  // after this nothing comes from below
    const transport::TransportReceiverInterface* receiver = nullptr;
    {
      const std::lock_guard lock(mutex_);
      if (const auto it = receivers_.find(locator); it != receivers_.end()) receiver = it->second;
    }
    if (receiver != nullptr) timetable_.forget(receiver);
    return closed;
  }

  void shutdown() override {
    timetable_.stop();
    ChainedTransport::shutdown();
  }

  bool send(rtps::SenderResource& below, const rtps::octet* buffer, std::uint32_t size,
            const rtps::LocatorList_t& destinations, const Clock::time_point& until) override {
    learn_own_prefix(buffer, size);
    bool sent = true;
    for (const rtps::Locator_t& destination : destinations) {
      rtps::LocatorList_t one;
      one.push_back(destination);
      if (is_own(destination)) {
        sent = send_now(below, buffer, size, one, until) && sent;
        continue;
      }
      each_copy(descriptor_.network->of_sent(size), slow_sending_, [&](std::optional<Clock::time_point> due) {
        if (!due) sent = send_now(below, buffer, size, one, until) && sent;
        else hold(*due, {{buffer, buffer + size}, nullptr, {}, {}, &below, one});
      });
    }
    return sent;
  }

  void receive(transport::TransportReceiverInterface* next_receiver, const rtps::octet* buffer, std::uint32_t size,
               const rtps::Locator_t& local, const rtps::Locator_t& remote) override {
    const auto sender = sender_of(buffer, size);
    if (sender && is_own(*sender)) return next_receiver->OnDataReceived(buffer, size, local, remote);
    const VehicleId vehicle = sender ? vehicle_of(*sender) : 0;
    each_copy(descriptor_.network->of_received(size, vehicle), slow_reception_,
              [&](std::optional<Clock::time_point> due) {
                if (!due) next_receiver->OnDataReceived(buffer, size, local, remote);
                else hold(*due, {{buffer, buffer + size}, next_receiver, local, remote, nullptr, {}});
              });
  }

  transport::TransportDescriptorInterface* get_configuration() override { return &descriptor_; }

 private:
  /// Calls `pass` for each copy that is not lost, with the time it is due if it may be held back.
  template <class Pass>
  void each_copy(const ImpairedLink::Fate& fate, bool slow, Pass&& pass) {
    if (fate.copies == 0) ++descriptor_.counters->dropped;
    const Clock::time_point opened = descriptor_.network->impairments().opened;
    for (int i = 0; i < fate.copies; ++i)
      pass(slow ? std::optional(opened + duration_of(fate.due_s[static_cast<std::size_t>(i)])) : std::nullopt);
  }

  void hold(Clock::time_point due, Held held) {
    if (!timetable_.add(due, std::move(held))) ++descriptor_.counters->dropped;
  }

  void hand_on(const Held& held) {
    const auto size = static_cast<std::uint32_t>(held.bytes.size());
    if (held.receiver != nullptr) held.receiver->OnDataReceived(held.bytes.data(), size, held.local, held.remote);
    else send_now(*held.sender, held.bytes.data(), size, held.destination, Clock::now() + std::chrono::seconds(1));
  }

  bool send_now(rtps::SenderResource& below, const rtps::octet* buffer, std::uint32_t size,
                const rtps::LocatorList_t& destinations, const Clock::time_point& until) {
    const std::lock_guard lock(send_mutex_);
    return send_on(below, buffer, size, destinations, until);
  }

  void learn_own_prefix(const rtps::octet* buffer, std::uint32_t size) {
    const std::lock_guard lock(mutex_);
    if (!own_prefix_) own_prefix_ = sender_of(buffer, size);
  }
  bool is_own(const rtps::GuidPrefix_t& sender) {
    const std::lock_guard lock(mutex_);
    return own_prefix_ == sender;
  }
  bool is_own(const rtps::Locator_t& destination) {
    if (rtps::IPLocator::isMulticast(destination) || !is_local_locator(destination)) return false;
    const std::lock_guard lock(mutex_);
    return own_ports_.contains(destination.port);
  }

  ImpairedTransportDescriptor descriptor_;
  const bool slow_reception_, slow_sending_;
  std::mutex mutex_;  // of the next three
  std::optional<rtps::GuidPrefix_t> own_prefix_;
  std::map<rtps::Locator_t, transport::TransportReceiverInterface*> receivers_;
  std::set<std::uint32_t> own_ports_;
  std::mutex send_mutex_;  // participants send from one thread at a time, the timetable from another
  Timetable timetable_;    // last: it calls this
};

transport::TransportInterface* ImpairedTransportDescriptor::create_transport() const {
  return new ImpairedTransport(*this);
}

Impairment of_direction(Impairment impairment, std::uint64_t direction) {
  impairment.seed += 0x9e3779b97f4a7c15U * direction;  // equal seeds do not mean equal decisions both ways
  return impairment;
}

}  // namespace

ImpairedNetwork::ImpairedNetwork(const Impairments& impairments)
    : impairments_(impairments), received_(impairments.received), sent_(of_direction(impairments.sent, 1)) {}

double ImpairedNetwork::now_s() const {
  return std::chrono::duration<double>(Clock::now() - impairments_.opened).count();
}

ImpairedLink::Fate ImpairedNetwork::of_received(std::size_t bytes, VehicleId sender) {
  const std::lock_guard lock(mutex_);
  return received_.fate(now_s(), bytes, sender);
}
ImpairedLink::Fate ImpairedNetwork::of_sent(std::size_t bytes) {
  const std::lock_guard lock(mutex_);
  return sent_.fate(now_s(), bytes, 0);
}
void ImpairedNetwork::block(VehicleId vehicle) {
  const std::lock_guard lock(mutex_);
  received_.block(vehicle);
}
void ImpairedNetwork::unblock(VehicleId vehicle) {
  const std::lock_guard lock(mutex_);
  received_.unblock(vehicle);
}
void ImpairedNetwork::set_loss_received(double loss) {
  const std::lock_guard lock(mutex_);
  received_.set_loss(loss);
}
void ImpairedNetwork::set_loss_sent(double loss) {
  const std::lock_guard lock(mutex_);
  sent_.set_loss(loss);
}

std::shared_ptr<ImpairedNetwork> impair(DdsConfig& config, const Impairments& impairments) {
  if (config.participant != nullptr)
    throw ConfigError("impairment: the transports of a participant of the host's own are not convoy's to impair");
  if (!impairments.sent.partitions.empty())
    throw ConfigError("impairment: a partition is of what is received; leave it out of what is sent");
  auto network = std::make_shared<ImpairedNetwork>(impairments);
  config.wrap_transport = [network](auto below, auto counters) {
    return std::make_shared<ImpairedTransportDescriptor>(std::move(below), network, std::move(counters));
  };
  return network;
}

}  // namespace convoy::dds
