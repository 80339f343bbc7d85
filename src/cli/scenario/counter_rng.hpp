// Random numbers by counter (Philox4x32-10: Salmon, Moraes, Dror, Shaw: Parallel random numbers: as easy as 1, 2, 3,
// SC 2011). A number is a pure function of its key and its place, so streams cannot disturb one another, whatever is
// drawn, in whatever order; and there is no std:: distribution, whose numbers differ between standard libraries.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

namespace convoy::cli {

/// One Philox4x32-10 block.
constexpr std::array<std::uint32_t, 4> philox4x32(std::array<std::uint32_t, 4> counter,
                                                  std::array<std::uint32_t, 2> key) {
  for (int round = 0; round < 10; ++round) {
    const std::uint64_t a = std::uint64_t{0xD2511F53U} * counter[0];
    const std::uint64_t b = std::uint64_t{0xCD9E8D57U} * counter[2];
    counter = {static_cast<std::uint32_t>(b >> 32) ^ counter[1] ^ key[0], static_cast<std::uint32_t>(b),
               static_cast<std::uint32_t>(a >> 32) ^ counter[3] ^ key[1], static_cast<std::uint32_t>(a)};
    key[0] += 0x9E3779B9U;
    key[1] += 0xBB67AE85U;
  }
  return counter;
}

/// The stream of one sensor (`stream`) of one vehicle (0: the world) in a run with this seed.
class CounterRng {
 public:
  constexpr CounterRng(std::uint64_t seed, std::uint32_t vehicle, std::uint32_t stream)
      : key_{static_cast<std::uint32_t>(seed), static_cast<std::uint32_t>(seed >> 32)},
        vehicle_(vehicle),
        stream_(stream) {}

  /// In [0, 1), 53 bits, at place (i, j).
  double uniform(std::uint32_t i, std::uint32_t j = 0) const {
    const auto w = block(i, j);
    return unit(w[0], w[1]);
  }

  /// N(0, 1) at place (i, j) (Box-Muller).
  double normal(std::uint32_t i, std::uint32_t j = 0) const {
    const auto w = block(i, j);
    const double radius = std::sqrt(-2.0 * std::log(1.0 - unit(w[0], w[1])));
    return radius * std::cos(2.0 * M_PI * unit(w[2], w[3]));
  }

 private:
  std::array<std::uint32_t, 4> block(std::uint32_t i, std::uint32_t j) const {
    return philox4x32({i, j, vehicle_, stream_}, key_);
  }
  static double unit(std::uint32_t high, std::uint32_t low) {
    return static_cast<double>(((std::uint64_t{high} << 32) | low) >> 11) * 0x1p-53;
  }

  std::array<std::uint32_t, 2> key_;
  std::uint32_t vehicle_;
  std::uint32_t stream_;
};

}  // namespace convoy::cli
