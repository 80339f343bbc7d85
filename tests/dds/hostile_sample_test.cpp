// A real second participant that speaks the right topics and sends the wrong bytes.
#include "../support/exchange_contract.hpp"
#include "dds_testing.hpp"

#include <convoy/idl/convoyPubSubTypes.h>
#include <convoy/dds/convert.hpp>
#include <convoy/dds/profile_file.hpp>

#include <fastdds/rtps/common/InstanceHandle.h>
#include <fastdds/rtps/common/SerializedPayload.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/topic/Topic.hpp>

#include <cstring>
#include <limits>

namespace convoy::dds::testing {
namespace {

namespace edds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using Bytes = std::vector<std::uint8_t>;

/// Claims to be a type of convoy.idl and sends whatever bytes it is given.
class RawType final : public edds::TopicDataType {
 public:
  explicit RawType(const char* name) {
    setName(name);
    m_typeSize = 1 << 16;
    m_isGetKeyDefined = true;
    auto_fill_type_object(false);
    auto_fill_type_information(false);
  }
  bool serialize(void* data, rtps::SerializedPayload_t* payload) override {
    const auto& bytes = *static_cast<const Bytes*>(data);
    payload->reserve(static_cast<std::uint32_t>(bytes.size()));
    std::memcpy(payload->data, bytes.data(), bytes.size());
    payload->length = static_cast<std::uint32_t>(bytes.size());
    return true;
  }
  bool deserialize(rtps::SerializedPayload_t*, void*) override { return true; }
  std::function<std::uint32_t()> getSerializedSizeProvider(void* data) override {
    return [data] { return static_cast<std::uint32_t>(static_cast<const Bytes*>(data)->size()); };
  }
  void* createData() override { return new Bytes; }
  void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
  bool getKey(void*, rtps::InstanceHandle_t* handle, bool) override {
    for (unsigned i = 0; i < 16; ++i) handle->value[i] = 5;
    return true;
  }
};

/// A stranger with one writer.
class Stranger {
 public:
  Stranger(const std::string& topic, const char* type_name) : profiles_(loopback_profile()) {
    auto* factory = edds::DomainParticipantFactory::get_instance();
    auto qos = profiles_.participant("convoy");
    for (auto& octet : qos.wire_protocol().prefix.value) octet = 0x66;  // not this process: sockets, not memory
    participant_ = factory->create_participant(domain_of_this_test(), qos);
    edds::TypeSupport type(new RawType(type_name));
    type.register_type(participant_);
    topic_ = participant_->create_topic(topic, type_name, edds::TOPIC_QOS_DEFAULT);
    publisher_ = participant_->create_publisher(edds::PUBLISHER_QOS_DEFAULT);
    writer_ = publisher_->create_datawriter(topic_, profiles_.writer(*publisher_, topic));
  }
  ~Stranger() {
    publisher_->delete_datawriter(writer_);
    participant_->delete_publisher(publisher_);
    participant_->delete_topic(topic_);
    edds::DomainParticipantFactory::get_instance()->delete_participant(participant_);
  }
  bool matched() const {
    edds::PublicationMatchedStatus status;
    writer_->get_publication_matched_status(status);
    return status.current_count > 0;
  }
  bool send(Bytes bytes) { return writer_->write(&bytes); }

