#include "../support/exchange_contract.hpp"

#include "dds_testing.hpp"

#include <convoy/exchange/in_process.hpp>

#include <thread>

namespace convoy {
namespace {

template <class G>
struct InProcess {
  using Group = G;
  static constexpr bool keeps_history = false;
  std::unique_ptr<SubmapExchange<G>> join() { return network.join(); }
  bool connect(std::size_t) { return true; }
  void pause() {}
  InProcessNetwork<G> network;
};

template <class G>
struct Loopback {
  using Group = G;
  static constexpr bool keeps_history = true;
  std::unique_ptr<SubmapExchange<G>> join() {
    auto exchange = std::make_unique<dds::DdsExchange<G>>(dds::testing::config_of_this_test());
    joined.push_back(exchange.get());
    return exchange;
  }
  bool connect(std::size_t n) { return n == joined.size() && dds::testing::all_connected(joined); }
  void pause() { std::this_thread::sleep_for(std::chrono::milliseconds(20)); }
  std::vector<dds::DdsExchange<G>*> joined;
};

}  // namespace

namespace testing {
template <template <class> class Network>
using Both = ::testing::Types<Network<SE2>, Network<SE3>>;
INSTANTIATE_TYPED_TEST_SUITE_P(InProcess, ExchangeContract, Both<InProcess>);
INSTANTIATE_TYPED_TEST_SUITE_P(Dds, ExchangeContract, Both<Loopback>);
}  // namespace testing
}  // namespace convoy
