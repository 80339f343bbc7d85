#include <convoy/submap/content_hash.hpp>
#include <convoy/submap/facts.hpp>

#include "../sample_facts.hpp"

#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <set>

namespace convoy {
namespace {

const ChainId chain{7, 3};
const std::vector<Pairing> one_pair{{Key{{1, 2}, 3}, Key{{4, 5}, 6}}};

// Hashes travel between vehicles, so they must not change with compiler, platform or version. The values come from an
// independent implementation of "FNV-1a over little-endian fields, mixed by the finaliser of MurmurHash3".
TEST(FactHash, IsTheOneOfTheWireFormat) {
  AnchorFact<SE2> anchor{{chain, 5}, {}};
  anchor.state.stamp_s = 12.5;
  anchor.state.abscissa_m = 40.0;
  anchor.state.pose = SE2(1.5, -2.25, 0.5);
  anchor.state.drift = Eigen::Vector3d(0.25, 0.5, 0.125).asDiagonal();
  anchor.first_landmark = 17;
  anchor.landmark_count = 3;
  EXPECT_EQ(hash_of(anchor), 0xa6ce95f65d03dd30U);

  LandmarkFact<SE2> landmark;
  landmark.key = {chain, 9};
  landmark.anchor = 5;
  landmark.position = {3.0, -4.0};
  landmark.covariance << 0.25, 0.125, 0.125, 0.5;
  landmark.loading.leftCols<4>() << 0.25, 0.0, 0.125, 0.0, 0.0, 0.5, -0.25, 0.0;
  landmark.descriptor.kind = Descriptor::Kind::patch_8x8_4bit;
  for (std::uint8_t i = 0; i < 32; ++i) landmark.descriptor.bytes[i] = i;
  EXPECT_EQ(hash_of(landmark), 0x84802ed0cd79228U);

  PriorFact<SE2> prior{{chain, 0}, true, SE2(1.0, 2.0, 0.25)};
  prior.covariance = Eigen::Vector3d(4.0, 4.0, 0.25).asDiagonal();
  EXPECT_EQ(hash_of(prior), 0xf4fb1aa7956d7c45U);
  EXPECT_EQ(hash_of(AssociationFact{{chain, 1}, one_pair}), 0x181903a7d870f349U);
  EXPECT_EQ(hypothesis_id(one_pair), 0x1ccc7591ab9cbc8fU);
  EXPECT_EQ(hash_of(VerdictFact{{chain, 2}, hypothesis_id(one_pair), true}), 0xc16e2c3a87291bb1U);
}

TEST(FactHash, IsTheOneOfTheWireFormatInSpace) {
  AnchorFact<SE3> anchor{{chain, 5}, {}};
  anchor.state.stamp_s = 12.5;
  anchor.state.abscissa_m = 40.0;
  anchor.state.pose = SE3({0.5, 0.5, -0.5, 0.5}, {1.5, -2.25, 0.75});
  anchor.state.drift.diagonal() << 0.25, 0.5, 0.125, 0.0625, 1.0, 2.0;
  anchor.first_landmark = 17;
  anchor.landmark_count = 3;
  EXPECT_EQ(hash_of(anchor), 0x755f0782c308e9ceU);

  LandmarkFact<SE3> landmark;
  landmark.key = {chain, 9};
  landmark.anchor = 5;
  landmark.position = {3.0, -4.0, 5.0};
  landmark.covariance << 0.5, 0.125, 0.0, 0.125, 0.5, 0.0625, 0.0, 0.0625, 0.25;
  for (int k = 0; k < 21; ++k) landmark.loading.data()[k] = 0.125 * (k % 5 - 2);
  landmark.descriptor.kind = Descriptor::Kind::patch_8x8_4bit;
  for (std::uint8_t i = 0; i < 32; ++i) landmark.descriptor.bytes[i] = i;
  EXPECT_EQ(hash_of(landmark), 0x47221ef1ce2820e6U);

  PriorFact<SE3> prior{{chain, 0}, true, SE3({1.0, 0.0, 0.0, 0.0}, {1.0, 2.0, 3.0})};
  prior.covariance.diagonal() << 4.0, 4.0, 4.0, 0.25, 0.25, 0.25;
  EXPECT_EQ(hash_of(prior), 0x730e9ee889d42337U);
}

/// Applies each change to a copy of `original`: every hash must differ from every other.
template <class Fact, class... Change>
void expect_each_field_counts(const Fact& original, Change... change) {
  std::set<Hash> hashes{hash_of(original)};
  const auto add = [&](auto apply) {
    Fact changed = original;
    apply(changed);
    hashes.insert(hash_of(changed));
  };
  (add(change), ...);
  EXPECT_EQ(hashes.size(), sizeof...(change) + 1);
}

TEST(FactHash, CountsEveryFieldOfAnAnchor) {
  using F = AnchorFact<SE2>;
  expect_each_field_counts(
      test::anchor(1, 3), [](F& f) { f.key.chain.vehicle = 9; }, [](F& f) { f.key.chain.epoch += 1; },
      [](F& f) { f.key.index = 4; }, [](F& f) { f.state.stamp_s += 1e-9; }, [](F& f) { f.state.abscissa_m += 1e-9; },
      [](F& f) { f.state.pose = SE2(f.state.pose.translation() + SE2::Point(1e-9, 0.0), f.state.pose.theta()); },
      [](F& f) { f.state.pose = SE2(f.state.pose.translation() + SE2::Point(0.0, 1e-9), f.state.pose.theta()); },
      [](F& f) { f.state.pose = SE2(f.state.pose.translation(), f.state.pose.theta() + 1e-9); },
      [](F& f) { f.state.drift(0, 0) += 1e-9; }, [](F& f) { f.state.drift(0, 1) += 1e-9; },
      [](F& f) { f.state.drift(2, 2) += 1e-9; }, [](F& f) { f.first_landmark += 1; },
      [](F& f) { f.landmark_count += 1; });
}

TEST(FactHash, CountsEveryFieldOfALandmark) {
  using F = LandmarkFact<SE2>;
  expect_each_field_counts(
      test::landmark(1, 3), [](F& f) { f.key.chain.vehicle = 9; }, [](F& f) { f.key.chain.epoch += 1; },
      [](F& f) { f.key.index = 4; }, [](F& f) { f.anchor = 7; }, [](F& f) { f.position.x() += 1e-9; },
      [](F& f) { f.position.y() += 1e-9; }, [](F& f) { f.covariance(0, 0) += 1e-9; },
      [](F& f) { f.covariance(1, 0) += 1e-9; }, [](F& f) { f.covariance(1, 1) += 1e-9; },
      [](F& f) { f.loading(0, 0) += 1e-9; }, [](F& f) { f.loading(1, SE2::Shared - 1) += 1e-9; },
      [](F& f) { f.descriptor.kind = Descriptor::Kind::none; }, [](F& f) { f.descriptor.bytes[0] ^= 1; },
      [](F& f) { f.descriptor.bytes[31] ^= 1; }, [](F& f) { f.kind += 1; });
}

TEST(FactHash, CountsEveryFieldOfTheOthers) {
  using P = PriorFact<SE2>;
  expect_each_field_counts(
      test::prior(1), [](P& f) { f.key.chain.vehicle = 9; }, [](P& f) { f.known = false; },
      [](P& f) { f.mean = SE2(0.0, 0.0, 0.0); }, [](P& f) { f.covariance(2, 2) += 1e-9; });
  using A = AssociationFact;
  expect_each_field_counts(
      test::association(1, 0, test::pairings(1, 2, 0, 3)), [](A& f) { f.key.index = 1; },
      [](A& f) { f.pairings.pop_back(); }, [](A& f) { f.pairings[0].first.index = 9; },
      [](A& f) { f.pairings[0].second.chain.vehicle = 9; }, [](A& f) { f.pairings[0].second.chain.epoch += 1; });
  using V = VerdictFact;
  expect_each_field_counts(
      test::verdict(1, 0, 5, true), [](V& f) { f.key.index = 1; }, [](V& f) { f.hypothesis = 6; },
      [](V& f) { f.veto = false; });
}

TEST(FactHash, ZeroHasOneHash) {
  auto a = test::anchor(1, 1), b = a;
  a.state.stamp_s = 0.0;
  b.state.stamp_s = -0.0;
  EXPECT_EQ(hash_of(a), hash_of(b));
}

TEST(Hypothesis, IsItsPairingsWhoeverStatesIt) {
  const auto list = test::pairings(1, 2, 0, 3);
  EXPECT_NE(hash_of(test::association(1, 0, list)), hash_of(test::association(2, 0, list)));
  EXPECT_NE(hypothesis_id(list), hypothesis_id(test::pairings(1, 2, 0, 2)));
  EXPECT_EQ(hypothesis_id(list), hypothesis_id(test::pairings(2, 1, 0, 3)));
}

TEST(Canonical, SortsWithinAndAmongPairingsAndRemovesRepeats) {
  const Key a{{1, 1}, 0}, b{{1, 1}, 1}, c{{2, 1}, 0}, d{{2, 1}, 1};
  const std::vector<Pairing> expected{{a, d}, {b, c}};
  EXPECT_EQ(canonical({{c, b}, {a, d}, {b, c}, {d, a}}), expected);
  EXPECT_EQ(canonical(expected), expected);
  EXPECT_TRUE(canonical({}).empty());
}

TEST(Key, OrdersByVehicleThenEpochThenIndex) {
  const Key first{{1, 9}, 9}, second{{2, 1}, 9}, third{{2, 2}, 0}, fourth{{2, 2}, 1};
  EXPECT_LT(first, second);
  EXPECT_LT(second, third);
  EXPECT_LT(third, fourth);
}

TEST(ContentHash, DependsOnOrderAndWidth) {
  EXPECT_NE(ContentHash().add(std::uint64_t{1}, 4).add(std::uint64_t{2}, 4).value(),
            ContentHash().add(std::uint64_t{2}, 4).add(std::uint64_t{1}, 4).value());
  EXPECT_NE(ContentHash().add(std::uint64_t{1}, 4).value(), ContentHash().add(std::uint64_t{1}, 8).value());
}

TEST(FactHash, OfAnAbsoluteFixCoversEveryField) {
  const AbsoluteFixFact<SE2> good = test::absolute_fix(3, 2);
  std::set<Hash> hashes{hash_of(good)};
  const auto spoilt = [&](auto spoil) {
    AbsoluteFixFact<SE2> fact = good;
    spoil(fact);
    EXPECT_TRUE(hashes.insert(hash_of(fact)).second);
  };
  spoilt([](auto& f) { ++f.key.chain.vehicle; });
  spoilt([](auto& f) { ++f.key.chain.epoch; });
  spoilt([](auto& f) { ++f.key.index; });
  spoilt([](auto& f) { ++f.anchor; });
  spoilt([](auto& f) { f.state.stamp_s += 1e-9; });
  spoilt([](auto& f) { f.state.abscissa_m += 1e-9; });
  spoilt([](auto& f) { f.state.pose = f.state.pose * SE2(0.0, 0.0, 1e-9); });
  spoilt([](auto& f) { f.state.drift(2, 2) += 1e-9; });
  spoilt([](auto& f) { f.state.heading_lever[1] += 1e-9; });
  for (int i = 0; i < 2; ++i) {
    spoilt([i](auto& f) { f.lever[i] += 1e-9; });
    spoilt([i](auto& f) { f.position[i] += 1e-9; });
    spoilt([i](auto& f) { f.covariance(i, i) += 1e-9; });
  }
  spoilt([](auto& f) { f.covariance(0, 1) += 1e-9; });
  EXPECT_EQ(hash_of(good), hash_of(test::absolute_fix(3, 2)));
}

template <class Fact>
void expect_every_change_shows(const Fact& good, const std::vector<std::function<void(Fact&)>>& changes) {
  std::set<Hash> hashes{hash_of(good)};
  for (const auto& change : changes) {
    Fact fact = good;
    change(fact);
    EXPECT_TRUE(hashes.insert(hash_of(fact)).second);
  }
}

TEST(FactHash, OfAnEncounterAndOfAWaypointCoversEveryField) {
  using Encounter = EncounterFact<SE2>;
  expect_every_change_shows<Encounter>(
      test::encounter(3, 2),
      {[](Encounter& f) { ++f.key.index; }, [](Encounter& f) { ++f.anchor; },
       [](Encounter& f) { f.state.stamp_s += 1e-9; }, [](Encounter& f) { ++f.other; },
       [](Encounter& f) { f.position[0] += 1e-9; }, [](Encounter& f) { f.position[1] += 1e-9; },
       [](Encounter& f) { f.covariance(0, 0) += 1e-9; }, [](Encounter& f) { f.covariance(0, 1) += 1e-9; },
       [](Encounter& f) { f.covariance(1, 1) += 1e-9; }});
  using Waypoint = WaypointFact<SE2>;
  expect_every_change_shows<Waypoint>(
      test::waypoint(3, 2),
      {[](Waypoint& f) { ++f.key.index; }, [](Waypoint& f) { ++f.anchor; },
       [](Waypoint& f) { f.state.abscissa_m += 1e-9; }, [](Waypoint& f) { ++f.encounter.index; },
       [](Waypoint& f) { ++f.encounter.chain.vehicle; }, [](Waypoint& f) { ++f.encounter.chain.epoch; },
       [](Waypoint& f) { f.mark[0] += 1e-9; }, [](Waypoint& f) { f.mark[1] += 1e-9; }});
}

TEST(FactHash, OfAPriorCoversItsPersistentDrift) {
  using Prior = PriorFact<SE3>;
  expect_every_change_shows<Prior>(
      {test::key_of(3, 0), false, SE3()},
      {[](Prior& f) { f.persistent.scale = 0.01; }, [](Prior& f) { f.persistent.heading_rad_per_m = 0.01; },
       [](Prior& f) { f.persistent.tilt_rad = 0.01; }, [](Prior& f) { f.persistent.height_m = 0.01; },
       [](Prior& f) { f.persistent.correlation_m = 0.01; }, [](Prior& f) { f.persistent.up[0] = 0.01; },
       [](Prior& f) { f.persistent.up[2] = 0.01; }, [](Prior& f) { f.persistent.scales_landmarks = true; }});
}

}  // namespace
}  // namespace convoy
