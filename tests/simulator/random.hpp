// Counter-based random numbers (Philox 4x32-10, Salmon et al., SC 2011): a number is a function of where it stands, so
// that a sensor's noise in one frame depends neither on how many numbers were drawn before nor on who else draws.
#pragma once

#include <array>
#include <cstdint>

namespace convoy::simulator {

/// What a stream is of. Streams with different keys are independent.
struct StreamKey {
  std::uint32_t seed = 1;     ///< of the run
  std::uint32_t vehicle = 0;  ///< 0: the world
  std::uint32_t sensor = 0;   ///< by numbers of the caller's own
  std::uint32_t frame = 0;    ///< reading of the sensor
};

/// Numbers in the order of being asked for; the same key gives the same ones. Also a UniformRandomBitGenerator, but the
/// distributions of the standard library differ from one library to another: use the members.
class Stream {
 public:
  using result_type = std::uint32_t;
  explicit Stream(const StreamKey& key) : key_(key) {}

  static constexpr result_type min() { return 0; }
  static constexpr result_type max() { return 0xffffffffU; }
  result_type operator()();

  double uniform(double low, double high);  ///< [low, high)
  double gaussian();                        ///< N(0, 1)
  std::uint32_t below(std::uint32_t n);     ///< 0..n-1, n >= 1
  bool chance(double probability) { return uniform(0.0, 1.0) < probability; }

 private:
  StreamKey key_;
  std::uint64_t block_ = 0;
  std::array<std::uint32_t, 4> numbers_{};
  unsigned left_ = 0;
};

}  // namespace convoy::simulator
