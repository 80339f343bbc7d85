// A host that restarts its vehicle while the SLAM is between two anchors: since_start() subtracts a drift that the SLAM
// later takes back (it regains information), so that the next anchor's drift is no covariance and is refused.
#include <gtest/gtest.h>
#include <convoy/components/front_end_component.hpp>
#include <convoy/exchange/in_process.hpp>
#include "../frontend/range_bearing_world.hpp"
using namespace convoy;
TEST(LateChain, AChainThatBeginsBetweenTwoAnchorsStatesCovariances) {
  int bad = 0, runs = 0, control = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed)
    for (double start_m : {0.0, 4.0, 8.0, 12.0, 20.0, 24.0}) {
      test::RangeBearingWorld<SE2> world(test::quiet_params(), seed);
      world.drive(start_m, 0.04);
      InProcessNetwork<SE2> network;
      const auto exchange = network.join();
      SubmapManager<SE2> manager({1, 1}, *exchange, {});
      world.filter().take_segments();
      FrontEndComponent<SE2> component(world.filter(), manager, {});
      manager.open_chain(0.0, std::nullopt);
      world.drive(80.0, 0.04, [&] { component.poll(); });
      runs += start_m > 0.0;
      (start_m > 0.0 ? bad : control) +=
          manager.store().insertions()[static_cast<std::size_t>(Insertion::not_covariance)] > 0;
    }
  EXPECT_EQ(control, 0) << "chains that begin with the SLAM";
  EXPECT_EQ(bad, 0) << "of " << runs;
}
