#include "vehicle_warnings.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace convoy::cli {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

VehicleConfig<SE2> some_config() {
  VehicleConfig<SE2> config;
  config.vehicle.id = 1;
  config.dds.domain = 7;
  config.dds.profile_file = "/etc/convoy/unicast_peers.xml";
  config.dds.interface_whitelist = {"192.0.2.1"};
  return config;
}

VehicleSnapshot<SE2> with_peers(std::optional<std::size_t> peers) {
  VehicleSnapshot<SE2> snapshot;
  snapshot.self = {1, 1};
  snapshot.live_peers = peers;
  return snapshot;
}

void hear(VehicleSnapshot<SE2>& snapshot, VehicleId vehicle, double heard_s, std::optional<double> offset_s = {}) {
  VehicleState<SE2> state;
  state.chain = {vehicle, 1};
  state.heard_s = heard_s;
  state.clock_offset_s = offset_s;
  snapshot.vehicles.push_back(state);
}

std::string text_of(const std::vector<Notice>& notices) {
  std::string text;
  for (const Notice& notice : notices) text += notice.text + "\n";
  return text;
}

TEST(VehicleWarnings, AVehicleThatIsAloneIsToldSoOncePerPeriodAndWhatToCheck) {
  VehicleConfig<SE2> config = some_config();
  config.dds.initial_peers = {"192.0.2.2"};
  VehicleWarnings<SE2> warnings(config, true);
  const auto at = [&](double wall_s, std::optional<std::size_t> peers) {
    return text_of(warnings.look(with_peers(peers), wall_s));
  };
  EXPECT_THAT(at(100.0, 0), IsEmpty());
  EXPECT_THAT(at(109.0, 0), IsEmpty());
  EXPECT_THAT(at(110.0, 0),
              AllOf(HasSubstr("no other vehicle is there for 10 s"),
                    HasSubstr("domain 7, profile unicast_peers.xml, interfaces 192.0.2.1, without DDS Security"),
                    HasSubstr("<dds peers> says (192.0.2.2)")));
  EXPECT_THAT(at(120.0, 0), IsEmpty());
  EXPECT_THAT(at(121.0, 2), HasSubstr("others are there now: 2"));
  EXPECT_THAT(at(122.0, 0), IsEmpty());
  EXPECT_THAT(at(130.0, std::nullopt), IsEmpty());  // being opened anew
  EXPECT_THAT(at(132.0, 0), HasSubstr("no other vehicle is there"));
}

TEST(VehicleWarnings, ASecuredVehicleThatIsAloneIsPointedAtItsCertificatesAndItsServer) {
  VehicleConfig<SE2> config = some_config();
  config.dds.security_folder = "fleet/vehicle_1";
  config.dds.discovery_servers = {"192.0.2.9:11811"};
  VehicleWarnings<SE2> warnings(config, true);
  (void)warnings.look(with_peers(0), 0.0);
  EXPECT_THAT(text_of(warnings.look(with_peers(0), 10.0)),
              AllOf(HasSubstr("secured by fleet/vehicle_1"), HasSubstr("certificates of the same fleet"),
                    HasSubstr("a Discovery Server answers at 192.0.2.9:11811")));
}

TEST(VehicleWarnings, WhoOfTheRosterIsNotHeardIsNamedOncePerPeriod) {
  VehicleConfig<SE2> config = some_config();
  config.vehicle.submaps.limits.roster = {1, 2, 3, 4};
  VehicleWarnings<SE2> warnings(config, true);
  const auto at = [&](double wall_s, double two_s, double three_s) {
    VehicleSnapshot<SE2> snapshot = with_peers(1);
    hear(snapshot, 2, two_s);
    hear(snapshot, 3, three_s);
    return text_of(warnings.look(snapshot, wall_s));
  };
  EXPECT_THAT(at(50.0, 1.0, 1.0), IsEmpty());
  EXPECT_THAT(at(59.0, 9.0, 1.0), IsEmpty());
  EXPECT_THAT(at(60.0, 10.0, 1.0), HasSubstr("nothing is heard for 10 s of vehicle 3, 4;"));
  EXPECT_THAT(at(75.0, 24.0, 1.0), IsEmpty());
  EXPECT_THAT(at(76.0, 25.0, 26.0), IsEmpty());
  EXPECT_THAT(at(85.0, 35.0, 26.0), IsEmpty());
  EXPECT_THAT(at(86.0, 36.0, 26.0), HasSubstr("of vehicle 3;"));
}

