// Two stores that got the same facts in another order agree.
#include <convoy/exchange/in_process.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/submap/fact_store.hpp>

#include <cstdio>

int main() {
  using namespace convoy;
  InProcessNetwork<SE2> network;
  const auto sender = network.join(), receiver = network.join();
  FactStore<SE2> there, here;
  for (std::uint32_t index = 0; index < 3; ++index) {
    AnchorFact<SE2> anchor{{{1, 1}, index}, {}};
    anchor.state.abscissa_m = 25.0 * index;
    anchor.state.pose = SE2(25.0 * index, 0.0, 0.0);
    if (there.insert(anchor) != Insertion::inserted) return 1;
    if (sender->send({{1, 1}, anchor}) != SendStatus::sent) return 2;
  }
  auto messages = receiver->take(0.0);
  for (auto it = messages.rbegin(); it != messages.rend(); ++it)
    if (here.insert(std::get<AnchorFact<SE2>>(it->payload)) != Insertion::inserted) return 3;
  std::printf("%llu facts, digests %s\n", static_cast<unsigned long long>(here.size()),
              here.digest() == there.digest() ? "equal" : "not equal");
  return here.size() == 3 && here.digest() == there.digest() ? 0 : 4;
}
