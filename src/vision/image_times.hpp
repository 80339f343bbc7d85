#pragma once

#include <convoy/vision/image_source.hpp>

#include <optional>
#include <vector>

namespace convoy {

struct StampedName {
  double stamp_s = 0.0;
  std::string name;  ///< of the picture; empty: not told
  std::size_t line = 0;
};

/// See ImageTimes::times. Throws ConfigError with file:line.
std::vector<StampedName> read_times(const std::filesystem::path& file);

/// Throws ConfigError if it is not in (0, 10000].
void check_rate(double rate_hz, const std::string& source);

}  // namespace convoy
