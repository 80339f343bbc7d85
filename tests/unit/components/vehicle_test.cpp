#include <convoy/components/vehicle.hpp>
#include <convoy/config_error.hpp>
#include <convoy/exchange/in_process.hpp>
#include <convoy/frontend/frozen_landmarks.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/sparse_map.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <thread>

namespace convoy {
namespace {

namespace fs = std::filesystem;
using State = Vehicle<SE2>::State;

double clock_s() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

/// A vehicle alone on its network, with a folder that is removed afterwards.
class VehicleTest : public ::testing::Test {
 protected:
  VehicleTest() {
    const auto* test = ::testing::UnitTest::GetInstance()->current_test_info();
    folder_ =
        fs::temp_directory_path() / ("convoy_vehicle_" + std::string(test->name()) + "_" + std::to_string(::getpid()));
    fs::remove_all(folder_);
    params_.id = 4;
    params_.state_folder = folder_ / "state";
    params_.fresh_epoch = [] { return Epoch{1}; };
    params_.step_period_s = 0.005;
    params_.submaps.map_period_s = 0.01;
  }
  ~VehicleTest() override { fs::remove_all(folder_); }

  Vehicle<SE2>& vehicle() {
    if (!vehicle_)
      vehicle_ = std::make_unique<Vehicle<SE2>>(
          params_, front_end_, [this] { return network_.join(); }, clock_s);
    return *vehicle_;
  }

  /// One more segment of three landmarks.
  void close_segment() {
    ASSERT_TRUE(vehicle().feed([&] {
      FrontEndState<SE2> state = front_end_.state();
      state.stamp_s += 10.0;
      state.abscissa_m += 25.0;
      state.pose = state.pose * SE2(25.0, 0.0, 0.1);
      ASSERT_TRUE(front_end_.advance(state));
      std::vector<FrozenLandmark<SE2>> landmarks;
      for (int k = 0; k < 3; ++k)
        landmarks.push_back(
            {{1.0 + k, 2.0}, 0.01 * Eigen::Matrix2d::Identity(), SE2::Loading::Zero(), {}, std::uint64_t(k)});
      front_end_.close(landmarks);
    }));
  }

  /// Waits for the thread to get there.
  bool eventually(const std::function<bool(const VehicleSnapshot<SE2>&)>& condition) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    while (std::chrono::steady_clock::now() < end) {
      if (condition(vehicle().snapshot())) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    return false;
  }

