// A fleet that has lived for long: hundreds of chains of runs that are over, and vehicles that hold little of them.
#include <convoy/components/submap_manager.hpp>
#include <convoy/exchange/in_process.hpp>

#include "../sample_facts.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <random>
#include <vector>

namespace convoy {
namespace {

/// What a journal would have given back comes in first.
class WithPast final : public SubmapExchange<SE2> {
 public:
  explicit WithPast(std::unique_ptr<SubmapExchange<SE2>> inner) : inner_(std::move(inner)) {}
  void remember(const Message<SE2>& message) { past_.push_back(message); }
  SendStatus send(const Message<SE2>& message) override {
    ++sent;
    return inner_->send(message);
  }
  std::vector<Message<SE2>> take(double now_s) override {
    return past_.empty() ? inner_->take(now_s) : std::exchange(past_, {});
  }
  ExchangeCounters counters() const override { return inner_->counters(); }
  std::uint64_t sent = 0;

 private:
  std::unique_ptr<SubmapExchange<SE2>> inner_;
  std::vector<Message<SE2>> past_;
};

class OldFleet {
 public:
  OldFleet(std::uint32_t vehicles, const Impairment& impairment) : impairment_(impairment) {
    for (std::uint32_t v = 1; v <= vehicles; ++v) add();
  }

  void add() {
    auto member = std::make_unique<Member>();
    member->exchange = std::make_unique<WithPast>(network_.join(impairment_));
    SubmapManagerParams params;
    params.map_period_s = 1e6;  // maps are not what is tried here
    params.seed = members_.size() + 1;
    const ChainId self = test::chain_of(static_cast<VehicleId>(members_.size() + 1));
    member->manager = std::make_unique<SubmapManager<SE2>>(self, *member->exchange, params);
    member->manager->open_chain(now_s_, std::nullopt);
    members_.push_back(std::move(member));
  }

  /// Runs that are over, of each vehicle. Each member holds a `share` of them, somebody each one.
  void live_through(std::uint32_t runs, double share) {
    std::mt19937_64 random(1);
    const auto chance = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
    for (std::uint32_t run = 1; run <= runs; ++run) {
      for (VehicleId v = 1; v <= members_.size(); ++v) {
        const std::size_t keeper = random() % members_.size();
        for (std::size_t m = 0; m < members_.size(); ++m)
          if (chance() < share || m == keeper) remember(*members_[m], {v, test::epoch - run});
      }
    }
    for (const auto& member : members_)
      while (member->manager->store().size() < 4 || member->manager->busy()) member->manager->step(now_s_);
  }

  /// Until all hold the same; how long that took.
  double settle(double at_most_s) {
    const double begun_s = now_s_;
    for (; now_s_ < begun_s + at_most_s; now_s_ += 0.05) {
      for (const auto& member : members_) member->manager->step(now_s_);
      if (equal()) break;
    }
    EXPECT_TRUE(equal()) << "not within " << at_most_s << " s";
    return now_s_ - begun_s;
  }
  std::uint64_t sent() const {
    std::uint64_t sum = 0;
    for (const auto& member : members_) sum += member->exchange->sent;
    return sum;
  }

 private:
  struct Member {
    std::unique_ptr<WithPast> exchange;
    std::unique_ptr<SubmapManager<SE2>> manager;
  };
  static void remember(Member& member, const ChainId& chain) {
    const auto say = [&](auto fact) {
      fact.key.chain = chain;
      member.exchange->remember({chain, fact});
    };
    say(test::prior(chain.vehicle));
    LandmarkBatch<SE2> batch;
    for (std::uint32_t k = 0; k < 4; ++k) {
      say(test::anchor(chain.vehicle, k));
      for (std::uint32_t i = 0; i < 4; ++i) {
        auto landmark = test::landmark(chain.vehicle, 4 * k + i);
        landmark.key.chain = chain;
        batch.landmarks.push_back(landmark);
      }
      member.exchange->remember({chain, std::exchange(batch, {})});
    }
  }
  bool equal() const {
    const auto& last = members_.back()->manager->store();
    return std::all_of(members_.begin(), members_.end(),
                       [&](const auto& member) { return member->manager->store().holdings() == last.holdings(); });
  }

  InProcessNetwork<SE2> network_;
  Impairment impairment_;
  double now_s_ = 0.0;
  std::vector<std::unique_ptr<Member>> members_;
};

TEST(ManyChains, WhoComesLateHasThemSoon) {
  OldFleet fleet(9, {.delay_s = 0.02});
  fleet.live_through(45, 1.0);
  fleet.settle(60.0);
  fleet.add();
  const std::uint64_t before = fleet.sent();
  const double took_s = fleet.settle(300.0);
  EXPECT_LT(took_s, 15.0) << "of 405 runs that are over, each is told, and asked for, sequence by sequence";
  EXPECT_LT(fleet.sent() - before, 12000U) << "of 8525 facts, 6480 of them landmarks in batches of four";
}

TEST(ManyChains, WhatEachHoldsInPartAllHoldSoon) {
  OldFleet fleet(10, {.delay_s = 0.02});
  fleet.live_through(44, 0.4);
  const double took_s = fleet.settle(300.0);
  EXPECT_LT(took_s, 35.0);
  EXPECT_LT(fleet.sent(), 16000U) << "of 9260 facts: what one asks for is answered for all";
}

}  // namespace
}  // namespace convoy
