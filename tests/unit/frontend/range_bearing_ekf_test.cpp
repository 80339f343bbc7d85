#include <convoy/config_error.hpp>
#include <convoy/drift/drift_model.hpp>
#include <convoy/frontend/range_bearing_ekf.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include "range_bearing_world.hpp"

#include <gtest/gtest.h>

#include <cstdio>
#include <limits>
#include <numeric>
#include <set>

namespace convoy {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double infinity = std::numeric_limits<double>::infinity();

bool identical(const FrontEndState<SE2>& a, const FrontEndState<SE2>& b) {
  return a.stamp_s == b.stamp_s && a.abscissa_m == b.abscissa_m && a.pose.translation() == b.pose.translation() &&
         a.pose.theta() == b.pose.theta() && a.slam_drift == b.slam_drift;
}

// ---- consistency ----

struct Nees {
  std::vector<double> values;
  int dof = 0;  // of each
  double mean() const {
    return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
  }
  /// Mean of n values is chi2(n dof) / n if the covariances are right.
  bool in_band(double covariance_factor = 1.0) const {
    const double n = static_cast<double>(values.size()), all = dof * n;
    const double sum = n * mean() / covariance_factor;
    return sum > chi2_quantile(0.001, all) && sum < chi2_quantile(0.999, all);
  }
};

template <class G>
struct Consistency {
  Nees landmarks{{}, G::Dim}, steps{{}, G::Dof};
};

// One landmark and one step between anchors per run: values are independent of each other.
template <class G>
Consistency<G> monte_carlo(int first_seed, int runs) {
  Consistency<G> result;
  for (int seed = first_seed; seed < first_seed + runs; ++seed) {
    test::RangeBearingWorld<G> world(test::quiet_params(), static_cast<std::uint64_t>(seed));
    std::vector<Segment<G>> segments;
    std::vector<G> truth{G()};
    std::vector<FrontEndState<G>> closings{{}};
    world.drive(110.0, 0.04, [&] {
      for (auto& segment : world.filter().take_segments()) {
        truth.push_back(world.passed().at(segment.closing.stamp_s));
        closings.push_back(segment.closing);
        segments.push_back(std::move(segment));
      }
    });
    EXPECT_GE(segments.size(), 3U);
    if (segments.size() < 3) continue;
    const std::size_t k = 1 + static_cast<std::size_t>(seed) % 3;  // this step
    const auto& segment = segments[k - 1];
    EXPECT_FALSE(segment.landmarks.empty());
    if (segment.landmarks.empty()) continue;
    const auto& l = segment.landmarks[static_cast<std::size_t>(seed) % segment.landmarks.size()];
    const typename G::Point expected = truth[k].inverse() * world.points()[l.track];
    result.landmarks.values.push_back(squared_mahalanobis(typename G::Point(l.position - expected), l.covariance));
    const ChainState<G> a{0, 0, closings[k - 1].pose, closings[k - 1].slam_drift};
    const ChainState<G> b{0, 0, closings[k].pose, closings[k].slam_drift};
    const auto step = increment(a, b);
    const G actual = truth[k - 1].inverse() * truth[k];
    result.steps.values.push_back(squared_mahalanobis((step.motion.inverse() * actual).Log(), step.covariance));
  }
  return result;
}

template <class G>
void expect_consistent_over_many_worlds() {
  const Consistency<G> c = monte_carlo<G>(1000, 150);
  ASSERT_GE(c.landmarks.values.size(), 140U);
  std::printf("seeds 1000..1149, NEES per dof: landmarks %.3f, steps %.3f\n", c.landmarks.mean() / G::Dim,
              c.steps.mean() / G::Dof);
  EXPECT_TRUE(c.landmarks.in_band()) << "landmark NEES / Dim = " << c.landmarks.mean() / G::Dim;
  EXPECT_TRUE(c.steps.in_band()) << "step NEES / Dof = " << c.steps.mean() / G::Dof;
  // The test can fail: covariances that are wrong by a factor of two do.
  for (const double factor : {0.5, 2.0}) {
    EXPECT_FALSE(c.landmarks.in_band(factor)) << factor;
    EXPECT_FALSE(c.steps.in_band(factor)) << factor;
  }
}

TEST(RangeBearingEkf, IsConsistentOverManyWorlds) { expect_consistent_over_many_worlds<SE2>(); }

TEST(RangeBearingEkf, IsConsistentOverManyWorldsInSpace) { expect_consistent_over_many_worlds<SE3>(); }

TEST(RangeBearingEkf, TheTrailIsCloserToTheTruthThanWhatWasSaidThen) {
  RangeBearingEkfParams params = test::quiet_params();
  params.trail_spacing_m = 1.0;
  params.sigma_along_per_sqrt_m = 0.1;  // much is forgotten from one round of sightings to the next
  params.sigma_across_per_sqrt_m = 0.05;
  params.sigma_heading_per_sqrt_m = 0.02;
  double smoothed = 0.0, filtered = 0.0;
  int states = 0;
  for (std::uint64_t seed = 1; seed <= 15; ++seed) {
    test::RangeBearingWorld<SE2> world(params, seed);
    std::map<double, FrontEndState<SE2>> said;
    FrontEndState<SE2> anchor;
    world.drive(60.0, 0.04, [&] {
      const auto state = world.filter().state();
      said[state.stamp_s] = state;
      for (const auto& segment : world.filter().take_segments()) {
        const SE2 T = world.passed().at(anchor.stamp_s);
        EXPECT_GE(segment.trail.size(), 20U);
        for (const auto& s : segment.trail) {
          const SE2::Point truth = T.inverse() * world.passed().at(s.stamp_s).translation();
          smoothed += (anchor.pose.inverse() * s.pose.translation() - truth).squaredNorm();
          filtered += (anchor.pose.inverse() * said.at(s.stamp_s).pose.translation() - truth).squaredNorm();
          ++states;
        }
        anchor = segment.closing;
      }
    });
  }
  ASSERT_GT(states, 300);
  EXPECT_LT(smoothed, 0.9 * filtered) << std::sqrt(smoothed / states) << " m, " << std::sqrt(filtered / states) << " m";
}

// ---- prediction ----

TEST(RangeBearingEkf, PredictsWithTheNoiseItIsTold) {
  RangeBearingEkfParams p;
  p.sigma_along_per_sqrt_m = 0.1;
  p.sigma_along_per_sqrt_rad = 0.2;
  p.sigma_across_per_sqrt_m = 0.03;
  p.sigma_heading_per_sqrt_m = 0.01;
  p.sigma_heading_per_sqrt_rad = 0.04;
  p.sigma_heading_per_sqrt_s = 0.02;
  p.distance_scale = 1.1;
  p.angle_scale = 0.9;
  RangeBearingEkf<SE2> filter(p);
  SE2 pose;
  SE2::Covariance drift = SE2::Covariance::Zero();
  for (int k = 0; k < 20; ++k) {  // 18.7 m: the segment stays open
    const double v = 1.7, omega = k % 2 ? -0.3 : 0.5, dt = 0.5;
    ASSERT_TRUE(filter.on_odometry(dt * k, v, omega));
    const double d = 1.1 * v * dt, a = 0.9 * omega * dt;
    pose = pose * SE2::Exp({d, 0.0, a});
    const Eigen::Vector3d variance(0.01 * d + 0.04 * std::abs(a), 9e-4 * d,
                                   1e-4 * d + 1.6e-3 * std::abs(a) + 4e-4 * dt);
    drift += pose.adjoint() * variance.asDiagonal() * pose.adjoint().transpose();
  }
  ASSERT_TRUE(filter.on_odometry(10.0, 0.0, 0.0));
  const auto state = filter.state();
  EXPECT_LT((state.pose.inverse() * pose).Log().norm(), 1e-12);
  EXPECT_LT((state.slam_drift - drift).norm(), 1e-12 * drift.norm() + 1e-14);
  EXPECT_NEAR(state.abscissa_m, 20 * 1.1 * 1.7 * 0.5, 1e-9);
}

// Wheels say how far and how much to the left; what the road does to roll, pitch and height is told as noise.
TEST(RangeBearingEkf, PredictsInSpaceWithTheNoiseItIsTold) {
  RangeBearingEkfParams p;
  p.sigma_along_per_sqrt_m = 0.1;
  p.sigma_across_per_sqrt_m = 0.03;
  p.sigma_vertical_per_sqrt_m = 0.02;
  p.sigma_tilt_per_sqrt_m = 0.005;
  p.sigma_heading_per_sqrt_m = 0.01;
  p.sigma_heading_per_sqrt_rad = 0.0;
  RangeBearingEkf<SE3> filter(p);
  SE3 pose;
  SE3::Covariance drift = SE3::Covariance::Zero();
  for (int k = 0; k < 20; ++k) {  // 17 m: the segment stays open
    const double v = 1.7, omega = k % 2 ? -0.3 : 0.5, dt = 0.5, d = v * dt;
    ASSERT_TRUE(filter.on_odometry(dt * k, v, omega));
    SE3::Tangent motion = SE3::Tangent::Zero(), variance;
    motion[0] = d;
    motion[5] = omega * dt;
    variance << 0.01, 9e-4, 4e-4, 2.5e-5, 2.5e-5, 1e-4;
    pose = pose * SE3::Exp(motion);
    drift += pose.adjoint() * (d * variance).asDiagonal() * pose.adjoint().transpose();
  }
  ASSERT_TRUE(filter.on_odometry(10.0, 0.0, 0.0));
  const auto state = filter.state();
  EXPECT_LT((state.pose.inverse() * pose).Log().norm(), 1e-12);
  EXPECT_EQ(state.pose.translation().z(), 0.0);
  EXPECT_LT((state.slam_drift - drift).norm(), 1e-12 * drift.norm() + 1e-14);
}

TEST(RangeBearingEkf, StandingStillAddsNoUncertainty) {
  test::RangeBearingWorld<SE2> world(test::quiet_params(), 4);
  world.drive(12.0, 0.02);
  RangeBearingEkf<SE2>& filter = world.filter();
  ASSERT_TRUE(filter.on_odometry(world.now_s(), 0.0, 0.0));
  const auto before = filter.state();
  for (int k = 1; k <= 100; ++k) ASSERT_TRUE(filter.on_odometry(world.now_s() + k, 0.0, 0.0));
  auto after = filter.state();
  EXPECT_EQ(after.stamp_s, world.now_s() + 100.0);
  after.stamp_s = before.stamp_s;
  EXPECT_TRUE(identical(before, after));
}

TEST(RangeBearingEkf, ASilentOdometerIsNotTrustedForever) {
  RangeBearingEkfParams p = test::quiet_params();
  p.max_odometry_gap_s = 2.0;
  RangeBearingEkf<SE2> filter(p);
  ASSERT_TRUE(filter.on_odometry(0.0, 1.0, 0.0));
  ASSERT_TRUE(filter.on_odometry(10.0, 0.0, 0.0));
  EXPECT_NEAR(filter.state().abscissa_m, 2.0, 1e-12);
  EXPECT_EQ(filter.state().stamp_s, 10.0);
}

// ---- bad input ----

TEST(RangeBearingEkf, RefusesAndCountsBadInputAndStaysAsItWas) {
  test::RangeBearingWorld<SE2> world(test::quiet_params(), 4);
  world.drive(15.0, 0.02);
  RangeBearingEkf<SE2>& filter = world.filter();
  const auto before = filter.state();
  const auto counters = filter.counters();
  const double t = before.stamp_s;

  const double bad_odometry[][3] = {{nan, 1, 0},      {infinity, 1, 0},  {t, nan, 0},     {t, 1, nan},
                                    {t, infinity, 0}, {t, 1, -infinity}, {t - 0.01, 1, 0}};
  for (const auto& [stamp, v, omega] : bad_odometry) EXPECT_FALSE(filter.on_odometry(stamp, v, omega));
  EXPECT_EQ(filter.counters().odometry_invalid, counters.odometry_invalid + std::size(bad_odometry));

  const double bad_sightings[][3] = {{nan, 5, 0},          {t - 0.01, 5, 0},     {t + 1, nan, 0}, {t + 1, 5, nan},
                                     {t + 1, infinity, 0}, {t + 1, 5, infinity}, {t + 1, -5, 0},  {t + 1, 0, 0},
                                     {t + 1, 0.05, 0},     {t + 1, 101, 0}};
  for (const auto& [stamp, range, bearing] : bad_sightings)
    for (const std::uint64_t track : {std::uint64_t{0}, std::uint64_t{999999}})
      EXPECT_FALSE(filter.on_sighting(stamp, track, range, bearing));
  EXPECT_EQ(filter.counters().sightings_invalid, counters.sightings_invalid + 2 * std::size(bad_sightings));
  EXPECT_TRUE(identical(filter.state(), before));
  EXPECT_EQ(filter.counters().sightings_used, counters.sightings_used);
  EXPECT_TRUE(filter.take_segments().empty());

  // What follows comes out as if nothing had happened.
  test::RangeBearingWorld<SE2> twin(test::quiet_params(), 4);
  twin.drive(15.0, 0.02);
  twin.drive(40.0, 0.02);
  world.drive(40.0, 0.02);
  EXPECT_TRUE(identical(filter.state(), twin.filter().state()));
}

TEST(RangeBearingEkf, NothingIsSeenBeyondTheZenith) {
  RangeBearingEkf<SE3> filter(test::quiet_params());
  ASSERT_TRUE(filter.on_odometry(0.0, 1.0, 0.0));
  EXPECT_TRUE(filter.on_sighting(0.0, 1, 5.0, 0.3, 0.5 * M_PI));
  for (const double elevation_rad : {0.51 * M_PI, -0.51 * M_PI, nan, infinity})
    EXPECT_FALSE(filter.on_sighting(0.0, 2, 5.0, 0.3, elevation_rad));
  EXPECT_EQ(filter.counters().sightings_invalid, 4U);
  EXPECT_EQ(filter.tracked(), 1U);
}

// ---- tracking ----

/// A filter that has followed one landmark, 10 m to the left of a straight path of 10 m; standing at 10 m, t = 10 s.
RangeBearingEkf<SE2> one_track(const RangeBearingEkfParams& params) {
  RangeBearingEkf<SE2> filter(params);
  for (int k = 0; k <= 10; ++k) {
    filter.on_odometry(k, k < 10 ? 1.0 : 0.0, 0.0);
    const Eigen::Vector2d y(5.0 - k, 10.0);
    EXPECT_TRUE(filter.on_sighting(k, 7, y.norm(), std::atan2(y.y(), y.x())));
  }
  return filter;
}
const double range_now = std::hypot(-5.0, 10.0), bearing_now = std::atan2(10.0, -5.0);

TEST(RangeBearingEkf, GatesAnOutlierAndStaysAsItWas) {
  RangeBearingEkf<SE2> filter = one_track(test::quiet_params());
  const auto before = filter.state();
  EXPECT_FALSE(filter.on_sighting(10.0, 7, range_now + 3.0, bearing_now));
  EXPECT_FALSE(filter.on_sighting(10.0, 7, range_now, bearing_now + 0.5));
  EXPECT_EQ(filter.counters().sightings_gated, 2U);
  EXPECT_TRUE(identical(before, filter.state()));
  EXPECT_TRUE(filter.on_sighting(10.0, 7, range_now + 0.05, bearing_now));
  EXPECT_FALSE(identical(before, filter.state()));
}

TEST(RangeBearingEkf, DropsATrackAfterTooManyRejectionsInARow) {
  RangeBearingEkfParams params = test::quiet_params();
  params.max_rejections = 3;
  RangeBearingEkf<SE2> filter = one_track(params);
  EXPECT_FALSE(filter.on_sighting(10.0, 7, range_now + 5.0, bearing_now));
  EXPECT_FALSE(filter.on_sighting(10.0, 7, range_now + 5.0, bearing_now));
  EXPECT_TRUE(filter.on_sighting(10.0, 7, range_now, bearing_now));  // not in a row
  EXPECT_FALSE(filter.on_sighting(10.0, 7, range_now + 5.0, bearing_now));
  EXPECT_FALSE(filter.on_sighting(10.0, 7, range_now + 5.0, bearing_now));
  EXPECT_EQ(filter.tracked(), 1U);
  EXPECT_FALSE(filter.on_sighting(10.0, 7, range_now + 5.0, bearing_now));
  EXPECT_EQ(filter.tracked(), 0U);
  EXPECT_EQ(filter.counters().tracks_dropped, 1U);
  EXPECT_TRUE(filter.on_sighting(10.0, 7, range_now + 5.0, bearing_now));  // starts anew, where it is seen now
  EXPECT_TRUE(filter.on_sighting(10.0, 7, range_now + 5.0, bearing_now));
  EXPECT_EQ(filter.tracked(), 1U);
}

TEST(RangeBearingEkf, ThinsSightingsThatShareTheirErrors) {
  RangeBearingEkfParams params = test::quiet_params();
  params.min_sighting_interval_s = 0.5;
  RangeBearingEkf<SE2> filter = one_track(params);
  const auto before = filter.state();
  EXPECT_FALSE(filter.on_sighting(10.0, 7, range_now, bearing_now));
  EXPECT_FALSE(filter.on_sighting(10.4, 7, range_now, bearing_now));
  EXPECT_EQ(filter.counters().sightings_thinned, 2U);
  EXPECT_EQ(filter.state().slam_drift, before.slam_drift);
  EXPECT_TRUE(filter.on_sighting(10.4, 8, range_now, bearing_now));  // another track has a clock of its own
  EXPECT_TRUE(filter.on_sighting(10.5, 7, range_now, bearing_now));
}

// ---- segments ----

TEST(RangeBearingEkf, FinishClosesTheSegmentWithWhatMayLeave) {
  RangeBearingEkf<SE2> filter = one_track(test::quiet_params());
  ASSERT_TRUE(filter.on_sighting(10.0, 8, 5.0, 0.0));  // seen once: stays
  filter.finish();
  const auto segments = filter.take_segments();
  ASSERT_EQ(segments.size(), 1U);
  ASSERT_EQ(segments[0].landmarks.size(), 1U);
  const auto& l = segments[0].landmarks[0];
  EXPECT_EQ(l.track, 7U);
  EXPECT_LT((l.position - Eigen::Vector2d(-5.0, 10.0)).norm(), 0.2);
  EXPECT_EQ(segments[0].closing.abscissa_m, 10.0);
  EXPECT_EQ(filter.tracked(), 1U);
  EXPECT_EQ(filter.counters().landmarks_frozen, 1U);
  EXPECT_TRUE(filter.take_segments().empty());
}

TEST(RangeBearingEkf, AFrozenLandmarkHasLeftAndItsSightingsServeOnce) {
  RangeBearingEkf<SE2> filter = one_track(test::quiet_params());
  filter.finish();
  ASSERT_EQ(filter.take_segments().size(), 1U);
  ASSERT_EQ(filter.tracked(), 0U);
  // Seen again it begins at nothing: one sighting is not enough to leave once more.
  EXPECT_TRUE(filter.on_sighting(10.0, 7, range_now + 5.0, bearing_now));  // and nothing is left to gate it with
  filter.finish();
  const auto segments = filter.take_segments();
  ASSERT_EQ(segments.size(), 1U);
  EXPECT_TRUE(segments[0].landmarks.empty());
}

// R5: what a fact between anchors may say is what a filter without memory says.
TEST(RangeBearingEkf, TheExportableStateKnowsNothingByLandmarksThatHaveLeft) {
  RangeBearingEkfParams forgets = test::quiet_params();
  forgets.max_remembered = 0;
  test::RangeBearingWorld<SE2> with(test::quiet_params(), 3), without(forgets, 3);
  with.drive(70.0, 0.04);
  without.drive(70.0, 0.04);
  ASSERT_FALSE(with.filter().take_segments().empty());
  EXPECT_TRUE(identical(with.filter().exportable_state(), without.filter().exportable_state()));
  EXPECT_TRUE(identical(without.filter().state(), without.filter().exportable_state()));
  EXPECT_FALSE(identical(with.filter().state(), with.filter().exportable_state()));
}

// Landmarks that were exported are still known, where they are from here, with the covariance that is stated.
template <class G>
void expect_remembered_landmarks_where_they_are() {
  double nees = 0.0;
  int dof = 0;
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    test::RangeBearingWorld<G> world(test::quiet_params(), seed);
    world.drive(70.0, 0.04);
    std::set<std::uint64_t> exported;
    for (const auto& segment : world.filter().take_segments())
      for (const auto& landmark : segment.landmarks) exported.insert(landmark.track);
    ASSERT_FALSE(exported.empty());
    const RelativeLandmarks<G> all = world.filter().remembered();
    std::vector<std::size_t> indices;
    for (std::size_t i = 0; i < all.tracks.size(); ++i)
      if (exported.count(all.tracks[i]) > 0) indices.push_back(i);
    ASSERT_GE(indices.size(), 5U);
    const RelativeLandmarks<G> known = subset(all, indices);
    Eigen::VectorXd error(G::Dim * static_cast<Eigen::Index>(indices.size()));
    for (std::size_t i = 0; i < indices.size(); ++i)
      error.template segment<G::Dim>(G::Dim * static_cast<Eigen::Index>(i)) =
          known.positions[i] - world.truth().inverse() * world.points()[known.tracks[i]];
    nees += squared_mahalanobis(error, known.covariance);
    dof += static_cast<int>(error.size());
  }
  EXPECT_GT(nees / dof, 0.8);
  EXPECT_LT(nees / dof, 1.2);
}

