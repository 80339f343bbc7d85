// Who is let into a secured fleet, and who is not. Fast DDS is silent about most refusals; what it tells of newcomers
// is enough to count them, and to say what is wrong with them.
#pragma once

#include <convoy/dds/dds_exchange.hpp>

#include <fastrtps/config.h>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>

#include <atomic>
#include <chrono>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#if !HAVE_SECURITY
#error "convoy needs a Fast DDS that is built with security (Debian's is)"
#endif

namespace convoy::dds {

/// Listens to the discovery of a secured participant. Thread-safe.
class Admission final : public eprosima::fastdds::dds::DomainParticipantListener {
 public:
  /// `authority`: that of this fleet, as participants announce it.
  explicit Admission(std::string authority) : authority_(std::move(authority)) {}

  SecurityCounters counters();
  std::string last_refused();

  /// The vehicle in whose partition a writer is, or was, whose samples are received; 0: nobody's. Fast DDS matches a
  /// writer only if the permissions of the certificate that its participant has shown allow the partition.
  VehicleId speaker(const eprosima::fastrtps::rtps::GUID_t& writer);

  /// RTPS messages that the gate has stopped.
  const std::shared_ptr<std::atomic<std::uint64_t>> unprotected = std::make_shared<std::atomic<std::uint64_t>>(0);

  void on_participant_discovery(eprosima::fastdds::dds::DomainParticipant* participant,
                                eprosima::fastrtps::rtps::ParticipantDiscoveryInfo&& info) override;
  void on_publisher_discovery(eprosima::fastdds::dds::DomainParticipant* participant,
                              eprosima::fastrtps::rtps::WriterDiscoveryInfo&& info) override;
  void onParticipantAuthentication(eprosima::fastdds::dds::DomainParticipant* participant,
                                   eprosima::fastrtps::rtps::ParticipantAuthenticationInfo&& info) override;

 private:
  enum class Standing { unknown, admitted, refused };
  struct Newcomer {
    Standing standing = Standing::unknown;
    std::chrono::steady_clock::time_point since;
    std::uint64_t SecurityCounters::*counter = nullptr;  // what it counts as if it is refused
    std::string text;
  };
  void refuse(Newcomer& newcomer);
  void refuse_who_prove_nothing();
  void leave(const eprosima::fastrtps::rtps::GUID_t& writer);

  const std::string authority_;
  std::mutex mutex_;
  std::map<eprosima::fastrtps::rtps::GuidPrefix_t, Newcomer> newcomers_;  // those that announce themselves
  std::map<eprosima::fastrtps::rtps::GUID_t, VehicleId> speakers_;        // writer -> vehicle
  std::deque<eprosima::fastrtps::rtps::GUID_t> gone_;                     // of these, the last one behind
  SecurityCounters counters_;
  std::string last_refused_;
};

}  // namespace convoy::dds
