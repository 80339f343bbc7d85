// Vehicles in processes of their own: killed, started again, late.
#include "dds_testing.hpp"

namespace convoy::dds::testing {
namespace {

TEST(SeveralProcesses, FiveFindEachOtherAndHoldEverything) {
  std::vector<std::unique_ptr<Child>> vehicles;
  for (VehicleId v = 1; v <= 5; ++v) vehicles.push_back(std::make_unique<Child>(peer_command(v)));
  for (auto& vehicle : vehicles) ASSERT_EQ(vehicle->hear(), "ready");
  for (auto& vehicle : vehicles) vehicle->tell("peers 4");
  for (auto& vehicle : vehicles) ASSERT_EQ(vehicle->hear(), "peers 4");
  for (auto& vehicle : vehicles) vehicle->tell("send 0 100");
  for (auto& vehicle : vehicles) ASSERT_EQ(vehicle->hear(), "sent 100");
  for (auto& vehicle : vehicles) vehicle->tell("expect 400");
  for (auto& vehicle : vehicles) EXPECT_EQ(vehicle->hear(), "held 400");
  for (auto& vehicle : vehicles) EXPECT_EQ(vehicle->finish(), 0);
}

TEST(SeveralProcesses, OneIsKilledTheOthersGoOnAndItComesBackToTheHistory) {
  Child a(peer_command(1)), b(peer_command(2));
  auto c = std::make_unique<Child>(peer_command(3));
  for (Child* vehicle : {&a, &b, c.get()}) ASSERT_EQ(vehicle->hear(), "ready");
  for (Child* vehicle : {&a, &b, c.get()}) vehicle->tell("peers 2");
  for (Child* vehicle : {&a, &b, c.get()}) ASSERT_EQ(vehicle->hear(), "peers 2");
  for (Child* vehicle : {&a, &b, c.get()}) vehicle->tell("send 0 50");
  for (Child* vehicle : {&a, &b, c.get()}) ASSERT_EQ(vehicle->hear(), "sent 50");
  for (Child* vehicle : {&a, &b}) vehicle->tell("expect 100");
  for (Child* vehicle : {&a, &b}) ASSERT_EQ(vehicle->hear(), "held 100");

  c->kill_hard();
  for (Child* vehicle : {&a, &b}) vehicle->tell("send 50 50");
  for (Child* vehicle : {&a, &b}) ASSERT_EQ(vehicle->hear(), "sent 50");
  for (Child* vehicle : {&a, &b}) vehicle->tell("expect 150");
  for (Child* vehicle : {&a, &b}) EXPECT_EQ(vehicle->hear(), "held 150");  // 100 of the other, 50 of the dead

  c = std::make_unique<Child>(peer_command(3));
  ASSERT_EQ(c->hear(), "ready");
  c->tell("expect 200");
  EXPECT_EQ(c->hear(), "held 200");  // all that the living have ever said
  c->tell("send 50 10");
  ASSERT_EQ(c->hear(), "sent 10");
  for (Child* vehicle : {&a, &b}) vehicle->tell("expect 160");
  for (Child* vehicle : {&a, &b}) EXPECT_EQ(vehicle->hear(), "held 160");
  for (Child* vehicle : {&a, &b, c.get()}) EXPECT_EQ(vehicle->finish(), 0);
}

TEST(SeveralProcesses, PeersAreCountedAndMissedWhenTheyLeave) {
  const DdsExchange<SE2> exchange(config_of_this_test());
  EXPECT_FALSE(exchange.wait_for_peers(1, 0.2));
  Child a(peer_command(1)), b(peer_command(2));
  EXPECT_TRUE(exchange.wait_for_peers(2, deadline_s));
  EXPECT_EQ(a.finish(), 0);
  EXPECT_TRUE(eventually([&] { return exchange.peers() == 1; }));
  EXPECT_EQ(b.finish(), 0);
  EXPECT_TRUE(eventually([&] { return exchange.peers() == 0; }));
}

}  // namespace
}  // namespace convoy::dds::testing
