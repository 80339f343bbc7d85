// A fleet on short byte budgets, on a virtual clock: what one has sent, others do not send again.
#include <convoy/components/submap_manager.hpp>
#include <convoy/exchange/in_process.hpp>
#include <convoy/exchange/paced_exchange.hpp>

#include "../sample_facts.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <vector>

namespace convoy {
namespace {

using test::chain_of;

class BudgetedFleet {
 public:
  BudgetedFleet(double bytes_per_s, const Impairment& impairment) : impairment_(impairment) {
    budget_.bytes_per_s = bytes_per_s;
  }

  void add() {
    auto member = std::make_unique<Member>();
    member->exchange = std::make_unique<PacedExchange<SE2>>(network_.join(impairment_), budget_);
    SubmapManagerParams params;
    params.map_period_s = 1e6;  // maps are not what is tried here
    params.seed = members_.size() + 1;
    params.repair = under_budget(params.repair, budget_.bytes_per_s);
    const ChainId self = chain_of(static_cast<VehicleId>(members_.size() + 1));
    member->manager = std::make_unique<SubmapManager<SE2>>(self, *member->exchange, params);
    member->manager->open_chain(now_s_, std::nullopt);
    members_.push_back(std::move(member));
  }
  void remove_first() { members_.front().reset(); }

  /// The first vehicle states so many landmarks.
  void state(std::uint32_t segments) {
    for (std::uint32_t s = 1; s <= segments; ++s) {
      std::vector<LandmarkFact<SE2>> landmarks;
      for (std::uint32_t i = 0; i < 20; ++i) landmarks.push_back(test::landmark(1, i));
      (void)members_.front()->manager->publish_segment(test::anchor(1, s).state, landmarks);
    }
  }

  /// Until all hold the same; how long that took.
  double settle(double at_most_s) {
    const double begun_s = now_s_;
    for (; now_s_ < begun_s + at_most_s; now_s_ += 0.02) {
      for (const auto& member : members_)
        if (member) member->manager->step(now_s_);
      if (equal()) break;
    }
    EXPECT_TRUE(equal()) << "not within " << at_most_s << " s";
    return now_s_ - begun_s;
  }

  std::uint64_t facts_served() const {
    std::uint64_t sum = 0;
    for (const auto& member : members_)
      if (member) sum += member->manager->repair_counters().facts_served;
    return sum;
  }

 private:
  struct Member {
    std::unique_ptr<PacedExchange<SE2>> exchange;
    std::unique_ptr<SubmapManager<SE2>> manager;
  };
  bool equal() const {
    const auto& last = members_.back()->manager->store();
    return std::all_of(members_.begin(), members_.end(), [&](const auto& member) {
      return !member || (member->manager->store().holdings() == last.holdings() &&
                         member->manager->store().chains().size() == members_.size());
    });
  }

  InProcessNetwork<SE2> network_;
  Impairment impairment_;
  BudgetParams budget_;
  double now_s_ = 0.0;
  std::vector<std::unique_ptr<Member>> members_;
};

TEST(Budget, WhoComesLateIsServedByOne) {
  BudgetedFleet fleet(2000.0, {.delay_s = 0.02});
  for (int v = 0; v < 6; ++v) fleet.add();
  fleet.state(30);
  fleet.settle(120.0);
  const std::uint64_t before = fleet.facts_served();
  fleet.add();
  fleet.settle(120.0);
  EXPECT_LT(fleet.facts_served() - before, 1500U) << "of 600 landmarks and 37 other facts";
}

TEST(Budget, WhenTheAuthorIsGoneFewRelay) {
  BudgetedFleet fleet(2000.0, {.loss = 0.1, .delay_s = 0.02});
  for (int v = 0; v < 6; ++v) fleet.add();
  fleet.state(30);
  fleet.settle(300.0);
  fleet.remove_first();
  const std::uint64_t before = fleet.facts_served();
  fleet.add();
  fleet.settle(300.0);
  EXPECT_LT(fleet.facts_served() - before, 2500U) << "of 600 landmarks and 37 other facts";
}

TEST(Budget, LossOnAShortBudgetIsRepairedInTime) {
  BudgetedFleet fleet(900.0, {.loss = 0.1, .delay_s = 0.02});
  for (int v = 0; v < 6; ++v) fleet.add();
  fleet.state(30);
  EXPECT_LT(fleet.settle(400.0), 200.0);
}

}  // namespace
}  // namespace convoy
