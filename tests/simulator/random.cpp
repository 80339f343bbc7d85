#include "random.hpp"

#include <cmath>

namespace convoy::simulator {
namespace {

std::uint32_t high_of(std::uint64_t product) { return static_cast<std::uint32_t>(product >> 32U); }
std::uint32_t low_of(std::uint64_t product) { return static_cast<std::uint32_t>(product); }

std::array<std::uint32_t, 4> philox(std::array<std::uint32_t, 4> counter, std::array<std::uint32_t, 2> key) {
  for (int round = 0; round < 10; ++round) {
    const std::uint64_t a = 0xD2511F53ULL * counter[0], b = 0xCD9E8D57ULL * counter[2];
    counter = {high_of(b) ^ counter[1] ^ key[0], low_of(b), high_of(a) ^ counter[3] ^ key[1], low_of(a)};
    key[0] += 0x9E3779B9U;
    key[1] += 0xBB67AE85U;
  }
  return counter;
}

}  // namespace

Stream::result_type Stream::operator()() {
  if (left_ == 0) {
    numbers_ = philox({low_of(block_), key_.frame, key_.sensor, high_of(block_)}, {key_.seed, key_.vehicle});
    ++block_;
    left_ = 4;
  }
  return numbers_[--left_];
}

double Stream::uniform(double low, double high) {
  const std::uint64_t bits = (static_cast<std::uint64_t>((*this)()) << 32U) | (*this)();
  return low + (high - low) * (static_cast<double>(bits >> 11U) * 0x1p-53);
}

double Stream::gaussian() {
  const double radius = std::sqrt(-2.0 * std::log(1.0 - uniform(0.0, 1.0)));
  return radius * std::cos(uniform(0.0, 2.0 * M_PI));
}

std::uint32_t Stream::below(std::uint32_t n) {
  return static_cast<std::uint32_t>((static_cast<std::uint64_t>((*this)()) * n) >> 32U);
}

}  // namespace convoy::simulator
