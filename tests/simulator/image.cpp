#include "image.hpp"

namespace convoy::simulator {

std::uint64_t frame_hash(const GreyImage& image) {
  std::uint64_t hash = 0xcbf29ce484222325ULL;
  const auto add = [&hash](std::uint8_t byte) { hash = (hash ^ byte) * 0x100000001b3ULL; };
  for (const int size : {image.width, image.height})
    for (unsigned shift = 0; shift < 32; shift += 8)
      add(static_cast<std::uint8_t>(static_cast<unsigned>(size) >> shift));
  for (const std::uint8_t value : image.values) add(value);
  return hash;
}

}  // namespace convoy::simulator
