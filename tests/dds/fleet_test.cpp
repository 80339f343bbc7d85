// Whole vehicles over DDS on loopback, in both groups; and fleets of both in one domain, which leave each other alone.
#include "scripted_host.hpp"

#include <convoy/dds/impaired_transport.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>

namespace convoy::dds::testing {
namespace {

template <class G>
class FleetOverDds : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(FleetOverDds, Groups);

TYPED_TEST(FleetOverDds, ThreeVehiclesFindEachOtherAndEndWithOneMap) {
  using G = TypeParam;
  std::vector<std::unique_ptr<Host<G>>> hosts;
  for (VehicleId id = 1; id <= 3; ++id) hosts.push_back(std::make_unique<Host<G>>(id, config_of_this_test()));
  for (const auto& host : hosts) ASSERT_TRUE(host->exchange().wait_for_peers(2, deadline_s));
  for (const auto& host : hosts) host->drive();
  std::vector<VehicleSnapshot<G>> looks;
  ASSERT_TRUE(eventually(
      [&] {
        looks.clear();
        for (const auto& host : hosts) looks.push_back(host->look());
        return one_map(looks);
      },
      60.0));
  for (const VehicleSnapshot<G>& look : looks) {
    EXPECT_EQ(look.exchange.hostile + look.exchange.undecodable + look.exchange.send_rejected, 0U);
    EXPECT_EQ(look.submaps.dimension_mismatch, 0U);
    for (std::size_t k = 0; k < hosts.size(); ++k) {
      const auto& estimate = look.vehicles[k].estimate;
      ASSERT_TRUE(estimate) << "vehicle " << k + 1 << " was not found";
      const G error = estimate->mean.inverse() * hosts[k]->truth();
      EXPECT_LT(squared_mahalanobis(error.Log(), estimate->covariance), chi2_quantile(0.9999, G::Dof));
    }
  }
}

TEST(FleetOverALossyThinLink, EndsWithOneMapByRepairAlone) {
  constexpr double patience_s = 60.0;
  std::vector<std::unique_ptr<Host<SE2>>> hosts;
  std::vector<std::shared_ptr<ImpairedNetwork>> networks;
  for (VehicleId id = 1; id <= 3; ++id) {
    DdsConfig config = config_of_this_test();
    config.vehicle = id;
    config.profile_file = profile_named("low_bandwidth");
    config.interface_whitelist = {"127.0.0.1"};
    networks.push_back(impair(config, Impairments::parse("seed=" + std::to_string(id))));
    hosts.push_back(std::make_unique<Host<SE2>>(id, config));
  }
  for (const auto& host : hosts) ASSERT_TRUE(host->exchange().wait_for_peers(2, deadline_s));
  for (const auto& network : networks) network->set_loss_received(0.3);
  for (const auto& host : hosts) host->drive();
  std::vector<VehicleSnapshot<SE2>> looks;
  ASSERT_TRUE(eventually(
      [&] {
        looks.clear();
        for (const auto& host : hosts) looks.push_back(host->look());
        return one_map(looks);
      },
      patience_s));
  for (const auto& look : looks) EXPECT_GT(look.exchange.dropped, 0U) << "nothing was lost: this proves nothing";
}

TEST(FleetsOverDds, OfDifferentDimensionsInOneDomainRefuseEachOtherAloud) {
  Host<SE2> flat(1, config_of_this_test());
  Host<SE3> spatial(2, config_of_this_test());
  ASSERT_TRUE(flat.exchange().wait_for_peers(1, deadline_s));
  flat.drive();
  spatial.drive();
  EXPECT_TRUE(eventually(
      [&] { return flat.look().submaps.dimension_mismatch >= 2 && spatial.look().submaps.dimension_mismatch >= 2; }));
  const auto a = flat.look();
  const auto b = spatial.look();
  EXPECT_EQ(a.submaps.facts_received, 0U);
  EXPECT_EQ(b.submaps.facts_received, 0U);
  EXPECT_GT(a.exchange.hostile, 0U) << "facts of the other dimension";
  EXPECT_GT(b.exchange.hostile, 0U);
  EXPECT_EQ(a.facts_missing + b.facts_missing, 0U);
  ASSERT_EQ(a.vehicles.size(), 1U);
  ASSERT_EQ(b.vehicles.size(), 1U);
}

}  // namespace
}  // namespace convoy::dds::testing
