// Four values at once.
#pragma once

#include <cstring>

namespace convoy::simulator {

/// Each is rounded as it would be alone.
using Four = float __attribute__((vector_size(16)));
inline Four load(const float* from) {
  Four four;
  std::memcpy(&four, from, sizeof four);
  return four;
}
inline void store(float* to, Four four) { std::memcpy(to, &four, sizeof four); }

}  // namespace convoy::simulator
