#include <gtest/gtest.h>
#include <convoy/components/vehicle.hpp>
#include <convoy/config_error.hpp>
#include <filesystem>
#include <fstream>
#include <limits>
#include "scripted_fleet.hpp"
using namespace convoy;
namespace {
const double nan_ = std::numeric_limits<double>::quiet_NaN();
AnchorFact<SE2> anchor_fact(const ChainId& chain, std::uint32_t index) {
  AnchorFact<SE2> fact;
  fact.key = {chain, index};
  fact.state.stamp_s = fact.state.abscissa_m = 10.0 * index;
  fact.state.pose = SE2(10.0 * index, 0.0, 0.0);
  return fact;
}
bool has(const VehicleState<SE2>& state, IntegrityReason reason) { return (state.reasons & reason) != 0; }
// Somebody sends other content under a key of ours: it is refused, we are no equivocator, and still two of us are
// about, which everybody must see.
TEST(Hardening, AnImpersonatorMakesUsSuspectAndNothingElse) {
  test::ScriptedFleet fleet;
  test::MemberOptions known;
  known.static_bias = Estimate<SE2>{test::script_of(1)[0].truth, SE2::Covariance::Zero()};
  fleet.add(1, known);
  fleet.drive(50);
  auto& self = *fleet.members[0];
  ASSERT_EQ(self.view_of({1, 1}, fleet.now_s).integrity, Integrity::ok);
  auto impersonator = fleet.network().join();
  ASSERT_EQ(impersonator->send({{7, 1}, anchor_fact({1, 1}, 1)}), SendStatus::sent);
  self.step(fleet.now_s);
  const auto view = self.view_of({1, 1}, fleet.now_s);
  EXPECT_EQ(view.integrity, Integrity::suspect);
  EXPECT_EQ(view.reasons, static_cast<std::uint32_t>(reason_impersonated));
  EXPECT_EQ(self.manager.counters().facts_impersonated, 1U);
  EXPECT_EQ(self.manager.counters().senders_impersonated, 0U);
  // The live pose says so, too.
  LivePose<SE2> here;
  here.state = view.slam;
  self.manager.publish_live(here);
  bool said = false;
  for (const auto& message : impersonator->take(0.0))
    if (const auto* live = std::get_if<LivePose<SE2>>(&message.payload))
      said = live->integrity == Integrity::suspect && (live->reasons & reason_impersonated) != 0;
  EXPECT_TRUE(said);
  self.step(fleet.now_s += 61.0);
  EXPECT_FALSE(has(self.view_of({1, 1}, fleet.now_s), reason_impersonated)) << "that is over";
}
// One key, two contents, and each vehicle has heard one of them: no store can see that by itself.
TEST(Hardening, WhoSaysOneThingToSomeAndAnotherToOthersIsFoundOut) {
  InProcessNetwork<SE2> left, right;
  const auto l = left.join(), r = right.join();
  const auto e1 = left.join(), e2 = right.join();
  SubmapManager<SE2> one({1, 1}, *e1, {}), two({2, 1}, *e2, {});
  AnchorFact<SE2> first = anchor_fact({3, 1}, 0), second = first;
  second.state.stamp_s += 1.0;
  ASSERT_EQ(l->send({{3, 1}, first}), SendStatus::sent);
  ASSERT_EQ(r->send({{3, 1}, second}), SendStatus::sent);
  double now_s = 0.0;
  const auto step = [&] {
    now_s += 0.5;
    one.step(now_s);
    two.step(now_s);
    for (auto& message : l->take(now_s))
      if (message.sender.vehicle == 1) (void)r->send(message);
    for (auto& message : r->take(now_s))
      if (message.sender.vehicle == 2) (void)l->send(message);
  };
  for (int k = 0; k < 20; ++k) step();
  for (auto* manager : {&one, &two}) {
    EXPECT_EQ(manager->store().insertions()[static_cast<std::size_t>(Insertion::conflict)], 0U);
    EXPECT_GT(manager->counters().contradictions, 0U);
    for (const auto& vehicle : manager->vehicles(now_s))
      EXPECT_EQ(has(vehicle, reason_equivocation), vehicle.chain.vehicle == 3) << vehicle.chain.vehicle;
  }
}
// Ever new epochs of one vehicle.
TEST(Hardening, WhatIsKeptOfThoseThatSpeakIsBounded) {
  InProcessNetwork<SE2> network;
  const auto e1 = network.join(), e2 = network.join();
  SubmapManager<SE2> manager({1, 1}, *e1, {});
  for (Epoch e = 1; e <= 1000; ++e) ASSERT_EQ(e2->send({{2, e}, Digest{}}), SendStatus::sent);
  manager.step(1.0);
  EXPECT_LE(manager.peers_heard(), 8U);
}
// Two processes with one id, each with an epoch of its own: both notice, and so do the others. A vehicle that was
// restarted is no such thing.
TEST(Hardening, TwoVehiclesWithOneIdAreSuspectAndARestartIsNot) {
  test::ScriptedFleet fleet;
  test::MemberOptions known, second;
  known.static_bias = Estimate<SE2>{test::script_of(1)[0].truth, SE2::Covariance::Zero()};
  second.static_bias = Estimate<SE2>{test::script_of(2)[0].truth, SE2::Covariance::Zero()};
  fleet.add(1, known);
  fleet.add(2, second);
  fleet.drive(30);
  fleet.members[1].reset();
  second.epoch = 2;
  fleet.add(2, second);
  fleet.drive(30);
  ASSERT_TRUE(fleet.settle());
  for (auto* member : {fleet.members[0].get(), fleet.members[2].get()})
    for (const auto& vehicle : member->manager.vehicles(fleet.now_s)) EXPECT_FALSE(has(vehicle, reason_impersonated));
  second.epoch = 3;
  fleet.add(2, second);
  fleet.drive(30);
  EXPECT_TRUE(has(fleet.members[2]->view_of({2, 2}, fleet.now_s), reason_impersonated));
  EXPECT_TRUE(has(fleet.members[3]->view_of({2, 3}, fleet.now_s), reason_impersonated));
  EXPECT_EQ(fleet.members[2]->view_of({2, 2}, fleet.now_s).integrity, Integrity::suspect);
  EXPECT_TRUE(has(fleet.members[0]->view_of({2, 2}, fleet.now_s), reason_impersonated));
  EXPECT_TRUE(has(fleet.members[0]->view_of({2, 3}, fleet.now_s), reason_impersonated));
  EXPECT_FALSE(has(fleet.members[0]->view_of({1, 1}, fleet.now_s), reason_impersonated));
}
// Two processes claim one id: the one that began later says nothing any more, and goes on when the other is gone.
TEST(Hardening, OfTwoVehiclesWithOneIdTheLaterOneIsRefused) {
  test::ScriptedFleet fleet;
  test::MemberOptions older, younger;
  older.epoch = 7;
  younger.epoch = 8;
  fleet.add(1);
  fleet.add(2, older);
  fleet.drive(20);
  fleet.add(2, younger);
  auto ear = fleet.network().join();
  fleet.drive(40);
  EXPECT_FALSE(fleet.members[0]->manager.refused());
  EXPECT_FALSE(fleet.members[1]->manager.refused());
  EXPECT_TRUE(fleet.members[2]->manager.refused());
  EXPECT_GT(fleet.members[2]->manager.counters().sends_withheld, 0U);
  ear->take(fleet.now_s);
  fleet.drive(10);
  for (const auto& message : ear->take(fleet.now_s)) EXPECT_NE(message.sender, (ChainId{2, 8}));
  fleet.members[1].reset();
  fleet.drive(60);
  EXPECT_FALSE(fleet.members[2]->manager.refused());
  ASSERT_TRUE(fleet.settle());  // what was withheld has been brought
  EXPECT_NE(fleet.members[0]->manager.store().anchor({{2, 8}, 3}), nullptr);
}
// Each hears the two others in turn.
TEST(Hardening, OfThreeVehiclesWithOneIdTheFirstRemains) {
  test::ScriptedFleet fleet;
  for (Epoch epoch = 7; epoch <= 9; ++epoch) {
    test::MemberOptions options;
    options.epoch = epoch;
    fleet.add(2, options);
  }
  fleet.drive(60);
  EXPECT_FALSE(fleet.members[0]->manager.refused());
  EXPECT_TRUE(fleet.members[1]->manager.refused());
  EXPECT_TRUE(fleet.members[2]->manager.refused());
}
// What an earlier run of this vehicle said just before it died is no second process, however late it comes.
TEST(Hardening, AnEchoOfTheLastRunIsNoRival) {
  Impairment slow;
  slow.delay_s = 2.0;
  test::ScriptedFleet fleet(slow);
  fleet.add(1);
  auto& before = fleet.add(2);
  fleet.drive(30);
  const auto echo = before.chain();
  fleet.members[1].reset();
  test::MemberOptions next;
  next.epoch = echo.epoch + 1;
  auto& after = fleet.add(2, next);
  fleet.drive(60);
  EXPECT_FALSE(after.manager.refused());
  EXPECT_EQ(after.manager.counters().sends_withheld, 0U);
}
// Clocks that differ are told of; the map is the same.
TEST(Hardening, AClockThatDiffersIsReported) {
  InProcessNetwork<SE2> network;
  const auto e1 = network.join(), e2 = network.join();
  SubmapManager<SE2> a({1, 1}, *e1, {}), b({2, 1}, *e2, {});
  a.open_chain(0.0, std::nullopt);
  b.open_chain(0.0, std::nullopt);
  for (double now_s = 0.0; now_s < 200.0; now_s += 0.5) {
    a.step(now_s);
    b.step(now_s + 3.5 + (now_s > 150.0 ? 10.0 : 0.0));  // set forward on the way
  }
  const auto offset = [](SubmapManager<SE2>& of, VehicleId vehicle) {
    for (const auto& state : of.vehicles(200.0))
      if (state.chain.vehicle == vehicle && state.clock_offset_s) return *state.clock_offset_s;
    return std::nan("");
  };
  EXPECT_NEAR(offset(a, 2), -13.5, 0.51);
  EXPECT_NEAR(offset(b, 1), 3.5, 0.51) << "the least of two minutes: a delay cannot be negative";
  EXPECT_TRUE(std::isnan(offset(a, 1)));
  EXPECT_EQ(a.store().digest(), b.store().digest());
}
// A peer that floods is not listened to for a while, and the others are.
TEST(Hardening, AFloodingPeerIsQuarantined) {
  SubmapManagerParams params;
  params.peers.burst = 50.0;
  params.peers.messages_per_s = 20.0;
  InProcessNetwork<SE2> network;
  const auto own = network.join(), flooder = network.join(), other = network.join();
  SubmapManager<SE2> manager({1, 1}, *own, params);
  manager.open_chain(0.0, std::nullopt);
  for (std::uint32_t k = 0; k < 500; ++k) {
    (void)flooder->send({{3, 1}, anchor_fact({3, 1}, k)});
    if (k % 25 == 0) (void)other->send({{4, 1}, anchor_fact({4, 1}, k / 25)});
  }
  manager.step(1.0);
  EXPECT_EQ(manager.peer_counters().quarantines, 1U);
  EXPECT_EQ(manager.store().chains().at({3, 1}).anchors.size(), 50U);
  EXPECT_EQ(manager.store().chains().at({4, 1}).anchors.size(), 20U);
}
// What one vehicle may fill is bounded; the others have their own share.
TEST(Hardening, AVehicleFillsItsOwnShareAndNoOther) {
  FactLimits limits;
  limits.max_facts_per_vehicle = 10;
  limits.max_chains_per_vehicle = 3;
  FactStore<SE2> store(limits);
  for (std::uint32_t k = 0; k < 20; ++k) store.insert(anchor_fact({3, 1}, k));
  EXPECT_EQ(store.size(), 10U);
  EXPECT_EQ(store.insertions()[static_cast<std::size_t>(Insertion::over_share)], 10U);
  EXPECT_EQ(store.insert(anchor_fact({3, 1}, 5)), Insertion::duplicate);
  for (Epoch e = 1; e <= 20; ++e)
    EXPECT_EQ(store.insert(anchor_fact({4, e}, 0)), e <= 3 ? Insertion::inserted : Insertion::over_share);
  EXPECT_EQ(store.chains().size(), 4U);
  EXPECT_EQ(store.insert(anchor_fact({5, 1}, 0)), Insertion::inserted);
}
// A stranger's fact under a key of ours is no answer to who asked for the true one: ours must still be sent.
TEST(Hardening, AnImpersonatorDoesNotSilenceOurAnswers) {
  test::ScriptedFleet fleet;
  fleet.add(1);
  fleet.drive(50);
  auto& self = *fleet.members[0];
  auto other = fleet.network().join();
  ASSERT_EQ(other->send({{7, 1}, Request{{1, 1}, FactKind::anchor, {{1, 2}}}}), SendStatus::sent);
  ASSERT_EQ(other->send({{7, 1}, anchor_fact({1, 1}, 1)}), SendStatus::sent);
  bool answered = false;
  for (int k = 0; k < 10; ++k) {
    self.step(fleet.now_s += 0.5);
    for (const auto& message : other->take(fleet.now_s))
      if (const auto* anchor = std::get_if<AnchorFact<SE2>>(&message.payload))
        answered = answered || self.manager.store().holds(*anchor);
  }
  EXPECT_TRUE(answered);
}
// A landmark the store refuses takes an index anyway: a hole that nobody can ever fill, in every store of the fleet.
/// Vehicle 1 alone, what it hears, and what it says.
struct Speaker {
  explicit Speaker(const SubmapManagerParams& params = {}) : manager({1, 1}, *exchange, params) {}
  void hear(const ChainId& sender, Payload<SE2> payload) { (void)ear->send({sender, std::move(payload)}); }
  std::vector<Message<SE2>> said() { return ear->take(0.0); }
  InProcessNetwork<SE2> network;
  std::unique_ptr<SubmapExchange<SE2>> exchange = network.join(), ear = network.join();
  SubmapManager<SE2> manager;
};
/// R D R^T as it comes out: symmetric but for its last bits.
template <class Square>
Square turned(double angle) {
  Square R = Square::Identity();
  R.template topLeftCorner<2, 2>() << std::cos(angle), -std::sin(angle), std::sin(angle), std::cos(angle);
  typename Eigen::Matrix<double, Square::RowsAtCompileTime, 1> sigmas;
  for (Eigen::Index i = 0; i < sigmas.size(); ++i) sigmas[i] = 0.1 + 0.7 * static_cast<double>(i);
  return R * sigmas.asDiagonal() * R.transpose();
}
template <class Matrix>
bool is_symmetric(const Matrix& P) {
  return P == P.transpose();
}
// What a host gives may be symmetric but for rounding; what is told is so to the bit, since half of it is sent.
TEST(Hardening, CovariancesAreToldSymmetricToTheBit) {
  int crooked = 0;
  for (int k = 0; k < 50; ++k) {
    const auto P = turned<Eigen::Matrix2d>(0.1 * k);
    const auto D = turned<Eigen::Matrix3d>(0.1 * k);
    crooked += !is_symmetric(P) && !is_symmetric(D);
    Speaker speaker;
    ChainState<SE2> state;
    state.stamp_s = state.abscissa_m = 10.0;
    state.drift = D;
    LandmarkFact<SE2> landmark;
    landmark.position = {1.0, 2.0};
    landmark.covariance = P;
    speaker.manager.open_chain(0.0, Estimate<SE2>{SE2(), D});
    ASSERT_TRUE(speaker.manager.publish_segment(state, {landmark})[0]);
    ASSERT_TRUE(speaker.manager.publish_absolute_fix(state, {0.0, 0.0}, {1.0, 2.0}, P));
    ASSERT_TRUE(speaker.manager.publish_encounter(state, 2, {1.0, 2.0}, P));
    ASSERT_TRUE(speaker.manager.publish_waypoint(state, {{2, 1}, 0}, {0.0, 0.0}));
    LivePose<SE2> live;
    live.state = state;
    live.shared = D;
    live.remembered = {{0, {1.0, 2.0}, P}};
    speaker.manager.publish_live(live);
    const auto said = speaker.said();
    EXPECT_EQ(said.size(), 8U);
    for (const auto& message : said)
      std::visit(
          [](const auto& told) {
            using Told = std::decay_t<decltype(told)>;
            if constexpr (requires { told.state.drift; }) {
              EXPECT_TRUE(is_symmetric(told.state.drift));
            }
            if constexpr (requires { told.covariance; }) {
              EXPECT_TRUE(is_symmetric(told.covariance));
            }
            if constexpr (std::is_same_v<Told, LivePose<SE2>>) {
              EXPECT_TRUE(is_symmetric(told.shared));
              ASSERT_EQ(told.remembered.size(), 1U);
              EXPECT_TRUE(is_symmetric(told.remembered[0].covariance));
            }
            if constexpr (std::is_same_v<Told, LandmarkBatch<SE2>>) {
              EXPECT_TRUE(is_symmetric(told.landmarks.at(0).covariance));
            }
          },
          message.payload);
  }
  EXPECT_GT(crooked, 5) << "else this tests nothing";
}
// What is refused is no answer to who asked for the true one, which somebody else wrote.
TEST(Hardening, ARefusedFactDoesNotSilenceWhoRelays) {
  Speaker self;
  self.manager.open_chain(0.0, std::nullopt);
  self.hear({3, 1}, anchor_fact({3, 1}, 1));
  self.manager.step(0.0);
  self.said();
  auto bogus = anchor_fact({3, 1}, 1);
  bogus.state.pose = SE2(nan_, 0.0, 0.0);
  self.hear({7, 1}, Request{{3, 1}, FactKind::anchor, {{1, 2}}});
  self.hear({7, 1}, bogus);
  bogus.state.pose = SE2(5.0, 0.0, 0.0);  // finite, and other than what is known
  self.hear({7, 1}, bogus);
  int answers = 0;
  for (double now_s = 1.0; now_s < 3.0; now_s += 0.1) {
    self.manager.step(now_s);
    for (const auto& message : self.said())
      if (const auto* anchor = std::get_if<AnchorFact<SE2>>(&message.payload)) answers += anchor->key == Key{{3, 1}, 1};
  }
  EXPECT_EQ(answers, 1);
}
TEST(Hardening, ALivePoseThatWasOvertakenDoesNotCount) {
  Speaker self;
  self.manager.open_chain(0.0, std::nullopt);
  self.hear({3, 1}, anchor_fact({3, 1}, 0));
  const auto hear = [&](double stamp_s, std::uint32_t anchor) {
    LivePose<SE2> live;
    live.chain = {3, 1};
    live.anchor = anchor;
    live.state.stamp_s = stamp_s;
    self.hear({3, 1}, live);
  };
  const auto stamp_at = [&](double now_s) {
    self.manager.step(now_s);
    for (const auto& vehicle : self.manager.vehicles(now_s))
      if (vehicle.chain == ChainId{3, 1}) return vehicle.slam.stamp_s;
    return nan_;
  };
  hear(10.0, 1);
  EXPECT_EQ(stamp_at(0.0), 10.0);
  hear(9.0, 1);
  EXPECT_EQ(stamp_at(1.0), 10.0);
  hear(11.0, 0);
  EXPECT_EQ(stamp_at(2.0), 10.0);
  hear(12.0, 1);
  EXPECT_EQ(stamp_at(3.0), 12.0);
  hear(1e9, 1);  // somebody else, under this name
  EXPECT_EQ(stamp_at(4.0), 1e9);
  hear(13.0, 1);
  EXPECT_EQ(stamp_at(5.0), 1e9);
  hear(25.0, 1);
  EXPECT_EQ(stamp_at(25.0), 25.0) << "it does not last";
}
// However much waits, a step does not take long; and what comes of it is the same.
TEST(Hardening, AStepTakesSoMuchAndTheRestInItsOrderLater) {
  SubmapManagerParams params;
  params.facts_per_step = 10;
  Speaker slow(params), quick;
  for (Speaker* self : {&slow, &quick}) {
    self->manager.open_chain(0.0, std::nullopt);
    for (std::uint32_t k = 0; k < 25; ++k) self->hear({3, 1}, anchor_fact({3, 1}, k));
    auto other = anchor_fact({3, 1}, 22);  // comes too late to be the one that is held
    other.state.stamp_s += 1.0;
    self->hear({3, 1}, other);
  }
  quick.manager.step(0.0);
  EXPECT_FALSE(quick.manager.busy());
  const auto& held = slow.manager.store().chains();
  for (const std::size_t count : {10U, 20U, 25U}) {
    slow.manager.step(0.0);
    EXPECT_EQ(held.at({3, 1}).anchors.size(), count);
    EXPECT_EQ(slow.manager.busy(), count < 25U);
  }
  EXPECT_EQ(held.at({3, 1}).anchors.at(22).state.stamp_s, 220.0);
  EXPECT_EQ(slow.manager.store().holdings(), quick.manager.store().holdings());
}
class Memory final : public JournalMedium {
 public:
  explicit Memory(Bytes& bytes) : bytes_(bytes) {}
  Bytes read() override { return bytes_; }
  bool append(std::span<const std::uint8_t> more) override {
    bytes_.insert(bytes_.end(), more.begin(), more.end());
    return true;
  }
  bool cut(std::uint64_t size) override {
    bytes_.resize(size);
    return true;
  }

