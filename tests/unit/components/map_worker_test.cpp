// Maps are built beside receiving and the live pose, never in front of them.
#include <convoy/components/map_worker.hpp>
#include <convoy/components/vehicle.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/map/ekf_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>
#include <utility>

#include "scripted_fleet.hpp"

namespace convoy {
namespace {

/// Solves as SparseMap does, but not while it is shut.
class GatedBackend final : public Backend<SE2> {
 public:
  std::unique_ptr<Map<SE2>> solve(Problem<SE2> problem) const override {
    std::unique_lock lock(mutex_);
    waiting_ = true;
    changed_.wait(lock, [this] { return open_; });
    waiting_ = false;
    lock.unlock();
    return SparseMap<SE2>().solve(std::move(problem));
  }
  void set_open(bool open) {
    const std::lock_guard lock(mutex_);
    open_ = open;
    changed_.notify_all();
  }
  bool waiting() const {
    const std::lock_guard lock(mutex_);
    return waiting_ && !open_;
  }

 private:
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  mutable bool waiting_ = false;
  bool open_ = true;
};

bool eventually(const std::function<bool()>& condition) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  while (std::chrono::steady_clock::now() < end) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return false;
}

/// A vehicle with its thread, and a peer that speaks and listens on the same network while the vehicle is held off.
class SlowMap : public testing::Test {
 protected:
  SlowMap() {
    VehicleParams<SE2> params;
    params.id = 4;
    params.fresh_epoch = [] { return Epoch{1}; };
    params.step_period_s = 0.002;
    params.submaps.map_period_s = 0.01;
    const auto clock = [] {
      return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
    };
    vehicle_ = std::make_unique<Vehicle<SE2>>(
        params, front_end_, [this] { return network_.join(); }, clock);
    vehicle_->use_backend(backend_);
    vehicle_->configure();
    vehicle_->activate();
  }
  ~SlowMap() override { backend_->set_open(true); }

  void advance(double metres, std::size_t landmarks) {
    ASSERT_TRUE(vehicle_->feed([&] {
      FrontEndState<SE2> state = front_end_.state();
      state.stamp_s += 10.0;
      state.abscissa_m += metres;
      state.pose = state.pose * SE2(metres, 0.0, 0.0);
      ASSERT_TRUE(front_end_.advance(state));
      std::vector<FrozenLandmark<SE2>> frozen;
      for (std::size_t k = 0; k < landmarks; ++k)
        frozen.push_back(
            {{1.0 + static_cast<double>(k), 2.0}, 0.01 * Eigen::Matrix2d::Identity(), SE2::Loading::Zero(), {}, k});
      if (landmarks > 0) front_end_.close(frozen);
    }));
  }

  void hold_off(const std::function<void(SubmapManager<SE2>&)>& look) {
    vehicle_->inspect([&](SubmapManager<SE2>& manager, FrontEndComponent<SE2>&) { look(manager); });
  }