TEST(RangeBearingEkf, RemembersWhereExportedLandmarksAreFromHere) { expect_remembered_landmarks_where_they_are<SE2>(); }

TEST(RangeBearingEkf, RemembersWhereExportedLandmarksAreFromHereInSpace) {
  expect_remembered_landmarks_where_they_are<SE3>();
}

TEST(RangeBearingEkf, MovesOnWithTimeAlone) {
  RangeBearingEkf<SE2> ekf(test::quiet_params());
  ekf.on_odometry(1.0, 2.0, 0.0);
  EXPECT_TRUE(ekf.on_time(1.5));
  EXPECT_DOUBLE_EQ(ekf.state().abscissa_m, 1.0);
  EXPECT_DOUBLE_EQ(ekf.state().pose.translation().x(), 1.0);
  const auto before = ekf.state();
  EXPECT_FALSE(ekf.on_time(1.4));
  EXPECT_FALSE(ekf.on_time(nan));
  EXPECT_FALSE(ekf.on_time(infinity));
  EXPECT_TRUE(identical(ekf.state(), before));
}

TEST(RangeBearingEkf, FreezesNothingWithoutParallaxOrEnoughSightings) {
  RangeBearingEkfParams params = test::quiet_params();
  params.min_sightings = 12;  // it has 11
  RangeBearingEkf<SE2> few = one_track(params);
  few.finish();
  EXPECT_TRUE(few.take_segments().at(0).landmarks.empty());
  params = test::quiet_params();
  params.min_parallax_rad = 1.5;  // atan(0.5) twice is 0.93
  RangeBearingEkf<SE2> narrow = one_track(params);
  narrow.finish();
  EXPECT_TRUE(narrow.take_segments().at(0).landmarks.empty());
  params = test::quiet_params();
  params.max_sigma_m = 0.01;
  RangeBearingEkf<SE2> vague = one_track(params);
  vague.finish();
  EXPECT_TRUE(vague.take_segments().at(0).landmarks.empty());
}