  /// What the peer has heard once it is so much.
  static std::vector<Message<SE2>> heard(SubmapExchange<SE2>& peer, std::size_t count) {
    std::vector<Message<SE2>> messages;
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    while (messages.size() < count && std::chrono::steady_clock::now() < end) {
      for (auto& message : peer.take(0.0)) messages.push_back(std::move(message));
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    return messages;
  }

  static std::string text_of(const std::function<void()>& call) {
    try {
      call();
    } catch (const ConfigError& error) {
      return error.what();
    }
    return "no error";
  }

  fs::path folder_;
  VehicleParams<SE2> params_;
  FrozenLandmarks<SE2> front_end_;
  InProcessNetwork<SE2> network_;
  std::unique_ptr<Vehicle<SE2>> vehicle_;
};

TEST_F(VehicleTest, ParametersOutOfRangeAreRefusedAtOnce) {
  params_.submaps.selection.residual = 1.0;
  EXPECT_EQ(text_of([this] { vehicle(); }), "map: residual must lie in (0, 1) (it is 1)");
  params_.submaps.selection = {};
  params_.submaps.repair.batch_limit = 65;
  EXPECT_EQ(text_of([this] { vehicle(); }), "repair: batch_limit must lie in 1..64 (it is 65)");
}

TEST_F(VehicleTest, AbsoluteFixesBecomeFactsAndUnfitOnesAreCounted) {
  const SE2::PointCovariance metre = SE2::PointCovariance::Identity();
  EXPECT_FALSE(vehicle().feed_absolute_fix({0.5, 0.0}, {100.0, 200.0}, metre)) << "unconfigured";
  vehicle().configure();
  close_segment();
  const auto published = vehicle().snapshot().submaps.facts_published;
  EXPECT_TRUE(vehicle().feed_absolute_fix({0.5, 0.0}, {100.0, 200.0}, metre));
  EXPECT_EQ(vehicle().snapshot().submaps.facts_published, published + 1);
  EXPECT_FALSE(vehicle().feed_absolute_fix({0.5, 0.0}, {NAN, 200.0}, metre));
  EXPECT_FALSE(vehicle().feed_absolute_fix({0.5, 0.0}, {100.0, 200.0}, -metre));
  EXPECT_FALSE(vehicle().feed_absolute_fix({0.5, 0.0}, {1e9, 200.0}, metre));
  EXPECT_EQ(vehicle().snapshot().submaps.facts_unfit, 3U);
  EXPECT_TRUE(vehicle().feed_absolute_fix({0.5, 0.0}, {100.0, 200.0}, metre)) << "fit, and not needed";
  EXPECT_EQ(vehicle().snapshot().submaps.fixes_thinned, 1U);
  EXPECT_EQ(vehicle().snapshot().submaps.facts_published, published + 1);
}

TEST_F(VehicleTest, EncountersBecomeFactsAndUnfitOnesAreCounted) {
  const SE2::PointCovariance metre = SE2::PointCovariance::Identity();
  EXPECT_FALSE(vehicle().feed_encounter(7, {5.0, 1.0}, metre)) << "unconfigured";
  vehicle().configure();
  close_segment();
  const auto published = vehicle().snapshot().submaps.facts_published;
  EXPECT_TRUE(vehicle().feed_encounter(7, {5.0, 1.0}, metre));
  EXPECT_FALSE(vehicle().feed_encounter(7, {5.0, NAN}, metre));
  EXPECT_FALSE(vehicle().feed_encounter(params_.id, {5.0, 1.0}, metre)) << "itself";
  const auto snapshot = vehicle().snapshot();
  EXPECT_EQ(snapshot.submaps.facts_published, published + 1);
  EXPECT_EQ(snapshot.submaps.facts_unfit, 2U);
}

/// Knows where it is by landmarks that it has exported.
class RemembersWhatHasLeft final : public FrontEnd<SE2> {
 public:
  FrontEndState<SE2> state() const override { return {10.0, 5.0, SE2(1.0, 0.0, 0.0)}; }
  FrontEndState<SE2> exportable_state() const override { return {10.0, 5.0, SE2(3.5, 0.0, 0.0)}; }
  std::vector<Segment<SE2>> take_segments() override { return {}; }
};

TEST_F(VehicleTest, AnAbsoluteFixIsStatedByWhatFactsMayUse) {
  RemembersWhatHasLeft slam;
  Vehicle<SE2> vehicle(
      params_, slam, [this] { return network_.join(); }, clock_s);
  vehicle.configure();
  ASSERT_TRUE(vehicle.feed_absolute_fix({0.0, 0.0}, {1.0, 2.0}, SE2::PointCovariance::Identity()));
  vehicle.inspect([](SubmapManager<SE2>& manager, FrontEndComponent<SE2>& front_end) {
    const ChainState<SE2>& stated = manager.store().chains().at(manager.self()).absolute_fixes.at(0).state;
    EXPECT_EQ(stated.stamp_s, 10.0);
    EXPECT_EQ(stated.pose.translation().x(), 2.5);
    EXPECT_EQ(front_end.state().stamp_s, 10.0);
    EXPECT_EQ(front_end.state().pose.translation().x(), 0.0);
  });
}

TEST_F(VehicleTest, CallsInTheWrongStateThrowAndChangeNothing) {
  auto& v = vehicle();
  EXPECT_EQ(v.state(), State::unconfigured);
  EXPECT_THROW(v.activate(), ConfigError);
  EXPECT_THROW(v.deactivate(), ConfigError);
  EXPECT_THROW((void)v.snapshot(), ConfigError);
  EXPECT_THROW(v.inspect([](auto&, auto&) {}), ConfigError);
  bool fed = false;
  EXPECT_FALSE(v.feed([&] { fed = true; }));
  EXPECT_FALSE(fed);
  EXPECT_EQ(v.state(), State::unconfigured);
  EXPECT_FALSE(fs::exists(params_.state_folder / "epoch"));

  v.configure();
  const auto before = v.snapshot();
  EXPECT_THROW(v.configure(), ConfigError);
  EXPECT_THROW(v.deactivate(), ConfigError);
  EXPECT_EQ(v.state(), State::inactive);
  EXPECT_EQ(v.snapshot().self, before.self);
  EXPECT_EQ(v.snapshot().facts_digest, before.facts_digest);

  v.activate();
  EXPECT_THROW(v.activate(), ConfigError);
  EXPECT_THROW(v.configure(), ConfigError);
  EXPECT_EQ(v.state(), State::active);
  EXPECT_EQ(v.snapshot().self, before.self);

  v.shutdown();
  EXPECT_EQ(v.state(), State::unconfigured);
  v.shutdown();  // from any state
  EXPECT_THROW((void)v.snapshot(), ConfigError);
}

TEST_F(VehicleTest, DeactivatedItKeepsItsFactsAndSensorInputCounts) {
  auto& v = vehicle();
  v.configure();
  v.activate();
  close_segment();
  ASSERT_TRUE(eventually([](const auto& s) { return s.settled && s.landmarks_known == 3; }));
  v.deactivate();
  EXPECT_EQ(v.state(), State::inactive);
  const auto before = v.snapshot();
  EXPECT_EQ(before.landmarks_exported, 3U);
  const auto maps = before.submaps.maps_built;
  close_segment();
  auto inactive = v.snapshot();
  EXPECT_EQ(inactive.landmarks_known, 6U);
  EXPECT_FALSE(inactive.settled);  // nobody builds the map
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  EXPECT_EQ(v.snapshot().submaps.maps_built, maps);
  v.activate();
  EXPECT_TRUE(eventually([](const auto& s) { return s.settled; }));
  const auto after = v.snapshot();
  EXPECT_EQ(after.self, before.self);
  EXPECT_EQ(after.facts_digest, inactive.facts_digest);
  EXPECT_EQ(after.landmarks_known, 6U);
}

TEST_F(VehicleTest, ShutdownAndConfigureIsANewEpochThatGrows) {
  std::vector<Epoch> epochs;
  for (int round = 0; round < 3; ++round) {
    vehicle().configure();
    epochs.push_back(vehicle().snapshot().self.epoch);
    close_segment();
    const auto s = vehicle().snapshot();
    EXPECT_EQ(s.restarted, round > 0);
    EXPECT_EQ(s.landmarks_known, 3U);  // of this epoch: the facts of the last one are gone
    EXPECT_EQ(s.facts_missing, 0U);
    vehicle().shutdown();
  }
  vehicle_.reset();  // another process
  vehicle().configure();
  EXPECT_TRUE(vehicle().snapshot().restarted);
  epochs.push_back(vehicle().snapshot().self.epoch);
  EXPECT_EQ(epochs, (std::vector<Epoch>{1, 2, 3, 4}));
  std::ifstream in(params_.state_folder / "epoch");
  Epoch written = 0;
  EXPECT_TRUE(in >> written);
  EXPECT_EQ(written, 4U);
}

TEST_F(VehicleTest, AnEpochFileThatIsNoNumberIsAClearError) {
  fs::create_directories(params_.state_folder);
  const fs::path file = params_.state_folder / "epoch";
  for (const std::string content : {"", "garbage\n", "\n\n", "x1"}) {
    std::ofstream(file, std::ios::trunc) << content;
    const std::string text = text_of([&] { vehicle().configure(); });
    EXPECT_THAT(text, ::testing::HasSubstr(file.string() + ":1")) << content;
    EXPECT_EQ(vehicle().state(), State::unconfigured);
  }
  fs::remove(file);
  StateFolder(params_.state_folder).next_epoch([] { return Epoch{41}; });
  vehicle().configure();
  EXPECT_EQ(vehicle().snapshot().self.epoch, 42U);
}

TEST_F(VehicleTest, AStateFolderThatCannotBeWrittenIsAClearError) {
  fs::create_directories(folder_);
  std::ofstream(params_.state_folder) << "a file where the folder should be";
  EXPECT_THAT(text_of([&] { vehicle().configure(); }), ::testing::HasSubstr(params_.state_folder.string()));
  EXPECT_EQ(vehicle().state(), State::unconfigured);
}

TEST_F(VehicleTest, OnlyTheFirstEpochStartsWhereTheStaticBiasSays) {
  params_.static_bias = Estimate<SE2>{SE2(1.0, 2.0, 0.3), SE2::Covariance::Identity()};
  const auto start_is_known = [&] {
    bool known = false;
    vehicle().inspect([&](auto& manager, auto&) { known = manager.store().prior(manager.self())->known; });
    return known;
  };
  vehicle().configure();
  EXPECT_TRUE(start_is_known());
  vehicle().shutdown();
  vehicle().configure();  // the vehicle has moved since: epoch 2 begins nobody knows where
  EXPECT_FALSE(start_is_known());
}

TEST_F(VehicleTest, ByDefaultTwoFreshFoldersDoNotBeginWithTheSameEpoch) {
  params_.fresh_epoch = VehicleParams<SE2>{}.fresh_epoch;
  std::vector<Epoch> epochs;
  for (const char* run : {"one", "two"}) {
    params_.state_folder = folder_ / run;
    vehicle_.reset();
    vehicle().configure();
    epochs.push_back(vehicle().snapshot().self.epoch);
    vehicle().shutdown();
    vehicle().configure();
    EXPECT_GT(vehicle().snapshot().self.epoch, epochs.back());
  }
  EXPECT_NE(epochs[0], epochs[1]);
}

TEST_F(VehicleTest, ASecondOneOnTheSameFolderIsRefusedBeforeItSpeaks) {
  auto peer = network_.join();
  vehicle().configure();
  ASSERT_EQ(heard(*peer, 2).size(), 2U);  // all that there is to say
  FrozenLandmarks<SE2> slam;
  Vehicle<SE2> twin(
      params_, slam, [this] { return network_.join(); }, clock_s);
  EXPECT_THAT(text_of([&] { twin.configure(); }),
              ::testing::HasSubstr("runs already, as process " + std::to_string(::getpid())));
  EXPECT_EQ(twin.state(), State::unconfigured);
  EXPECT_TRUE(peer->take(0.0).empty());
  vehicle().shutdown();
  twin.configure();
  EXPECT_EQ(twin.snapshot().self.epoch, 2U);  // the refusal has cost none
}

TEST_F(VehicleTest, WithoutAFolderTheEpochComesFromTheClock) {
  params_.state_folder.clear();
  params_.fresh_epoch = epoch_from_clock;
  vehicle().configure();
  const Epoch first = vehicle().snapshot().self.epoch;
  const auto now =
      std::chrono::duration_cast<std::chrono::seconds>(std::chrono::system_clock::now().time_since_epoch()).count();
  EXPECT_NEAR(static_cast<double>(first >> 12) * 1e-6, static_cast<double>(now), 5.0);
  vehicle().shutdown();
  vehicle().configure();
  EXPECT_NE(vehicle().snapshot().self.epoch, first);
}

TEST_F(VehicleTest, ANetworkThatDoesNotOpenLeavesItUnconfigured) {
  bool broken = true;
  Vehicle<SE2> v(
      params_, front_end_,
      [&]() -> std::unique_ptr<SubmapExchange<SE2>> {
        if (broken) throw ConfigError("no such profile");
        return network_.join();
      },
      clock_s);
  EXPECT_THROW(v.configure(), ConfigError);
  EXPECT_EQ(v.state(), State::unconfigured);
  EXPECT_FALSE(v.feed([] {}));
  broken = false;
  v.configure();
  EXPECT_EQ(v.state(), State::inactive);
}

TEST_F(VehicleTest, StatesItsStaticBiasWhenItIsConfigured) {
  params_.static_bias = Estimate<SE2>{SE2(5.0, -3.0, 0.4), 0.01 * SE2::Covariance::Identity()};
  auto peer = network_.join();
  vehicle().configure();
  const auto messages = heard(*peer, 2);
  ASSERT_EQ(messages.size(), 2U);
  EXPECT_TRUE(std::holds_alternative<AnchorFact<SE2>>(messages[0].payload));
  const auto& prior = std::get<PriorFact<SE2>>(messages[1].payload);
  EXPECT_TRUE(prior.known);
  EXPECT_EQ(prior.mean.theta(), 0.4);
  EXPECT_EQ(prior.key.chain, vehicle().snapshot().self);
}

TEST_F(VehicleTest, ARestartWithItsJournalHasAllItsFactsAndUsesNoIndexTwice) {
  params_.journal = true;
  vehicle().configure();
  close_segment();
  close_segment();
  EXPECT_EQ(vehicle().snapshot().journal.written, 1U + 1U + 2U * 4U);  // origin, prior, two batches with their anchors
  vehicle().shutdown();
  vehicle().configure();
  const auto snapshot = vehicle().snapshot();
  EXPECT_EQ(snapshot.self.epoch, 2U);
  EXPECT_EQ(snapshot.journal.restored, 10U);
  EXPECT_EQ(snapshot.landmarks_known, 6U);
  EXPECT_EQ(snapshot.vehicles.size(), 2U);
  vehicle().shutdown();

  std::filesystem::remove(params_.state_folder / "epoch");  // by hand: the epoch would be the first one's again
  EXPECT_THAT(text_of([&] { vehicle().configure(); }), ::testing::HasSubstr("take an epoch that was never used"));
  EXPECT_EQ(vehicle().state(), State::unconfigured);
  std::filesystem::remove(params_.state_folder / "facts.journal");
  vehicle().configure();
  EXPECT_EQ(vehicle().snapshot().landmarks_known, 0U);
}

TEST_F(VehicleTest, ReportsEveryExportByIndexAndTrack) {
  std::vector<std::pair<std::uint32_t, std::uint64_t>> exported;
  vehicle().on_export([&](std::uint32_t index, std::uint64_t track) { exported.emplace_back(index, track); });
  vehicle().configure();
  close_segment();
  close_segment();
  using Exported = decltype(exported);
  EXPECT_EQ(exported, (Exported{{0, 0}, {1, 1}, {2, 2}, {3, 0}, {4, 1}, {5, 2}}));
}

TEST_F(VehicleTest, ParametersAreChecked) {
  const auto refused = [&](auto change) {
    VehicleParams<SE2> params = params_;
    change(params);
    return text_of([&] {
             Vehicle<SE2> v(
                 params, front_end_, [this] { return network_.join(); }, clock_s);
           }) != "no error";
  };
  using P = VehicleParams<SE2>;
  EXPECT_FALSE(refused([](P&) {}));
  EXPECT_TRUE(refused([](P& p) { p.id = 0; }));
  EXPECT_TRUE(refused([](P& p) { p.step_period_s = 0.0; }));
  EXPECT_TRUE(refused([](P& p) { p.searches_per_step = 0; }));
  EXPECT_TRUE(refused([](P& p) { p.fresh_epoch = nullptr; }));
  EXPECT_TRUE(refused([](P& p) { p.drift.gamma = 0.0; }));
  EXPECT_TRUE(refused([](P& p) { p.budget.burst_s = 0.0; }));
  EXPECT_TRUE(refused([](P& p) { p.watchdog.deaf_s = 0.0; }));
  EXPECT_TRUE(refused([](P& p) { p.watchdog.deaf_s = p.submaps.repair.digest_idle_s; }));
  EXPECT_TRUE(refused([](P& p) { p.submaps.peers.burst = 0.0; }));
  EXPECT_TRUE(refused([](P& p) {
    p.journal = true;
    p.state_folder.clear();
  }));
  EXPECT_TRUE(refused([](P& p) { p.association.min_pairings = 0; }));
}

/// Throws while it is told to.
class Throwing final : public SubmapExchange<SE2> {
 public:
  Throwing(std::unique_ptr<SubmapExchange<SE2>> inner, std::atomic<bool>& throws)
      : inner_(std::move(inner)), throws_(throws) {}
  SendStatus send(const Message<SE2>& message) override { return inner_->send(message); }
  std::vector<Message<SE2>> take(double now_s) override {
    if (throws_) throw std::runtime_error("no buffer");
    return inner_->take(now_s);
  }
  ExchangeCounters counters() const override { return inner_->counters(); }