 private:
  ProfileFile profiles_;
  edds::DomainParticipant* participant_ = nullptr;
  edds::Topic* topic_ = nullptr;
  edds::Publisher* publisher_ = nullptr;
  edds::DataWriter* writer_ = nullptr;
};

template <class PubSubType>
Bytes serialised(typename PubSubType::type sample) {
  PubSubType type;
  rtps::SerializedPayload_t payload(type.getSerializedSizeProvider(&sample)());
  EXPECT_TRUE(type.serialize(&sample, &payload));
  return {payload.data, payload.data + payload.length};
}

v1::Landmark good_landmark() {
  const auto message = convoy::testing::landmark_message<SE2>(9, 0, 3);
  const auto& batch = std::get<LandmarkBatch<SE2>>(message.payload).landmarks;
  v1::Landmark sample;
  EXPECT_EQ(to_wire(message.sender, std::span<const LandmarkFact<SE2>>(batch), sample), WireStatus::ok);
  return sample;
}

v1::Request good_request() {
  v1::Request sample;
  EXPECT_EQ(to_wire<SE2>({9, 1}, Request{{3, 1}, FactKind::anchor, {{1, 2}}}, sample), WireStatus::ok);
  return sample;
}

class HostileSample : public ::testing::Test {
 protected:
  std::uint64_t undecodable() const { return exchange_.counters().undecodable; }
  std::uint64_t hostile() const { return exchange_.counters().hostile; }
  DdsExchange<SE2> exchange_{config_of_this_test()};
};

TEST_F(HostileSample, LandmarksAreRefusedCountedAndDoNotStopTheGoodOnes) {
  Stranger stranger("convoy/v1/Landmark", "convoy::v1::Landmark");
  ASSERT_TRUE(eventually([&] { return stranger.matched(); }));
  const Bytes good = serialised<v1::LandmarkPubSubType>(good_landmark());

  Bytes unknown_encapsulation = good;
  unknown_encapsulation[1] = 0x42;
  ASSERT_TRUE(stranger.send(unknown_encapsulation));
  EXPECT_TRUE(eventually([&] { return undecodable() == 1; }));

  const Bytes truncated(good.begin(), good.begin() + static_cast<std::ptrdiff_t>(good.size() / 2));
  ASSERT_TRUE(stranger.send(truncated));
  EXPECT_TRUE(eventually([&] { return undecodable() == 2; }));
  ASSERT_TRUE(stranger.send(Bytes{0, 1}));
  EXPECT_TRUE(eventually([&] { return undecodable() == 3; }));

  // More landmarks than the format allows, really there.
  v1::Landmark overlong = good_landmark();
  overlong.index().resize(65);
  ASSERT_TRUE(stranger.send(serialised<v1::LandmarkPubSubType>(overlong)));
  EXPECT_TRUE(eventually([&] { return hostile() == 1; }));

  // Four thousand million landmarks, announced only: nothing must be allocated for them.
  Bytes announced = good;
  std::memset(announced.data() + 4 + 32, 0xff, 4);
  ASSERT_TRUE(stranger.send(announced));
  EXPECT_TRUE(eventually([&] { return hostile() == 2; }));

  v1::Landmark not_a_number = good_landmark();
  not_a_number.position()[2] = std::numeric_limits<float>::quiet_NaN();
  ASSERT_TRUE(stranger.send(serialised<v1::LandmarkPubSubType>(not_a_number)));
  EXPECT_TRUE(eventually([&] { return hostile() == 3; }));

  v1::Landmark other_dimension = good_landmark();
  other_dimension.dimension(3);
  ASSERT_TRUE(stranger.send(serialised<v1::LandmarkPubSubType>(other_dimension)));
  EXPECT_TRUE(eventually([&] { return hostile() == 4; }));

  EXPECT_TRUE(exchange_.take(0.0).empty());
  ASSERT_TRUE(stranger.send(good));
  const auto got = collect(exchange_, 1);
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(std::get<LandmarkBatch<SE2>>(got[0].payload).landmarks.size(), 3U);
  EXPECT_EQ(undecodable(), 3U);
  EXPECT_EQ(hostile(), 4U);
}

TEST_F(HostileSample, ABurstOfBadAmongGoodLosesNoGoodOne) {
  Stranger stranger("convoy/v1/Landmark", "convoy::v1::Landmark");
  ASSERT_TRUE(eventually([&] { return stranger.matched(); }));
  const Bytes good = serialised<v1::LandmarkPubSubType>(good_landmark());
  Bytes bad = good;
  bad[1] = 0x42;
  for (int i = 0; i < 50; ++i) {
    ASSERT_TRUE(stranger.send(bad));
    ASSERT_TRUE(stranger.send(good));
  }
  EXPECT_EQ(collect(exchange_, 50).size(), 50U);
  EXPECT_TRUE(eventually([&] { return undecodable() == 50; }));
}

TEST_F(HostileSample, AbsoluteFixesAreRefusedCountedAndDoNotStopTheGoodOnes) {
  Stranger stranger("convoy/v1/AbsoluteFix", "convoy::v1::AbsoluteFix");
  ASSERT_TRUE(eventually([&] { return stranger.matched(); }));
  v1::AbsoluteFix sample;
  AbsoluteFixFact<SE2> fact{{{9, 1}, 0}, 0, {}};
  fact.covariance.setIdentity();
  ASSERT_EQ(to_wire(ChainId{9, 1}, fact, sample), WireStatus::ok);
  const Bytes good = serialised<v1::AbsoluteFixPubSubType>(sample);

  Bytes unknown_encapsulation = good;
  unknown_encapsulation[1] = 0x42;
  ASSERT_TRUE(stranger.send(unknown_encapsulation));
  EXPECT_TRUE(eventually([&] { return undecodable() == 1; }));
  ASSERT_TRUE(stranger.send(Bytes(good.begin(), good.begin() + static_cast<std::ptrdiff_t>(good.size() / 2))));
  EXPECT_TRUE(eventually([&] { return undecodable() == 2; }));

  v1::AbsoluteFix overlong = sample;  // more than the format allows, really there
  overlong.position().resize(4);
  ASSERT_TRUE(stranger.send(serialised<v1::AbsoluteFixPubSubType>(overlong)));
  EXPECT_TRUE(eventually([&] { return hostile() == 1; }));

  // A lever of four thousand million numbers, announced only. Its length stands before 2 + 2 + 3 doubles and the two
  // other lengths, each aligned to its doubles: 24, 24 and 32 bytes from the end.
  Bytes announced = good;
  std::memset(announced.data() + good.size() - 80, 0xff, 4);
  ASSERT_TRUE(stranger.send(announced));
  EXPECT_TRUE(eventually([&] { return hostile() == 2; }));

  v1::AbsoluteFix not_a_number = sample;
  not_a_number.covariance()[1] = std::numeric_limits<double>::quiet_NaN();
  ASSERT_TRUE(stranger.send(serialised<v1::AbsoluteFixPubSubType>(not_a_number)));
  EXPECT_TRUE(eventually([&] { return hostile() == 3; }));

  EXPECT_TRUE(exchange_.take(0.0).empty());
  ASSERT_TRUE(stranger.send(good));
  const auto got = collect(exchange_, 1);
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(hash_of(std::get<AbsoluteFixFact<SE2>>(got[0].payload)), hash_of(fact));
}

TEST_F(HostileSample, UnknownEnumeratorIsRefused) {
  Stranger stranger("convoy/v1/Request", "convoy::v1::Request");
  ASSERT_TRUE(eventually([&] { return stranger.matched(); }));
  v1::Request unknown = good_request();
  unknown.kind(static_cast<v1::FactKind>(77));
  ASSERT_TRUE(stranger.send(serialised<v1::RequestPubSubType>(unknown)));
  EXPECT_TRUE(eventually([&] { return hostile() == 1; }));
  ASSERT_TRUE(stranger.send(serialised<v1::RequestPubSubType>(good_request())));
  ASSERT_EQ(collect(exchange_, 1).size(), 1U);
  EXPECT_EQ(undecodable(), 0U);
}

}  // namespace
}  // namespace convoy::dds::testing
