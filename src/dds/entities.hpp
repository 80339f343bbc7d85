// The participant of an exchange, with what stands between it and its transports.
#pragma once

#include <convoy/dds/admission.hpp>
#include <convoy/dds/counting_transport.hpp>
#include <convoy/dds/dds_exchange.hpp>
#include <convoy/dds/profile_file.hpp>
#include <convoy/dds/security.hpp>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>

#include <memory>
#include <string>

namespace convoy::dds {

/// The three entities every topic's endpoints are made of, and where their profiles come from.
struct Domain {
  eprosima::fastdds::dds::DomainParticipant* participant = nullptr;
  eprosima::fastdds::dds::Publisher* publisher = nullptr;
  eprosima::fastdds::dds::Subscriber* subscriber = nullptr;
  const ProfileFile* profiles = nullptr;
  Admission* admission = nullptr;  ///< null: DDS Security is off
};

/// `entity`; throws ConfigError if there is none.
template <class Entity>
Entity* need(Entity* entity, const Domain& domain, const std::string& what) {
  if (entity == nullptr)
    throw ConfigError(domain.profiles->path() + ": Fast DDS does not create the " + what +
                      "; its profile contradicts itself or the domain forbids it (see the log of Fast DDS)");
  return entity;
}

/// A participant with its publisher and subscriber, deleted in the right order. An injected one is left alone.
class Entities {
 public:
  /// `profiles` must outlive it. Throws ConfigError.
  Entities(const DdsConfig& config, const ProfileFile& profiles, const std::shared_ptr<WireCounters>& counters);
  ~Entities() { close(); }
  Entities(const Entities&) = delete;
  Entities& operator=(const Entities&) = delete;
  const Domain& domain() const { return domain_; }

 private:
  void create_participant(const DdsConfig& config, const ProfileFile& profiles,
                          const std::shared_ptr<WireCounters>& counters);
  void close();

  // Held, so that the factory outlives the participant whatever the order in which a process winds down.
  std::shared_ptr<eprosima::fastdds::dds::DomainParticipantFactory> factory_ =
      eprosima::fastdds::dds::DomainParticipantFactory::get_shared_instance();
  std::unique_ptr<SecurityFolder> security_;
  std::unique_ptr<Admission> admission_;
  Domain domain_;
  eprosima::fastdds::dds::DomainParticipant* own_ = nullptr;
};

}  // namespace convoy::dds
