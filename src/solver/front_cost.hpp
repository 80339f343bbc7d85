#pragma once

namespace convoy {

/// Roughly what assembling and factoring a front takes, in nanoseconds; decides which fronts are merged. The constants
/// are good to a factor of two, which is all that choice needs.
inline double front_cost(double columns, double rows) {
  const double below = rows - columns;
  const double flops = columns * (columns * columns / 3.0 + columns * below + below * below);
  return 150.0 + 0.5 * columns * rows + 0.5 * below * below + 0.1 * flops;
}

}  // namespace convoy
