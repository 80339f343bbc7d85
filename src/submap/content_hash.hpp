// A byte-order independent content hash (FNV-1a, 64 bit, finished with the mixer of MurmurHash3).
#pragma once

#include <convoy/submap/facts.hpp>

#include <Eigen/Core>
#include <bit>
#include <cstdint>

namespace convoy {

class ContentHash {
 public:
  ContentHash& add(std::uint64_t value, int bytes = 8) {
    for (int i = 0; i < bytes; ++i) {
      state_ ^= (value >> (8 * i)) & 0xffU;
      state_ *= 0x100000001b3U;
    }
    return *this;
  }
  /// -0.0 and 0.0 are the same number and hash alike.
  ContentHash& add(double value) { return add(std::bit_cast<std::uint64_t>(value == 0.0 ? 0.0 : value)); }
  template <class Derived>
  ContentHash& add(const Eigen::MatrixBase<Derived>& m) {
    for (Eigen::Index c = 0; c < m.cols(); ++c)
      for (Eigen::Index r = 0; r < m.rows(); ++r) add(static_cast<double>(m(r, c)));
    return *this;
  }
  std::uint64_t value() const {
    std::uint64_t h = state_;
    h = (h ^ (h >> 33)) * 0xff51afd7ed558ccdU;
    h = (h ^ (h >> 33)) * 0xc4ceb9fe1a85ec53U;
    return h ^ (h >> 33);
  }

 private:
  std::uint64_t state_ = 0xcbf29ce484222325U;
};

inline void add_key(ContentHash& hash, const Key& key) {
  hash.add(key.chain.vehicle, 4).add(key.chain.epoch).add(key.index, 4);
}

}  // namespace convoy
