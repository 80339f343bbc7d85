// Facts that are said again because they were asked for.
#include <convoy/dds/convert.hpp>
#include <convoy/dds/guarded_type.hpp>
#include <convoy/dds/impaired_transport.hpp>
#include <convoy/submap/rounding.hpp>

#include "../support/exchange_contract.hpp"
#include "../unit/sample_facts.hpp"
#include "dds_testing.hpp"

#include <chrono>
#include <thread>
#include <utility>

namespace convoy::dds::testing {
namespace {

using convoy::testing::anchor_message;

const ChainId sender{7, 3};

std::vector<Message<SE2>> one_of_each_kind() {
  const auto of = [](Payload<SE2> payload) { return Message<SE2>{sender, std::move(payload), true}; };
  return {of(test::anchor(2, 1)),
          of(LandmarkBatch<SE2>{{rounded(test::landmark(2, 0)), rounded(test::landmark(2, 1))}}),
          of(test::prior(2)),
          of(test::association(2, 5, test::pairings(2, 3, 0, 4))),
          of(test::verdict(2, 6, 77, false)),
          of(test::absolute_fix(2, 2)),
          of(test::encounter(2, 1)),
          of(test::waypoint(3, 1))};
}

std::vector<Hash> hashes(const Message<SE2>& message) {
  return std::visit(
      [](const auto& payload) -> std::vector<Hash> {
        if constexpr (requires { payload.landmarks; }) {
          std::vector<Hash> all;
          for (const auto& landmark : payload.landmarks) all.push_back(hash_of(landmark));
          return all;
        } else if constexpr (requires { payload.key; }) {
          return {hash_of(payload)};
        } else {
          return {};
        }
      },
      message.payload);
}

TEST(Answer, EveryKindOfFactArrivesAsItWasSaid) {
  const DdsConfig config = config_of_this_test();
  DdsExchange<SE2> a(config), b(config);
  ASSERT_TRUE(all_connected({&a, &b}));
  const auto messages = one_of_each_kind();
  ASSERT_EQ(messages.size(), fact_kind_count);
  for (const auto& message : messages) ASSERT_EQ(a.send(message), SendStatus::sent) << message.payload.index();
  const auto got = collect(b, messages.size());
  ASSERT_EQ(got.size(), messages.size());
  for (std::size_t i = 0; i < got.size(); ++i) {
    EXPECT_EQ(hashes(got[i]), hashes(messages[i])) << i;
    EXPECT_EQ(got[i].sender, sender);
    EXPECT_TRUE(got[i].repeated);
  }
}

// Otherwise whoever starts gets, from each, everything that was ever repeated.
TEST(Answer, IsNotKeptForWhoComesLate) {
  const DdsConfig config = config_of_this_test();
  DdsExchange<SE2> a(config), b(config);
  ASSERT_TRUE(all_connected({&a, &b}));
  constexpr std::uint32_t news = 20, repeats = 200;
  for (std::uint32_t i = 0; i < news + repeats; ++i) {
    Message<SE2> message = anchor_message<SE2>(1, i);
    message.repeated = i >= news;
    ASSERT_EQ(a.send(message), SendStatus::sent);
  }
  EXPECT_EQ(collect(b, news + repeats).size(), news + repeats);
  DdsExchange<SE2> late(config);
  ASSERT_TRUE(all_connected({&a, &b, &late}));
  EXPECT_EQ(collect(late, news).size(), news);
  std::this_thread::sleep_for(std::chrono::seconds(1));
  EXPECT_TRUE(late.take(0.0).empty());
}

// What is repeated for others comes in bursts, to everybody: each sample costs headers, and a wakening.
TEST(Answer, FactsThatAreSaidTogetherShareSamples) {
  const DdsConfig config = config_of_this_test();
  DdsExchange<SE2> a(config), b(config);
  ASSERT_TRUE(all_connected({&a, &b}));
  constexpr std::uint32_t count = 100;
  std::vector<Message<SE2>> messages;
  for (std::uint32_t i = 0; i < count; ++i) {
    messages.push_back(anchor_message<SE2>(1, i));
    messages.back().repeated = true;
  }
  const std::uint64_t before = a.dds_counters().datagrams_sent;
  ASSERT_EQ(a.send_together(messages), SendStatus::sent);
  const std::uint64_t datagrams = a.dds_counters().datagrams_sent - before;
  EXPECT_LT(datagrams, count / 2);
  EXPECT_GT(datagrams, count / 8) << "none is larger than a frame";
  const auto got = collect(b, count);
  ASSERT_EQ(got.size(), count);
  for (std::uint32_t i = 0; i < count; ++i) EXPECT_EQ(hashes(got[i]), hashes(messages[i])) << i;
}

TEST(Answer, AFactThatDoesNotFitTheWireTakesNoOtherWithIt) {
  const DdsConfig config = config_of_this_test();
  DdsExchange<SE2> a(config), b(config);
  ASSERT_TRUE(all_connected({&a, &b}));
  std::vector<Message<SE2>> messages = one_of_each_kind();
  std::get<AnchorFact<SE2>>(messages[0].payload).state.drift(0, 1) += 1.0;  // no covariance
  EXPECT_EQ(a.send_together(messages), SendStatus::unfit);
  EXPECT_EQ(a.dds_counters().refused_to_wire, 1U);
  EXPECT_EQ(a.counters().messages_sent, messages.size() - 1);
  EXPECT_EQ(collect(b, messages.size() - 1).size(), messages.size() - 1);
}

// A watchdog takes for mute who has something to send and sends nothing.
TEST(Answer, ThatTheNetworkDoesNotTakeIsNotSent) {
  const std::string writer = R"(<data_writer profile_name="convoy/requests">
    <topic>
      <historyQos>
        <kind>KEEP_ALL</kind>
      </historyQos>
      <resourceLimitsQos>
        )";
  const ChangedProfile short_memory(writer + R"(<max_samples>0</max_samples>
        <max_instances>0</max_instances>
        <max_samples_per_instance>0<)",
                                    writer + R"(<max_samples>16</max_samples>
        <max_instances>1</max_instances>
        <max_samples_per_instance>16<)");
  DdsConfig config = config_of_this_test();
  config.vehicle = 2;
  DdsExchange<SE2> b(config);
  config.vehicle = 1;
  config.profile_file = short_memory.path;
  const auto network = impair(config, Impairments{});
  DdsExchange<SE2> a(config);
  ASSERT_TRUE(all_connected({&a, &b}));
  network->block(2);  // nobody acknowledges any more
  std::vector<Message<SE2>> go = one_of_each_kind();
  std::uint64_t sent = 0;
  for (int tries = 0; a.send_together(go) == SendStatus::sent; ++tries) {
    ASSERT_LT(tries, 100) << "its history is never full";
    sent += go.size();
    EXPECT_EQ(a.counters().messages_sent, sent);
  }
  EXPECT_EQ(a.counters().messages_sent, sent);
  EXPECT_EQ(a.counters().send_rejected, 1U);
  EXPECT_EQ(a.send_together(go), SendStatus::rejected);
  EXPECT_EQ(a.counters().messages_sent, sent);
  go = {go.front()};  // and what was refused does not go with what comes next
  network->unblock(2);
  ASSERT_TRUE(eventually([&] { return a.send_together(go) == SendStatus::sent; }));
  EXPECT_EQ(a.counters().messages_sent, sent + 1);
  EXPECT_EQ(collect(b, sent + 1).size(), sent + 1);
}

