// A DDS participant that speaks on 127.0.0.1 and nowhere else, and writers in it.
#pragma once

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

#include <cstdint>
#include <memory>
#include <string>

namespace convoy::simulator {

namespace edds = eprosima::fastdds::dds;

class LocalDomain {
 public:
  /// Throws SetUpError.
  LocalDomain(std::uint32_t domain, const std::string& name);
  ~LocalDomain();
  LocalDomain(const LocalDomain&) = delete;
  LocalDomain& operator=(const LocalDomain&) = delete;

  /// How samples are kept for readers.
  struct Keeping {
    int samples = 0;           ///< the last so many of each vehicle
    bool until_taken = false;  ///< a write waits while nobody takes; else the oldest go
    double deadline_s = 0.0;   ///< for the write
  };
  edds::DataWriter* writer(edds::TypeSupport type, const std::string& topic, const Keeping& keeping);
  /// Reliable; the last sample of each vehicle, late or not.
  edds::DataReader* reader(edds::TypeSupport type, const std::string& topic, edds::DataReaderListener* listener);

 private:
  edds::Topic* topic_of(edds::TypeSupport type, const std::string& topic);

  // Held, so that the factory outlives the participant whatever the order in which a process winds down.
  std::shared_ptr<edds::DomainParticipantFactory> factory_ = edds::DomainParticipantFactory::get_shared_instance();
  edds::DomainParticipant* participant_ = nullptr;
  edds::Publisher* publisher_ = nullptr;
  edds::Subscriber* subscriber_ = nullptr;
};

}  // namespace convoy::simulator
