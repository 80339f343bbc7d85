// A fact crosses two exchanges of an installed convoy, on loopback, with an installed profile.
#include <convoy/dds/dds_exchange.hpp>
#include <convoy/dds/sensor_reader.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/idl/sensors_qos.hpp>

#include <fastdds/dds/publisher/qos/DataWriterQos.hpp>

#include <cstdio>
#include <exception>

int main() try {
  using namespace convoy;
  dds::DdsConfig config;
  config.domain = 19;
  config.profile_file = CONVOY_PROFILE;
  dds::DdsExchange<SE2> sender(config), receiver(config);
  if (!sender.wait_for_peers(1, 20.0)) return 1;
  AnchorFact<SE2> anchor{{{1, 1}, 2}, {}};
  anchor.state.abscissa_m = 50.0;
  anchor.state.pose = SE2(50.0, 0.0, 0.1);
  if (sender.send({{1, 1}, anchor}) != SendStatus::sent) return 2;
  if (!receiver.wait_for_messages(20.0)) return 3;
  const auto messages = receiver.take(0.0);
  const bool whole = messages.size() == 1 && hash_of(std::get<AnchorFact<SE2>>(messages[0].payload)) == hash_of(anchor);
  // Drivers that send sensors of their own.
  namespace edds = eprosima::fastdds::dds;
  if (sensors::v1::endpoint_qos<edds::DataWriterQos>(4).history().depth != 4) return 6;
  std::printf("%zu message, %s\n", messages.size(), whole ? "whole" : "not the one that was sent");
  return whole ? 0 : 4;
} catch (const std::exception& error) {
  std::printf("%s\n", error.what());
  return 5;
}
