// Secured fleets over real sockets: who is let in, who is not and how that is seen, and who may say what.
#include "../support/exchange_contract.hpp"
#include "certificates.hpp"
#include "dds_testing.hpp"
#include "scripted_host.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <convoy/components/vehicle_config.hpp>
#include <convoy/dds/convert.hpp>
#include <convoy/dds/guarded_type.hpp>
#include <convoy/dds/profile_file.hpp>
#include <convoy/dds/security.hpp>

#include <fastdds/rtps/builtin/data/ParticipantProxyData.h>
#include <fastdds/rtps/participant/ParticipantDiscoveryInfo.h>
#include <gmock/gmock.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/topic/Topic.hpp>

#include <array>
#include <map>
#include <mutex>
#include <sstream>

namespace convoy::dds::testing {
namespace {

namespace edds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::StartsWith;

DdsConfig secured(const Certificates& fleet, VehicleId vehicle) {
  DdsConfig config = config_of_this_test();
  config.vehicle = vehicle;
  config.security_folder = fleet.folder(static_cast<int>(vehicle));
  return config;
}

std::vector<std::string> secured_peer(VehicleId vehicle, const std::string& folder,
                                      const std::string& profile = loopback_profile()) {
  return {CONVOY_DDS_PEER,         profile,     std::to_string(domain_of_this_test()),
          std::to_string(vehicle), "127.0.0.1", "security=" + folder};
}

std::string ask(Child& vehicle, const std::string& line) {
  vehicle.tell(line);
  return vehicle.hear();
}

/// Several vehicles do the same at the same time.
void all_answer(const std::vector<Child*>& vehicles, const std::string& line, const std::string& answer) {
  if (!line.empty())
    for (Child* vehicle : vehicles) vehicle->tell(line);
  for (Child* vehicle : vehicles) ASSERT_EQ(vehicle->hear(), answer) << line;
}

struct Refused {
  std::uint64_t unsecured = 0, other_fleet = 0, unproven = 0, impersonations = 0, unprotected = 0;
  std::string last_peer;
};

Refused refused_by(Child& vehicle) {
  std::istringstream words(ask(vehicle, "refused"));
  std::string word;
  Refused refused;
  words >> word >> refused.unsecured >> refused.other_fleet >> refused.unproven >> refused.impersonations >>
      refused.unprotected;
  refused.last_peer = vehicle.hear();
  return refused;
}

/// Waits until it says of a peer that it refused it for such a reason.
Refused wait_for_refusal(Child& vehicle, std::uint64_t Refused::*reason) {
  Refused refused;
  eventually([&] { return (refused = refused_by(vehicle)).*reason > 0; });
  return refused;
}

/// A pair of vehicles of a fleet that is joined by somebody who does not belong there.
void expect_shut_out(Child& a, Child& b, Child& stranger, std::uint64_t Refused::*reason, const std::string& words) {
  all_answer({&a, &b}, "peers 1", "peers 1");
  for (Child* vehicle : {&a, &b}) {
    const Refused refused = wait_for_refusal(*vehicle, reason);
    EXPECT_EQ(refused.*reason, 1U);
    EXPECT_EQ(refused.unsecured + refused.other_fleet + refused.unproven, 1U);
    EXPECT_THAT(refused.last_peer, AllOf(HasSubstr(words), HasSubstr("at 127.0.0.1")));
  }
  EXPECT_EQ(ask(stranger, "send 0 5"), "sent 5");
  EXPECT_EQ(ask(a, "send 0 5"), "sent 5");
  EXPECT_EQ(ask(b, "expect 5"), "held 5");
  a.tell("expect 1 2");  // both wait in vain at the same time
  EXPECT_EQ(ask(stranger, "expect 1 2"), "held 0");
  EXPECT_EQ(a.hear(), "held 0");
}

TEST(Security, AFleetOfThreeExchangesEverythingAndARelayersFacts) {
  const Certificates fleet("1,2,3");
  Child a(secured_peer(1, fleet.folder(1))), b(secured_peer(2, fleet.folder(2))), c(secured_peer(3, fleet.folder(3)));
  const std::vector<Child*> all{&a, &b, &c};
  all_answer(all, "", "ready");
  all_answer(all, "peers 2", "peers 2");
  all_answer(all, "send 0 100", "sent 100");
  all_answer(all, "expect 200", "held 200");
  EXPECT_EQ(ask(b, "relay 1 100 10"), "sent 10");  // says who it is, and whose facts they are
  EXPECT_EQ(ask(c, "expect 210"), "held 210");
  for (Child* vehicle : all) {
    const Refused refused = refused_by(*vehicle);
    EXPECT_EQ(refused.unsecured + refused.other_fleet + refused.unproven + refused.impersonations + refused.unprotected,
              0U);
    EXPECT_EQ(refused.last_peer, "");
    EXPECT_EQ(vehicle->finish(), 0);
  }
}

TEST(Security, ProfilesByWhichSecuredVehiclesDoNotMeetAreRefused) {
  const Certificates fleet("1");
  DdsConfig config = secured(fleet, 1);
  config.interface_whitelist = {"127.0.0.1"};
  config.profile_file = profile_named("wan_tcp");
  config.initial_peers = {"127.0.0.1:17400"};
  EXPECT_THAT(refusal(config),
              ::testing::ContainsRegex("wan_tcp\\.xml:[0-9]+: participant profile 'convoy': vehicles "
                                       "with DDS Security do not meet over TCP; take a profile over UDP"));
  config.initial_peers.clear();
  config.profile_file = profile_named("large_fleet");
  config.discovery_servers = {"127.0.0.1:11811"};
  EXPECT_THAT(refusal(config), HasSubstr("do not meet through a Discovery Server; take a profile over UDP"));
}

TEST(Security, HandshakesAndFactsPassInDatagramsOfALan) {
  const Certificates fleet("1,2");
  const std::string lan = CONVOY_QOS_PROFILES "/lan.xml";
  Child a(secured_peer(1, fleet.folder(1), lan)), b(secured_peer(2, fleet.folder(2), lan));
  all_answer({&a, &b}, "", "ready");
  all_answer({&a, &b}, "peers 1", "peers 1");
  EXPECT_EQ(ask(a, "pair 400"), "paired 400");  // in fragments
  EXPECT_EQ(ask(b, "expect 1"), "held 1");
  EXPECT_EQ(refused_by(b).unprotected, 0U);
}

TEST(Security, AVehiclesFactsOutliveItThroughTheRepairByAnother) {
  const Certificates fleet("1,2,3");
  auto author = std::make_unique<Host<SE2>>(1, secured(fleet, 1));
  Host<SE2> relayer(2, secured(fleet, 2));
  ASSERT_TRUE(relayer.exchange().wait_for_peers(1, deadline_s));
  author->drive();
  relayer.drive();
  ASSERT_TRUE(eventually([&] { return one_map<SE2>({author->look(), relayer.look()}); }, 60.0));
  author.reset();

  Host<SE2> late(3, secured(fleet, 3));
  ASSERT_TRUE(eventually(
      [&] {
        const auto a = relayer.look(), b = late.look();
        return a.settled && b.settled && a.facts_digest == b.facts_digest && a.vehicles.size() == 3;
      },
      60.0));
  EXPECT_GT(relayer.look().repair.facts_relayed, 0U);
  EXPECT_EQ(late.exchange().dds_counters().refused.impersonations, 0U);
  EXPECT_EQ(relayer.exchange().dds_counters().refused.impersonations, 0U);
}

TEST(Security, WhoSpeaksInAnothersNameIsNotHeardByAnybody) {
  const Certificates fleet("1,2,3");
  Child a(secured_peer(1, fleet.folder(1))), b(secured_peer(2, fleet.folder(2))), c(secured_peer(3, fleet.folder(3)));
  const std::vector<Child*> all{&a, &b, &c};
  all_answer(all, "", "ready");
  all_answer(all, "peers 2", "peers 2");
  EXPECT_EQ(ask(b, "claim 1 0 5"), "sent 5");
  EXPECT_EQ(ask(b, "claim 4 0 5"), "sent 5");  // nobody's name
  EXPECT_EQ(ask(b, "send 0 3"), "sent 3");     // behind them; a reader hands out by key, 2 before 4
  for (Child* vehicle : {&a, &c}) {
    EXPECT_EQ(ask(*vehicle, "expect 3"), "held 3");
    EXPECT_TRUE(eventually([&] { return refused_by(*vehicle).impersonations >= 10; }));
    EXPECT_EQ(refused_by(*vehicle).impersonations, 10U);
    EXPECT_EQ(ask(*vehicle, "take"), "held 3");
  }
}

TEST(Security, AnUnsecuredPeerGetsNothingAndIsCounted) {
  const Certificates fleet("1,2");
  Child a(secured_peer(1, fleet.folder(1))), b(secured_peer(2, fleet.folder(2))), stranger(peer_command(3));
  all_answer({&a, &b, &stranger}, "", "ready");
  expect_shut_out(a, b, stranger, &Refused::unsecured, "speaks without DDS Security");
}

TEST(Security, AVehicleOfAnotherFleetGetsNothingAndIsCounted) {
  const Certificates fleet("1,2"), other("3");
  Child a(secured_peer(1, fleet.folder(1))), b(secured_peer(2, fleet.folder(2)));
  Child stranger(secured_peer(3, other.folder(3)));
  all_answer({&a, &b, &stranger}, "", "ready");
  expect_shut_out(a, b, stranger, &Refused::other_fleet, "is of another fleet");
}

TEST(Security, ACertificateThatHasExpiredShutsOutAndIsCounted) {
  const Certificates fleet("1,2,3");
  constexpr int good_for_s = 8;
  fleet.certify(3, -60, good_for_s);
  const auto start = std::chrono::steady_clock::now();
  Child stranger(secured_peer(3, fleet.folder(3)));
  ASSERT_EQ(stranger.hear(), "ready") << "it starts while its certificate is good";
  std::this_thread::sleep_until(start + std::chrono::seconds(good_for_s + 1));
  Child a(secured_peer(1, fleet.folder(1))), b(secured_peer(2, fleet.folder(2)));
  all_answer({&a, &b}, "", "ready");
  expect_shut_out(a, b, stranger, &Refused::unproven, "did not prove");
}

TEST(Security, PermissionsOfOnesOwnMakingShutOutAndAreCounted) {
  const Certificates fleet("1,2,3");
  // An authority of the same name, which vehicle 3 believes, and which signed permissions to do everything.
  const std::string folder = fleet.folder(3), own = folder + "/own_key.pem";
  int status = -1;
  const std::string output =
      shell("set -e; cd " + folder +
                "; subject=$(openssl x509 -noout -subject -nameopt RFC2253,sep_multiline,sname -in permissions_ca.pem |"
                " sed -n 's/^ *O=/O=/p; s/^ *CN=/CN=/p' | tac | tr '\\n' '/');"
                " openssl req -new -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 10"
                " -subj \"/O=convoy/$(echo $subject | tr '/' '\\n' | grep CN=)\" -keyout " +
                own +
                " -out own_ca.pem;"
                " for f in permissions governance; do"
                " openssl smime -verify -noverify -text -in $f.p7s -signer signer.pem | sed "
                "'s|<topic>convoy/v1/.*</topic>|<topic>*</topic>|' >$f.xml;"
                " openssl smime -sign -text -in $f.xml -out $f.p7s -signer own_ca.pem -inkey own_key.pem; done;"
                " mv own_ca.pem permissions_ca.pem; grep '<topic>' permissions.p7s",
            &status);
  ASSERT_EQ(status, 0) << output;
  ASSERT_THAT(output, HasSubstr("<topic>*</topic>"));
  Child a(secured_peer(1, fleet.folder(1))), b(secured_peer(2, fleet.folder(2))), stranger(secured_peer(3, folder));
  all_answer({&a, &b, &stranger}, "", "ready");
  expect_shut_out(a, b, stranger, &Refused::unproven, "did not prove");
}

TEST(SecurityFolder, WhatIsMissingOrNotReadableIsNamed) {
  const Certificates fleet("1");
  for (const char* name :
       {"identity_ca.pem", "certificate.pem", "key.pem", "permissions_ca.pem", "governance.p7s", "permissions.p7s"}) {
    const std::string file = fleet.folder(1) + "/" + name;
    const std::string content = text_of(file);
    std::filesystem::remove(file);
    EXPECT_THAT(refusal(secured(fleet, 1)), AllOf(StartsWith(file), HasSubstr("cannot read"))) << "missing";
    std::filesystem::create_directory(file);
    EXPECT_THAT(refusal(secured(fleet, 1)), AllOf(StartsWith(file), HasSubstr("cannot read"))) << "a folder";
    std::filesystem::remove(file);
    append(file, "something else");
    EXPECT_THAT(refusal(secured(fleet, 1)), AllOf(StartsWith(file), HasSubstr("make-certs"))) << "nonsense";
    std::filesystem::remove(file);
    append(file, content);
  }
  EXPECT_EQ(refusal(secured(fleet, 1)), "accepted");
}

TEST(SecurityFolder, AFileEditedByHandIsNamed) {
  const Certificates fleet("1,2");
  for (const char* name : {"governance.p7s", "permissions.p7s"}) {
    const std::string file = fleet.folder(1) + "/" + name;
    const std::string content = text_of(file);
    std::string edited = content;
    edited.replace(edited.find("<max>232"), 8, "<max>231");
    std::filesystem::remove(file);
    append(file, edited);
    EXPECT_THAT(refusal(secured(fleet, 1)), AllOf(StartsWith(file), HasSubstr("changed after it was signed")));
    std::filesystem::remove(file);
    append(file, content);
  }
}

TEST(SecurityFolder, AVehicleCannotSignPermissionsForItself) {
  const Certificates fleet("1");
  int status = -1;
  const std::string output = shell("cd " + fleet.folder(1) +
                                       " && openssl smime -verify -noverify -text -in permissions.p7s -out own.xml"
                                       " && openssl smime -sign -text -in own.xml -out permissions.p7s"
                                       " -signer certificate.pem -inkey key.pem",
                                   &status);
  ASSERT_EQ(status, 0) << output;
  EXPECT_THAT(refusal(secured(fleet, 1)),
              AllOf(StartsWith(fleet.folder(1) + "/permissions.p7s"), HasSubstr("does not vouch for its signature")));
}

TEST(SecurityFolder, FilesOfAnotherVehicleAreNamed) {
  const auto overwrite = std::filesystem::copy_options::overwrite_existing;
  const Certificates fleet("1,2"), other("1");
  DdsConfig config = secured(fleet, 1);
  config.vehicle = 2;
  EXPECT_THAT(refusal(config), AllOf(StartsWith(fleet.folder(1) + "/certificate.pem"), HasSubstr("somebody else")));
  const std::string key = fleet.folder(1) + "/key.pem", kept = text_of(key);
  std::filesystem::copy_file(fleet.folder(2) + "/key.pem", key, overwrite);
  EXPECT_THAT(refusal(secured(fleet, 1)), AllOf(StartsWith(key), HasSubstr("not the key")));
  std::filesystem::remove(key);
  append(key, kept);
  const std::string permissions = fleet.folder(1) + "/permissions.p7s";
  std::filesystem::copy_file(fleet.folder(2) + "/permissions.p7s", permissions, overwrite);
  EXPECT_THAT(refusal(secured(fleet, 1)), AllOf(StartsWith(permissions), HasSubstr("grants nothing")));
  std::filesystem::copy_file(other.folder(1) + "/identity_ca.pem", fleet.folder(1) + "/identity_ca.pem", overwrite);
  EXPECT_THAT(refusal(secured(fleet, 1)),
              AllOf(StartsWith(fleet.folder(1) + "/certificate.pem"), HasSubstr("does not vouch")));
}

TEST(SecurityFolder, AConfigurationOfAnotherVehicleIsRefused) {
  const Certificates fleet("1");
  VehicleConfig<SE2> config;
  config.dds = secured(fleet, 1);
  config.vehicle.id = 2;
  EXPECT_THROW(open_exchange(config), ConfigError);
  config.vehicle.id = 1;
  EXPECT_NE(open_exchange(config), nullptr);
}

TEST(SecurityFolder, ACertificateOutOfItsTimeIsNamed) {
  const Certificates fleet("1");
  fleet.certify(1, -3600, -60);
  EXPECT_THAT(refusal(secured(fleet, 1)), HasSubstr("certificate.pem: identity_ca.pem beside it does not vouch for "
                                                    "this certificate: certificate has expired"));
  fleet.certify(1, 3600, 7200);
  EXPECT_THAT(refusal(secured(fleet, 1)), HasSubstr("certificate is not yet valid"));
}

TEST(SecurityFolder, AnInjectedParticipantHasASecurityOfItsOwn) {
  const Certificates fleet("1");
  const ProfileFile profiles(loopback_profile());
  const auto factory = edds::DomainParticipantFactory::get_shared_instance();
  DdsConfig config = secured(fleet, 1);
  config.participant = factory->create_participant(config.domain, profiles.participant("convoy"));
  EXPECT_THAT(refusal(config), HasSubstr("injected participant"));
  factory->delete_participant(config.participant);
}

/// Somebody on the network who has no certificate: hears the announcements, and sends what datagrams it likes.
class Outsider final : public edds::DomainParticipantListener {
 public:
  Outsider() {
    const ProfileFile profiles(loopback_profile());
    participant_ = factory_->create_participant(domain_of_this_test(), profiles.participant("convoy"), this,
                                                edds::StatusMask::none());
  }
  ~Outsider() override {
    participant_->set_listener(nullptr);
    factory_->delete_participant(participant_);
    close(socket_);
  }

