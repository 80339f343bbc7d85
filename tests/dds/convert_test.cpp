#include <convoy/dds/convert.hpp>
#include <convoy/dds/guarded_type.hpp>
#include <convoy/dds/wire_bounds.hpp>

#include "any_facts.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace convoy::dds::testing {
namespace {

/// Through the generated code and back, as a guarded type does it.
template <class PubSubType>
typename PubSubType::type over_the_wire(typename PubSubType::type& sample) {
  GuardedType<PubSubType> type;
  const std::uint32_t size = type.getSerializedSizeProvider(&sample)();
  eprosima::fastrtps::rtps::SerializedPayload_t payload(size);
  EXPECT_TRUE(type.serialize(&sample, &payload));
  Guarded<typename PubSubType::type> received;
  EXPECT_TRUE(type.deserialize(&payload, &received));
  EXPECT_EQ(received.decoding, Decoding::ok);
  for (std::uint32_t cut = 0; cut + 8 <= payload.length; ++cut) {  // 7 bytes or fewer are padding
    const Decoding decoding = scan_payload<typename PubSubType::type>(payload.data, cut);
    EXPECT_EQ(decoding, Decoding::undecodable) << "cut to " << cut << " of " << payload.length;
  }
  return received.sample;
}

template <class PubSubType, class G = SE2, class Part>
Message<G> round_trip(const Part& part) {
  typename PubSubType::type sample;
  EXPECT_EQ(to_wire<G>(sender, part, sample), WireStatus::ok);
  const auto received = over_the_wire<PubSubType>(sample);
  Message<G> message;
  EXPECT_EQ(from_wire(received, message), WireStatus::ok);
  EXPECT_EQ(message.sender, sender);
  return message;
}

// Content hashes cover every field to the bit, so equal hashes say that nothing was changed on the way.
TEST(Convert, AnchorRoundTrip) {
  const AnchorFact<SE2> fact{{author, 12}, any_state(), 34, 5};
  EXPECT_EQ(hash_of(std::get<AnchorFact<SE2>>(round_trip<v1::BiasPubSubType>(fact).payload)), hash_of(fact));
}

TEST(Convert, LandmarksRoundTrip) {
  for (const bool described : {false, true}) {
    const std::vector<LandmarkFact<SE2>> facts{any_landmark(0, described), any_landmark(9, !described)};
    const auto message = round_trip<v1::LandmarkPubSubType>(std::span<const LandmarkFact<SE2>>(facts));
    const auto& got = std::get<LandmarkBatch<SE2>>(message.payload).landmarks;
    ASSERT_EQ(got.size(), 2U);
    for (std::size_t i = 0; i < 2; ++i) EXPECT_EQ(hash_of(got[i]), hash_of(facts[i]));
  }
}

TEST(Convert, PriorRoundTrip) {
  const PriorFact<SE2> known{{author, 0}, true, SE2(any(), any(), any()), any_covariance<3>()};
  PriorFact<SE2> unknown;
  unknown.key = {author, 0};
  for (const auto& fact : {known, unknown})
    EXPECT_EQ(hash_of(std::get<PriorFact<SE2>>(round_trip<v1::PriorPubSubType>(fact).payload)), hash_of(fact));
}

TEST(Convert, AbsoluteFixRoundTrip) {
  const auto fact = any_fix<SE2>(any_state());
  EXPECT_EQ(hash_of(std::get<AbsoluteFixFact<SE2>>(round_trip<v1::AbsoluteFixPubSubType>(fact).payload)),
            hash_of(fact));
}

TEST(Convert, EncounterAndWaypointRoundTrip) {
  const auto encounter = any_encounter<SE2>(any_state());
  EXPECT_EQ(hash_of(std::get<EncounterFact<SE2>>(round_trip<v1::EncounterPubSubType>(encounter).payload)),
            hash_of(encounter));
  const auto waypoint = any_waypoint<SE2>(any_state());
  EXPECT_EQ(hash_of(std::get<WaypointFact<SE2>>(round_trip<v1::WaypointPubSubType>(waypoint).payload)),
            hash_of(waypoint));
}

TEST(Convert, AHeadingLeverCostsNothingWhereThereIsNone) {
  AnchorFact<SE2> fact{{author, 12}, any_state(), 34, 5};
  fact.state.heading_lever.setZero();
  v1::Bias sample;
  ASSERT_EQ(to_wire(sender, fact, sample), WireStatus::ok);
  EXPECT_TRUE(sample.state().heading_lever().empty());
  EXPECT_EQ(hash_of(std::get<AnchorFact<SE2>>(round_trip<v1::BiasPubSubType>(fact).payload)), hash_of(fact));
  fact.state.heading_lever << 1.0 / 3.0, -7.0, 12.0;
  EXPECT_EQ(hash_of(std::get<AnchorFact<SE2>>(round_trip<v1::BiasPubSubType>(fact).payload)), hash_of(fact));
}

TEST(Convert, PersistentDriftComesBackToTheBit) {
  PriorFact<SE3> fact{{author, 0}, false, SE3()};
  fact.persistent = {0.01 / 3.0, 1e-4 / 3.0, 0.01, 0.3, 51.0, Eigen::Vector3d(0.1, 0.2, 1.0).normalized(), true};
  EXPECT_EQ(hash_of(std::get<PriorFact<SE3>>(round_trip<v1::PriorPubSubType, SE3>(fact).payload)), hash_of(fact));
  v1::Prior good;
  ASSERT_EQ(to_wire(sender, fact, good), WireStatus::ok);
  const auto spoilt = [&](auto spoil) {
    v1::Prior sample = good;
    spoil(sample);
    Message<SE3> message;
    return from_wire(sample, message);
  };
  EXPECT_EQ(spoilt([](v1::Prior&) {}), WireStatus::ok);
  EXPECT_EQ(spoilt([](v1::Prior& s) { s.scale_sigma(NAN); }), WireStatus::not_finite);
  EXPECT_EQ(spoilt([](v1::Prior& s) { s.correlation(INFINITY); }), WireStatus::not_finite);
  EXPECT_EQ(spoilt([](v1::Prior& s) { s.up().resize(2); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](v1::Prior& s) { s.up()[1] = NAN; }), WireStatus::not_finite);
}

TEST(Convert, AssociationRoundTrip) {
  AssociationFact fact{{author, 5}, {}};
  for (std::uint32_t i = 0; i < 40; ++i) fact.pairings.push_back({{sender, i}, {{9 + i / 20, 1}, 2 * i}});
  const auto message = round_trip<v1::AssociationPubSubType>(fact);
  EXPECT_EQ(std::get<AssociationFact>(message.payload).pairings, fact.pairings);
  EXPECT_EQ(hash_of(std::get<AssociationFact>(message.payload)), hash_of(fact));
}

TEST(Convert, VerdictRoundTrip) {
  const VerdictFact fact{{author, 5}, 0xdeadbeefcafef00dULL, true};
  EXPECT_EQ(hash_of(std::get<VerdictFact>(round_trip<v1::VerdictPubSubType>(fact).payload)), hash_of(fact));
}

TEST(Convert, PoseRoundTrip) {
  const LivePose<SE2> pose{author, 3, any_state(), Integrity::suspect, reason_stale_peer | reason_innovation};
  const auto message = round_trip<v1::PosePubSubType>(pose);
  const auto& got = std::get<LivePose<SE2>>(message.payload);
  EXPECT_EQ(got.chain, pose.chain);
  EXPECT_EQ(got.anchor, pose.anchor);
  EXPECT_EQ(got.integrity, pose.integrity);
  EXPECT_EQ(got.reasons, pose.reasons);
  EXPECT_EQ(hash_of(AnchorFact<SE2>{{author, 3}, got.state}), hash_of(AnchorFact<SE2>{{author, 3}, pose.state}));
}

template <class G>
LivePose<G> with_remembered(LivePose<G> pose) {
  for (std::uint32_t i = 0; i < LivePose<G>::max_remembered; ++i) {
    RememberedLandmark<G> l{100 + i, G::Point::NullaryExpr([] { return any(); }), any_covariance<G::Dim>()};
    pose.remembered.push_back(l);
  }
  pose.shared = any_covariance<G::Dof>();
  return pose;
}

// Rounded to single precision, and no more than that.
template <class G>
void expect_same_remembered(const LivePose<G>& got, const LivePose<G>& sent) {
  ASSERT_EQ(got.remembered.size(), sent.remembered.size());
  EXPECT_EQ(got.shared, sent.shared);
  for (std::size_t i = 0; i < sent.remembered.size(); ++i) {
    EXPECT_EQ(got.remembered[i].index, sent.remembered[i].index);
    EXPECT_TRUE(got.remembered[i].position.isApprox(sent.remembered[i].position, 1e-7));
    EXPECT_TRUE(got.remembered[i].covariance.isApprox(sent.remembered[i].covariance, 1e-7));
  }
}

TEST(Convert, PoseWithRememberedLandmarksRoundTrip) {
  const auto pose = with_remembered(LivePose<SE2>{author, 3, any_state(), Integrity::ok, 0});
  expect_same_remembered(std::get<LivePose<SE2>>(round_trip<v1::PosePubSubType>(pose).payload), pose);
}

TEST(Convert, RequestRoundTrip) {
  for (int kind = 0; kind < fact_kind_count; ++kind) {
    const Request request{author, static_cast<FactKind>(kind), {{1, 2}, {5, 900}}, static_cast<std::uint8_t>(kind)};
    const auto message = round_trip<v1::RequestPubSubType>(request);
    const auto& got = std::get<Request>(message.payload);
    EXPECT_EQ(got.target, request.target);
    EXPECT_EQ(got.kind, request.kind);
    EXPECT_EQ(got.ranges, request.ranges);
    EXPECT_EQ(got.in_vain, request.in_vain);
  }
}

TEST(Convert, DigestRoundTripKeepsTheOrderOfMarks) {
  Digest digest{2, {}, 1, 2, 3, 4};
  for (const auto kind : {FactKind::anchor, FactKind::landmark, FactKind::verdict})
    digest.marks.push_back({author, kind, 9, 8, 7});
  digest.marks.push_back({sender, FactKind::verdict, 6, 5, 4});
  digest.marks.push_back({sender, FactKind::anchor, 3, 2, 1});  // out of canonical order
  const auto message = round_trip<v1::DigestPubSubType>(digest);
  const auto& got = std::get<Digest>(message.payload);
  EXPECT_EQ(got.marks, digest.marks);
  EXPECT_EQ(std::tie(got.facts, got.selection, got.map, got.map_facts),
            std::tie(digest.facts, digest.selection, digest.map, digest.map_facts));
}

TEST(Convert, ADigestOfTwoVehiclesIsSmall) {
  Digest digest;
  const auto size = [&] {
    v1::Digest sample;
    EXPECT_EQ(to_wire<SE2>(sender, digest, sample), WireStatus::ok);
    return v1::Digest::getCdrSerializedSize(sample);
  };
  for (const ChainId chain : {sender, author})
    for (const FactKind kind :
         {FactKind::anchor, FactKind::landmark, FactKind::prior, FactKind::association, FactKind::verdict})
      digest.marks.push_back({chain, kind, 9, 9, 9});
  const std::size_t without = size();
  EXPECT_LE(without, 304U);
  digest.marks.push_back(
      {author, FactKind::absolute_fix, 9, 9, 9});  // a kind costs those that have it: 4 + 4 + 8 bytes
  EXPECT_LE(size(), without + 24U);
}

TEST(Convert, SplitKeepsOrderAnchorsAndSize) {
  std::vector<LandmarkFact<SE2>> facts;
  for (std::uint32_t i = 0; i < 70; ++i) {
    facts.push_back(any_landmark(i, i % 3 == 0));
    facts.back().anchor = i / 40;
  }
  for (std::uint32_t i = 70; i < 200; ++i) {  // so small that their number is what cuts them
    facts.push_back(any_landmark(i, false));
    facts.back().anchor = 2;
  }
  std::uint32_t next = 0;
  for (const auto part : split(std::span<const LandmarkFact<SE2>>(facts))) {
    ASSERT_FALSE(part.empty());
    EXPECT_LE(part.size(), 64U);
    v1::Landmark sample;
    ASSERT_EQ(to_wire(sender, part, sample), WireStatus::ok);
    EXPECT_LE(v1::Landmark::getCdrSerializedSize(sample), max_sample_bytes);
    for (const auto& fact : part) {
      EXPECT_EQ(fact.key.index, next++);
      EXPECT_EQ(fact.anchor, part.front().anchor);
    }
  }
  EXPECT_EQ(next, 200U);
}

LandmarkFact<SE2> with_loading(std::uint32_t index) {
  LandmarkFact<SE2> fact = any_landmark(index, true);
  fact.descriptor = {};
  return fact;
}

TEST(Convert, TwentyLandmarksWithLoadingsMakeOneSample) {
  std::vector<LandmarkFact<SE2>> facts;
  for (std::uint32_t i = 0; i < 20; ++i) facts.push_back(with_loading(i));
  const auto parts = split(std::span<const LandmarkFact<SE2>>(facts));
  ASSERT_EQ(parts.size(), 1U);
  v1::Landmark sample;
  ASSERT_EQ(to_wire(sender, parts[0], sample), WireStatus::ok);
  EXPECT_EQ(sample.loading().size(), 20U * 31U);
  const std::size_t size = v1::Landmark::getCdrSerializedSize(sample);
  EXPECT_LE(size, max_sample_bytes);
  EXPECT_LE(size, 20U * 56U + 64U) << "index 4, kind 1, position 8, covariance 12, loading 31, and what all share";
  for (auto& fact : facts) fact.loading.setZero();
  ASSERT_EQ(to_wire(sender, std::span<const LandmarkFact<SE2>>(facts), sample), WireStatus::ok);
  EXPECT_LE(v1::Landmark::getCdrSerializedSize(sample), 20U * 25U + 64U);
}

// Whatever stands in its fields, a sample is not larger than split() has reckoned, nor much smaller.
TEST(Convert, SamplesAreFull) {
  for (int round = 0; round < 50; ++round) {
    std::vector<LandmarkFact<SE2>> facts;
    for (std::uint32_t i = 0; i < 60; ++i) {
      facts.push_back(with_loading(i));
      facts.back().kind = round % 2 == 0 ? 0 : 3;
      facts.back().loading.rightCols(round % 12 + 1).setZero();
    }
    const auto parts = split(std::span<const LandmarkFact<SE2>>(facts));
    for (std::size_t k = 0; k < parts.size(); ++k) {
      v1::Landmark sample;
      ASSERT_EQ(to_wire(sender, parts[k], sample), WireStatus::ok);
      const std::size_t size = v1::Landmark::getCdrSerializedSize(sample);
      EXPECT_LE(size, max_sample_bytes);
      if (k + 1 < parts.size()) {
        EXPECT_GT(size + 56U + 8U, max_sample_bytes);
      }
    }
  }
}

// What needs no column is not sent, and comes back to the bit.
TEST(Convert, OnlyColumnsThatAreNotZeroAreSent) {
  for (Eigen::Index columns = 0; columns <= SE2::Shared; ++columns) {
    std::vector<LandmarkFact<SE2>> facts{with_loading(0), with_loading(1), with_loading(2)};
    for (auto& fact : facts) fact.loading.rightCols(SE2::Shared - columns).setZero();
    facts[1].loading.setZero();
    v1::Landmark sample;
    ASSERT_EQ(to_wire(sender, std::span<const LandmarkFact<SE2>>(facts), sample), WireStatus::ok);
    const auto each = static_cast<std::size_t>(columns == 0 ? 0 : 1 + (columns + 1) / 2 + 2 * columns);
    EXPECT_EQ(sample.loading().size(), 3 * each);
    const auto message = round_trip<v1::LandmarkPubSubType>(std::span<const LandmarkFact<SE2>>(facts));
    const auto& got = std::get<LandmarkBatch<SE2>>(message.payload).landmarks;
    ASSERT_EQ(got.size(), facts.size());
    for (std::size_t i = 0; i < facts.size(); ++i) EXPECT_EQ(hash_of(got[i]), hash_of(facts[i]));
  }
}

// ---- refusals ---------------------------------------------------------------------------------------------------

v1::Bias good_bias() {
  v1::Bias sample;
  EXPECT_EQ(to_wire(sender, AnchorFact<SE2>{{author, 12}, any_state()}, sample), WireStatus::ok);
  return sample;
}

template <class Sample, class Spoil>
WireStatus status_of(Sample sample, Spoil spoil) {
  spoil(sample);
  Message<SE2> message;
  return from_wire(sample, message);
}

TEST(Convert, RefusesBadAnchors) {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  const auto spoilt = [](auto spoil) { return status_of(good_bias(), spoil); };
  EXPECT_EQ(spoilt([](v1::Bias&) {}), WireStatus::ok);
  EXPECT_EQ(spoilt([](v1::Bias& s) { s.dimension(3); }), WireStatus::wrong_dimension);
  EXPECT_EQ(spoilt([](v1::Bias& s) { s.vehicle(0); }), WireStatus::out_of_range);
  EXPECT_EQ(spoilt([](v1::Bias& s) { s.sender().vehicle(0); }), WireStatus::out_of_range);
  EXPECT_EQ(spoilt([](v1::Bias& s) { s.state().pose().resize(7); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](v1::Bias& s) { s.state().drift().resize(21); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](v1::Bias& s) { s.state().pose()[2] = 4.0; }), WireStatus::out_of_range);
  EXPECT_EQ(spoilt([nan](v1::Bias& s) { s.state().pose()[0] = nan; }), WireStatus::not_finite);
  EXPECT_EQ(spoilt([nan](v1::Bias& s) { s.state().drift()[5] = nan; }), WireStatus::not_finite);
  EXPECT_EQ(spoilt([nan](v1::Bias& s) { s.state().stamp_s(nan); }), WireStatus::not_finite);
}

TEST(Convert, RefusesBadLandmarks) {
  const std::vector<LandmarkFact<SE2>> facts{any_landmark(0, true), any_landmark(1, true)};
  v1::Landmark good;
  ASSERT_EQ(to_wire(sender, std::span<const LandmarkFact<SE2>>(facts), good), WireStatus::ok);
  const auto spoilt = [&](auto spoil) { return status_of(good, spoil); };
  using L = v1::Landmark;
  EXPECT_EQ(spoilt([](L&) {}), WireStatus::ok);
  EXPECT_EQ(spoilt([](L& s) { s.index().clear(); }), WireStatus::out_of_range);
  EXPECT_EQ(spoilt([](L& s) { s.index().resize(65); }), WireStatus::too_many);
  EXPECT_EQ(spoilt([](L& s) { s.index().push_back(2); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](L& s) { s.kind().pop_back(); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](L& s) { s.descriptor_kind().pop_back(); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](L& s) { s.descriptor_kind()[1] = 0; }), WireStatus::wrong_size) << "too many bytes now";
  EXPECT_EQ(spoilt([](L& s) { s.descriptor().pop_back(); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](L& s) { s.descriptor().clear(); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](L& s) { s.position().push_back(0.0F); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](L& s) { s.covariance().pop_back(); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](L& s) { s.loading().pop_back(); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](L& s) { s.loading().push_back(1); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](L& s) { s.loading().resize(2 * (1 + 7 + 26), 100); }), WireStatus::wrong_size)
      << "thirteen columns";
  EXPECT_EQ(spoilt([](L& s) { s.loading().resize(100000); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](L& s) { s.position()[0] = INFINITY; }), WireStatus::not_finite);
  EXPECT_EQ(spoilt([](L& s) { s.covariance()[5] = NAN; }), WireStatus::not_finite);
  EXPECT_EQ(spoilt([](L& s) { s.descriptor_kind()[0] = 77; }), WireStatus::unknown_enum);
}

TEST(Convert, RefusesLandmarksInAnotherFormThanTheirs) {
  const std::vector<LandmarkFact<SE2>> facts{with_loading(0), with_loading(1)};
  v1::Landmark good;
  ASSERT_EQ(to_wire(sender, std::span<const LandmarkFact<SE2>>(facts), good), WireStatus::ok);
  const auto spoilt = [&](auto spoil) { return status_of(good, spoil); };
  using L = v1::Landmark;
  // Of the first landmark, which has a loading of its own choosing: an exponent, and columns 0 and 1.
  struct Column {
    std::uint8_t shift, first, second;
  };
  const auto loading = [&](std::uint8_t exponent, Column zero, Column one) {
    return spoilt([&](L& s) {
      std::fill_n(s.loading().begin(), 31, 0);
      s.loading()[0] = exponent;
      const auto rest = static_cast<std::uint8_t>(std::min<int>(15, exponent));  // of columns of zeros
      std::fill_n(s.loading().begin() + 1, 6, static_cast<std::uint8_t>(rest | rest << 4U));
      s.loading()[1] = static_cast<std::uint8_t>(zero.shift | one.shift << 4U);
      s.loading()[7] = zero.first;
      s.loading()[8] = zero.second;
      s.loading()[9] = one.first;
      s.loading()[10] = one.second;
    });
  };
  EXPECT_EQ(loading(64, {0, 64, 3}, {7, 3, 100}), WireStatus::ok);
  EXPECT_EQ(loading(64, {7, 64, 3}, {0, 3, 100}), WireStatus::ok);
  EXPECT_EQ(loading(64, {0, 0x81, 3}, {15, 3, 2}), WireStatus::ok) << "-127, and a small column";
  EXPECT_EQ(loading(3, {0, 64, 3}, {3, 3, 2}), WireStatus::ok);
  EXPECT_EQ(loading(0, {0, 63, 3}, {0, 0, 1}), WireStatus::ok);
  EXPECT_EQ(loading(0, {0, 0, 0}, {0, 0, 0}), WireStatus::ok);
  EXPECT_EQ(loading(127, {0, 127, 0}, {0, 127, 127}), WireStatus::ok);
  EXPECT_EQ(loading(64, {0, 64, 3}, {14, 3, 2}), WireStatus::not_canonical);
  EXPECT_EQ(loading(64, {0, 63, 3}, {0, 62, 3}), WireStatus::not_canonical);
  EXPECT_EQ(loading(64, {1, 64, 3}, {7, 3, 100}), WireStatus::not_canonical) << "no column without a shift";
  EXPECT_EQ(loading(64, {0, 0x80, 3}, {7, 3, 100}), WireStatus::not_canonical) << "-128";
  EXPECT_EQ(loading(64, {0, 64, 3}, {14, 0, 0}), WireStatus::not_canonical) << "a column of zeros";
  EXPECT_EQ(loading(64, {15, 0, 0}, {15, 0, 0}), WireStatus::not_canonical) << "a loading of zeros";
  EXPECT_EQ(loading(3, {0, 64, 3}, {4, 3, 2}), WireStatus::not_canonical);
  EXPECT_EQ(loading(128, {0, 127, 0}, {0, 127, 0}), WireStatus::not_canonical);
  EXPECT_EQ(spoilt([](L& s) { s.kind() = {0, 0}; }), WireStatus::not_canonical);
  EXPECT_EQ(spoilt([](L& s) { s.kind().clear(); }), WireStatus::ok);
  EXPECT_EQ(spoilt([](L& s) { s.descriptor_kind() = {0, 0}; }), WireStatus::not_canonical);
  EXPECT_EQ(spoilt([](L& s) { s.loading().assign(2 * 4, 0); }), WireStatus::not_canonical) << "a last column of zeros";
}

TEST(Convert, RefusesToSendWhatIsNotRounded) {
  v1::Landmark sample;
  const auto status = [&](auto spoil) {
    LandmarkFact<SE2> fact = any_landmark(0, true);
    spoil(fact);
    return to_wire(sender, std::span<const LandmarkFact<SE2>>(&fact, 1), sample);
  };
  using L = LandmarkFact<SE2>;
  EXPECT_EQ(status([](L&) {}), WireStatus::ok);
  EXPECT_EQ(status([](L& l) { l.position[1] = 1.0 / 3.0; }), WireStatus::not_rounded);
  EXPECT_EQ(status([](L& l) { l.position[1] = 1e300; }), WireStatus::not_rounded);
  EXPECT_EQ(status([](L& l) { l.covariance(1, 1) = 1.0 / 3.0; }), WireStatus::not_rounded);
  EXPECT_EQ(status([](L& l) { l.covariance(0, 1) += 0.5; }), WireStatus::not_rounded) << "not symmetric";
  EXPECT_EQ(status([](L& l) { l.loading(0, 7) = 1.0 / 3.0; }), WireStatus::not_rounded);
  EXPECT_EQ(status([](L& l) { l.loading(0, 7) = NAN; }), WireStatus::not_rounded);
  EXPECT_EQ(status([](L& l) { l.descriptor.kind = Descriptor::Kind::none; }), WireStatus::not_rounded)
      << "bytes of no kind";
  EXPECT_EQ(status([](L& l) { l.descriptor.bytes.fill(0); }), WireStatus::ok);
}

TEST(Convert, RefusesBadAbsoluteFixes) {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  v1::AbsoluteFix good;
  ASSERT_EQ(to_wire(sender, any_fix<SE2>(any_state()), good), WireStatus::ok);
  const auto spoilt = [&](auto spoil) { return status_of(good, spoil); };
  EXPECT_EQ(spoilt([](v1::AbsoluteFix&) {}), WireStatus::ok);
  EXPECT_EQ(spoilt([](v1::AbsoluteFix& s) { s.dimension(3); }), WireStatus::wrong_dimension);
  EXPECT_EQ(spoilt([](v1::AbsoluteFix& s) { s.vehicle(0); }), WireStatus::out_of_range);
  EXPECT_EQ(spoilt([](v1::AbsoluteFix& s) { s.lever().resize(3); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](v1::AbsoluteFix& s) { s.position().clear(); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](v1::AbsoluteFix& s) { s.covariance().resize(6); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](v1::AbsoluteFix& s) { s.state().drift().resize(21); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](v1::AbsoluteFix& s) { s.state().pose()[2] = 4.0; }), WireStatus::out_of_range);
  EXPECT_EQ(spoilt([nan](v1::AbsoluteFix& s) { s.lever()[1] = nan; }), WireStatus::not_finite);
  EXPECT_EQ(spoilt([nan](v1::AbsoluteFix& s) { s.position()[0] = nan; }), WireStatus::not_finite);
  EXPECT_EQ(spoilt([nan](v1::AbsoluteFix& s) { s.covariance()[2] = nan; }), WireStatus::not_finite);
  EXPECT_EQ(spoilt([nan](v1::AbsoluteFix& s) { s.state().stamp_s(nan); }), WireStatus::not_finite);
}

TEST(Convert, RefusesBadEncountersAndWaypoints) {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  v1::Encounter encounter;
  ASSERT_EQ(to_wire(sender, any_encounter<SE2>(any_state()), encounter), WireStatus::ok);
  const auto bad_encounter = [&](auto spoil) { return status_of(encounter, spoil); };
  EXPECT_EQ(bad_encounter([](v1::Encounter&) {}), WireStatus::ok);
  EXPECT_EQ(bad_encounter([](v1::Encounter& s) { s.dimension(3); }), WireStatus::wrong_dimension);
  EXPECT_EQ(bad_encounter([](v1::Encounter& s) { s.vehicle(0); }), WireStatus::out_of_range);
  EXPECT_EQ(bad_encounter([](v1::Encounter& s) { s.other(0); }), WireStatus::out_of_range);
  EXPECT_EQ(bad_encounter([](v1::Encounter& s) { s.position().resize(3); }), WireStatus::wrong_size);
  EXPECT_EQ(bad_encounter([](v1::Encounter& s) { s.covariance().clear(); }), WireStatus::wrong_size);
  EXPECT_EQ(bad_encounter([](v1::Encounter& s) { s.state().heading_lever().resize(2); }), WireStatus::wrong_size);
  EXPECT_EQ(bad_encounter([nan](v1::Encounter& s) { s.position()[1] = nan; }), WireStatus::not_finite);
  v1::Waypoint waypoint;
  ASSERT_EQ(to_wire(sender, any_waypoint<SE2>(any_state()), waypoint), WireStatus::ok);
  const auto bad_waypoint = [&](auto spoil) { return status_of(waypoint, spoil); };
  EXPECT_EQ(bad_waypoint([](v1::Waypoint&) {}), WireStatus::ok);
  EXPECT_EQ(bad_waypoint([](v1::Waypoint& s) { s.dimension(3); }), WireStatus::wrong_dimension);
  EXPECT_EQ(bad_waypoint([](v1::Waypoint& s) { s.observer().vehicle(0); }), WireStatus::out_of_range);
  EXPECT_EQ(bad_waypoint([](v1::Waypoint& s) { s.mark().resize(1); }), WireStatus::wrong_size);
  EXPECT_EQ(bad_waypoint([nan](v1::Waypoint& s) { s.mark()[0] = nan; }), WireStatus::not_finite);
  EXPECT_EQ(bad_waypoint([nan](v1::Waypoint& s) { s.state().abscissa_m(nan); }), WireStatus::not_finite);
}

TEST(Convert, RefusesBadRequestsDigestsPosesAndAssociations) {
  v1::Request request;
  ASSERT_EQ(to_wire<SE2>(sender, Request{author, FactKind::anchor, {{1, 2}}}, request), WireStatus::ok);
  EXPECT_EQ(status_of(request, [](auto& s) { s.kind(static_cast<v1::FactKind>(77)); }), WireStatus::unknown_enum);
  EXPECT_EQ(status_of(request, [](auto& s) { s.ranges()[0].end(1); }), WireStatus::out_of_range);
  EXPECT_EQ(status_of(request, [](auto& s) { s.ranges().resize(65, s.ranges()[0]); }), WireStatus::too_many);
  EXPECT_EQ(status_of(request, [](auto& s) { s.ranges().resize(2, s.ranges()[0]); }), WireStatus::not_canonical);

  v1::Digest digest;
  ASSERT_EQ(to_wire<SE2>(sender, Digest{2, {{author, FactKind::prior, 1, 1, 1}}, 12.5, 5, 1, 2, 3, 4}, digest),
            WireStatus::ok);
  EXPECT_EQ(status_of(digest, [](auto& s) { s.dimension(3); }), WireStatus::ok) << "for its receiver to count";
  EXPECT_EQ(status_of(digest, [](auto& s) { s.dimension(4); }), WireStatus::wrong_dimension);
  EXPECT_EQ(status_of(digest, [](auto& s) { s.marks()[0].kinds(3); }), WireStatus::wrong_size);
  EXPECT_EQ(status_of(digest, [](auto& s) { s.marks().resize(257, s.marks()[0]); }), WireStatus::too_many);

  v1::Pose pose;
  ASSERT_EQ(to_wire(sender, LivePose<SE2>{author, 3, any_state(), Integrity::ok, 0}, pose), WireStatus::ok);
  EXPECT_EQ(status_of(pose, [](auto& s) { s.integrity(static_cast<v1::Integrity>(77)); }), WireStatus::unknown_enum);
  EXPECT_EQ(status_of(pose, [](auto& s) { s.remembered_shared().resize(6, 0.0); }), WireStatus::wrong_size);
  EXPECT_EQ(status_of(pose, [](auto& s) { s.remembered_points().resize(5, 0.0F); }), WireStatus::wrong_size);
  auto remembering = with_remembered(LivePose<SE2>{author, 3, any_state(), Integrity::ok, 0});
  ASSERT_EQ(to_wire(sender, remembering, pose), WireStatus::ok);
  EXPECT_EQ(status_of(pose, [](auto& s) { s.remembered().resize(9, 1); }), WireStatus::too_many);
  EXPECT_EQ(status_of(pose, [](auto& s) { s.remembered().pop_back(); }), WireStatus::wrong_size);
  EXPECT_EQ(status_of(pose, [](auto& s) { s.remembered_shared().clear(); }), WireStatus::wrong_size);
  EXPECT_EQ(status_of(pose, [](auto& s) { s.remembered_points()[7] = std::numeric_limits<float>::infinity(); }),
            WireStatus::not_finite);
  EXPECT_EQ(status_of(pose, [](auto& s) { s.remembered_shared()[2] = std::numeric_limits<double>::quiet_NaN(); }),
            WireStatus::not_finite);
  remembering.remembered.push_back(remembering.remembered[0]);
  EXPECT_EQ(to_wire(sender, remembering, pose), WireStatus::too_many);
  remembering.remembered.resize(1);
  remembering.remembered[0].position[0] = 1e300;  // beyond single precision: nobody takes it
  ASSERT_EQ(to_wire(sender, remembering, pose), WireStatus::ok);
  EXPECT_EQ(status_of(pose, [](auto&) {}), WireStatus::not_finite);

  v1::Association association;
  ASSERT_EQ(to_wire<SE2>(sender, AssociationFact{{author, 0}, {{{sender, 1}, {author, 1}}}}, association),
            WireStatus::ok);
  EXPECT_EQ(status_of(association, [](auto& s) { s.dimension(3); }), WireStatus::wrong_dimension);
  EXPECT_EQ(status_of(association, [](auto& s) { s.groups()[0].pairs().resize(4097); }), WireStatus::too_many);
  EXPECT_EQ(status_of(association, [](auto& s) { s.groups().resize(65, s.groups()[0]); }), WireStatus::too_many);
}

TEST(Convert, RefusesAVerdictOfTheOtherDimension) {
  v1::Verdict verdict;
  ASSERT_EQ(to_wire<SE3>(sender, VerdictFact{{author, 0}, 1, true}, verdict), WireStatus::ok);
  EXPECT_EQ(status_of(verdict, [](auto&) {}), WireStatus::wrong_dimension);
}

TEST(Convert, RefusesToSendWhatWouldNotArriveAsItIs) {
  AnchorFact<SE2> fact{{author, 1}, any_state()};
  fact.state.drift(0, 1) = std::nextafter(fact.state.drift(0, 1), 1e9);
  v1::Bias sample;
  EXPECT_EQ(to_wire(sender, fact, sample), WireStatus::not_symmetric);
  AssociationFact association{{author, 1}, std::vector<Pairing>(bounds::pairs + 1)};
  v1::Association wide;
  EXPECT_EQ(to_wire<SE2>(sender, association, wide), WireStatus::too_many);
}

// ---- in space --------------------------------------------------------------------------------------------------

SE3 any_pose_in_space() { return {{any(), any(), any(), any()}, {any(), any(), any()}}; }

ChainState<SE3> any_state_in_space() { return {any(), std::abs(any()), any_pose_in_space(), any_covariance<6>()}; }

LandmarkFact<SE3> any_landmark_in_space(std::uint32_t index) {
  LandmarkFact<SE3> fact{{author, index}, 4, {any(), any(), any()}, any_covariance<3>(), SE3::Loading::Zero(), {}};
  fact.loading = SE3::Loading::NullaryExpr([] { return any(); });
  fact.descriptor.kind = Descriptor::Kind::patch_8x8_4bit;
  for (auto& byte : fact.descriptor.bytes) byte = static_cast<std::uint8_t>(engine());
  return rounded(fact);
}

TEST(ConvertInSpace, FactsAndPosesComeBackToTheBitAfterAnyNumberOfHops) {
  for (int round = 0; round < 50; ++round) {
    AnchorFact<SE3> anchor{{author, 12}, any_state_in_space(), 34, 5};
    PriorFact<SE3> prior{{author, 0}, true, any_pose_in_space(), any_covariance<6>()};
    const LivePose<SE3> pose{author, 3, any_state_in_space(), Integrity::suspect, reason_stale_peer};
    const Hash anchor_hash = hash_of(anchor), prior_hash = hash_of(prior);
    for (int hop = 0; hop < 3; ++hop) {
      anchor = std::get<AnchorFact<SE3>>(round_trip<v1::BiasPubSubType, SE3>(anchor).payload);
      prior = std::get<PriorFact<SE3>>(round_trip<v1::PriorPubSubType, SE3>(prior).payload);
    }
    EXPECT_EQ(hash_of(anchor), anchor_hash);
    EXPECT_EQ(hash_of(prior), prior_hash);
    const auto fix = any_fix<SE3>(any_state_in_space());
    EXPECT_EQ(hash_of(std::get<AbsoluteFixFact<SE3>>(round_trip<v1::AbsoluteFixPubSubType, SE3>(fix).payload)),
              hash_of(fix));
    const auto got = std::get<LivePose<SE3>>(round_trip<v1::PosePubSubType, SE3>(pose).payload);
    EXPECT_EQ(hash_of(AnchorFact<SE3>{{author, 3}, got.state}), hash_of(AnchorFact<SE3>{{author, 3}, pose.state}));
    const auto remembering = with_remembered(pose);
    expect_same_remembered(std::get<LivePose<SE3>>(round_trip<v1::PosePubSubType, SE3>(remembering).payload),
                           remembering);
  }
}

TEST(ConvertInSpace, ABatchIsSplitIntoSamplesThatFitAFrame) {
  std::vector<LandmarkFact<SE3>> batch;
  for (std::uint32_t i = 0; i < 20; ++i) batch.push_back(any_landmark_in_space(i));
  std::vector<Hash> got;
  for (const auto part : split(std::span<const LandmarkFact<SE3>>(batch))) {
    v1::Landmark sample;
    ASSERT_EQ(to_wire(sender, part, sample), WireStatus::ok);
    GuardedType<v1::LandmarkPubSubType> type;
    EXPECT_LE(type.getSerializedSizeProvider(&sample)(), max_sample_bytes);
    const auto message = round_trip<v1::LandmarkPubSubType, SE3>(part);
    for (const auto& l : std::get<LandmarkBatch<SE3>>(message.payload).landmarks) got.push_back(hash_of(l));
  }
  ASSERT_EQ(got.size(), batch.size());
  for (std::size_t i = 0; i < batch.size(); ++i) EXPECT_EQ(got[i], hash_of(batch[i]));
}

TEST(ConvertInSpace, RefusesWhatIsOfThePlaneOrNoRotation) {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  v1::Bias good;
  ASSERT_EQ(to_wire(sender, AnchorFact<SE3>{{author, 12}, any_state_in_space()}, good), WireStatus::ok);
  const auto spoilt = [&](auto spoil) {
    v1::Bias sample = good;
    spoil(sample);
    Message<SE3> message;
    return from_wire(sample, message);
  };
  EXPECT_EQ(spoilt([](v1::Bias&) {}), WireStatus::ok);
  EXPECT_EQ(spoilt([](v1::Bias& s) { s.dimension(2); }), WireStatus::wrong_dimension);
  EXPECT_EQ(spoilt([](v1::Bias& s) { s.state().pose().resize(3); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](v1::Bias& s) { s.state().pose().resize(6); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([](v1::Bias& s) { s.state().drift().resize(6); }), WireStatus::wrong_size);
  EXPECT_EQ(spoilt([nan](v1::Bias& s) { s.state().pose()[4] = nan; }), WireStatus::not_finite);
  EXPECT_EQ(spoilt([](v1::Bias& s) {
              for (std::size_t i = 3; i < 7; ++i) s.state().pose()[i] *= 1.0 + 1e-9;
            }),
            WireStatus::out_of_range)
      << "too long";
  EXPECT_EQ(spoilt([](v1::Bias& s) {
              for (std::size_t i = 3; i < 7; ++i) s.state().pose()[i] *= -1.0;
            }),
            WireStatus::out_of_range)
      << "-q is q, and q has one form";
  EXPECT_EQ(spoilt([](v1::Bias& s) {
              for (std::size_t i = 3; i < 7; ++i) s.state().pose()[i] = 0.0;
            }),
            WireStatus::out_of_range);

  const std::vector<LandmarkFact<SE3>> facts{any_landmark_in_space(0)};
  v1::Landmark landmark;
  ASSERT_EQ(to_wire(sender, std::span<const LandmarkFact<SE3>>(facts), landmark), WireStatus::ok);
  landmark.position().pop_back();
  Message<SE3> message;
  EXPECT_EQ(from_wire(landmark, message), WireStatus::wrong_size);
}

}  // namespace
}  // namespace convoy::dds::testing
