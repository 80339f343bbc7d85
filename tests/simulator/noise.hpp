// Noise that is a function of where it is asked for.
#pragma once

#include <cmath>
#include <cstdint>

namespace convoy::simulator {

/// A number in [-1, 1) of a lattice point.
inline double lattice_noise(std::uint32_t seed, std::int32_t x, std::int32_t y) {
  std::uint32_t h = seed * 0x9E3779B1U ^ static_cast<std::uint32_t>(x) * 0x85EBCA77U;
  h = (h ^ (h >> 15U)) * 0x2C1B3C6DU ^ static_cast<std::uint32_t>(y) * 0xC2B2AE3DU;
  h = (h ^ (h >> 13U)) * 0x297A2D39U;
  h ^= h >> 16U;
  return static_cast<double>(h) * 0x1p-31 - 1.0;
}

/// Smooth, in (-1, 1), of wavelength about 2; `period` > 0 makes it repeat after so many lattice points.
inline double value_noise(std::uint32_t seed, double x, double y, int period = 0) {
  const double floor_x = std::floor(x), floor_y = std::floor(y);
  const auto ease = [](double t) { return t * t * (3.0 - 2.0 * t); };
  const double u = ease(x - floor_x), v = ease(y - floor_y);
  const auto at = [&](int dx, int dy) {
    int ix = static_cast<int>(floor_x) + dx, iy = static_cast<int>(floor_y) + dy;
    if (period > 0) ix = ((ix % period) + period) % period, iy = ((iy % period) + period) % period;
    return lattice_noise(seed, ix, iy);
  };
  const double low = at(0, 0) + u * (at(1, 0) - at(0, 0)), high = at(0, 1) + u * (at(1, 1) - at(0, 1));
  return low + v * (high - low);
}

}  // namespace convoy::simulator