  void on_participant_discovery(edds::DomainParticipant*, rtps::ParticipantDiscoveryInfo&& found) override {
    const std::lock_guard lock(mutex_);
    if (!found.info.default_locators.unicast.empty())
      ports_[found.info.m_guid.guidPrefix] =
          static_cast<std::uint16_t>(found.info.default_locators.unicast.begin()->port);
  }
  std::map<rtps::GuidPrefix_t, std::uint16_t> heard_of() {
    const std::lock_guard lock(mutex_);
    return ports_;
  }

  /// A sample, as if the `number`th endpoint of `author` had sent it.
  void forge(const rtps::GuidPrefix_t& author, unsigned char number, const rtps::SerializedPayload_t& sample,
             std::uint16_t port) const {
    std::vector<unsigned char> datagram{'R', 'T', 'P', 'S', 2, 3, 1, 15};
    datagram.insert(datagram.end(), std::begin(author.value), std::end(author.value));
    const std::size_t length = (20 + sample.length + 3) / 4 * 4;
    for (const std::size_t byte : {std::size_t{0x15}, std::size_t{5}, length & 0xff, length >> 8})
      datagram.push_back(static_cast<unsigned char>(byte));
    for (const unsigned char byte : {0, 0, 16, 0, 0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 0, 0xe8, 3, 0, 0})
      datagram.push_back(byte);  // to any reader, from this writer, with sequence number 1000
    datagram[datagram.size() - 10] = number;
    datagram.insert(datagram.end(), sample.data, sample.data + sample.length);
    datagram.resize(24 + length);
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(port);
    inet_pton(AF_INET, "127.0.0.1", &to.sin_addr);
    ASSERT_EQ(sendto(socket_, datagram.data(), datagram.size(), 0, reinterpret_cast<sockaddr*>(&to), sizeof to),
              static_cast<ssize_t>(datagram.size()));
  }

