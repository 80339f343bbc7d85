#include <convoy/config_error.hpp>
#include <convoy/exchange/impairment.hpp>

#include "../sample_facts.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>

namespace convoy {
namespace {

using testing::HasSubstr;

Message<SE2> numbered(std::uint32_t number) { return {test::chain_of(1), test::verdict(1, number, 0, true)}; }
std::uint32_t number_of(const Message<SE2>& message) { return std::get<VerdictFact>(message.payload).key.index; }

std::vector<std::uint32_t> numbers(const std::vector<Message<SE2>>& messages) {
  std::vector<std::uint32_t> list;
  for (const auto& message : messages) list.push_back(number_of(message));
  return list;
}

/// What comes out of `count` messages pushed at once, looked at when all are due.
std::vector<std::uint32_t> through(const Impairment& impairment, std::uint32_t count) {
  ImpairedQueue<SE2> queue(impairment);
  for (std::uint32_t i = 0; i < count; ++i) queue.push(numbered(i), 0.0);
  return numbers(queue.take(impairment.delay_s + impairment.jitter_s));
}

TEST(Impairment, ParsesEveryEntryInAnyOrder) {
  const Impairment all = Impairment::parse("seed=7,jitter=0.5,loss=0.3,delay=0.1,duplicate=0.2");
  EXPECT_EQ(all.loss, 0.3);
  EXPECT_EQ(all.duplicate, 0.2);
  EXPECT_EQ(all.delay_s, 0.1);
  EXPECT_EQ(all.jitter_s, 0.5);
  EXPECT_EQ(all.seed, 7U);
  EXPECT_TRUE(all.any());
  EXPECT_FALSE(Impairment::parse("").any());
  EXPECT_FALSE(Impairment::parse("seed=3").any());
  EXPECT_EQ(Impairment::parse("loss=0,duplicate=1").duplicate, 1.0);
}

TEST(Impairment, ReadsUnits) {
  const Impairment all =
      Impairment::parse("delay=100ms,jitter=50us,queue=2s,rate=100kB/s,reorder=0.1,partition=3+40@10s..70");
  EXPECT_DOUBLE_EQ(all.delay_s, 0.1);
  EXPECT_DOUBLE_EQ(all.jitter_s, 5e-5);
  EXPECT_EQ(all.queue_s, 2.0);
  EXPECT_EQ(all.rate_bytes_per_s, 1e5);
  EXPECT_EQ(all.reorder, 0.1);
  ASSERT_EQ(all.partitions.size(), 1U);
  EXPECT_EQ(all.partitions[0].vehicles, (std::vector<VehicleId>{3, 40}));
  EXPECT_EQ(all.partitions[0].from_s, 10.0);
  EXPECT_EQ(all.partitions[0].to_s, 70.0);
  EXPECT_EQ(Partition::parse(to_string(all.partitions[0])).vehicles, all.partitions[0].vehicles);
  EXPECT_EQ(Impairment::parse("rate=2MB/s").rate_bytes_per_s, 2e6);
  EXPECT_EQ(Impairment::parse("rate=500B/s").rate_bytes_per_s, 500.0);
  for (const char* one : {"reorder=1", "rate=1000", "partition=1@0..1", "delay=1ms"})
    EXPECT_TRUE(Impairment::parse(one).any()) << one;
}

TEST(Impairment, DirectionsAreApartAndShareASeed) {
  const Impairments both = Impairments::parse("loss=0.3,out.loss=0.1,out.delay=10ms,seed=9");
  EXPECT_EQ(both.received.loss, 0.3);
  EXPECT_EQ(both.sent.loss, 0.1);
  EXPECT_EQ(both.received.delay_s, 0.0);
  EXPECT_EQ(both.sent.delay_s, 0.01);
  EXPECT_EQ(both.sent.seed, 9U);
  EXPECT_EQ(Impairments::parse("out.seed=4,seed=9").sent.seed, 4U);
  EXPECT_TRUE(Impairments::parse("out.loss=0.1").any());
  EXPECT_FALSE(Impairments::parse("").any());
  EXPECT_THROW(Impairment::parse("out.loss=0.1"), ConfigError);
}

TEST(Impairment, WrittenAsItIsRead) {
  EXPECT_EQ(to_string(Impairments()), "");
  EXPECT_EQ(to_string(Impairments::parse("loss=0.3,delay=100ms")), "loss=0.3,delay=0.1s,seed=1");
  const char* all =
      "loss=0.3,duplicate=0.2,delay=1.5s,jitter=5e-05s,reorder=0.1,rate=1e+05B/s,queue=2s,partition=3+40@10..70,"
      "partition=1@80..90,seed=7,out.loss=0.1,out.seed=8";
  EXPECT_EQ(to_string(Impairments::parse(all)), all);
}

class UnusableImpairment : public testing::TestWithParam<const char*> {};

TEST_P(UnusableImpairment, IsRefusedWithItsNameAndTheMend) {
  const std::string entry = GetParam();
  try {
    Impairment::parse("delay=0.1," + entry);
    FAIL() << "'" << entry << "' was accepted";
  } catch (const ConfigError& error) {
    EXPECT_THAT(error.what(), HasSubstr("'" + entry + "'"));
    EXPECT_THAT(error.what(), HasSubstr("loss=0..0.99"));
  }
}

INSTANTIATE_TEST_SUITE_P(Entries, UnusableImpairment,
                         testing::Values("loss=1", "loss=-0.1", "loss=1.5", "loss=nan", "loss=", "loss", "loss=0.3x",
                                         "duplicate=1.1", "delay=-1", "delay=inf", "delay=3601", "jitter=nan",
                                         "jitter=fast", "jitter=50", "queue=1", "delay=0.2", "seed=-1", "Loss=0.3",
                                         " loss=0.3", "speed=3", "=1", "loss=0.1=0.2", "delay=5m", "delay=ms", "rate=5",
                                         "rate=1GB", "reorder=1.1", "queue=0", "seed=3s", "partition=3",
                                         "partition=3@5", "partition=@1..2", "partition=3+@1..2", "partition=0@1..2",
                                         "partition=3@2..1", "partition=3@-1..1", "partition=3@1..inf",
                                         "partition=a@1..2", "in.loss=0.1", "out.loss=1", "out."));

TEST(Impairment, TheFaultIsNamed) {
  const auto fault_of = [](const char* text) -> std::string {
    try {
      Impairment::parse(text);
    } catch (const ConfigError& error) {
      return error.what();
    }
    return "accepted";
  };
  EXPECT_THAT(fault_of("delay=100"), HasSubstr("'100' has no unit; write 100s or 100ms"));
  EXPECT_THAT(fault_of("loss=0.1,loss=0.2"), HasSubstr("cannot use 'loss=0.2' (it is given twice)"));
  EXPECT_EQ(fault_of("loss=0.1,partition=1@0..1,partition=2@0..1"), "accepted");
  EXPECT_EQ(Impairments::parse("loss=0.1,out.loss=0.2").sent.loss, 0.2);
  EXPECT_THAT(fault_of("loss=abc"), HasSubstr("cannot use 'loss=abc' ('abc' is no number)"));
  EXPECT_THAT(fault_of("loss="), HasSubstr("('' is no number)"));
  EXPECT_THAT(fault_of("loss"), HasSubstr("(no '=')"));
  EXPECT_THAT(fault_of("speed=3"), HasSubstr("(no such entry)"));
  EXPECT_THAT(fault_of("seed=0.5"), HasSubstr("(the seed is a whole number from 0 on)"));
  EXPECT_THAT(fault_of("loss=2"), HasSubstr("(loss is 2; it must lie in [0, 1))"));
}

TEST(Impairment, OneValidationServesTheCommandTheFileAndTheHost) {
  EXPECT_NO_THROW(validate(Impairment{.loss = 0.999, .duplicate = 1.0, .delay_s = 3600.0, .jitter_s = 0.0}));
  const double nan = std::nan("");
  for (const Impairment& bad :
       {Impairment{.loss = 1.0}, Impairment{.loss = nan}, Impairment{.duplicate = 1.01}, Impairment{.delay_s = -0.1},
        Impairment{.jitter_s = nan}, Impairment{.jitter_s = 3601.0}}) {
    EXPECT_THROW(validate(bad), ConfigError);
    EXPECT_THROW(ImpairedQueue<SE2>{bad}, ConfigError);
  }
}

TEST(ImpairedQueue, APartitionIsOnTheCallersClock) {
  ImpairedQueue<SE2> queue(Impairment::parse("partition=1@10..20"));
  for (const double now_s : {9.9, 10.0, 19.9, 20.0}) queue.push(numbered(static_cast<std::uint32_t>(now_s)), now_s);
  EXPECT_EQ(numbers(queue.take(30.0)), (std::vector<std::uint32_t>{9, 20}));
  EXPECT_EQ(queue.lost(), 2U);
}

TEST(ImpairedQueue, HeldBackMessagesAreOvertaken) {
  ImpairedQueue<SE2> queue({.reorder = 0.2, .seed = 4});
  for (std::uint32_t i = 0; i < 1000; ++i) queue.push(numbered(i), 0.0);
  EXPECT_NEAR(static_cast<double>(queue.take(0.0).size()), 800.0, 60.0);
  EXPECT_NEAR(static_cast<double>(queue.take(Impairment::hold_s).size()), 200.0, 60.0);
}

TEST(ImpairedQueue, MessagesHaveNoSizeForARate) {
  EXPECT_THROW(ImpairedQueue<SE2>(Impairment::parse("rate=1000")), ConfigError);
}

TEST(ImpairedQueue, PassesEverythingInOrderWhenNothingIsImpaired) {
  ImpairedQueue<SE2> queue{Impairment{}};
  for (std::uint32_t i = 0; i < 100; ++i) queue.push(numbered(i), 1.0);
  const auto out = numbers(queue.take(1.0));
  ASSERT_EQ(out.size(), 100U);
  EXPECT_TRUE(std::is_sorted(out.begin(), out.end()));
  EXPECT_EQ(queue.lost(), 0U);
  EXPECT_TRUE(queue.take(2.0).empty());
}

TEST(ImpairedQueue, SameSeedSameFateOtherSeedOtherFate) {
  Impairment impairment{.loss = 0.3, .duplicate = 0.2, .delay_s = 0.1, .jitter_s = 0.5, .seed = 42};
  const auto first = through(impairment, 1000);
  EXPECT_EQ(through(impairment, 1000), first);
  impairment.seed = 43;
  EXPECT_NE(through(impairment, 1000), first);
}

TEST(ImpairedQueue, LosesAndDoublesAtTheGivenRates) {
  constexpr int n = 20000;
  for (const double rate : {0.05, 0.3, 0.7}) {
    // Five standard deviations of a binomial share.
    const double band = 5.0 * std::sqrt(rate * (1.0 - rate) / n);
    const auto kept = through({.loss = rate, .seed = 11}, n);
    EXPECT_NEAR(1.0 - static_cast<double>(kept.size()) / n, rate, band) << "seed 11";
    const auto doubled = through({.duplicate = rate, .seed = 12}, n);
    EXPECT_NEAR(static_cast<double>(doubled.size()) / n - 1.0, rate, band) << "seed 12";
  }
}

TEST(ImpairedQueue, CountsWhatItLoses) {
  ImpairedQueue<SE2> queue({.loss = 0.5, .seed = 3});
  for (std::uint32_t i = 0; i < 1000; ++i) queue.push(numbered(i), 0.0);
  const auto out = queue.take(0.0);
  EXPECT_GT(queue.lost(), 0U);
  EXPECT_EQ(queue.lost() + out.size(), 1000U);
}

TEST(ImpairedQueue, DelayHoldsBackAndKeepsOrder) {
  ImpairedQueue<SE2> queue({.delay_s = 0.5});
  queue.push(numbered(0), 10.0);
  queue.push(numbered(1), 10.2);
  EXPECT_TRUE(queue.take(10.49).empty());
  EXPECT_EQ(numbers(queue.take(10.5)), (std::vector<std::uint32_t>{0}));
  EXPECT_EQ(numbers(queue.take(11.0)), (std::vector<std::uint32_t>{1}));
}

TEST(ImpairedQueue, JitterReordersWithinItsBounds) {
  const Impairment impairment{.delay_s = 0.2, .jitter_s = 0.5, .seed = 5};
  ImpairedQueue<SE2> queue(impairment);
  for (std::uint32_t i = 0; i < 1000; ++i) queue.push(numbered(i), 0.0);
  EXPECT_TRUE(queue.take(0.199).empty());
  auto early = queue.take(0.45), late = queue.take(0.7);
  EXPECT_EQ(early.size() + late.size(), 1000U);
  EXPECT_NEAR(static_cast<double>(early.size()), 500.0, 80.0);
  auto order = numbers(early);
  EXPECT_FALSE(std::is_sorted(order.begin(), order.end()));
}

}  // namespace
}  // namespace convoy
