#include "local_domain.hpp"

#include "sim_error.hpp"

#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <convoy/idl/sensors_qos.hpp>

#include <cmath>

namespace convoy::simulator {
namespace {

template <class Entity>
Entity* need(Entity* entity, const std::string& what) {
  if (entity == nullptr) throw SetUpError("Fast DDS does not make the " + what);
  return entity;
}

eprosima::fastrtps::Duration_t duration(double seconds) {
  const double whole = std::floor(seconds);
  return {static_cast<std::int32_t>(whole), static_cast<std::uint32_t>((seconds - whole) * 1e9)};
}

edds::DomainParticipantQos local_qos(const std::string& name) {
  edds::DomainParticipantQos qos;
  qos.name(name);
  auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  udp->interfaceWhiteList = {"127.0.0.1"};
  udp->sendBufferSize = udp->receiveBufferSize = 4 << 20;
  udp->maxMessageSize = 65000;
  udp->TTL = 0;
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports = {udp};
  qos.transport().send_socket_buffer_size = qos.transport().listen_socket_buffer_size = 4 << 20;
  auto& discovery = qos.wire_protocol().builtin.discovery_config;
  discovery.leaseDuration = {20, 0};
  discovery.leaseDuration_announcementperiod = {0, 250'000'000};  // no network is spared here
  qos.wire_protocol().builtin.avoid_builtin_multicast = true;
  return qos;
}

}  // namespace

LocalDomain::LocalDomain(std::uint32_t domain, const std::string& name) {
  const std::string where = "participant in domain " + std::to_string(domain);
  const auto make = [&] {
    return need(factory_->create_participant(domain, local_qos(name), nullptr, edds::StatusMask::none()), where);
  };
  participant_ = make();
  // Fast DDS announces a participant before it can hear the answers, and nobody answers twice: they would be heard when
  // they next speak of themselves, by default in three seconds. Another newcomer makes them.
  factory_->delete_participant(make());
  publisher_ = participant_->create_publisher(edds::PublisherQos());
  subscriber_ = participant_->create_subscriber(edds::SubscriberQos());
}

LocalDomain::~LocalDomain() {
  participant_->delete_contained_entities();
  factory_->delete_participant(participant_);
}

edds::Topic* LocalDomain::topic_of(edds::TypeSupport type, const std::string& topic) {
  if (auto* known = dynamic_cast<edds::Topic*>(participant_->lookup_topicdescription(topic))) return known;
  type->auto_fill_type_object(false);
  type->auto_fill_type_information(false);
  type.register_type(participant_);
  return need(participant_->create_topic(topic, type.get_type_name(), edds::TopicQos()), "topic " + topic);
}

edds::DataWriter* LocalDomain::writer(edds::TypeSupport type, const std::string& topic, const Keeping& keeping) {
  auto qos = sensors::v1::endpoint_qos<edds::DataWriterQos>(keeping.samples);
  qos.reliability().max_blocking_time = duration(keeping.deadline_s);
  if (keeping.until_taken) qos.history().kind = edds::KEEP_ALL_HISTORY_QOS;
  qos.resource_limits().max_samples_per_instance = keeping.samples;
  qos.publish_mode().kind = edds::ASYNCHRONOUS_PUBLISH_MODE;
  qos.reliable_writer_qos().times.initialHeartbeatDelay = {0, 10'000'000};
  qos.reliable_writer_qos().times.heartbeatPeriod = {0, 50'000'000};
  qos.reliable_writer_qos().times.nackResponseDelay = {0, 2'000'000};
  return need(publisher_->create_datawriter(topic_of(type, topic), qos), "writer of " + topic);
}

edds::DataReader* LocalDomain::reader(edds::TypeSupport type, const std::string& topic,
                                      edds::DataReaderListener* listener) {
  const auto qos = sensors::v1::endpoint_qos<edds::DataReaderQos>(16);
  return need(
      subscriber_->create_datareader(topic_of(type, topic), qos, listener,
                                     edds::StatusMask::data_available() << edds::StatusMask::subscription_matched()),
      "reader of " + topic);
}

}  // namespace convoy::simulator