TEST(RangeBearingEkf, ClosesAtTheSegmentLengthOrAtLastWithoutABatch) {
  RangeBearingEkfParams params = test::quiet_params();
  params.segment_length_m = 20.0;
  params.max_segment_length_m = 45.0;
  RangeBearingEkf<SE2> blind(params);
  for (int k = 0; k <= 100; ++k) ASSERT_TRUE(blind.on_odometry(k, 1.0, 0.0));
  const auto segments = blind.take_segments();
  ASSERT_EQ(segments.size(), 2U);
  EXPECT_EQ(segments[0].closing.abscissa_m, 45.0);
  EXPECT_EQ(segments[1].closing.abscissa_m, 90.0);
  EXPECT_TRUE(segments[0].landmarks.empty());

  test::RangeBearingWorld<SE2> world(params, 9);
  world.drive(50.0, 0.02);
  const auto seeing = world.filter().take_segments();
  ASSERT_EQ(seeing.size(), 2U);
  EXPECT_NEAR(seeing[0].closing.abscissa_m, 20.0, 3.0);
  EXPECT_GE(static_cast<int>(seeing[0].landmarks.size()), params.min_batch);
}

TEST(RangeBearingEkfParams, AreChecked) {
  const auto refused = [](auto change) {
    RangeBearingEkfParams params;
    change(params);
    try {
      RangeBearingEkf<SE2> filter(params);
    } catch (const ConfigError&) {
      return true;
    }
    return false;
  };
  using P = RangeBearingEkfParams;
  EXPECT_FALSE(refused([](P&) {}));
  EXPECT_TRUE(refused([](P& p) { p.sigma_along_per_sqrt_m = -0.1; }));
  EXPECT_TRUE(refused([](P& p) { p.sigma_heading_per_sqrt_s = nan; }));
  EXPECT_TRUE(refused([](P& p) { p.sigma_range_m = 0.0; }));
  EXPECT_TRUE(refused([](P& p) { p.sigma_bearing_rad = nan; }));
  EXPECT_TRUE(refused([](P& p) { p.sigma_elevation_rad = 0.0; }));
  EXPECT_TRUE(refused([](P& p) { p.sigma_vertical_per_sqrt_m = -1.0; }));
  EXPECT_TRUE(refused([](P& p) { p.sigma_tilt_per_sqrt_m = nan; }));
  EXPECT_TRUE(refused([](P& p) { p.distance_scale = 0.0; }));
  EXPECT_TRUE(refused([](P& p) { p.gate = 1.0; }));
  EXPECT_TRUE(refused([](P& p) { p.nis_confidence = 0.0; }));
  EXPECT_TRUE(refused([](P& p) { p.max_rejections = 0; }));
  EXPECT_TRUE(refused([](P& p) { p.min_sightings = 1; }));
  EXPECT_TRUE(refused([](P& p) { p.max_range_m = p.min_range_m; }));
  EXPECT_TRUE(refused([](P& p) { p.max_odometry_gap_s = 0.0; }));
  EXPECT_TRUE(refused([](P& p) { p.max_sigma_m = 0.0; }));
  EXPECT_TRUE(refused([](P& p) { p.max_segment_length_m = p.segment_length_m / 2.0; }));
  EXPECT_TRUE(refused([](P& p) { p.min_batch = 0; }));
  EXPECT_TRUE(refused([](P& p) { p.trail_spacing_m = -1.0; }));
}

}  // namespace
}  // namespace convoy
