// How readers and writers of the topics of sensors.idl are set: one side offers what the other asks for.
#pragma once

#include <fastdds/dds/core/policy/QosPolicies.hpp>

#include <cstdint>

namespace convoy::sensors::v1 {

/// Of a DataReader or a DataWriter. Reliable, and late readers get the last `depth` samples of each vehicle: so does
/// the first step, which is sent as soon as StepDone is heard.
template <class Qos>
Qos endpoint_qos(std::int32_t depth) {
  namespace dds = eprosima::fastdds::dds;
  Qos qos;
  qos.reliability().kind = dds::RELIABLE_RELIABILITY_QOS;
  qos.durability().kind = dds::TRANSIENT_LOCAL_DURABILITY_QOS;
  qos.history().kind = dds::KEEP_LAST_HISTORY_QOS;
  qos.history().depth = depth;
  // Vehicles are keys, and there may be many. 0: no limit.
  qos.resource_limits().max_samples = 0;
  qos.resource_limits().max_instances = 0;
  qos.resource_limits().max_samples_per_instance = 0;
  qos.resource_limits().allocated_samples = 4;
  qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::DYNAMIC_REUSABLE_MEMORY_MODE;
  qos.data_sharing().off();
  return qos;
}

}  // namespace convoy::sensors::v1
