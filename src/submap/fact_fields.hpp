// The fields of each fact, listed once: for hashing, storing and reading back. An archive has
//   natural(value, bytes)   an unsigned integer, an enumeration or a bool
//   real(value)             a double
//   matrix(m)               a vector or matrix of doubles
//   pose(T)                 an element of SE(2) or SE(3)
//   bytes(array)            an array of octets
//   list(items, visit)      a vector
// and is given the fields in a fixed order, the key first.
#pragma once

#include <convoy/submap/facts.hpp>

#include <type_traits>

namespace convoy {

template <class Archive, class K>
void key_fields(Archive& a, K& key) {
  a.natural(key.chain.vehicle, 4);
  a.natural(key.chain.epoch, 8);
  a.natural(key.index, 4);
}

template <class Archive, class State>
void state_fields(Archive& a, State& s) {
  a.real(s.stamp_s);
  a.real(s.abscissa_m);
  a.pose(s.pose);
  a.matrix(s.drift);
  a.matrix(s.heading_lever);
}

/// `Fact`: one of the alternatives of AnyFact, const or not.
template <class Archive, class Fact>
void fact_fields(Archive& a, Fact& f) {
  constexpr FactKind kind = kind_of<std::remove_const_t<Fact>>;
  key_fields(a, f.key);
  if constexpr (kind == FactKind::anchor) {
    state_fields(a, f.state);
    a.natural(f.first_landmark, 4);
    a.natural(f.landmark_count, 4);
  } else if constexpr (kind == FactKind::landmark) {
    a.natural(f.anchor, 4);
    a.matrix(f.position);
    a.matrix(f.covariance);
    a.matrix(f.loading);
    a.natural(f.kind, 1);
    a.natural(f.descriptor.kind, 1);
    a.bytes(f.descriptor.bytes);
  } else if constexpr (kind == FactKind::prior) {
    a.natural(f.known, 1);
    a.pose(f.mean);
    a.matrix(f.covariance);
    a.real(f.persistent.scale);
    a.real(f.persistent.heading_rad_per_m);
    a.real(f.persistent.tilt_rad);
    a.real(f.persistent.height_m);
    a.real(f.persistent.correlation_m);
    a.matrix(f.persistent.up);
    a.natural(f.persistent.scales_landmarks, 1);
  } else if constexpr (kind == FactKind::association) {
    a.list(f.pairings, [&a](auto& pairing) {
      key_fields(a, pairing.first);
      key_fields(a, pairing.second);
    });
  } else if constexpr (kind == FactKind::verdict) {
    a.natural(f.hypothesis, 8);
    a.natural(f.veto, 1);
  } else if constexpr (kind == FactKind::absolute_fix) {
    a.natural(f.anchor, 4);
    state_fields(a, f.state);
    a.matrix(f.lever);
    a.matrix(f.position);
    a.matrix(f.covariance);
  } else if constexpr (kind == FactKind::encounter) {
    a.natural(f.anchor, 4);
    state_fields(a, f.state);
    a.natural(f.other, 4);
    a.matrix(f.position);
    a.matrix(f.covariance);
  } else {
    a.natural(f.anchor, 4);
    state_fields(a, f.state);
    key_fields(a, f.encounter);
    a.matrix(f.mark);
  }
}

}  // namespace convoy
