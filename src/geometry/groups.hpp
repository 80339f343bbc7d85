// The groups convoy is built for. Every template of the core is instantiated for exactly these.
#pragma once

#include <convoy/geometry/se2.hpp>
#include <convoy/geometry/se3.hpp>

/// Expands MACRO(G) once per group.
#define CONVOY_FOR_EACH_GROUP(MACRO) \
  MACRO(::convoy::SE2)               \
  MACRO(::convoy::SE3)

namespace convoy {

/// use(G()) with the group of a fleet whose dimension is known at run time alone: 2, or else 3.
template <class Use>
decltype(auto) with_group(int dimension, const Use& use) {
  return dimension == 2 ? use(SE2()) : use(SE3());
}

/// Feeds the coordinates of a group element to a content hash.
template <class HashLike>
void add_group(HashLike& hash, const SE2& T) {
  hash.add(T.translation()).add(T.theta());
}
template <class HashLike>
void add_group(HashLike& hash, const SE3& T) {
  hash.add(T.translation()).add(T.quaternion());
}

}  // namespace convoy