 private:
  std::unique_ptr<SubmapExchange<SE2>> inner_;
  std::atomic<bool>& throws_;
};

class ThrowingBackend final : public Backend<SE2> {
 public:
  std::unique_ptr<Map<SE2>> solve(Problem<SE2> problem) const override {
    if (throws) throw std::runtime_error("singular");
    return SparseMap<SE2>().solve(std::move(problem));
  }
  std::atomic<bool> throws{false};
};

TEST_F(VehicleTest, WhatTheNetworkOrTheSolverThrowsEndsNothing) {
  std::atomic<bool> throws{true};
  const auto backend = std::make_shared<ThrowingBackend>();
  Vehicle<SE2> v(
      params_, front_end_, [&] { return std::make_unique<Throwing>(network_.join(), throws); }, clock_s);
  v.use_backend(backend);
  v.configure();
  auto peer = network_.join();
  AnchorFact<SE2> anchor;
  anchor.key = {{7, 1}, 0};
  (void)peer->send({{7, 1}, anchor});
  const auto soon = [&](auto condition) {
    for (int k = 0; k < 5000 && !condition(v.snapshot()); ++k)
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    return condition(v.snapshot());
  };
  v.activate();
  EXPECT_TRUE(soon([](const auto& s) { return s.failures.count > 3 && s.submaps.maps_built > 0; }))
      << "the rest goes on meanwhile";
  EXPECT_EQ(v.snapshot().failures.last_error, "no buffer");
  throws = false;
  EXPECT_TRUE(soon([](const auto& s) { return s.settled && s.vehicles.size() == 2; }));

  backend->throws = true;
  PriorFact<SE2> prior;
  prior.key = {{7, 1}, 0};
  (void)peer->send({{7, 1}, prior});
  EXPECT_TRUE(soon([](const auto& s) { return s.failures.last_error == "singular"; }));
  backend->throws = false;
  EXPECT_TRUE(soon([](const auto& s) { return s.settled; })) << "nothing that was ordered is lost";
}

TEST_F(VehicleTest, WhatAFrontEndThrowsItsHostGetsAndTheVehicleGoesOn) {
  vehicle().configure();
  vehicle().activate();
  EXPECT_THROW(vehicle().feed([] { throw std::runtime_error("no such track"); }), std::runtime_error);
  close_segment();
  EXPECT_TRUE(eventually([](const auto& s) { return s.settled && s.landmarks_known == 3; }));
}

/// Two batches of one place.
class SamePlaceTwice : public VehicleTest {
 protected:
  SamePlaceTwice() { params_.association.min_pairings = 3; }
  void see_it() {
    ASSERT_TRUE(vehicle().feed([&] {
      FrontEndState<SE2> state = front_end_.state();
      state.stamp_s += 10.0;
      state.abscissa_m += 0.5;
      ASSERT_TRUE(front_end_.advance(state));
      std::vector<FrozenLandmark<SE2>> landmarks;
      for (int k = 0; k < 6; ++k)
        landmarks.push_back({{1.0 + 3.0 * k, 2.0 + k * k},
                             0.01 * Eigen::Matrix2d::Identity(),
                             SE2::Loading::Zero(),
                             {},
                             static_cast<std::uint64_t>(k)});
      front_end_.close(landmarks);
    }));
  }
};

TEST_F(SamePlaceTwice, WhatAConstraintOfTheHostThrowsEndsNothing) {
  std::atomic<int> asked{0};
  params_.looks_alike = [&](const auto&, const auto&) -> bool {
    ++asked;
    throw std::runtime_error("no picture");
  };
  vehicle().configure();
  vehicle().activate();
  see_it();
  see_it();
  EXPECT_TRUE(eventually([](const auto& s) { return s.failures.last_error == "no picture"; }));
  EXPECT_TRUE(eventually([](const auto& s) { return s.settled && s.landmarks_known == 12; }));
  EXPECT_GT(asked, 0);
}

TEST_F(SamePlaceTwice, ASearchKeepsNobodyWaiting) {
  std::atomic<bool> searching{false}, may_end{false};
  const double until_s = clock_s() + 20.0;
  params_.looks_alike = [&](const auto&, const auto&) {
    searching = true;
    while (!may_end && clock_s() < until_s) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return true;
  };
  vehicle().configure();
  vehicle().activate();
  see_it();
  see_it();
  for (int k = 0; k < 10'000 && !searching; ++k) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  ASSERT_TRUE(searching);
  const double begin_s = clock_s();
  see_it();
  EXPECT_EQ(vehicle().snapshot().landmarks_known, 18U);
  EXPECT_LT(clock_s() - begin_s, 5.0);  // the search takes twenty
  EXPECT_FALSE(vehicle().snapshot().settled);
  may_end = true;
  EXPECT_TRUE(eventually([](const auto& s) { return s.settled && s.association.accepted > 0; }));
}

TEST_F(VehicleTest, IsNotSettledWhileABudgetKeepsFactsWaiting) {
  params_.budget.bytes_per_s = 500.0;
  params_.budget.burst_s = 0.1;
  vehicle().configure();
  for (int k = 0; k < 5; ++k) close_segment();
  vehicle().activate();
  const auto has_a_map = [](const VehicleSnapshot<SE2>& s) { return s.facts_digest != 0 && s.map_digest != 0; };
  bool waited = false;
  EXPECT_TRUE(eventually([&](const VehicleSnapshot<SE2>& s) {
    const bool waits = s.network.outbox.facts_waiting > 0;
    EXPECT_FALSE(waits && s.settled);
    waited = waited || (waits && has_a_map(s));
    return s.settled;
  }));
  EXPECT_TRUE(waited);
}

TEST_F(VehicleTest, IsGoneCleanlyWhileActive) {
  vehicle().configure();
  vehicle().activate();
  close_segment();
  vehicle_.reset();
  EXPECT_TRUE(network_.join()->take(0.0).empty());
}

}  // namespace
}  // namespace convoy
