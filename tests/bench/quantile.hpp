#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace convoy::bench {

/// The value that a share p of all lies below; 0 if there are none.
inline double quantile(std::vector<double> values, double p) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1, static_cast<std::size_t>(p * static_cast<double>(values.size())))];
}

}  // namespace convoy::bench
