// What a front end remembers of landmarks that it has exported, on its way to the live pose.
#include <convoy/components/vehicle.hpp>
#include <convoy/exchange/in_process.hpp>
#include <convoy/geometry/se2.hpp>

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace convoy {
namespace {

/// Passes on what the test says.
class Remembering final : public FrontEnd<SE2> {
 public:
  FrontEndState<SE2> state() const override { return state_; }
  RelativeLandmarks<SE2> remembered() const override { return known; }
  bool scales_landmarks() const override { return scales; }
  std::vector<Segment<SE2>> take_segments() override { return std::exchange(segments_, {}); }

  void go(double x_m) {
    state_.stamp_s = state_.abscissa_m = x_m;
    state_.pose = SE2(x_m, 0.0, 0.0);
  }
  /// Twelve landmarks around the place where x is 5 m, under these tracks.
  void close(std::uint64_t first_track) {
    Segment<SE2> segment;
    segment.closing = state_;
    for (std::uint64_t k = 0; k < 12; ++k)
      segment.landmarks.push_back(
          {from_here(k), 0.01 * Eigen::Matrix2d::Identity(), SE2::Loading::Zero(), {}, first_track + k});
    segments_.push_back(segment);
  }
  SE2::Point from_here(std::uint64_t k) const {
    const double angle = 0.5 * static_cast<double>(k * k);
    return state_.pose.inverse() *
           SE2::Point(5.0 + 8.0 * std::cos(angle), (3.0 + static_cast<double>(k)) * std::sin(angle));
  }
  void remember(std::uint64_t first_track) {
    known = {};
    for (std::uint64_t k = 0; k < 12; ++k) {
      known.tracks.push_back(first_track + k);
      known.positions.push_back(from_here(k));
    }
    known.covariance = 0.04 * Eigen::MatrixXd::Identity(24, 24);
  }

  RelativeLandmarks<SE2> known;
  bool scales = false;

 private:
  FrontEndState<SE2> state_;
  std::vector<Segment<SE2>> segments_;
};

// A vehicle alone that comes by the same place twice and says so.
struct LivePoseHook : testing::Test {
  LivePoseHook() {
    manager.open_chain(0.0, Estimate<SE2>{SE2(), 1e-6 * SE2::Covariance::Identity()});
    for (const double x : {10.0, 20.0}) {
      slam.go(x);
      slam.close(static_cast<std::uint64_t>(100.0 * x));
      component.poll();
    }
    std::vector<Pairing> pairings;
    for (std::uint32_t k = 0; k < 12; ++k) pairings.push_back({{manager.self(), k}, {manager.self(), 12 + k}});
    manager.publish_association(pairings);
    manager.rebuild(0.0, true);
  }

  static DriftParams<SE2> drift() {
    DriftParams<SE2> params;
    params.rate = SE2::Tangent(1e-3, 1e-3, 1e-5);
    params.landmark_inflation = 3.0;
    return params;
  }

  InProcessNetwork<SE2> network;
  std::unique_ptr<SubmapExchange<SE2>> exchange = network.join();
  Remembering slam;
  SubmapManager<SE2> manager{{1, 1}, *exchange, {}};
  FrontEndComponent<SE2> component{slam, manager, drift()};
};

TEST_F(LivePoseHook, GivesTheBestKnownOfWhatTheMapHasJoinedWithTheFactorsOfFacts) {
  ASSERT_EQ(manager.map().class_of.size(), 24U);
  slam.go(24.0);
  slam.remember(2000);
  for (Eigen::Index i = 0; i < 24; ++i) slam.known.covariance(i, i) = 0.04 + 0.001 * static_cast<double>(i / 2);
  slam.known.tracks[0] = 7;  // never exported
  component.poll();
  const LivePose<SE2> live = component.live();
  ASSERT_EQ(live.remembered.size(), LivePose<SE2>::max_remembered);
  for (std::uint32_t k = 0; k < 8; ++k) {
    EXPECT_EQ(live.remembered[k].index, 13 + k) << "the latest export of each, the most certain first";
    EXPECT_EQ(live.remembered[k].position, slam.known.positions[k + 1]);
  }
  RelativeLandmarks<SE2> chosen = subset(slam.known, {1, 2, 3, 4, 5, 6, 7, 8});
  chosen.covariance *= 3.0;
  SE2::Covariance expected = rigid_part(chosen)->shared;
  expected.diagonal() += 4.0 * drift().rate;
  EXPECT_TRUE(live.shared.isApprox(expected, 1e-9));
  // However long it says nothing of them.
  slam.known = {};
  component.poll();
  EXPECT_TRUE(component.live().remembered.empty());
  slam.remember(2000);
  EXPECT_EQ(component.live().remembered.size(), LivePose<SE2>::max_remembered);
  EXPECT_EQ(component.remembered_unfit(), 0U);
}

TEST_F(LivePoseHook, WhatIsNotUsableIsCountedAndThePoseGoesOn) {
  slam.go(24.0);
  std::vector<RelativeLandmarks<SE2>> bad;
  const auto spoilt = [&](const std::function<void(RelativeLandmarks<SE2>&)>& spoil) {
    slam.remember(2000);
    spoil(slam.known);
    bad.push_back(slam.known);
  };
  spoilt([](auto& k) { k.positions.pop_back(); });
  spoilt([](auto& k) { k.tracks.pop_back(); });
  spoilt([](auto& k) { k.covariance.resize(0, 0); });
  spoilt([](auto& k) { k.covariance = Eigen::MatrixXd::Identity(24, 12); });
  spoilt([](auto& k) { k.tracks[3] = k.tracks[4]; });
  spoilt([](auto& k) { k.positions[2].x() = std::numeric_limits<double>::quiet_NaN(); });
  spoilt([](auto& k) { k.covariance(5, 5) = std::numeric_limits<double>::infinity(); });
  std::uint64_t count = 0;
  for (const auto& known : bad) {
    slam.known = known;
    const LivePose<SE2> live = component.live();
    EXPECT_TRUE(live.remembered.empty());
    EXPECT_EQ(component.remembered_unfit(), ++count);
  }
  EXPECT_NO_THROW(component.poll());
}

TEST(Snapshot, TellsWhereTheVehicleIsNowAndNotWhenItLastSpoke) {
  InProcessNetwork<SE2> network;
  Remembering slam;
  VehicleParams<SE2> params;
  params.id = 1;
  params.live_period_s = 100.0;
  params.static_bias = Estimate<SE2>{SE2(), SE2::Covariance::Zero()};
  Vehicle<SE2> vehicle(
      params, slam, [&] { return network.join(); }, [] { return 0.0; });
  vehicle.configure();
  for (const double x : {1.0, 2.0, 3.0}) {
    ASSERT_TRUE(vehicle.feed([&] { slam.go(x); }));
    const auto snapshot = vehicle.snapshot();
    ASSERT_EQ(snapshot.vehicles.size(), 1U);
    EXPECT_EQ(snapshot.vehicles[0].slam.stamp_s, x);
  }
}

TEST_F(LivePoseHook, AChainSaysThatItsLandmarksHaveTheScaleOfItsOdometer) {
  const auto says = [&](bool scales, double sigma) {
    slam.scales = scales;
    DriftParams<SE2> params = drift();
    params.persistent.scale = sigma;
    return FrontEndComponent<SE2>(slam, manager, params, 1.0).persistent().scales_landmarks;
  };
  EXPECT_TRUE(says(true, 0.01));
  EXPECT_FALSE(says(false, 0.01));
  EXPECT_FALSE(says(true, 0.0)) << "which has no error";
}

}  // namespace
}  // namespace convoy