 private:
  std::shared_ptr<edds::DomainParticipantFactory> factory_ = edds::DomainParticipantFactory::get_shared_instance();
  edds::DomainParticipant* participant_ = nullptr;
  const int socket_ = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  std::mutex mutex_;
  std::map<rtps::GuidPrefix_t, std::uint16_t> ports_;
};

LivePose<SE2> pose_of(VehicleId vehicle, std::uint32_t anchor) {
  LivePose<SE2> pose;
  pose.chain = {vehicle, 1};
  pose.anchor = anchor;
  return pose;
}

TEST(Security, DatagramsForgedUnderAVehiclesNameDoNotGetThrough) {
  constexpr std::uint32_t forged = 666, honest = 7;
  constexpr unsigned char endpoints = 40;
  const Certificates fleet("1,2");
  DdsExchange<SE2> a(secured(fleet, 1)), b(secured(fleet, 2));
  ASSERT_TRUE(all_connected({&a, &b}));
  Outsider outsider;
  ASSERT_TRUE(eventually([&] { return outsider.heard_of().size() == 2; }));

  GuardedType<v1::PosePubSubType> type;
  v1::Pose sample;
  ASSERT_EQ(to_wire<SE2>({1, 1}, pose_of(1, forged), sample), WireStatus::ok);
  rtps::SerializedPayload_t payload(4096);
  ASSERT_TRUE(type.serialize(&sample, &payload));
  // Which of the two is whom it does not know; it tries both.
  const auto heard = outsider.heard_of();
  for (const auto& [author, own_port] : heard)
    for (const auto& [reader, port] : heard)
      for (unsigned char number = 1; author != reader && number <= endpoints; ++number)
        outsider.forge(author, number, payload, port);
  ASSERT_TRUE(eventually([&] { return b.dds_counters().refused.unprotected >= endpoints; }));
  EXPECT_GE(b.counters().unauthorised, endpoints);

  ASSERT_EQ(a.send({{1, 1}, pose_of(1, honest)}), SendStatus::sent);
  for (const auto& message : collect(b, 1)) {
    const auto* pose = std::get_if<LivePose<SE2>>(&message.payload);
    ASSERT_NE(pose, nullptr);
    EXPECT_EQ(pose->anchor, honest);
  }
  EXPECT_EQ(b.counters().messages_taken, 1U);
}

/// Software of one's own behind a good certificate: writes poses, in the partition it likes.
class Rogue {
 public:
  explicit Rogue(const Certificates& fleet, VehicleId certified) {
    const ProfileFile profiles(loopback_profile());
    edds::DomainParticipantQos qos = profiles.participant("convoy");
    SecurityFolder(fleet.folder(static_cast<int>(certified)), certified).apply(qos);
    participant_ = factory_->create_participant(domain_of_this_test(), qos);
    edds::TypeSupport type(new GuardedType<v1::PosePubSubType>);
    type.register_type(participant_);
    topic_ = participant_->create_topic("convoy/v1/Pose", type.get_type_name(), edds::TOPIC_QOS_DEFAULT);
    publisher_ = participant_->create_publisher(in(partition_of(certified)));
    writer_ = publisher_->create_datawriter(topic_, profiles.writer(*publisher_, "convoy/v1/Pose"));
  }
  ~Rogue() {
    participant_->delete_contained_entities();
    factory_->delete_participant(participant_);
  }
  /// Fast DDS checks the permissions of its own writers when they are made, and not here.
  void move_to(const std::string& partition) { publisher_->set_qos(in(partition)); }
  void say(VehicleId sender) {
    v1::Pose sample;
    ASSERT_EQ(to_wire<SE2>({sender, 1}, pose_of(sender, 0), sample), WireStatus::ok);
    ASSERT_TRUE(writer_->write(&sample));
  }

