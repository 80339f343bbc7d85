// The scan before decoding, and what spoilt bytes come to.
#include <convoy/dds/convert.hpp>
#include <convoy/dds/guarded_type.hpp>
#include <convoy/map/global_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include "any_facts.hpp"

#include <gtest/gtest.h>

#include <map>

namespace convoy::dds::testing {
namespace {

using Payload = eprosima::fastrtps::rtps::SerializedPayload_t;

/// `good` with two bytes drawn at random.
void spoil(Payload& good, Payload& spoilt) {
  spoilt.copy(&good);
  for (int flips = 0; flips < 2; ++flips) spoilt.data[engine() % spoilt.length] = static_cast<std::uint8_t>(engine());
}

TEST(WireScan, ReadsBothByteOrders) {
  // Verdict, big endian: sender (epoch 8, vehicle 4), vehicle 4, epoch 8, index 4, dimension 1, pad 3, hypothesis 8,
  // veto 1.
  std::vector<std::uint8_t> bytes(4 + 41, 0);
  EXPECT_EQ(scan_payload<v1::Verdict>(bytes.data(), bytes.size()), Decoding::ok);
  // Association with 2 groups in big endian, of which the second is cut.
  std::vector<std::uint8_t> cut(4 + 36, 0);
  cut[4 + 35] = 2;
  EXPECT_EQ(scan_payload<v1::Association>(cut.data(), cut.size()), Decoding::undecodable);
  cut[4 + 35] = 65;
  EXPECT_EQ(scan_payload<v1::Association>(cut.data(), cut.size()), Decoding::hostile);
}

TEST(WireScan, RefusesUnknownEncapsulationAndTrailingBytes) {
  std::vector<std::uint8_t> bytes(4 + 41, 0);
  for (const std::uint8_t kind : {2, 3, 6, 7, 0x42}) {
    bytes[1] = kind;
    EXPECT_EQ(scan_payload<v1::Verdict>(bytes.data(), bytes.size()), Decoding::undecodable) << int{kind};
  }
  bytes.assign(4 + 41 + 8, 0);
  EXPECT_EQ(scan_payload<v1::Verdict>(bytes.data(), bytes.size()), Decoding::undecodable);
  EXPECT_EQ(scan_payload<v1::Verdict>(nullptr, 0), Decoding::undecodable);
}

// Whatever the scan lets through, the generated code decodes; whatever it decodes is refused or converted.
TEST(WireScan, SpoiltBytesAreDecodedOrRefusedNeverWorse) {
  const std::vector<LandmarkFact<SE2>> facts{any_landmark(0, true), any_landmark(1, false), any_landmark(2, true)};
  v1::Landmark sample;
  ASSERT_EQ(to_wire(sender, std::span<const LandmarkFact<SE2>>(facts), sample), WireStatus::ok);
  GuardedType<v1::LandmarkPubSubType> type;
  Payload good(type.getSerializedSizeProvider(&sample)());
  ASSERT_TRUE(type.serialize(&sample, &good));
  std::map<Decoding, int> seen;
  for (int run = 0; run < 20000; ++run) {
    Payload spoilt(good.length);
    spoil(good, spoilt);
    Guarded<v1::Landmark> received;
    ASSERT_TRUE(type.deserialize(&spoilt, &received));
    ASSERT_EQ(received.decoding, scan_payload<v1::Landmark>(spoilt.data, spoilt.length));
    ++seen[received.decoding];
    Message<SE2> message;
    if (received.decoding == Decoding::ok && from_wire(received.sample, message) == WireStatus::ok) {
      ASSERT_EQ(std::get<LandmarkBatch<SE2>>(message.payload).landmarks.size(), received.sample.index().size());
    }
  }
  EXPECT_GT(seen[Decoding::ok], 0);
  EXPECT_GT(seen[Decoding::undecodable], 0);
  EXPECT_GT(seen[Decoding::hostile], 0);
}

// The same of absolute fixes; and what is taken in at last does a map no harm.
template <class G>
void expect_spoilt_fixes_do_no_harm(const ChainState<G>& state) {
  v1::AbsoluteFix sample;
  AbsoluteFixFact<G> fact = any_fix<G>(state);
  fact.key.index = 0;
  fact.anchor = 1;
  ASSERT_EQ(to_wire(sender, fact, sample), WireStatus::ok);
  GuardedType<v1::AbsoluteFixPubSubType> type;
  Payload good(type.getSerializedSizeProvider(&sample)());
  ASSERT_TRUE(type.serialize(&sample, &good));
  FactStore<G> store;
  for (std::uint32_t k = 0; k < 2; ++k)
    ASSERT_EQ(store.insert(AnchorFact<G>{{author, k}, k == 0 ? ChainState<G>{} : state}), Insertion::inserted);
  std::map<Decoding, int> seen;
  std::map<Insertion, int> taken;
  for (int run = 0; run < 20000; ++run) {
    Payload spoilt(good.length);
    spoil(good, spoilt);
    Guarded<v1::AbsoluteFix> received;
    ASSERT_TRUE(type.deserialize(&spoilt, &received));
    ASSERT_EQ(received.decoding, scan_payload<v1::AbsoluteFix>(spoilt.data, spoilt.length));
    ++seen[received.decoding];
    Message<G> message;
    if (received.decoding != Decoding::ok || from_wire(received.sample, message) != WireStatus::ok) continue;
    auto& got = std::get<AbsoluteFixFact<G>>(message.payload);
    if (got.key == fact.key) got.key.index = static_cast<std::uint32_t>(run);
    ++taken[store.insert(got)];
  }
  for (const Decoding decoding : {Decoding::ok, Decoding::undecodable, Decoding::hostile}) EXPECT_GT(seen[decoding], 0);
  for (const Insertion result : {Insertion::inserted, Insertion::not_covariance, Insertion::out_of_range})
    EXPECT_GT(taken[result], 0) << to_string(result);
  const auto global = build_global_map(store, SelectionParams{}, SparseMap<G>());
  EXPECT_FALSE(global.selection.fixes.empty());
  for (const G& pose : global.map->poses()) {
    EXPECT_TRUE(pose.translation().allFinite());
    EXPECT_TRUE(pose.rotation().allFinite());
  }
}

TEST(WireScan, SpoiltFixesAreDecodedOrRefusedAndDoAMapNoHarm) {
  ChainState<SE2> state{100.0, 50.0, SE2(40.0, 10.0, 0.5)};
  state.drift = 0.1 * SE2::Covariance::Identity();
  expect_spoilt_fixes_do_no_harm<SE2>(state);
}

TEST(WireScan, SpoiltFixesInSpaceAreDecodedOrRefusedAndDoAMapNoHarm) {
  ChainState<SE3> state{100.0, 50.0, SE3({1.0, 0.0, 0.0, 0.0}, {40.0, 10.0, 0.5})};
  state.drift = 0.1 * SE3::Covariance::Identity();
  expect_spoilt_fixes_do_no_harm<SE3>(state);
}

// The same of encounters and of what answers them, in the plane and in space.
template <class G, class PubSubType, class Fact>
void expect_spoilt_bytes_do_no_harm(const Fact& fact) {
  using Sample = typename PubSubType::type;
  Sample sample;
  ASSERT_EQ(to_wire<G>(sender, fact, sample), WireStatus::ok);
  GuardedType<PubSubType> type;
  Payload good(type.getSerializedSizeProvider(&sample)());
  ASSERT_TRUE(type.serialize(&sample, &good));
  FactStore<G> store;
  std::map<Decoding, int> seen;
  for (int run = 0; run < 20000; ++run) {
    Payload spoilt(good.length);
    spoil(good, spoilt);
    Guarded<Sample> received;
    ASSERT_TRUE(type.deserialize(&spoilt, &received));
    ASSERT_EQ(received.decoding, scan_payload<Sample>(spoilt.data, spoilt.length));
    ++seen[received.decoding];
    Message<G> message;
    if (received.decoding == Decoding::ok && from_wire(received.sample, message) == WireStatus::ok)
      store.insert(std::get<Fact>(message.payload));
  }
  for (const Decoding decoding : {Decoding::ok, Decoding::undecodable, Decoding::hostile}) EXPECT_GT(seen[decoding], 0);
  EXPECT_GT(store.size(), 0U);
  EXPECT_NO_THROW(build_global_map(store, SelectionParams{}, SparseMap<G>()));
}

TEST(WireScan, SpoiltEncountersAndWaypointsAreDecodedOrRefusedAndDoAMapNoHarm) {
  ChainState<SE2> plane{100.0, 50.0, SE2(40.0, 10.0, 0.5), 0.1 * SE2::Covariance::Identity(), {1.0, 2.0, 50.0}};
  expect_spoilt_bytes_do_no_harm<SE2, v1::EncounterPubSubType>(any_encounter<SE2>(plane));
  expect_spoilt_bytes_do_no_harm<SE2, v1::WaypointPubSubType>(any_waypoint<SE2>(plane));
  ChainState<SE3> space{100.0, 50.0, SE3({1.0, 0.0, 0.0, 0.0}, {40.0, 10.0, 0.5}), 0.1 * SE3::Covariance::Identity(),
                        SE3::Tangent::Constant(3.0)};
  expect_spoilt_bytes_do_no_harm<SE3, v1::EncounterPubSubType>(any_encounter<SE3>(space));
  expect_spoilt_bytes_do_no_harm<SE3, v1::WaypointPubSubType>(any_waypoint<SE3>(space));
}

// A sample within a sample is scanned as any other.
TEST(WireScan, SpoiltAnswersAreDecodedOrRefusedNeverWorse) {
  v1::Answer answer;
  const auto add = [&](auto& sample) {
    v1::RepeatedFact fact;
    ASSERT_EQ(to_repeated(sample, fact), WireStatus::ok);
    append(answer, sender, std::move(fact));
  };
  v1::AbsoluteFix fix;
  ASSERT_EQ(to_wire(sender, any_fix<SE2>(any_state()), fix), WireStatus::ok);
  add(fix);
  const std::vector<LandmarkFact<SE2>> facts{any_landmark(0, true), any_landmark(1, false)};
  v1::Landmark landmarks;
  ASSERT_EQ(to_wire(sender, std::span<const LandmarkFact<SE2>>(facts), landmarks), WireStatus::ok);
  add(landmarks);
  GuardedType<v1::AnswerPubSubType> type;
  Payload good(type.getSerializedSizeProvider(&answer)());
  ASSERT_TRUE(type.serialize(&answer, &good));
  std::map<WireStatus, int> seen;
  for (int run = 0; run < 20000; ++run) {
    Payload spoilt(good.length);
    spoil(good, spoilt);
    Guarded<v1::Answer> received;
    ASSERT_TRUE(type.deserialize(&spoilt, &received));
    if (received.decoding != Decoding::ok) continue;
    std::vector<Message<SE2>> messages;
    const WireStatus status = from_wire(received.sample, messages);
    ++seen[status];
    if (status == WireStatus::ok) {
      ASSERT_EQ(messages.size(), received.sample.facts().size());
    }
  }
  for (const WireStatus status : {WireStatus::ok, WireStatus::bad_answer, WireStatus::unknown_enum})
    EXPECT_GT(seen[status], 0) << to_string(status);
}

}  // namespace
}  // namespace convoy::dds::testing
