// Somebody who speaks on the topics of sensors: their drivers, or a simulator.
#pragma once

#include <convoy/idl/sensorsPubSubTypes.h>
#include <convoy/idl/sensors_qos.hpp>

#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/topic/Topic.hpp>

#include <cstring>
#include <memory>
#include <string>

#include "dds_testing.hpp"

namespace convoy::dds::testing {

/// A sample whose payload says that it holds what no machine does.
template <class PubSubType>
class Liar final : public PubSubType {
 public:
  bool serialize(void* data, eprosima::fastrtps::rtps::SerializedPayload_t* payload) override {
    if (!PubSubType::serialize(data, payload)) return false;
    constexpr std::size_t at = 4 + 44;  // behind its header: of the only sequence in it
    const std::uint32_t length = 0xfffffff0U;
    std::memcpy(payload->data + at, &length, sizeof length);
    return true;
  }
};

class SensorParticipant {
 public:
  SensorParticipant() {
    namespace edds = eprosima::fastdds::dds;
    edds::DomainParticipantQos qos;
    auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    udp->interfaceWhiteList = {"127.0.0.1"};
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports = {udp};
    qos.wire_protocol().builtin.discovery_config.leaseDuration_announcementperiod = {0, 100'000'000};
    participant_ = factory_->create_participant(domain_of_this_test(), qos);
    publisher_ = participant_->create_publisher(edds::PublisherQos());
  }
  ~SensorParticipant() {
    participant_->delete_contained_entities();
    factory_->delete_participant(participant_);
  }
  SensorParticipant(const SensorParticipant&) = delete;
  SensorParticipant& operator=(const SensorParticipant&) = delete;

  eprosima::fastdds::dds::DomainParticipant* operator->() const { return participant_; }

  eprosima::fastdds::dds::Topic* topic(eprosima::fastdds::dds::TopicDataType* made, const std::string& name) {
    const eprosima::fastdds::dds::TypeSupport type(made);
    type->auto_fill_type_object(false);
    type->auto_fill_type_information(false);
    type.register_type(participant_);
    return participant_->create_topic("convoy/sensors/v1/" + name, type.get_type_name(), {});
  }
  eprosima::fastdds::dds::DataWriter* writer(eprosima::fastdds::dds::TopicDataType* type, const std::string& name) {
    return publisher_->create_datawriter(topic(type, name),
                                         sensors::v1::endpoint_qos<eprosima::fastdds::dds::DataWriterQos>(64));
  }

 private:
  eprosima::fastdds::dds::DomainParticipantFactory* factory_ =
      eprosima::fastdds::dds::DomainParticipantFactory::get_instance();
  eprosima::fastdds::dds::DomainParticipant* participant_;
  eprosima::fastdds::dds::Publisher* publisher_;
};

/// With its vehicle and header.
template <class Sample>
Sample sample_of(VehicleId vehicle, std::uint64_t run, double stamp_s, std::uint32_t step) {
  Sample sample;
  sample.vehicle(vehicle);
  sample.header().run(run);
  sample.header().step(step);
  sample.header().stamp_s(stamp_s);
  return sample;
}

}  // namespace convoy::dds::testing
