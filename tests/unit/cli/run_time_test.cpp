#include "run_time.hpp"

#include <gtest/gtest.h>

namespace convoy::cli {
namespace {

// A clock that the test sets.
template <int>
struct SetClock {
  using duration = std::chrono::duration<double>;
  using time_point = std::chrono::time_point<SetClock, duration>;
  static inline double now_s = 0.0;
  static time_point now() { return time_point(duration(now_s)); }
};

TEST(UnixTime, GoesOnWhateverBecomesOfTheSystemClock) {
  using System = SetClock<0>;
  using Steady = SetClock<1>;
  System::now_s = 1.7e9;
  Steady::now_s = 50.0;
  const UnixTime<System, Steady> time;
  EXPECT_DOUBLE_EQ(time(), 1.7e9);
  Steady::now_s = 52.0;
  System::now_s = 1.7e9 - 3600.0;  // set back by an hour
  EXPECT_DOUBLE_EQ(time(), 1.7e9 + 2.0);
  Steady::now_s = 53.0;
  System::now_s = 2.0e9;
  EXPECT_DOUBLE_EQ(time(), 1.7e9 + 3.0);
}

TEST(FleetEnd, WhoHasSettledWaitsForTheOthersAndNotForEver) {
  FleetEnd agreed;
  EXPECT_FALSE(agreed.reached(false, true, 100.0));
  EXPECT_FALSE(agreed.reached(true, false, 200.0));
  EXPECT_FALSE(agreed.reached(true, false, 229.0));
  EXPECT_TRUE(agreed.reached(true, true, 229.5));
  FleetEnd refused;
  EXPECT_FALSE(refused.reached(true, false, 200.0));
  EXPECT_FALSE(refused.reached(false, false, 230.0));  // something new has come in
  EXPECT_TRUE(refused.reached(true, false, 230.0));
}

}  // namespace
}  // namespace convoy::cli
