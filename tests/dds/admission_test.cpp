// Whose samples a secured exchange takes for whose.
#include <convoy/dds/admission.hpp>
#include <convoy/dds/security.hpp>

#include <fastdds/rtps/builtin/data/WriterProxyData.h>
#include <fastdds/rtps/writer/WriterDiscoveryInfo.h>

#include <gtest/gtest.h>

namespace convoy::dds::testing {
namespace {

using Writer = eprosima::fastrtps::rtps::WriterDiscoveryInfo;

eprosima::fastrtps::rtps::GUID_t writer_number(std::uint32_t n) {
  eprosima::fastrtps::rtps::GUID_t writer;
  writer.entityId = n;
  return writer;
}

void tell(Admission& admission, std::uint32_t writer, VehicleId vehicle, Writer::DISCOVERY_STATUS status) {
  eprosima::fastrtps::rtps::WriterProxyData data(1, 1);
  data.guid(writer_number(writer));
  data.m_qos.m_partition.push_back(partition_of(vehicle).c_str());
  Writer info(data);
  info.status = status;
  admission.on_publisher_discovery(nullptr, std::move(info));
}

TEST(Admission, WhatAWriterSaidLastIsTakenForItsVehicles) {
  Admission admission("authority");
  EXPECT_EQ(admission.speaker(writer_number(1)), 0U);
  tell(admission, 1, 7, Writer::DISCOVERED_WRITER);
  EXPECT_EQ(admission.speaker(writer_number(1)), 7U);
  tell(admission, 1, 7, Writer::REMOVED_WRITER);
  EXPECT_EQ(admission.speaker(writer_number(1)), 7U) << "its samples may lie in a reader still";
  tell(admission, 1, 8, Writer::DISCOVERED_WRITER);
  EXPECT_EQ(admission.speaker(writer_number(1)), 0U) << "nobody moves";
}

TEST(Admission, OfWritersThatAreGoneItKnowsTheLastOnes) {
  Admission admission("authority");
  tell(admission, 1, 7, Writer::DISCOVERED_WRITER);
  tell(admission, 2, 7, Writer::DISCOVERED_WRITER);
  for (int i = 0; i < 3; ++i) {  // a lease that ran out, and was renewed
    tell(admission, 2, 7, Writer::REMOVED_WRITER);
    tell(admission, 2, 7, Writer::DISCOVERED_WRITER);
  }
  constexpr std::uint32_t many = 5000;
  for (std::uint32_t n = 3; n < many; ++n) {
    tell(admission, n, 9, Writer::DISCOVERED_WRITER);
    tell(admission, n, 9, Writer::REMOVED_WRITER);
  }
  std::uint32_t known = 0;
  for (std::uint32_t n = 3; n < many; ++n) known += admission.speaker(writer_number(n)) == 9;
  EXPECT_GE(known, 100U);
  EXPECT_LE(known, 1500U);
  EXPECT_EQ(admission.speaker(writer_number(many - 1)), 9U);
  EXPECT_EQ(admission.speaker(writer_number(1)), 7U) << "it is there";
  EXPECT_EQ(admission.speaker(writer_number(2)), 7U) << "it is there again";
}

}  // namespace
}  // namespace convoy::dds::testing