 private:
  static edds::PublisherQos in(const std::string& partition) {
    edds::PublisherQos qos;
    qos.partition().push_back(partition.c_str());
    return qos;
  }
  std::shared_ptr<edds::DomainParticipantFactory> factory_ = edds::DomainParticipantFactory::get_shared_instance();
  edds::DomainParticipant* participant_ = nullptr;
  edds::Topic* topic_ = nullptr;
  edds::Publisher* publisher_ = nullptr;
  edds::DataWriter* writer_ = nullptr;
};

/// True once `exchange` hears a pose of `vehicle` that `rogue` repeats.
bool hears(DdsExchange<SE2>& exchange, Rogue& rogue, VehicleId vehicle, double timeout_s = deadline_s) {
  return eventually(
      [&] {
        rogue.say(vehicle);
        std::this_thread::sleep_for(std::chrono::milliseconds(20));
        for (const auto& message : exchange.take(0.0))
          if (message.sender.vehicle == vehicle) return true;
        return false;
      },
      timeout_s);
}

TEST(Security, AWriterThatMovesIntoAnothersPartitionIsNotHeardAnyMore) {
  const Certificates fleet("1,2,3");
  Rogue rogue(fleet, 2);
  DdsExchange<SE2> there_before(secured(fleet, 3));
  EXPECT_TRUE(hears(there_before, rogue, 2)) << "under its own name";
  EXPECT_FALSE(hears(there_before, rogue, 1, 0.5));
  rogue.move_to(partition_of(1));
  EXPECT_TRUE(eventually([&] { return !hears(there_before, rogue, 2, 0.5); })) << "that it has moved";
  EXPECT_FALSE(hears(there_before, rogue, 1, 1.0));
  // Fast DDS refuses the partition in its log, and hands out the samples all the same.
  EXPECT_GT(there_before.dds_counters().refused.impersonations, 0U);

  DdsExchange<SE2> there_later(secured(fleet, 1));
  ASSERT_TRUE(there_later.wait_for_peers(1, deadline_s));
  EXPECT_FALSE(hears(there_later, rogue, 1, 1.0)) << "its permissions do not allow it to be there";
  rogue.move_to(partition_of(2));
  EXPECT_FALSE(hears(there_later, rogue, 1, 1.0));
}

struct Spent {
  double bytes = 0.0, cpu_ms = 0.0;
};

/// What a vehicle of three has spent so far, on average.
Spent spent_by(const std::vector<Child*>& vehicles) {
  Spent spent;
  for (Child* vehicle : vehicles) {
    std::string word;
    double rtps_bytes = 0.0, header_bytes = 0.0, ms = 0.0;
    std::istringstream(ask(*vehicle, "bytes")) >> word >> rtps_bytes >> header_bytes;
    std::istringstream(ask(*vehicle, "cpu")) >> word >> ms;
    spent.bytes += (rtps_bytes + header_bytes) / static_cast<double>(vehicles.size());
    spent.cpu_ms += ms / static_cast<double>(vehicles.size());
  }
  return spent;
}

/// Prints what stands in qos_profiles/README.md.
TEST(Security, CostsNoMoreThanItShould) {
  constexpr int facts = 2000;
  const Certificates fleet("1,2,3");
  std::map<bool, double> bytes_per_fact;
  for (const bool secure : {false, true}) {
    std::vector<std::unique_ptr<Child>> children;
    std::vector<Child*> all;
    for (int v = 1; v <= 3; ++v) {
      const auto vehicle = static_cast<VehicleId>(v);
      children.push_back(
          std::make_unique<Child>(secure ? secured_peer(vehicle, fleet.folder(v)) : peer_command(vehicle)));
      all.push_back(children.back().get());
    }
    all_answer(all, "", "ready");
    all_answer(all, "peers 2", "peers 2");
    const Spent found = spent_by(all);
    all_answer(all, "send 0 " + std::to_string(facts), "sent " + std::to_string(facts));
    all_answer(all, "expect " + std::to_string(2 * facts), "held " + std::to_string(2 * facts));
    const Spent told = spent_by(all);
    bytes_per_fact[secure] = (told.bytes - found.bytes) / facts;
    std::printf(
        "%s: until all are found %.1f KB and %.0f ms of CPU; per fact told to two others %.0f bytes and %.0f us\n",
        secure ? "secured" : "unsecured", found.bytes / 1000, found.cpu_ms, bytes_per_fact[secure],
        1000 * (told.cpu_ms - found.cpu_ms) / facts);
  }
  EXPECT_GT(bytes_per_fact[true], bytes_per_fact[false]);
  EXPECT_LT(bytes_per_fact[true], 2.0 * bytes_per_fact[false]);
}

/// The contract of every exchange, kept by secured vehicles 1, 2, ...
template <class G>
struct SecuredNetwork {
  using Group = G;
  static constexpr bool keeps_history = true;
  std::unique_ptr<SubmapExchange<G>> join() {
    auto exchange = std::make_unique<DdsExchange<G>>(secured(fleet, static_cast<VehicleId>(joined.size() + 1)));
    joined.push_back(exchange.get());
    return exchange;
  }
  bool connect(std::size_t n) { return n == joined.size() && all_connected(joined); }
  void pause() { std::this_thread::sleep_for(std::chrono::milliseconds(20)); }
  const Certificates fleet{"1,2,3"};
  std::vector<DdsExchange<G>*> joined;
};

}  // namespace
}  // namespace convoy::dds::testing

namespace convoy::testing {
using SecuredNetworks = ::testing::Types<dds::testing::SecuredNetwork<SE2>, dds::testing::SecuredNetwork<SE3>>;
INSTANTIATE_TYPED_TEST_SUITE_P(Secured, ExchangeContract, SecuredNetworks);
}  // namespace convoy::testing