v1::RepeatedFact repeated_anchor(std::uint32_t index) {
  v1::Bias bias;
  EXPECT_EQ(to_wire<SE2>(sender, test::anchor(2, index), bias), WireStatus::ok);
  v1::RepeatedFact fact;
  EXPECT_EQ(to_repeated(bias, fact), WireStatus::ok);
  return fact;
}

v1::Answer some_answer() {
  v1::Answer answer;
  for (const std::uint32_t index : {1U, 2U}) append(answer, sender, repeated_anchor(index));
  return answer;
}

TEST(Answer, IsNoLargerThanAFrameAndOfOneSender) {
  v1::Answer answer;
  EXPECT_TRUE(has_room(answer, sender, repeated_anchor(0)));
  std::uint32_t index = 0;
  for (; has_room(answer, sender, repeated_anchor(index)); ++index) append(answer, sender, repeated_anchor(index));
  EXPECT_GT(index, 3U);
  GuardedType<v1::AnswerPubSubType> type;
  EXPECT_LE(type.getSerializedSizeProvider(&answer)(), max_sample_bytes);
  std::vector<Message<SE2>> messages;
  EXPECT_EQ(from_wire(answer, messages), WireStatus::ok);
  append(answer, sender, repeated_anchor(index));
  EXPECT_GT(type.getSerializedSizeProvider(&answer)(), max_sample_bytes) << "there was room";
  EXPECT_EQ(from_wire(answer, messages), WireStatus::too_many) << "whoever sends this is none of us";
  answer = some_answer();
  EXPECT_TRUE(has_room(answer, sender, repeated_anchor(0)));
  EXPECT_FALSE(has_room(answer, {sender.vehicle, sender.epoch + 1}, repeated_anchor(0)));
}