 private:
  Bytes& bytes_;
};
// Strangers have filled this vehicle's share under its earlier epochs, and the journal holds that.
TEST(Hardening, AFullShareOfEarlierEpochsInTheJournalEndsNothing) {
  SubmapManagerParams params;
  params.limits.max_chains_per_vehicle = 3;
  Bytes bytes;
  {
    FactStore<SE2> store;
    Journal<SE2> journal(std::make_unique<Memory>(bytes));
    journal.restore(store);
    for (Epoch epoch = 1; epoch <= 6; ++epoch) journal.append(anchor_fact({1, epoch}, 0), 0.0);
  }
  Journal<SE2> journal(std::make_unique<Memory>(bytes));
  InProcessNetwork<SE2> network;
  const auto exchange = network.join();
  SubmapManager<SE2> manager({1, 9}, *exchange, params);
  manager.keep_in(journal);
  EXPECT_EQ(journal.counters().restored, 3U);
  manager.open_chain(0.0, std::nullopt);
  ChainState<SE2> state;
  state.stamp_s = state.abscissa_m = 10.0;
  LandmarkFact<SE2> landmark;
  landmark.position = {1.0, 2.0};
  landmark.covariance = Eigen::Matrix2d::Identity();
  EXPECT_NO_THROW({
    manager.publish_segment(state, {landmark});
    (void)manager.publish_encounter(state, 2, {1.0, 2.0}, Eigen::Matrix2d::Identity());
    (void)manager.publish_waypoint(state, {{2, 1}, 0}, {0.0, 0.0});
    (void)manager.publish_absolute_fix(state, {0.0, 0.0}, {1.0, 2.0}, Eigen::Matrix2d::Identity());
    LivePose<SE2> live;
    live.state = state;
    manager.publish_live(live);
    manager.step(1.0);
    manager.rebuild(1.0, true);
    manager.vehicles(1.0);
  });
}
TEST(Hardening, ARefusedOwnLandmarkLeavesNoHole) {
  InProcessNetwork<SE2> network;
  const auto e1 = network.join(), e2 = network.join();
  SubmapManager<SE2> one({1, 1}, *e1, {}), two({2, 1}, *e2, {});
  one.open_chain(0.0, std::nullopt);
  ChainState<SE2> s;
  s.stamp_s = s.abscissa_m = 10.0;
  LandmarkFact<SE2> good, bad;
  good.covariance.setIdentity();
  bad = good;
  bad.position.x() = nan_;
  one.publish_segment(s, {good, bad, good});
  two.step(0.0);
  EXPECT_EQ(one.store().missing_count(), 0U);
  EXPECT_EQ(two.store().missing_count(), 0U);
  EXPECT_TRUE(complete(one.store(), Key{{1, 1}, 1}));
}
// Likewise an association the store refuses (nothing in it).
TEST(Hardening, ARefusedOwnAssociationTakesNoIndex) {
  InProcessNetwork<SE2> network;
  const auto e1 = network.join(), e2 = network.join();
  SubmapManager<SE2> one({1, 1}, *e1, {}), two({2, 1}, *e2, {});
  EXPECT_FALSE(one.publish_association({}));
  one.publish_association({{Key{{1, 1}, 0}, Key{{2, 1}, 0}}});
  EXPECT_EQ(one.store().missing_count(), 0U);
}
// A static bias that is no covariance is set-up: it ought to throw. Nothing is stated then.
TEST(Hardening, ABadStaticBiasIsAConfigError) {
  InProcessNetwork<SE2> network;
  const auto e1 = network.join();
  SubmapManager<SE2> one({1, 1}, *e1, {});
  Estimate<SE2> bias;
  bias.covariance(0, 0) = -1.0;
  EXPECT_THROW(one.open_chain(0.0, bias), ConfigError);
  EXPECT_EQ(one.store().size(), 0U);
}
// A peer's live pose that is not finite must not reach the host.
TEST(Hardening, ALivePoseThatIsNotFiniteIsRefused) {
  test::ScriptedFleet fleet;
  test::MemberOptions known;
  known.static_bias = Estimate<SE2>{SE2(), SE2::Covariance::Zero()};
  auto& self = fleet.add(1, known);
  auto peer = fleet.network().join();
  ASSERT_EQ(peer->send({{2, 1}, anchor_fact({2, 1}, 0)}), SendStatus::sent);
  PriorFact<SE2> prior{{{2, 1}, 0}, true, SE2(), {}};
  ASSERT_EQ(peer->send({{2, 1}, prior}), SendStatus::sent);
  LivePose<SE2> live;
  live.chain = {2, 1};
  live.state.stamp_s = 5.0;
  live.state.pose = SE2(nan_, 0.0, 0.0);
  live.state.drift(0, 0) = -100.0;
  ASSERT_EQ(peer->send({{2, 1}, live}), SendStatus::sent);
  self.step(10.0);
  const auto view = self.view_of({2, 1}, 10.0);
  ASSERT_TRUE(view.estimate);
  EXPECT_TRUE(view.estimate->mean.translation().allFinite());
}
// Nor does one whose landmarks are none take the place of the last good one, whoever made it.
TEST(Hardening, ALivePoseWithUnfitLandmarksIsRefused) {
  test::ScriptedFleet fleet;
  auto& self = fleet.add(1);
  auto peer = fleet.network().join();
  ASSERT_EQ(peer->send({{2, 1}, anchor_fact({2, 1}, 0)}), SendStatus::sent);
  LivePose<SE2> good;
  good.chain = {2, 1};
  good.state.stamp_s = good.state.abscissa_m = 5.0;
  good.state.pose = SE2(5.0, 0.0, 0.0);
  for (std::uint32_t i = 0; i < 4; ++i)
    good.remembered.push_back({i, {1.0 + i, 2.0 * i * i}, 0.01 * Eigen::Matrix2d::Identity()});
  good.shared = 0.01 * SE2::Covariance::Identity();
  ASSERT_EQ(peer->send({{2, 1}, good}), SendStatus::sent);
  std::vector<LivePose<SE2>> bad(6, good);
  bad[0].remembered[2].position.x() = nan_;
  bad[1].remembered[2].covariance(0, 0) = -1.0;
  bad[2].shared(2, 2) = -1.0;
  bad[3].shared(0, 0) = std::numeric_limits<double>::infinity();
  bad[4].remembered.resize(9, good.remembered[0]);
  bad[5].remembered[0].position.y() = 1e7;
  for (auto& live : bad) {
    live.state.stamp_s = 6.0;
    ASSERT_EQ(peer->send({{2, 1}, live}), SendStatus::sent);
  }
  self.step(10.0);
  EXPECT_EQ(self.manager.counters().live_unfit, bad.size());
  EXPECT_EQ(self.view_of({2, 1}, 10.0).slam.stamp_s, 5.0);
  // Of our own making: told without them.
  bad[2].state = ChainState<SE2>();
  self.manager.publish_live(bad[2]);
  EXPECT_EQ(self.manager.counters().live_unfit, bad.size() + 1);
  for (const auto& message : peer->take(0.0))
    if (const auto* live = std::get_if<LivePose<SE2>>(&message.payload)) {
      EXPECT_TRUE(live->remembered.empty());
    }
}
double zero_clock() { return 0.0; }
// The front end closed a segment before this vehicle's chain began.
TEST(Hardening, ASegmentClosedBeforeConfigureIsNotExported) {
  InProcessNetwork<SE2> network;
  FrozenLandmarks<SE2> slam;
  VehicleParams<SE2> params;
  params.id = 1;
  Vehicle<SE2> vehicle(
      params, slam, [&] { return network.join(); }, zero_clock);
  FrontEndState<SE2> s;
  const auto go = [&](double x) {
    s.stamp_s = s.abscissa_m = x;
    s.pose = SE2(x, 0.0, 0.0);
    ASSERT_TRUE(slam.advance(s));
  };
  go(10.0);
  slam.close({{SE2::Point(1, 1), Eigen::Matrix2d::Identity(), SE2::Loading::Zero(), {}, 1}});
  go(20.0);
  vehicle.configure();
  ASSERT_TRUE(vehicle.feed([&] { go(30.0); }));
  const auto snapshot = vehicle.snapshot();
  EXPECT_EQ(snapshot.facts_missing, 0U);
  EXPECT_EQ(snapshot.insertions[static_cast<std::size_t>(Insertion::out_of_range)], 0U);
}
TEST(Hardening, AnEpochFileWithANumberAndMoreIsCorruptToo) {
  const auto folder = std::filesystem::temp_directory_path() / "convoy_failing_epoch";
  std::filesystem::create_directories(folder);
  InProcessNetwork<SE2> network;
  FrozenLandmarks<SE2> slam;
  VehicleParams<SE2> params;
  params.id = 1;
  params.state_folder = folder;
  for (const char* content : {"-5\n", "12abc\n", "12 34\n", "18446744073709551615\n"}) {
    std::ofstream(folder / "epoch", std::ios::trunc) << content;
    Vehicle<SE2> vehicle(
        params, slam, [&] { return network.join(); }, zero_clock);
    EXPECT_THROW(vehicle.configure(), ConfigError) << content;
  }
  std::filesystem::remove_all(folder);
}
// "So that it grows and never repeats".
TEST(Hardening, AnEpochFromTheClockGrowsWithinASecondToo) {
  InProcessNetwork<SE2> network;
  FrozenLandmarks<SE2> slam;
  VehicleParams<SE2> params;
  params.id = 1;
  Vehicle<SE2> vehicle(
      params, slam, [&] { return network.join(); }, zero_clock);
  Epoch last = 0;
  for (int k = 0; k < 30; ++k) {
    vehicle.configure();
    const Epoch epoch = vehicle.snapshot().self.epoch;
    EXPECT_GT(epoch, last) << k;
    last = epoch;
    vehicle.shutdown();
  }
}
}  // namespace
