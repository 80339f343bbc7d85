#include "paint.hpp"

#include "noise.hpp"

#include <algorithm>
#include <cmath>

namespace convoy::simulator {

NoiseTile::NoiseTile(std::uint32_t seed, int size, int finest, int coarsest, double falling, double sigma)
    : mask_(size - 1), values_(static_cast<std::size_t>(size) * static_cast<std::size_t>(size), 0.0F) {
  double strength = 1.0;
  std::uint32_t octave = 0;
  for (int wavelength = coarsest; wavelength >= finest; wavelength /= 2) {
    const double scale = 1.0 / wavelength;
    for (int y = 0; y < size; ++y)
      for (int x = 0; x < size; ++x)
        values_[static_cast<std::size_t>(y * size + x)] +=
            static_cast<float>(strength * value_noise(seed + 101 * octave, x * scale, y * scale, size / wavelength));
    strength *= std::exp2(-falling);
    ++octave;
  }
  double squares = 0.0;
  for (const float value : values_) squares += static_cast<double>(value) * static_cast<double>(value);
  const double norm = sigma / std::sqrt(squares / static_cast<double>(values_.size()));
  for (float& value : values_) value = static_cast<float>(value * norm);
}

Canvas::Canvas(double width_m, double height_m, double texel_m, bool wraps) : texel_m_(texel_m), wraps_(wraps) {
  image_.width = std::max(1, static_cast<int>(std::lround(width_m / texel_m)));
  image_.height = std::max(1, static_cast<int>(std::lround(height_m / texel_m)));
  image_.grey.assign(static_cast<std::size_t>(image_.width) * static_cast<std::size_t>(image_.height), 128);
}

template <typename Change>
void Canvas::each(double x0, double y0, double x1, double y1, Change change) {
  int left = static_cast<int>(std::lround(x0 / texel_m_)), right = static_cast<int>(std::lround(x1 / texel_m_));
  int top = static_cast<int>(std::lround(y0 / texel_m_)), bottom = static_cast<int>(std::lround(y1 / texel_m_));
  if (right == left) ++right;
  if (bottom == top) ++bottom;
  const int width = image_.width, height = image_.height;
  if (!wraps_)
    left = std::max(left, 0), top = std::max(top, 0), right = std::min(right, width), bottom = std::min(bottom, height);
  for (int y = top; y < bottom; ++y) {
    const int row = wraps_ ? ((y % height) + height) % height : y;
    for (int x = left; x < right; ++x) {
      const int column = wraps_ ? ((x % width) + width) % width : x;
      std::uint8_t& texel = image_.grey[static_cast<std::size_t>(row * width + column)];
      const double value = change((x + 0.5) * texel_m_, (y + 0.5) * texel_m_, static_cast<double>(texel));
      texel = static_cast<std::uint8_t>(std::clamp(value + 0.5, 0.0, 255.0));
    }
  }
}

void Canvas::fill(double x0, double y0, double x1, double y1, double grey, double opacity) {
  each(x0, y0, x1, y1, [&](double, double, double old) { return old + opacity * (grey - old); });
}

void Canvas::shade(double x0, double y0, double x1, double y1, double top, double bottom, double opacity) {
  each(x0, y0, x1, y1, [&](double, double y, double old) {
    return old + opacity * (top + (bottom - top) * (y - y0) / (y1 - y0) - old);
  });
}

void Canvas::darken(double x0, double y0, double x1, double y1, double factor, double soft_m) {
  each(x0, y0, x1, y1, [&](double x, double y, double old) {
    const double inside = std::min({x - x0, x1 - x, y - y0, y1 - y});
    const double share = soft_m > 0.0 ? std::clamp(inside / soft_m, 0.0, 1.0) : 1.0;
    return old * (1.0 + share * (factor - 1.0));
  });
}

void Canvas::line(double x0, double y0, double x1, double y1, double width_m, double grey, double opacity) {
  const double half = width_m / 2, soft = texel_m_, dx = x1 - x0, dy = y1 - y0;
  const double squared = std::max(dx * dx + dy * dy, 1e-12), reach = half + soft;
  each(std::min(x0, x1) - reach, std::min(y0, y1) - reach, std::max(x0, x1) + reach, std::max(y0, y1) + reach,
       [&](double x, double y, double old) {
         const double t = std::clamp(((x - x0) * dx + (y - y0) * dy) / squared, 0.0, 1.0);
         const double away = std::hypot(x - x0 - t * dx, y - y0 - t * dy);
         return old + opacity * std::clamp((half - away) / soft + 0.5, 0.0, 1.0) * (grey - old);
       });
}

void Canvas::disc(double x, double y, double radius_m, double grey, double opacity) {
  line(x, y, x, y, 2 * radius_m, grey, opacity);
}

void Canvas::roughen(const NoiseTile& tile, double strength, int offset_x, int offset_y, int scale) {
  for (int y = 0; y < image_.height; ++y) {
    for (int x = 0; x < image_.width; ++x) {
      std::uint8_t& texel = image_.grey[static_cast<std::size_t>(y * image_.width + x)];
      const double value = texel + strength * static_cast<double>(tile.at(x / scale + offset_x, y / scale + offset_y));
      texel = static_cast<std::uint8_t>(std::clamp(value + 0.5, 0.0, 255.0));
    }
  }
}

void Canvas::crack(Stream& random, double x, double y, double angle_rad, double length_m, double width_m, double grey) {
  constexpr double step = 0.04;
  double angle = angle_rad;
  for (double done = 0.0; done < length_m; done += step) {
    angle += random.uniform(-0.55, 0.55) + 0.1 * (angle_rad - angle);
    const double next_x = x + step * std::cos(angle), next_y = y + step * std::sin(angle);
    line(x, y, next_x, next_y, width_m * (1.0 - 0.6 * done / length_m), grey, 0.8);
    x = next_x, y = next_y;
  }
}

void Canvas::letters(Stream& random, double x, double y, double h, int count, double grey) {
  const double width = 0.55 * h, stroke = std::max(0.15 * h, 1.2 * texel_m_);
  for (int i = 0; i < count; ++i, x += width + 0.25 * h) {
    // A few strokes between the nodes of a grid of 2 x 3, one of them upright.
    line(x, y, x, y + h, stroke, grey);
    const int strokes = 1 + static_cast<int>(random.below(3));
    for (int s = 0; s < strokes; ++s) {
      const double from_x = x + width * random.below(2), from_y = y + h * random.below(3) / 2.0;
      const double to_x = x + width * (s == 0 ? 1.0 : random.below(2)), to_y = y + h * random.below(3) / 2.0;
      line(from_x, from_y, to_x, to_y, stroke, grey);
    }
  }
}

void Canvas::frame(double x0, double y0, double x1, double y1, double width_m, double grey) {
  fill(x0, y0, x1, y0 + width_m, grey);
  fill(x0, y1 - width_m, x1, y1, grey);
  fill(x0, y0, x0 + width_m, y1, grey);
  fill(x1 - width_m, y0, x1, y1, grey);
}

Texture plain(std::uint8_t grey) { return {1, 1, {grey}}; }

}  // namespace convoy::simulator