TEST(VehicleWarnings, ASenderWhoIsNotOnTheRosterIsSpokenOfOnce) {
  VehicleWarnings<SE2> warnings(some_config(), true);
  VehicleSnapshot<SE2> snapshot = with_peers(1);
  snapshot.submaps.unknown_senders = 1;
  snapshot.submaps.last_unknown_sender = 23;
  EXPECT_THAT(text_of(warnings.look(snapshot, 0.0)), HasSubstr("vehicle 23, which is not on the roster, speaks"));
  snapshot.submaps.unknown_senders = 9;
  EXPECT_THAT(warnings.look(snapshot, 1.0), IsEmpty());
}

TEST(VehicleWarnings, WhoIsRefusedByASecuredFleetIsNamedIfThatIsKnown) {
  VehicleSnapshot<SE2> snapshot = with_peers(1);
  snapshot.exchange.unauthorised = 1;
  EXPECT_THAT(text_of(VehicleWarnings<SE2>(some_config(), true).look(snapshot, 0.0)),
              HasSubstr("without the credentials of this fleet speaks on its network, and is refused\n"));
  snapshot.exchange.last_unauthorised = "participant 01 at 192.0.2.3: unsecured";
  EXPECT_THAT(text_of(VehicleWarnings<SE2>(some_config(), true).look(snapshot, 0.0)),
              HasSubstr("and is refused: participant 01 at 192.0.2.3: unsecured"));
}

TEST(VehicleWarnings, AKnownStartIsToldToHoldForTheFirstEpochOnly) {
  VehicleConfig<SE2> config = some_config();
  EXPECT_FALSE(start_notice(config, true));
  config.vehicle.static_bias = Estimate<SE2>();
  config.vehicle.state_folder = "/var/lib/convoy";
  EXPECT_FALSE(start_notice(config, false));
  EXPECT_THAT(start_notice(config, true)->text, HasSubstr("not the first run of /var/lib/convoy: <static_bias>"));
}

TEST(VehicleWarnings, ImpairmentIsToldAtTheStartWithWhatItDoes) {
  VehicleConfig<SE2> config = some_config();
  EXPECT_THAT(start_line(config, 1), Not(HasSubstr("IMPAIRED")));
  config.impairment = Impairments::parse("loss=0.3,out.delay=100ms");
  EXPECT_THAT(start_line(config, 1), HasSubstr("IMPAIRED on purpose (loss=0.3,seed=1,out.delay=0.1s,out.seed=1)"));
}

TEST(VehicleWarnings, WhoFloodsTheNetworkIsNamedEachTime) {
  VehicleWarnings<SE2> warnings(some_config(), true);
  VehicleSnapshot<SE2> snapshot = with_peers(1);
  for (const VehicleId flooder : {VehicleId{7}, VehicleId{9}}) {
    ++snapshot.peers.quarantines;
    snapshot.peers.last_quarantined = flooder;
    EXPECT_THAT(text_of(warnings.look(snapshot, 0.0)), HasSubstr("as vehicle " + std::to_string(flooder) + ":"));
    EXPECT_THAT(warnings.look(snapshot, 1.0), IsEmpty());
  }
}

