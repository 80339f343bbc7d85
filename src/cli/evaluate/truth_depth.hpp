// Which point of the world an image shows where a corner was found, by the true depth of each pixel.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

namespace convoy::cli {

/// Depth at the pixel [m]. Where the pixels around it lie at two depths, the nearer one: the corner of a silhouette is
/// a point of what is in front, and is found to a pixel, so that its own pixel may show what is behind. 0: the sky, or
/// no such pixel.
inline double depth_of_corner(const std::vector<float>& depth_m, int width, int height, double u, double v) {
  constexpr int around = 2;                          // [px]
  constexpr double step_m = 0.5, step_share = 0.05;  // more is no slope
  if (!(u >= -0.5 && v >= -0.5 && u < width && v < height)) return 0.0;
  const int column = static_cast<int>(std::lround(u)), row = static_cast<int>(std::lround(v));
  const auto at = [&](int c, int r) -> double {
    if (c < 0 || r < 0 || c >= width || r >= height) return 0.0;
    return depth_m[static_cast<std::size_t>(r) * static_cast<std::size_t>(width) + static_cast<std::size_t>(c)];
  };
  const double own_m = at(column, row);
  if (column >= width || row >= height) return 0.0;
  double nearest_m = own_m, farthest_m = own_m;
  bool sky = !(own_m > 0.0);
  for (int r = std::max(row - around, 0); r <= std::min(row + around, height - 1); ++r)
    for (int c = std::max(column - around, 0); c <= std::min(column + around, width - 1); ++c) {
      const double d = at(c, r);
      if (!(d > 0.0)) {
        sky = true;
        continue;
      }
      nearest_m = nearest_m > 0.0 ? std::min(nearest_m, d) : d;
      farthest_m = std::max(farthest_m, d);
    }
  const bool two = sky || farthest_m - nearest_m > std::max(step_m, step_share * nearest_m);
  return two ? nearest_m : own_m;
}

}  // namespace convoy::cli