TEST(Answer, OfAnotherKindOrSenderOrDamagedIsRefusedWhole) {
  const auto open = [](const v1::Answer& answer) {
    std::vector<Message<SE2>> messages;
    return from_wire(answer, messages);
  };
  std::vector<Message<SE2>> messages;
  ASSERT_EQ(from_wire(some_answer(), messages), WireStatus::ok);
  ASSERT_EQ(messages.size(), 2U);
  EXPECT_EQ(hashes(messages[0]), std::vector<Hash>{hash_of(test::anchor(2, 1))});
  EXPECT_EQ(hashes(messages[1]), std::vector<Hash>{hash_of(test::anchor(2, 2))});

  EXPECT_EQ(open(v1::Answer()), WireStatus::bad_answer);
  v1::Answer of_other_kind = some_answer();
  of_other_kind.facts()[1].kind(v1::KIND_LANDMARK);
  EXPECT_EQ(open(of_other_kind), WireStatus::bad_answer);
  v1::Answer of_no_kind = some_answer();
  of_no_kind.facts()[1].kind(static_cast<v1::FactKind>(99));
  EXPECT_EQ(open(of_no_kind), WireStatus::unknown_enum);
  v1::Answer of_other_sender = some_answer();
  of_other_sender.vehicle(sender.vehicle + 1);
  EXPECT_EQ(open(of_other_sender), WireStatus::bad_answer);
  for (std::size_t bytes = 0; bytes + 8 <= repeated_anchor(2).sample().size(); ++bytes) {
    v1::Answer cut = some_answer();
    cut.facts()[1].sample().resize(bytes);
    EXPECT_EQ(open(cut), WireStatus::bad_answer) << bytes;
  }
  std::vector<Message<SE3>> of_other_dimension;
  EXPECT_EQ(from_wire(some_answer(), of_other_dimension), WireStatus::wrong_dimension);
}

// The scan before decoding walks the same fields as the generated code.
TEST(Answer, IsScannedAsItIsDecoded) {
  v1::Answer answer = some_answer();
  GuardedType<v1::AnswerPubSubType> type;
  eprosima::fastrtps::rtps::SerializedPayload_t payload(type.getSerializedSizeProvider(&answer)());
  ASSERT_TRUE(type.serialize(&answer, &payload));
  EXPECT_EQ(scan_payload<v1::Answer>(payload.data, payload.length), Decoding::ok);
  for (std::uint32_t cut = 0; cut + 8 <= payload.length; ++cut)
    EXPECT_EQ(scan_payload<v1::Answer>(payload.data, cut), Decoding::undecodable) << cut;
  Guarded<v1::Answer> received;
  type.deserialize(&payload, &received);
  EXPECT_EQ(received.decoding, Decoding::ok);
  ASSERT_EQ(received.sample.facts().size(), answer.facts().size());
  for (std::size_t i = 0; i < answer.facts().size(); ++i)
    EXPECT_EQ(received.sample.facts()[i].sample(), answer.facts()[i].sample());
  const std::size_t count_at = 4 + 4 + 4 + 8;      // encapsulation, vehicle, its padding, epoch
  const std::size_t length_at = count_at + 4 + 4;  // kind
  for (const std::size_t at : {count_at, length_at}) {
    const auto honest = std::exchange(payload.data[at + 2], 0xff);
    EXPECT_EQ(scan_payload<v1::Answer>(payload.data, payload.length), Decoding::hostile) << at;
    payload.data[at + 2] = honest;
  }
}

}  // namespace
}  // namespace convoy::dds::testing