  InProcessNetwork<SE2> network_;
  std::unique_ptr<SubmapExchange<SE2>> peer_ = network_.join();
  FrozenLandmarks<SE2> front_end_;
  std::shared_ptr<GatedBackend> backend_ = std::make_shared<GatedBackend>();
  std::unique_ptr<Vehicle<SE2>> vehicle_;
};

TEST_F(SlowMap, BlocksNeitherReceivingNorTheLivePoseAndEndsWithTheMapOfItsFacts) {
  advance(25.0, 3);
  ASSERT_TRUE(eventually([&] { return vehicle_->snapshot().settled; }));
  backend_->set_open(false);
  advance(25.0, 3);
  ASSERT_TRUE(eventually([&] { return backend_->waiting(); }));
  const VehicleSnapshot<SE2> before = vehicle_->snapshot();

  hold_off([&](SubmapManager<SE2>&) {
    peer_->take(0.0);
    PriorFact<SE2> prior;
    prior.key = {{9, 1}, 0};
    AnchorFact<SE2> anchor;
    anchor.key = {{9, 1}, 0};
    EXPECT_EQ(peer_->send({{9, 1}, prior}), SendStatus::sent);
    EXPECT_EQ(peer_->send({{9, 1}, anchor}), SendStatus::sent);
  });
  EXPECT_TRUE(
      eventually([&] { return vehicle_->snapshot().submaps.facts_received == before.submaps.facts_received + 2; }));

  advance(5.0, 0);
  const VehicleSnapshot<SE2> now = vehicle_->snapshot();
  ASSERT_EQ(now.vehicles.size(), 2U);
  ASSERT_TRUE(before.vehicles.at(0).estimate && now.vehicles[0].estimate);
  const SE2 motion = before.vehicles[0].estimate->mean.inverse() * now.vehicles[0].estimate->mean;
  EXPECT_NEAR(motion.translation().x(), 5.0, 1e-9);
  EXPECT_GT(now.vehicles[0].estimate->covariance.trace(), before.vehicles[0].estimate->covariance.trace());
  EXPECT_TRUE(eventually([&] {
    bool told = false;
    for (const Message<SE2>& message : peer_->take(1e9))
      if (const auto* live = std::get_if<LivePose<SE2>>(&message.payload))
        told = told || live->state.stamp_s == front_end_.state().stamp_s;
    return told;
  }));
  EXPECT_TRUE(backend_->waiting());
  EXPECT_EQ(vehicle_->snapshot().submaps.maps_built, before.submaps.maps_built);

  backend_->set_open(true);
  EXPECT_TRUE(eventually([&] { return vehicle_->snapshot().settled; }));
  hold_off([&](SubmapManager<SE2>& manager) {
    const auto fresh = build_global_map(manager.store(), SelectionParams{}, SparseMap<SE2>());
    EXPECT_EQ(manager.map().facts, manager.store().digest());
    EXPECT_EQ(manager.map().map->digest(), fresh.map->digest());
    EXPECT_EQ(manager.map().map->problem().chains.size(), 2U);
  });
}

TEST_F(SlowMap, IsWaitedForWhenTheVehicleIsShutDown) {
  advance(25.0, 3);
  ASSERT_TRUE(eventually([&] { return vehicle_->snapshot().settled; }));
  backend_->set_open(false);
  advance(25.0, 3);
  ASSERT_TRUE(eventually([&] { return backend_->waiting(); }));
  std::atomic<bool> down = false;
  std::thread closer([&] {
    vehicle_->shutdown();
    down = true;
  });
  EXPECT_TRUE(eventually([&] { return vehicle_->state() == Vehicle<SE2>::State::unconfigured; }));
  EXPECT_FALSE(down);
  backend_->set_open(true);
  closer.join();
}

// A member that has just closed a segment says where it is, absolutely.
void fix_at_closings(test::MemberOf<SE2>& member, std::size_t& closed) {
  const auto& anchors = member.manager.store().chains().at(member.chain()).anchors;
  if (anchors.size() == std::exchange(closed, anchors.size())) return;
  const ChainState<SE2>& here = anchors.rbegin()->second.state;
  EXPECT_TRUE(member.manager.publish_absolute_fix(here, SE2::Point::Zero(), member.truth() * SE2::Point(0.0, 0.0),
                                                  SE2::PointCovariance::Identity()));
}

// Orders hand over every fact once; the maps that come back are those of a rebuild.
TEST(MapOrders, AmountToTheMapsOfRebuilds) {
  InProcessNetwork<SE2> network;
  std::vector<std::unique_ptr<test::MemberOf<SE2>>> members;
  test::MemberOptions options;
  options.submaps.selection.fix_correlation_s = 5.0;
  for (const VehicleId v : {1U, 2U, 3U})
    members.push_back(std::make_unique<test::MemberOf<SE2>>(v, network.join(), options));
  SubmapManager<SE2>& manager = members.front()->manager;
  MapWorker<SE2> worker(options.submaps, manager.backend());
  std::vector<std::size_t> closed(members.size(), 1);  // the start is no closing
  // One that is held before the first order.
  ASSERT_TRUE(manager.publish_absolute_fix(members.front()->front_end_component.exportable_state(), SE2::Point::Zero(),
                                           members.front()->script.front().truth.translation(),
                                           SE2::PointCovariance::Identity()));
  std::size_t handed_over = 0, maps = 0;
  std::optional<BuiltMap<SE2>> first;
  double now_s = 0.0;
  for (int k = 0; k < 140; ++k, now_s += 0.5) {
    for (std::size_t m = 0; m < members.size(); ++m) {
      members[m]->drive();
      fix_at_closings(*members[m], closed[m]);
      members[m]->manager.step(now_s);
      members[m]->association.step();
      if (m > 0) members[m]->manager.rebuild(now_s);
    }
    auto order = manager.order_map(now_s);
    if (!order) continue;
    EXPECT_EQ(order->revision, manager.store().revision());
    handed_over += order->news.size();
    worker.start(std::move(*order));
    std::optional<BuiltMap<SE2>> built;
    ASSERT_TRUE(eventually([&] { return (built = worker.collect()).has_value(); }));
    EXPECT_TRUE(worker.idle());
    ++maps;
    if (!first) {
      first = std::move(built);
      continue;
    }
    worker.retire(manager.adopt(std::move(*built)));
    EXPECT_EQ(manager.map().facts, manager.store().digest());
    if (maps % 8 == 0) {
      EXPECT_EQ(manager.map().map->digest(),
                build_global_map(manager.store(), options.submaps.selection, SparseMap<SE2>()).map->digest());
    }
  }
  EXPECT_GT(maps, 10U);
  EXPECT_EQ(handed_over, manager.store().size());
  EXPECT_EQ(manager.map().map->digest(), members[1]->map_digest());
  EXPECT_FALSE(manager.map().selection.classes.empty());
  EXPECT_GE(manager.map().map->problem().fixes.size(), 12U);
  // An order that comes back late does not undo a map of more facts.
  const Hash newest = manager.map().map->digest();
  const Hash late = first->map.map->digest();
  EXPECT_EQ(manager.adopt(std::move(*first)).map->digest(), late);
  EXPECT_EQ(manager.map().map->digest(), newest);
}

// By the paper's filter even those that were ordered to be worked in are exact.
TEST(MapOrders, AnExactMapComesWithItsDigestsHoweverItWasOrdered) {
  SubmapManagerParams params;
  MapWorker<SE2> worker(params, std::make_shared<EkfMap<SE2>>());
  MapOrder<SE2> order;
  order.news.emplace_back(AnchorFact<SE2>{{{1, 1}, 0}, {}});
  order.news.emplace_back(PriorFact<SE2>{{{1, 1}, 0}, false, SE2()});
  order.exact = false;
  worker.start(std::move(order));
  std::optional<BuiltMap<SE2>> built;
  ASSERT_TRUE(eventually([&] { return (built = worker.collect()).has_value(); }));
  ASSERT_TRUE(built->map.exact);
  EXPECT_EQ(built->digests.map, built->map.map->digest());
  EXPECT_EQ(built->digests.facts, built->map.facts);
}

// A map that takes its time is built exactly when it is quiet; until then, what is new is worked into the last one.
TEST(MapOrders, AreExactWhenNothingNewComes) {
  InProcessNetwork<SE2> network;
  std::vector<std::unique_ptr<test::MemberOf<SE2>>> members;
  test::MemberOptions options;
  options.submaps.exact_share = 0.0;
  for (const VehicleId v : {1U, 2U, 3U})
    members.push_back(std::make_unique<test::MemberOf<SE2>>(v, network.join(), options));
  SubmapManager<SE2>& manager = members.front()->manager;
  MapWorker<SE2> worker(options.submaps, manager.backend());
  int quick = 0, exact = 0;
  const auto step = [&](double now_s) {
    for (auto& member : members) {
      member->manager.step(now_s);
      member->association.step();
    }
    const bool news = manager.store().digest() != manager.map().facts;
    auto order = manager.order_map(now_s);
    if (!order) return;
    const bool is_exact = order->exact;
    EXPECT_TRUE(is_exact || news);
    const Hash told = manager.digests().map;
    worker.start(std::move(*order));
    std::optional<BuiltMap<SE2>> built;
    ASSERT_TRUE(eventually([&] { return (built = worker.collect()).has_value(); }));
    built->seconds = 1.0;  // however quick it was
    manager.adopt(std::move(*built));
    EXPECT_EQ(manager.map().exact, is_exact);
    EXPECT_EQ(manager.map().facts, manager.store().digest());
    if (!is_exact) {
      EXPECT_EQ(manager.digests().map, told);  // others hear of exact maps alone
    }
    ++(is_exact ? exact : quick);
  };
  double now_s = 0.0;
  for (int k = 0; k < 120; ++k, now_s += 1.1) {
    for (auto& member : members) member->drive();
    step(now_s);
  }
  EXPECT_GT(quick, 4);
  EXPECT_GT(exact, 2);  // twenty times what one takes has passed now and then
  for (int k = 0; k < 20; ++k, now_s += 1.1) step(now_s);
  EXPECT_TRUE(manager.map().exact);
  const auto reference = build_global_map(manager.store(), options.submaps.selection, SparseMap<SE2>());
  EXPECT_EQ(manager.digests().map, reference.map->digest());
  EXPECT_EQ(manager.digests().facts, manager.store().digest());
  EXPECT_EQ(manager.digests().selection, reference.selection.digest());
  EXPECT_FALSE(reference.selection.classes.empty());
  EXPECT_FALSE(manager.order_map(now_s + 100.0));  // nothing is left to do
}

/// Knows every pose for certain.
class Certain final : public CovarianceSource<SE2> {
 public:
  Eigen::MatrixXd between(int, int) override { return Eigen::Matrix3d::Zero(); }
  Eigen::MatrixXd joint(const std::vector<int>& unknowns) override {
    const auto size = 3 * static_cast<Eigen::Index>(unknowns.size());
    return Eigen::MatrixXd::Zero(size, size);
  }
};

// Facts that do not agree with each other are a reason to doubt every pose; a map that was not iterated to its end says
// nothing of it.
TEST(MapOrders, AnExactMapThatFitsBadlyIsAReasonToSuspect) {
  InProcessNetwork<SE2> network;
  std::vector<std::unique_ptr<test::MemberOf<SE2>>> members;
  for (const VehicleId v : {1U, 2U}) members.push_back(std::make_unique<test::MemberOf<SE2>>(v, network.join()));
  SubmapManager<SE2>& manager = members.front()->manager;
  double now_s = 0.0;
  for (int k = 0; k < 120; ++k, now_s += 0.5)
    for (auto& member : members) {
      member->drive();
      member->step(now_s);
    }
  ASSERT_FALSE(manager.map().selection.classes.empty());
  const auto suspected = [&] {
    for (const VehicleState<SE2>& vehicle : manager.vehicles(now_s))
      if ((vehicle.reasons & reason_innovation) == 0) return false;
    return true;
  };
  const auto adopt = [&](bool exact, double chi2_of_its_limit) {
    auto built = build_global_map(manager.store(), SelectionParams{}, SparseMap<SE2>());
    SolveReport report = built.map->report();
    report.chi2 = chi2_of_its_limit * chi2_quantile(0.999, report.dof);
    built.map = std::make_unique<Map<SE2>>(built.map->shared_problem(),
                                           State<SE2>{built.map->poses(), built.map->points(), built.map->constants()},
                                           report, std::make_unique<Certain>());
    built.exact = exact;
    manager.adopt({std::move(built), manager.store().revision()});
  };
  adopt(false, 1.1);
  EXPECT_FALSE(suspected());
  adopt(true, 1.1);
  EXPECT_TRUE(suspected());
  adopt(false, 0.9);
  EXPECT_TRUE(suspected());  // it is the last exact one that counts
  adopt(true, 0.9);
  EXPECT_FALSE(suspected());
}

}  // namespace
}  // namespace convoy