TEST(VehicleWarnings, ABudgetThatDiscoveryTakesForAWhileIsNoneToSpeakOf) {
  VehicleWarnings<SE2> warnings(some_config(), true);
  VehicleSnapshot<SE2> snapshot = with_peers(1);
  const auto said = [&](std::uint64_t in_debt, double wall_s) {
    snapshot.network.outbox.in_debt = in_debt;
    return text_of(warnings.look(snapshot, wall_s));
  };
  EXPECT_EQ(said(0, 0.0), "");
  EXPECT_EQ(said(100, 3.0), "");
  EXPECT_EQ(said(100, 30.0), "");
  EXPECT_EQ(said(110, 60.0), "");
  EXPECT_EQ(said(140, 89.0), "");
  EXPECT_THAT(said(140, 90.0), HasSubstr("takes the whole byte budget"));
  EXPECT_EQ(said(200, 120.0), "");
}

TEST(VehicleWarnings, ClocksAreComparedWhereTheyAreReal) {
  VehicleSnapshot<SE2> snapshot = with_peers(2);
  hear(snapshot, 2, 1.0, 3.0);
  hear(snapshot, 3, 1.0, -3.0);
  hear(snapshot, 4, 1.0, 0.2);
  VehicleWarnings<SE2> replayed(some_config(), false), real(some_config(), true);
  EXPECT_THAT(replayed.look(snapshot, 0.0), IsEmpty());
  EXPECT_THAT(
      text_of(real.look(snapshot, 0.0)),
      AllOf(HasSubstr("vehicle 2 sends is stamped 3.0 s before it comes in: its clock is late, or its messages"),
            HasSubstr("vehicle 3 sends is stamped 3.0 s after it comes in: its clock is ahead"),
            Not(HasSubstr("vehicle 4"))));
}

TEST(VehicleWarnings, TheStartLineSaysHowTheVehicleSpeaks) {
  VehicleConfig<SE2> config = some_config();
  EXPECT_EQ(start_line(config, 5),
            "vehicle 1 epoch 5 on domain 7, profile unicast_peers.xml, interfaces 192.0.2.1, without DDS Security, no "
            "journal");
  config.dds.interface_whitelist.clear();
  config.impairment.sent.loss = 0.1;
  config.vehicle.budget.bytes_per_s = 2000.0;
  config.vehicle.journal = true;
  config.vehicle.state_folder = "state";
  EXPECT_EQ(start_line(config, 5),
            "vehicle 1 epoch 5 on domain 7, profile unicast_peers.xml, interfaces of the profile, without DDS "
            "Security, IMPAIRED on purpose (out.loss=0.1,out.seed=1), budget 2000 B/s, journal in state");
}

TEST(VehicleWarnings, ABudgetThatAProfileOrABatchDoesNotKeepToIsPointedAt) {
  VehicleConfig<SE2> config = some_config();
  EXPECT_THAT(budget_notices(config, true), IsEmpty()) << "no budget";
  config.vehicle.budget.bytes_per_s = 5000.0;
  EXPECT_THAT(budget_notices(config, false), IsEmpty());
  EXPECT_THAT(text_of(budget_notices(config, true)), HasSubstr("such as low_bandwidth.xml"));
  config.vehicle.budget.bytes_per_s = 500.0;
  EXPECT_THAT(text_of(budget_notices(config, false)), HasSubstr("batch_limit> 20 landmarks takes some 1"));
}

TEST(VehicleWarnings, TheJournalSaysWhatItGaveBackAndWhatWasDamaged) {
  VehicleConfig<SE2> config = some_config();
  EXPECT_FALSE(journal_notice(config, {}));
  config.vehicle.journal = true;
  JournalCounters journal;
  journal.restored = 12;
  auto notice = journal_notice(config, journal);
  ASSERT_TRUE(notice);
  EXPECT_EQ(notice->level, Notice::Level::info);
  EXPECT_EQ(notice->text, "journal: 12 facts restored");
  journal.damaged_bytes = 100;
  journal.cut_bytes = 7;
  notice = journal_notice(config, journal);
  ASSERT_TRUE(notice);
  EXPECT_EQ(notice->level, Notice::Level::warning);
  EXPECT_THAT(notice->text, AllOf(HasSubstr("107 bytes were damaged"), HasSubstr("peers are asked")));
}

}  // namespace
}  // namespace convoy::cli
