// The contract of FrontEnd as a battery of tests that every implementation runs.
//
// A drive under test is a default-constructible class with
//   using Group = ...;
//   FrontEnd<Group>& front_end();
//   void run(const std::function<void()>& after_input);   a course of four segments or more with ten landmarks or more,
//                                                         calling after_input() after each input to the front end
// and one line: INSTANTIATE_TYPED_TEST_SUITE_P(Name, FrontEndContract, ::testing::Types<MyDrive>);
#pragma once

#include <convoy/frontend/front_end.hpp>
#include <convoy/geometry/covariance.hpp>

#include <gtest/gtest.h>

#include <functional>
#include <set>
#include <vector>

namespace convoy::testing {

template <class Drive>
class FrontEndContract : public ::testing::Test {
 public:
  using Group = typename Drive::Group;

  /// Runs the course and takes all segments, at once when they are there.
  void run(const std::function<void(const Segment<Group>&)>& on_segment = [](const Segment<Group>&) {}) {
    drive_.run([&] {
      states_.push_back(drive_.front_end().state());
      for (Segment<Group>& segment : drive_.front_end().take_segments()) {
        on_segment(segment);
        segments_.push_back(std::move(segment));
      }
    });
    ASSERT_GE(segments_.size(), 4U) << "the course of this test is too short";
    std::size_t landmarks = 0;
    for (const auto& segment : segments_) landmarks += segment.landmarks.size();
    ASSERT_GE(landmarks, 10U) << "the course of this test has too few landmarks";
  }

  Drive drive_;
  std::vector<FrontEndState<Group>> states_;
  std::vector<Segment<Group>> segments_;
};
TYPED_TEST_SUITE_P(FrontEndContract);

TYPED_TEST_P(FrontEndContract, StartsAtTheIdentityWithoutDrift) {
  const auto state = this->drive_.front_end().state();
  EXPECT_EQ(state.abscissa_m, 0.0);
  EXPECT_TRUE(state.pose.Log().isZero(0.0));
  EXPECT_TRUE(state.slam_drift.isZero(0.0));
  EXPECT_TRUE(this->drive_.front_end().take_segments().empty());
}

TYPED_TEST_P(FrontEndContract, StampsAndAbscissaNeverDecrease) {
  this->run();
  for (std::size_t k = 1; k < this->states_.size(); ++k) {
    ASSERT_GE(this->states_[k].stamp_s, this->states_[k - 1].stamp_s);
    ASSERT_GE(this->states_[k].abscissa_m, this->states_[k - 1].abscissa_m);
  }
  for (std::size_t k = 1; k < this->segments_.size(); ++k) {
    ASSERT_GE(this->segments_[k].closing.stamp_s, this->segments_[k - 1].closing.stamp_s);
    ASSERT_GE(this->segments_[k].closing.abscissa_m, this->segments_[k - 1].closing.abscissa_m);
  }
}

TYPED_TEST_P(FrontEndContract, NoSegmentClosesLaterThanTheState) {
  this->run([&](const auto& segment) {
    const auto state = this->drive_.front_end().state();
    ASSERT_LE(segment.closing.stamp_s, state.stamp_s);
    ASSERT_LE(segment.closing.abscissa_m, state.abscissa_m);
  });
}

TYPED_TEST_P(FrontEndContract, TheTrailOfASegmentLiesWithinIt) {
  this->run();
  double stamp_s = 0.0, abscissa_m = 0.0;
  for (const auto& segment : this->segments_) {
    for (const auto& state : segment.trail) {
      ASSERT_GE(state.stamp_s, stamp_s);
      ASSERT_GE(state.abscissa_m, abscissa_m);
      stamp_s = state.stamp_s;
      abscissa_m = state.abscissa_m;
      ASSERT_TRUE(is_covariance(state.slam_drift));
    }
    ASSERT_LE(stamp_s, segment.closing.stamp_s);
    ASSERT_LE(abscissa_m, segment.closing.abscissa_m);
    stamp_s = segment.closing.stamp_s;
    abscissa_m = segment.closing.abscissa_m;
  }
}

TYPED_TEST_P(FrontEndContract, DriftIsACovarianceAndGrowsFromAnchorToAnchor) {
  this->run();
  for (const auto& state : this->states_) ASSERT_TRUE(is_covariance(state.slam_drift)) << state.slam_drift;
  typename TypeParam::Group::Covariance before = TypeParam::Group::Covariance::Zero();
  for (const auto& segment : this->segments_) {
    const auto& drift = segment.closing.slam_drift;
    ASSERT_TRUE(is_covariance(typename TypeParam::Group::Covariance(drift - before), drift.cwiseAbs().maxCoeff()));
    before = drift;
  }
}

TYPED_TEST_P(FrontEndContract, ASegmentIsGivenOnceAndALandmarkOnceInIt) {
  this->run([&](const auto&) { ASSERT_TRUE(this->drive_.front_end().take_segments().empty()); });
  std::set<std::vector<double>> positions;
  std::size_t landmarks = 0;
  for (const auto& segment : this->segments_) {
    std::set<std::uint64_t> tracks;
    for (const auto& landmark : segment.landmarks) {
      ASSERT_TRUE(tracks.insert(landmark.track).second) << "track " << landmark.track;
      const auto& p = landmark.position;
      positions.emplace(p.data(), p.data() + p.size());
      ++landmarks;
    }
  }
  EXPECT_EQ(positions.size(), landmarks);
}

TYPED_TEST_P(FrontEndContract, LandmarksStateACovarianceOfWhichTheSharedPartIsAPart) {
  this->run();
  for (const auto& segment : this->segments_)
    for (const auto& l : segment.landmarks) {
      ASSERT_TRUE(l.position.allFinite() && l.loading.allFinite());
      ASSERT_TRUE(is_covariance(l.covariance)) << l.covariance;
      ASSERT_GT(l.covariance.trace(), 0.0);
      ASSERT_TRUE(
          is_covariance(typename TypeParam::Group::PointCovariance(l.covariance - l.loading * l.loading.transpose()),
                        l.covariance.cwiseAbs().maxCoeff()));
    }
}

TYPED_TEST_P(FrontEndContract, WhatItRemembersIsWholeAndHasAJointCovariance) {
  using G = typename TypeParam::Group;
  this->run([&](const auto&) {
    const RelativeLandmarks<G> known = this->drive_.front_end().remembered();
    ASSERT_EQ(known.positions.size(), known.tracks.size());
    ASSERT_EQ(known.covariance.rows(), G::Dim * static_cast<Eigen::Index>(known.tracks.size()));
    ASSERT_TRUE(known.tracks.empty() || is_covariance(known.covariance));
    ASSERT_EQ(std::set<std::uint64_t>(known.tracks.begin(), known.tracks.end()).size(), known.tracks.size());
    for (const auto& p : known.positions) ASSERT_TRUE(p.allFinite());
  });
}

REGISTER_TYPED_TEST_SUITE_P(FrontEndContract, StartsAtTheIdentityWithoutDrift, StampsAndAbscissaNeverDecrease,
                            NoSegmentClosesLaterThanTheState, TheTrailOfASegmentLiesWithinIt,
                            DriftIsACovarianceAndGrowsFromAnchorToAnchor, ASegmentIsGivenOnceAndALandmarkOnceInIt,
                            LandmarksStateACovarianceOfWhichTheSharedPartIsAPart,
                            WhatItRemembersIsWholeAndHasAJointCovariance);

}  // namespace convoy::testing
