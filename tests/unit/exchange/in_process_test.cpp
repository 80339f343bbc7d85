#include <convoy/exchange/in_process.hpp>

#include "../../support/exchange_contract.hpp"
#include "../sample_facts.hpp"

#include <gtest/gtest.h>

#include <array>
#include <memory>
#include <vector>

namespace convoy {
namespace {

using Exchange = std::unique_ptr<SubmapExchange<SE2>>;

/// For the contract: everything is there at once.
struct InProcess {
  using Group = SE2;
  static constexpr bool keeps_history = false;
  Exchange join() { return network.join(); }
  bool connect(std::size_t) { return true; }
  void pause() {}
  InProcessNetwork<SE2> network;
};

}  // namespace
}  // namespace convoy

namespace convoy::testing {
INSTANTIATE_TYPED_TEST_SUITE_P(InProcess, ExchangeContract, InProcess);
}  // namespace convoy::testing

namespace convoy {
namespace {

Message<SE2> anchor(std::uint32_t index) { return {test::chain_of(1), test::anchor(1, index)}; }

std::vector<std::uint32_t> anchors(const std::vector<Message<SE2>>& messages) {
  std::vector<std::uint32_t> list;
  for (const auto& message : messages) list.push_back(std::get<AnchorFact<SE2>>(message.payload).key.index);
  return list;
}

TEST(InProcessNetwork, ALateJoinerGetsWhatIsSentFromThenOn) {
  InProcessNetwork<SE2> network;
  auto a = network.join();
  ASSERT_EQ(a->send(anchor(0)), SendStatus::sent);
  auto b = network.join();
  ASSERT_EQ(a->send(anchor(1)), SendStatus::sent);
  EXPECT_EQ(anchors(b->take(0.0)), (std::vector<std::uint32_t>{1}));
}

TEST(InProcessNetwork, EndpointsOutliveTheNetwork) {
  Exchange a, b;
  {
    InProcessNetwork<SE2> network;
    a = network.join();
    b = network.join();
  }
  ASSERT_EQ(a->send(anchor(3)), SendStatus::sent);
  EXPECT_EQ(anchors(b->take(0.0)), (std::vector<std::uint32_t>{3}));
}

TEST(InProcessNetwork, ImpairmentIsRepeatableAndOfEachReceiverItsOwn) {
  const auto run = [](std::uint64_t seed) {
    InProcessNetwork<SE2> network;
    const Impairment impairment{.loss = 0.3, .duplicate = 0.2, .delay_s = 0.1, .jitter_s = 1.0, .seed = seed};
    auto sender = network.join();
    auto first = network.join(impairment), second = network.join(impairment);
    for (std::uint32_t i = 0; i < 500; ++i) EXPECT_EQ(sender->send(anchor(i)), SendStatus::sent);
    std::array<std::vector<std::uint32_t>, 2> got;
    for (const double now_s : {0.0, 0.5, 2.0}) {
      for (const auto index : anchors(first->take(now_s))) got[0].push_back(index);
      for (const auto index : anchors(second->take(now_s))) got[1].push_back(index);
    }
    EXPECT_GT(first->counters().dropped, 0U);
    EXPECT_EQ(first->counters().messages_taken, got[0].size());
    return got;
  };
  const auto reference = run(1);
  EXPECT_EQ(run(1), reference);
  EXPECT_NE(run(2), reference);
  EXPECT_NE(reference[0], reference[1]);
}

}  // namespace
}  // namespace convoy
