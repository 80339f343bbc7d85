// What was sensed, in a number (FNV-1a, 64 bit): the same for the same, wherever it was made.
#pragma once

#include "sensor_data.hpp"

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>

namespace convoy::simulator {

class Digest {
 public:
  void add_bytes(const void* data, std::size_t size);
  void add(std::uint64_t value) { add_bytes(&value, sizeof value); }
  void add(double value) { add_bytes(&value, sizeof value); }
  void add(const VehicleStep& step);  ///< everything but the truth
  std::uint64_t value() const { return value_; }
  std::string text() const;  ///< 16 hexadecimal digits

 private:
  std::uint64_t value_ = 0xcbf29ce484222325ULL;
};

/// Of the pixels alone.
std::string digest_of(const FrameData& frame);
/// Of the bytes; that of an empty one if it cannot be read.
std::string digest_of(const std::filesystem::path& file);

}  // namespace convoy::simulator
