#include "../support/exchange_contract.hpp"

#include "dds_testing.hpp"

#include <convoy/exchange/in_process.hpp>

#include <thread>

namespace convoy {
namespace {

struct InProcess {
  using Group = SE2;
  static constexpr bool keeps_history = false;
  std::unique_ptr<SubmapExchange<SE2>> join() { return network.join(); }
  bool connect(std::size_t) { return true; }
  void pause() {}
  InProcessNetwork<SE2> network;
};

struct Loopback {
  using Group = SE2;
  static constexpr bool keeps_history = true;
  std::unique_ptr<SubmapExchange<SE2>> join() {
    auto exchange = std::make_unique<dds::DdsExchange<SE2>>(dds::testing::config_of_this_test());
    joined.push_back(exchange.get());
    return exchange;
  }
  bool connect(std::size_t n) { return n == joined.size() && dds::testing::all_connected(joined); }
  void pause() { std::this_thread::sleep_for(std::chrono::milliseconds(20)); }
  std::vector<dds::DdsExchange<SE2>*> joined;
};

}  // namespace

namespace testing {
INSTANTIATE_TYPED_TEST_SUITE_P(InProcess, ExchangeContract, ::testing::Types<InProcess>);
INSTANTIATE_TYPED_TEST_SUITE_P(Dds, ExchangeContract, ::testing::Types<Loopback>);
}  // namespace testing
}  // namespace convoy
