// Landmarks that could as well be of another class (DESIGN B5), one reason after the other.
#include <convoy/map/misfits.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <set>
#include <vector>

namespace convoy {
namespace {

using test::key_of;
using Keys = std::set<Key>;

/// Vehicles in one yard, with one batch each. What they see is without error, and said to be known to 0.1 m.
template <class G>
class Yard {
 public:
  using Point = typename G::Point;
  static constexpr std::uint32_t posts = 16;

  /// Each sees the posts around the yard.
  explicit Yard(VehicleId vehicles) {
    for (VehicleId v = 1; v <= vehicles; ++v) {
      store.insert(AnchorFact<G>{key_of(v, 0), {}});
      PriorFact<G> prior{key_of(v, 0), true, pose_of(v)};
      prior.covariance = test::known_start_of<G>.cwiseAbs2().asDiagonal();
      store.insert(prior);
      for (std::uint32_t k = 0; k < posts; ++k) {
        const double angle = 2.0 * M_PI * k / posts;
        Point post = at(10.0 * std::cos(angle), 10.0 * std::sin(angle));
        if constexpr (G::Dim == 3) post.z() = k % 2;
        see(v, post);
      }
    }
  }
  static Point at(double x_m, double y_m = 0.0) {
    Point p = Point::Zero();
    p.template head<2>() << x_m, y_m;
    return p;
  }
  /// One landmark more in the batch of v.
  Key see(VehicleId v, const Point& where) {
    LandmarkFact<G> l;
    l.key = key_of(v, seen_[v]++);
    l.position = pose_of(v).inverse() * where;
    l.covariance = 0.01 * G::PointCovariance::Identity();
    store.insert(l);
    return l.key;
  }
  /// The posts are the same to both, and so are these.
  void associate(VehicleId v, VehicleId w, std::vector<Pairing> pairs = {}) {
    for (std::uint32_t k = 0; k < posts; ++k) pairs.emplace_back(key_of(v, k), key_of(w, k));
    store.insert(test::association(v, stated_[v]++, canonical(pairs)));
  }
  Keys misfits(const Keys* batches = nullptr) const {
    const auto map = SparseMap<G>().solve(build_problem<G>(store, select(store, test::unconfirmed_too)));
    return convoy::misfits(store, *map, SelectionParams{}, batches);
  }

  FactStore<G> store;

 private:
  static G pose_of(VehicleId v) { return test::on_the_street<G>(3.0 * v, -2.0 * v, 0.4 * v); }
  std::map<VehicleId, std::uint32_t> seen_, stated_;
};

template <class G>
class Misfits : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(Misfits, Groups);

/// Two classes this far apart: of vehicles 1 and 2, of 3 and 4. Nobody sees both, unless `by_5`.
template <class G>
struct TwoClasses {
  TwoClasses(double apart_m, bool by_5) : yard(5) {
    for (const VehicleId v : {1U, 2U}) members.push_back(yard.see(v, yard.at(0.0)));
    for (const VehicleId v : {3U, 4U}) members.push_back(yard.see(v, yard.at(apart_m)));
    yard.associate(1, 2, {{members[0], members[1]}});
    yard.associate(2, 3);
    yard.associate(3, 4, {{members[2], members[3]}});
    if (by_5) see_both(apart_m);
  }
  void see_both(double apart_m) {
    yard.associate(5, 1, {{yard.see(5, yard.at(0.0)), members[0]}});
    yard.associate(5, 3, {{yard.see(5, yard.at(apart_m)), members[2]}});
  }
  Yard<G> yard;
  std::vector<Key> members;
};

TYPED_TEST(Misfits, AnotherClassNearIsNoRivalIfNobodyHasSeenBoth) {
  EXPECT_EQ((TwoClasses<TypeParam>(0.2, false).yard.misfits()), Keys());
}

TYPED_TEST(Misfits, AnotherClassNearThatSomebodyHasToldApartIsOne) {
  const TwoClasses<TypeParam> two(0.2, true);
  const Keys found = two.yard.misfits();
  for (const Key& member : two.members) EXPECT_EQ(found.count(member), 1U) << member.chain.vehicle;
}

TYPED_TEST(Misfits, AnotherClassThatIsConceivableButClearlyWorseIsNone) {
  EXPECT_EQ((TwoClasses<TypeParam>(0.4, true).yard.misfits()), Keys());
}

TYPED_TEST(Misfits, TwoPairsThatCouldBeExchangedAreMisfits) {
  for (const double apart_m : {0.15, 0.4}) {
    Yard<TypeParam> yard(2);
    Keys near;
    std::vector<Pairing> pairs;
    for (const double x_m : {0.0, apart_m}) {
      pairs.emplace_back(yard.see(1, yard.at(x_m)), yard.see(2, yard.at(x_m)));
      near.insert({pairs.back().first, pairs.back().second});
    }
    yard.associate(1, 2, pairs);
    EXPECT_EQ(yard.misfits(), apart_m < 0.3 ? near : Keys()) << apart_m;
  }
}

// Of a batch alone: to the other one, that has not seen the neighbour, nothing else is conceivable.
TYPED_TEST(Misfits, ANeighbourInNoClassMakesALandmarkOfItsBatchAMisfit) {
  for (const double apart_m : {0.2, 0.5}) {
    Yard<TypeParam> yard(2);
    const Key paired = yard.see(1, yard.at(0.0));
    yard.see(1, yard.at(apart_m));
    yard.associate(1, 2, {{paired, yard.see(2, yard.at(0.0))}});
    EXPECT_EQ(yard.misfits(), apart_m < 0.3 ? Keys{paired} : Keys()) << apart_m;
  }
}

// Beyond the gate from where the other puts the class, within it from where both do.
TYPED_TEST(Misfits, WhatABatchSaysOfAClassIsNotHeldAgainstItself) {
  for (const double off_m : {0.45, 0.1}) {
    Yard<TypeParam> yard(2);
    const Key off = yard.see(1, yard.at(off_m));
    yard.see(1, yard.at(0.0, 0.55));  // conceivable, far as it is
    yard.associate(1, 2, {{off, yard.see(2, yard.at(0.0))}});
    EXPECT_EQ(yard.misfits(), off_m > 0.3 ? Keys{off} : Keys()) << off_m;
  }
}

// Beyond the gate, but a neighbour 1 m away and a class 1 m away are not what it could be.
TYPED_TEST(Misfits, APoorFitAloneMakesNone) {
  Yard<TypeParam> yard(3);
  const Key off = yard.see(1, yard.at(0.45)), its = yard.see(2, yard.at(0.0)), other = yard.see(2, yard.at(0.0, -1.0));
  yard.see(1, yard.at(0.0, 1.0));
  yard.associate(1, 2, {{off, its}});
  yard.associate(2, 3, {{other, yard.see(3, yard.at(0.0, -1.0))}});
  EXPECT_EQ(yard.misfits(), Keys());
}

// 0.4 m from where 2 and 3 together put their class, 0.2 m from where 2 alone does.
TYPED_TEST(Misfits, WhatWasTakenOffForABatchIsThereForTheNext) {
  Yard<TypeParam> yard(4);
  const Key here = yard.see(4, yard.at(0.0)), first = yard.see(1, yard.at(0.0)), told_apart = yard.see(3, yard.at(0.0));
  yard.associate(1, 4, {{first, here}});
  yard.associate(1, 3, {{first, told_apart}});
  yard.associate(2, 3, {{yard.see(2, yard.at(0.2)), yard.see(3, yard.at(0.6))}});
  EXPECT_EQ(yard.misfits().count(here), 0U);
}

TYPED_TEST(Misfits, AreLookedForInTheBatchesThatAreNamed) {
  const TwoClasses<TypeParam> two(0.2, true);
  const Keys batches{key_of(1, 0), key_of(4, 0)};
  EXPECT_EQ(two.yard.misfits(&batches), (Keys{two.members[0], two.members[3]}));
}

// ---- as news come ----

template <class G>
bool is_in_a_class(const GlobalMap<G>& global, const Key& landmark) {
  return global.class_of.find(landmark).has_value();
}

TYPED_TEST(Misfits, AMispairedLandmarkIsLeftOutOfTheUpdateItComesBy) {
  using G = TypeParam;
  Yard<G> yard(3);
  const Key known = yard.see(1, yard.at(0.0));
  yard.see(3, yard.at(0.0));  // this is the one
  const Key mispaired = yard.see(3, yard.at(0.3));
  yard.associate(1, 2, {{known, yard.see(2, yard.at(0.0))}});
  const SparseMap<G> backend;
  MapBuilder<G> builder(test::unconfirmed_too, backend);
  builder.build(yard.store);
  builder.update(yard.store);
  yard.associate(3, 1, {{mispaired, known}});
  const auto global = builder.update(yard.store);
  ASSERT_FALSE(global.exact);
  EXPECT_FALSE(is_in_a_class(global, mispaired));
  EXPECT_TRUE(is_in_a_class(global, known));
  EXPECT_TRUE(is_in_a_class(global, key_of(3, 0)));  // a post: the hypothesis stands
}

// Members of old may have become doubtful by what is new, whoever they are of.
TYPED_TEST(Misfits, NewsOfAClassPutItsOldMembersToTheTest) {
  using G = TypeParam;
  TwoClasses<G> two(0.2, false);
  const SparseMap<G> backend;
  MapBuilder<G> builder(test::unconfirmed_too, backend);
  builder.build(two.yard.store);
  for (const Key& member : two.members) ASSERT_TRUE(is_in_a_class(builder.update(two.yard.store), member));
  two.see_both(0.2);
  const auto global = builder.update(two.yard.store);
  ASSERT_FALSE(global.exact);
  for (const Key& member : two.members) EXPECT_FALSE(is_in_a_class(global, member)) << member.chain.vehicle;
}

}  // namespace
}  // namespace convoy
